"""Interacting vehicles: counted by hand, by brute force over pairs, and as a user counts them."""

from __future__ import annotations

import csv
import json
import sys
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from conftest import crossing_lanes, scene_of
from hypothesis import given
from hypothesis import strategies as st

from hatn_sim import cli
from hatn_sim.datatypes import Frame, Kind, Scene, Truth
from hatn_sim.graph import build_graphs
from hatn_sim.perception import Perception, begin, perceive
from hatn_sim.report.density_figure import all_counts, bar_width, draw_density
from hatn_sim.resources import scenes_to_test_on
from hatn_sim.road import Road
from hatn_sim.score.density import (
    CRITERIA,
    Density,
    clustered_over,
    conflicting,
    count_interacting,
    counts_of,
    criteria_of,
    density_scores,
    histogram,
    pool,
    pool_runs,
    summarise,
)

NORTH = np.pi / 2
STANDING = (0.0, 0.0)  # yaw, speed
Vehicles = dict[str, tuple[float, float, float, float]]

CROSSING: Vehicles = {
    "west": (-40.0, 0.0, 0.0, 10.0),
    "south": (0.0, -30.0, NORTH, 8.0),
    "behind": (0.0, -42.0, NORTH, 8.0),
    "far": (0.0, -61.0, NORTH, 8.0),  # 61 m before the crossing
    "gone": (0.0, 20.0, NORTH, 8.0),  # 20 m past it
    "astray": (300.0, 300.0, 0.0, 5.0),  # on no line
}


def frames_of(vehicles: Vehicles, count: int) -> Iterator[Frame]:
    """Frames in which everybody drives straight on; the positions given are those of the last."""
    for index in range(count):
        back_s = 0.1 * (count - 1 - index)
        moved = {
            name: (x - v * back_s * np.cos(yaw), y - v * back_s * np.sin(yaw), yaw, v)
            for name, (x, y, yaw, v) in vehicles.items()
        }
        yield frame_of(scene_of(0.1 * index, moved))


def frame_of(scene: Scene) -> Frame:
    return Frame(scene, Truth((None,) * len(scene.ids)), done=False)


def seen_of(road: Road, frames: Iterator[Frame]) -> Perception:
    state = begin(road)
    for frame in frames:
        state = perceive(state, frame.scene, None)
    return state.seen


def density_of(count: list[list[int]], has_line: list[bool] | None = None) -> Density:
    """Samples of one run, all of one vehicle."""
    nothing = np.zeros(len(count), dtype=np.int64)
    lines = np.array([True] * len(count) if has_line is None else has_line)
    return Density(nothing, nothing, np.array(count), lines)


# ---------------------------------------------------------------------------------------------
# Counts


def test_a_crossing_by_hand() -> None:
    road = Road(crossing_lanes())
    found = count_interacting(road, frames_of(CROSSING, 16), watched=15)
    assert found.vehicle.tolist() == [0, 1, 2, 3, 4, 5]
    assert found.has_line.tolist() == [True] * 5 + [False]
    assert dict(zip(CROSSING, found.count.tolist(), strict=True)) == {
        # Centres: west-south 50 m, south-behind 12 m, behind-far 19 m, south-far 31 m.
        "west": [5, 0, 0, 2],  # south and behind; far is 61 m before the crossing, gone past it
        "south": [5, 1, 0, 1],
        "behind": [5, 2, 0, 1],
        "far": [5, 1, 0, 0],
        "gone": [5, 0, 0, 0],
        "astray": [5, 0, 0, 0],
    }
    assert counts_of(found, "conflict").tolist() == [2, 1, 1, 0, 0]


@pytest.mark.parametrize(
    ("apart_m", "within"),
    [(9.999, [1, 1]), (10.0, [1, 1]), (10.001, [1, 0]), (30.0, [1, 0]), (30.001, [0, 0])],
)
def test_distances_around_the_limits(apart_m: float, within: list[int]) -> None:
    road = Road(crossing_lanes())
    pair = {"one": (100.0, 0.0, *STANDING), "other": (100.0 + apart_m, 0.0, *STANDING)}
    found = count_interacting(road, frames_of(pair, 1))
    assert found.count[:, 1:3].tolist() == [within, within]


@pytest.mark.parametrize(("to_crossing_m", "interacts"), [(59.7, True), (60.3, False)])
@pytest.mark.parametrize("name", ["west", "south"])
def test_a_conflict_within_sixty_metres_of_both(
    name: str, to_crossing_m: float, interacts: bool
) -> None:
    at_m = {"west": 40.0, "south": 40.0, name: to_crossing_m}
    pair = {"west": (-at_m["west"], 0.0, 0.0, 8.0), "south": (0.0, -at_m["south"], NORTH, 8.0)}
    found = count_interacting(Road(crossing_lanes()), frames_of(pair, 16), watched=15)
    assert found.count[:, 3].tolist() == [int(interacts)] * 2


@pytest.mark.parametrize(("past_m", "interacts"), [(1.7, True), (2.3, False)])
def test_a_conflict_is_over_two_metres_past_it(past_m: float, interacts: bool) -> None:
    pair = {"west": (past_m, 0.0, 0.0, 8.0), "south": (0.0, -40.0, NORTH, 8.0)}
    found = count_interacting(Road(crossing_lanes()), frames_of(pair, 16), watched=15)
    assert found.count[:, 3].tolist() == [int(interacts)] * 2


def test_pedestrians_are_neither_egos_nor_counted() -> None:
    def with_one_on_foot(frame: Frame) -> Frame:
        kind = np.where(np.array(frame.scene.ids) == "south", Kind.PEDESTRIAN, frame.scene.kind)
        return frame_of(replace(frame.scene, kind=kind))

    road = Road(crossing_lanes())
    frames = (with_one_on_foot(frame) for frame in frames_of(CROSSING, 16))
    found = count_interacting(road, frames, watched=15)
    assert found.count[:, 0].tolist() == [4] * 5
    assert found.count[0].tolist() == [4, 0, 0, 1]  # west: behind is left


def test_samples_are_half_a_second_apart_and_vehicles_keep_their_numbers() -> None:
    frames = list(frames_of(CROSSING, 18))
    alone = scene_of(2.0, {"new": (50.0, 0.0, 0.0, 8.0), "south": (0.0, -29.0, NORTH, 8.0)})
    frames[12] = frame_of(alone)
    found = count_interacting(Road(crossing_lanes()), iter(frames), watched=2)
    # Frames 2, 7, 12 and 17 are sampled.
    assert found.vehicle.tolist() == [*range(6), *range(6), 6, 1, *range(6)]
    assert found.count[12:14].tolist() == [[1, 0, 0, 0]] * 2


def test_nobody_there() -> None:
    road = Road(crossing_lanes())
    nobody = frame_of(scene_of(0.0, {}))
    assert not len(count_interacting(road, [nobody] * 3).run)
    single = count_interacting(road, frames_of({"one": (50.0, 0.0, *STANDING)}, 1))
    assert single.count.tolist() == [[0, 0, 0, 0]]


# ---------------------------------------------------------------------------------------------
# Against a loop over pairs, and against the graph

PLACES = {
    "w": lambda m: (-m, 0.0, 0.0),
    "s": lambda m: (0.0, -m, NORTH),
    "e": lambda m: (m, 0.0, 0.0),
    "n": lambda m: (0.0, m, NORTH),
}


@st.composite
def traffic(draw: st.DrawFn) -> Vehicles:
    """Up to 14 vehicles on the arms of the crossing, 12 m and more from it, at 3 to 12 m/s."""
    rows = draw(
        st.lists(
            st.tuples(st.sampled_from("wsen"), st.floats(12.0, 75.0), st.floats(3.0, 12.0)),
            min_size=1,
            max_size=14,
        )
    )
    return {f"v{k}": (*PLACES[arm](m), speed) for k, (arm, m, speed) in enumerate(rows)}


@given(traffic())
def test_conflicts_are_those_of_a_loop_over_pairs(vehicles: Vehicles) -> None:
    road = Road(crossing_lanes())
    seen = seen_of(road, frames_of(vehicles, 8))
    expected = [0] * len(vehicles)
    for i in range(len(vehicles)):
        for j in range(len(vehicles)):
            one, other = seen.lines.line[i], seen.lines.line[j]
            if i == j or one < 0 or other < 0 or one == other:
                continue
            expected[i] += any(
                -2.0 < conflict.point_s_m[0] - seen.lines.s_m[i] <= 60.0
                and -2.0 < conflict.point_s_m[1] - seen.lines.s_m[j] <= 60.0
                for conflict in road.conflicts(int(one), int(other))
            )
    assert conflicting(road, seen, np.arange(len(vehicles))).tolist() == expected


@given(traffic())
def test_capped_the_counts_are_the_nodes_of_the_graphs(vehicles: Vehicles) -> None:
    road = Road(crossing_lanes())
    found = count_interacting(road, frames_of(vehicles, 8), watched=7)
    graphs = build_graphs(road, seen_of(road, frames_of(vehicles, 8)))
    nodes = graphs.node_mask[:, 1:].sum(axis=1)
    assert counts_of(found, "conflict_capped").tolist() == nodes.tolist()


# ---------------------------------------------------------------------------------------------
# Figures


def test_summary_by_hand() -> None:
    found = density_of([[k, 0, 0, 2 * k] for k in range(10)], [k < 5 for k in range(10)])
    every = summarise(found, "all")
    assert (every.n, every.mean, every.median, every.maximum) == (10, 4.5, 4.5, 9)
    assert every.ninetieth == 8.0  # nine of ten are at most 8
    assert every.none_share == 0.1
    assert summarise(found, "30m").none_share == 1.0
    lines = summarise(found, "conflict")  # 0, 2, 4, 6, 8
    assert (lines.n, lines.mean, lines.maximum, lines.none_share) == (5, 4.0, 8, 0.2)
    assert criteria_of(found) == (*CRITERIA, "conflict_capped")
    assert summarise(found, "conflict_capped").mean == (0 + 2 + 4 + 6 + 7) / 5
    assert criteria_of(density_of([[0, 0, 0, 7]])) == CRITERIA


def test_no_samples_have_no_value() -> None:
    assert summarise(pool([]), "conflict").mean is None
    for score in density_scores("nowhere", pool_runs([pool([])])):
        assert (score.n, score.value, score.low, score.high) == (0, None, None, None)


def test_intervals_are_over_vehicles_and_from_five_runs_on_over_runs() -> None:
    two = Density(
        run=np.zeros(4, dtype=np.int64),
        vehicle=np.array([0, 0, 1, 1]),
        count=np.array([[1, 0, 0, 0]] * 2 + [[3, 0, 0, 0]] * 2),
        has_line=np.array([True] * 4),
    )
    score = density_scores("here", pool_runs([two, two]))[0]
    assert (score.measure, score.predictor, score.value, score.n) == ("density_all", "-", 2.0, 8)
    assert score.low is not None and score.high is not None
    assert 1.0 <= score.low < 2.0 < score.high <= 3.0
    five = pool_runs([two] * 5)
    assert (clustered_over(pool_runs([two] * 4)), clustered_over(five)) == ("vehicles", "seeds")
    score = density_scores("here", five)[0]
    assert (score.low, score.high) == (2.0, 2.0)  # all runs are equal


@pytest.mark.parametrize(
    ("last", "width"), [(0, 1), (39, 1), (40, 2), (79, 2), (80, 5), (399, 10), (5000, 200)]
)
def test_bars_are_few_and_round(last: int, width: int) -> None:
    assert bar_width(last) == width


def test_a_histogram_by_hand() -> None:
    first, samples = histogram(np.array([0, 1, 1, 4, 5]), 2)
    assert (first.tolist(), samples.tolist()) == ([0, 2, 4], [3, 0, 2])


def test_the_figure_is_drawn_of_anything_and_equal_for_equal_samples(tmp_path: Path) -> None:
    densities = {
        "busy": density_of([[350, 12, 2, 9], [20, 1, 0, 0]]),
        "nobody": pool([]),
        "a very long path to a scene of the user's own": density_of([[0, 0, 0, 0]], [False]),
    }
    for name in ("a", "b"):
        counts = {label: all_counts(density) for label, density in densities.items()}
        draw_density(counts, [tmp_path / f"{name}.png", tmp_path / f"{name}.pdf"])
    for suffix, magic in ((".png", b"\x89PNG"), (".pdf", b"%PDF")):
        drawn = (tmp_path / f"a{suffix}").read_bytes()
        assert drawn.startswith(magic)
        assert drawn == (tmp_path / f"b{suffix}").read_bytes()


# ---------------------------------------------------------------------------------------------
# The command


def evaluate(*words: object) -> int:
    try:
        return cli.main(["evaluate", *(str(word) for word in words)])
    except SystemExit as leaving:
        assert isinstance(leaving.code, int)
        return leaving.code


def test_another_table_is_handed_what_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Namespace] = []
    module = ModuleType("hatn_sim.commands.evaluate_lines")
    module.main = lambda arguments: asked.append(arguments) or 0  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    assert evaluate("--table", "lines") == 0
    assert evaluate("--table", "lines", "--scenes", "a,b.sumocfg", "--seeds", "2-3") == 0
    first, second = asked
    assert (first.scenes, first.seeds, first.duration) == (scenes_to_test_on(), (1,), 120.0)
    assert (first.warm_up, first.out, first.json, first.quiet) == (None, None, False, False)
    assert (second.scenes, second.seeds) == (("a", "b.sumocfg"), (2, 3))


@pytest.mark.slow
def test_a_shipped_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = ("--table", "density", "--scenes", "roundabout8", "--duration", 5, "--warm-up", 20)
    out = tmp_path / "new" / "out"
    assert evaluate(*run, "--seeds", "1-2", "--json", "--quiet", "--out", out) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    scores = {score["measure"]: score for score in json.loads(printed.out)}
    assert list(scores) == ["density_all", "density_30m", "density_10m", "density_conflict"]
    assert {score["scene"] for score in scores.values()} == {"roundabout8"}
    assert scores["density_conflict"]["predictor"] == "semantic graph"
    assert scores["density_all"]["value"] >= scores["density_30m"]["value"]
    assert scores["density_30m"]["value"] >= scores["density_10m"]["value"] > 0
    with (out / "density.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for criterion in CRITERIA:
        of_it = [row for row in rows if row["criterion"] == criterion]
        n = sum(int(row["samples"]) for row in of_it)
        total = sum(int(row["interacting_vehicles"]) * int(row["samples"]) for row in of_it)
        assert n == scores[f"density_{criterion}"]["n"]
        assert total / n == pytest.approx(scores[f"density_{criterion}"]["value"])
        assert sum(float(row["share"]) for row in of_it) == pytest.approx(1.0, abs=1e-5)
    assert (out / "density.png").is_file() and (out / "density.pdf").is_file()

    assert evaluate(*run, "--out", out) == 2
    assert f"{out / 'density.csv'}: exists already" in capsys.readouterr().err

    assert evaluate(*run, "--quiet", "--out", tmp_path) == 0
    printed_table = capsys.readouterr().out
    assert "conflicting lines" in printed_table
    assert "bootstrapped over vehicles" in printed_table
    assert str(tmp_path / "density.png") in printed_table.replace("\n", "")


class Recorded:
    """A recording of the crossing's traffic, in frames of which the last says so."""

    name, notices, lanes = "crossing", ("three arms only",), crossing_lanes()

    def frames(self) -> Iterator[Frame]:
        *before, last = frames_of(CROSSING, 16)
        yield from before
        yield replace(last, done=True)


def test_recorded_tracks_are_played_once_and_to_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = ModuleType("hatn_sim.recordings.find")
    module.open_recording = lambda name, source: Recorded()  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    tracks, lanes = tmp_path / "tracks.csv", tmp_path / "map.osm"
    tracks.touch()
    lanes.touch()
    words = ("--table", "density", "--tracks", tracks, "--map", lanes, "--out", tmp_path / "out")
    assert evaluate(*words, "--seeds", "1-9", "--json") == 0
    printed = capsys.readouterr()
    assert printed.err.splitlines()[0] == "hatn-sim: tracks: three arms only"
    scores = {score["measure"]: score for score in json.loads(printed.out)}
    # Frames 0, 5, 10 and 15 of six vehicles; one of them is on no line.
    assert (scores["density_all"]["n"], scores["density_conflict"]["n"]) == (24, 20)
    assert scores["density_all"]["value"] == 5.0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--table", "densty"), "argument --table: invalid choice: 'densty'"),
        (("--table", "density", "--predictors", "idm"), "--predictors is of no use to --table de"),
        (("--table", "density", "--scenes", "roundabot8"), "unknown scene 'roundabot8'; did you"),
        (("--table", "density", "--map", "a.osm"), "--map a.osm goes with --tracks; leave it out"),
        (("--table", "density", "--tracks", "no_*.csv"), "no_*.csv: there are no such tracks"),
        (("--table", "lines", "--tracks", "a.csv"), "--table lines: recorded tracks know no rout"),
        (("--table", "density", "--seeds", "5-1"), "argument --seeds: expected seeds in rising"),
        (("--table", "density", "--out", "file"), "file: expected a folder, found a file"),
    ],
)
def test_mistakes_are_one_line(
    words: tuple[str, ...],
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    assert evaluate(*words) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = printed.err.splitlines()
    assert line.startswith(f"hatn-sim: {expected}")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
