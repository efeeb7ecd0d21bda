"""Figures of runs and of tables, and films, on a crossing made by hand."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import pytest
from conftest import lane
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image
from test_export import driving, log
from test_picture import FRAMES, SPEED_MPS, START_M, SURE_OF_PASS, write_run

from hatn_sim.cli import main
from hatn_sim.datatypes import HORIZON_FRAMES, Gate, Score, Suggestion
from hatn_sim.evaluation.comparison import write_curves
from hatn_sim.evaluation.paper import TABLES
from hatn_sim.evaluation.table import AblationRow, compare
from hatn_sim.evaluation.table import write_csv as write_entries
from hatn_sim.learn.adaptation_rows import AdaptationRow, Change, write_csv
from hatn_sim.log import Run, read_run
from hatn_sim.log.road_file import ROAD_FILE, write_road
from hatn_sim.report import (
    assistance_figure,
    calibration_figure,
    run_figures,
    space_time_figure,
    steps_figure,
)
from hatn_sim.report import space_time as space_time_of
from hatn_sim.report.adaptation_file import read_adaptation
from hatn_sim.report.assistance_figure import compared_by_scene, events_by_scene
from hatn_sim.report.kept_numbers import read_beside, read_curves, read_density, read_scores
from hatn_sim.report.moment import Moment, moment_at
from hatn_sim.report.policy_figure import spread
from hatn_sim.report.space_time import free_spans, passing_time_s, space_time
from hatn_sim.report.steps_figure import read_steps, write_steps
from hatn_sim.report.table import write_scores
from hatn_sim.report.traffic_figure import speeds_over_time
from hatn_sim.score.driven import driven_in
from hatn_sim.score.events import severe_events
from hatn_sim.score.prediction import score_runs
from hatn_sim.score.slot_calibration import reliability, slot_reliability
from hatn_sim.score.steps import StepErrors, errors_by_step
from hatn_sim.score.sweep import Operating

AXES: Final = ("east", "north")


@pytest.fixture(scope="module")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return write_run(tmp_path_factory.mktemp("runs") / "crossing")


# -- what is drawn --------------------------------------------------------------------------------


def test_reliability_by_hand() -> None:
    said = np.array([0.51, 0.52, 0.99, 1.0, 0.97])
    true = np.array([True, False, True, True, False])
    found = reliability("made_up", "likeliest", said, true, np.arange(5))
    # Of 15 bins, the eighth begins at 7/15 = 0.467, the last at 14/15 = 0.933.
    assert found.n.tolist() == [0] * 7 + [2] + [0] * 6 + [3]
    assert found.said[7] == pytest.approx(0.515) and found.came_true[7] == pytest.approx(0.5)
    assert found.came_true[14] == pytest.approx(2.0 / 3.0)
    gap = 2.0 * (0.515 - 0.5) + 3.0 * ((0.99 + 1.0 + 0.97) / 3.0 - 2.0 / 3.0)
    assert found.ece == pytest.approx(gap / 5.0)
    assert np.isnan(found.low[0]) and found.low[14] <= 2.0 / 3.0 <= found.high[14]


def test_calibration_is_that_of_the_scores(crossing: Run) -> None:
    (score,) = [s for s in score_runs([crossing]) if s.measure == "slot_ece"]
    found = [one for one in slot_reliability(crossing) if one.answer == "likeliest"]
    assert (sum(one.n.sum() for one in found), bool(found)) == (score.n, score.n > 0)
    for one in found:
        assert one.ece == pytest.approx(score.value)


def test_speeds_are_numpys_quantiles(crossing: Run) -> None:
    count, quantiles = speeds_over_time(crossing)
    assert count.tolist() == [2.0] * FRAMES
    np.testing.assert_allclose(quantiles, SPEED_MPS)
    tracks = crossing.tracks
    rng = np.random.default_rng(0)
    speed = rng.uniform(0.0, 20.0, len(tracks.speed_mps))
    object.__setattr__(tracks, "speed_mps", speed)
    _, quantiles = speeds_over_time(crossing)
    for frame in range(0, FRAMES, 7):
        expected = np.quantile(speed[tracks.frame == frame], (0.1, 0.5, 0.9))
        np.testing.assert_allclose(quantiles[:, frame], expected)


# -- numbers that are kept ------------------------------------------------------------------------


def test_what_is_written_is_read(tmp_path: Path, crossing: Run) -> None:
    errors = errors_by_step([crossing])
    write_steps(tmp_path / "steps.csv", errors)
    for one, again in zip(errors, read_steps(tmp_path / "steps.csv"), strict=True):
        assert (one.scene, one.predictor, one.subset, one.n) == (
            again.scene, again.predictor, again.subset, again.n,
        )  # fmt: skip
        np.testing.assert_allclose(again.mean_m, one.mean_m, atol=1e-6)
        np.testing.assert_allclose(again.low_m, one.low_m, atol=1e-6)
    curves = {"a": {"hatn": [Operating(0.5, 1.0, 0.9, 0.8, float("nan"))], "ttc": []}}
    write_curves(tmp_path / "curves.csv", curves)
    (again,) = read_curves(tmp_path / "curves.csv")["a"]["hatn"]
    assert again.event_recall == 0.9 and np.isnan(again.lead_time_s)
    scores = score_runs([crossing])
    assert read_scores(write_scores(tmp_path, scores)) == scores


def test_a_table_is_drawn_from_its_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rising = np.linspace(0.1, 3.0, HORIZON_FRAMES)
    write_steps(
        tmp_path / "steps.csv", [StepErrors("a", "b", "moving", rising, rising, rising, rising, 9)]
    )
    assert main(["figures", str(tmp_path)]) == 0
    told = [Path(line) for line in capsys.readouterr().out.split()]
    assert [path.name for path in told] == ["steps.pdf", "steps.svg", "steps.png"]
    first = [path.read_bytes() for path in told]
    # Fonts are TrueType; Type 3 is refused by printers.
    assert b"/FontFile2" in first[0] and b"/Type3" not in first[0]
    assert b"<text" not in first[1]
    assert main(["figures", str(tmp_path), "--formats", "svg,pdf,png"]) == 0
    assert [path.read_bytes() for path in told] == first


def test_figures_of_a_run(crossing: Run, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["figures", str(crossing.path), "--only", "traffic,moment", "--formats", "png"]
    assert main(words) == 0
    for line in capsys.readouterr().out.split():
        assert min(Image.open(line).size) > 500


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--only", "trafic"], "did you mean 'traffic'"),
        (["--formats", "pgn"], "did you mean 'png'"),
        (["--only", "sequence"], "no case to draw"),
    ],
)
def test_wrong_wishes(
    crossing: Run, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["figures", str(crossing.path), *words]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("nothing", "", "found none to draw"),
        ("steps.csv", "a,b\n", "expected a column 'scene'"),
        ("scores.json", "{", "found damage"),
    ],
)
def test_folders_that_lack_something(
    tmp_path: Path, name: str, content: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_text(content)
    assert main(["figures", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert said in error and "Traceback" not in error


def test_histograms_are_the_counts_they_were_made_of(tmp_path: Path) -> None:
    path = tmp_path / "density.csv"
    path.write_text(
        "scene,criterion,interacting_vehicles,samples,share\n"
        "a,all,0,0,0\na,all,1,2,0.5\na,all,2,2,0.5\na,conflict,0,1,1\n"
    )
    found = read_density(path)["a"]
    assert found["all"].tolist() == [1, 1, 2, 2] and found["conflict"].tolist() == [0]
    assert not len(found["30m"])


def test_adaptation_is_sorted_by_the_figure_it_is_of(tmp_path: Path) -> None:
    changes = {"ade2": Change(0.2, 0.1, None, None), "ade4": Change(1.0, 1.0, -0.1, 0.1)}
    made = [
        AdaptationRow("a", "hatn", method, layer, steps, 7, changes)
        for method, layer, steps in (
            ("mekf", "dense3", 1), ("mekf", "dense3", 3), ("rls", "dense3", 3),
            ("mekf", "encoder_input", 3), ("mekf", "dense3", 3),
        )
    ]  # fmt: skip
    write_csv(tmp_path / "adaptation.csv", made)
    whole, by_layer = read_adaptation(tmp_path / "adaptation.csv")["hatn"]
    assert [row.steps for row in whole["a"]] == [1, 3]
    assert [row.layer for row in by_layer["a"]] == ["encoder_input", "dense3"]
    for row in (*whole["a"], *by_layer["a"]):
        assert (row.n, row.changes) == (7, changes)


def test_the_papers_numbers_are_drawn_beside_ours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (table,) = TABLES["sgn"]
    score = Score("goal_error", "x", "intersection5", "all", "none", 0.8, "m", 9, 0.7, 0.9)
    write_entries(tmp_path / "sgn.csv", compare(table, [AblationRow("sgn", "Ours", (score,))]))
    ours = [one for one in read_beside(tmp_path / "sgn.csv") if one.row == "Ours"]
    (told,) = [one for one in ours if one.measure == "goal_error"]
    # The paper: 0.94 m at its intersection.
    assert (told.paper, told.ours, told.low, told.high) == (0.94, 0.8, 0.7, 0.9)
    assert main(["figures", str(tmp_path), "--formats", "png"]) == 0
    assert Path(capsys.readouterr().out.strip()).name == "sgn.png"


def test_a_table_without_numbers_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "lines.pdf").touch()
    assert main(["figures", str(tmp_path)]) == 2
    assert "samples that are not kept" in capsys.readouterr().err


# -- films ----------------------------------------------------------------------------------------


@pytest.mark.skipif(find_spec("av") is None, reason="PyAV (extra `video`) is not installed")
def test_a_film_follows_its_ego(crossing: Run, tmp_path: Path) -> None:
    import av

    out = tmp_path / "film.mp4"
    words = ["animate", str(crossing.path), "--from", "101", "--to", "101.4", "--speed", "2"]
    assert main([*words, "--ego", "eastbound", "--out", str(out)]) == 0
    with av.open(str(out)) as film:
        stream = film.streams.video[0]
        assert (stream.width, stream.height) == (1920, 1080)
        assert (stream.codec_context.name, stream.average_rate) == ("h264", 20)
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(frames) == 5


def test_the_camera_keeps_the_ego_and_moves_the_other(crossing: Run) -> None:
    from hatn_sim.report.animation import Stretch, _camera

    centres, _, _ = _camera(crossing, Stretch("eastbound", 10, 40, follow=True), 1.6)
    along_m = START_M["eastbound"] + 0.1 * SPEED_MPS * np.arange(10, 40)
    # In the middle of a stretch of even speed the mean place is the place.
    assert abs(centres[15, 0] - along_m[15]) < 0.5
    assert (np.diff(centres[:, 0]) >= 0.0).all() and not centres[:, 1].any()


def test_films_hold_those_told_of_and_give_way_before_they_have_to(crossing: Run) -> None:
    """An ego that drives east at 8 m/s; told, in frames 100 to 199, of somebody 50 m north."""
    from hatn_sim.report.animation import _following
    from hatn_sim.report.picture import WIDE_M

    ego_xy_m = np.stack((0.8 * np.arange(300.0), np.zeros(300)), axis=1)
    first = moment_at(crossing, 10, "eastbound")
    said = Suggestion("eastbound", 1.0, "yield", "northbound", 0.9, 0.8, None, 5.0, True, "Yield")

    def moment(frame: int) -> Moment:
        xy_m = np.stack((ego_xy_m[frame], ego_xy_m[frame] + [0.0, 50.0]))
        told = said if 100 <= frame < 200 else None
        scene = replace(first.scene, xy_m=xy_m)
        return replace(first, scene=scene, slots=(), suggestion=told)

    assert first.scene.ids == ("eastbound", "northbound")
    centres, width_m = _following(ego_xy_m, 1.5, map(moment, range(300)))
    # 50 m, 2 m of cars at both ends and 2.5 m around them are 59 m; at 88 m by 58.7 m, a bit more.
    assert width_m == pytest.approx(1.5 * 59.0) and width_m > WIDE_M
    half = 0.5 * np.array([width_m, width_m / 1.5])
    for frame in range(100, 200):
        for place in (ego_xy_m[frame], ego_xy_m[frame] + [0.0, 50.0]):
            assert (np.abs(place - centres[frame]) < half).all()
    np.testing.assert_allclose(centres[[0, 40, 260, 299]], ego_xy_m[[0, 40, 260, 299]], atol=1e-9)
    # It comes to be 25 m aside over 4 s.
    assert np.abs(np.diff(centres[:, 1])).max() < 25.0 / 40.0
    assert centres[150, 1] == pytest.approx(25.0, abs=0.1)


@pytest.mark.parametrize(("pause", "most_lost"), [(0, 10), (16, 0), (30, 0)])
def test_films_turn_to_the_other_side_in_time(
    crossing: Run, monkeypatch: pytest.MonkeyPatch, pause: int, most_lost: int
) -> None:
    """Told of somebody 50 m north up to frame 150, and of another 50 m south after a pause.

    One picture cannot hold the last place and the next one 25 m to each side, so that without a
    pause somebody is lost while the camera turns.
    """
    from hatn_sim.report import animation

    ego_xy_m = np.stack((0.8 * np.arange(300.0), np.zeros(300)), axis=1)
    sides = dict.fromkeys(range(100, 150), 50.0)
    sides |= dict.fromkeys(range(150 + pause, 220), -50.0)

    def told(frame: int) -> Any:
        return ego_xy_m[frame] + [[0.0, 0.0], [0.0, sides.get(frame, 0.0)]]

    monkeypatch.setattr(animation, "told_of", told)
    centres, width_m = animation._following(ego_xy_m, 1.5, iter(range(300)))  # type: ignore[arg-type]
    half = 0.5 * np.array([width_m, width_m / 1.5])
    lost = [one for one in sides if (np.abs(told(one) - centres[one]) > half + 1e-9).any()]
    assert len(lost) <= most_lost and all(abs(frame - 149.5) < 5.0 for frame in lost)
    # From 25 m (and the rim) on one side to the other over eleven frames, no faster.
    assert np.abs(np.diff(centres[:, 1])).max() <= 55.0 / 11.0


def test_a_moving_sheet_shows_what_a_standing_one_does(crossing: Run) -> None:
    from hatn_sim.log.road_file import ROAD_FILE, read_road
    from hatn_sim.report.canvas import FILM
    from hatn_sim.report.moment import moment_at
    from hatn_sim.report.moving_sheet import MovingSheet

    lanes = read_road(crossing.path / ROAD_FILE)
    moment = moment_at(crossing, 20, "eastbound")
    here, there = np.zeros(2), np.array([4.0, 3.0])
    moving = MovingSheet(FILM, lanes, here, 80.0, moves=True)
    moving.draw(moment, "", here)
    standing = MovingSheet(FILM, lanes, there, 80.0, moves=False)
    pixels = [sheet.draw(moment, "", there).astype(int) for sheet in (moving, standing)]
    # Up to half a pixel apart: edges differ, areas do not.
    assert (np.abs(pixels[0] - pixels[1]).max(axis=2) > 60).mean() < 0.02


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--from", "90"], "expected rising times between 100.0 and 106.9 s"),
        (["--from", "104", "--to", "103"], "expected rising times"),
        (["--ego", "eastbond"], "did you mean 'eastbound'"),
        (["--out", "film.avi"], "ends in .mp4 or .gif"),
    ],
)
def test_wrong_films(
    crossing: Run, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["animate", str(crossing.path), "--out", "film.gif", *words]) == 2
    assert said in capsys.readouterr().err


# -- rerun ----------------------------------------------------------------------------------------


@pytest.mark.skipif(find_spec("rerun") is None, reason="rerun-sdk (extra `viz`) is not installed")
def test_reruns_own_tools_read_the_export(crossing: Run, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    assert (
        main(["export", str(crossing.path), "--format", "rrd", "--out", str(tmp_path / "x")]) == 0
    )
    path = str(tmp_path / "x" / "run.rrd")
    rerun = [sys.executable, "-m", "rerun_cli", "rrd"]
    assert subprocess.run([*rerun, "verify", path], capture_output=True).returncode == 0
    printed = subprocess.run([*rerun, "print", path], capture_output=True, text=True)
    for entity in ("/vehicles", "/predictions", "/conflicts", "/road/lanes", "/plots/vehicles"):
        assert entity in printed.stdout
    assert json.loads((crossing.path / "run.json").read_text())["frames"] == FRAMES


@pytest.mark.skipif(find_spec("rerun") is None, reason="rerun-sdk (extra `viz`) is not installed")
def test_vehicles_are_in_the_export_where_they_were(crossing: Run, tmp_path: Path) -> None:
    reader = pytest.importorskip("rerun.chunk").RrdReader
    words = ["export", str(crossing.path), "--format", "rrd", "--out", str(tmp_path / "x")]
    assert main(words) == 0
    told: dict[str, list[dict[str, Any]]] = {}
    for chunk in reader(tmp_path / "x" / "run.rrd").stream().to_chunks():
        told.setdefault(chunk.entity_path, []).extend(chunk.to_record_batch().to_pylist())
    (road,) = told["/road"]
    origin = [next(v[0] for k, v in road.items() if f"origin_{of}_m" in k) for of in AXES]
    of_frame = {row["frame"]: row for row in told["/vehicles"]}
    assert sorted(of_frame) == list(range(FRAMES))
    for frame in (0, 25, 69):
        row = of_frame[frame]
        assert row["Boxes3D:labels"] == ["eastbound", "northbound"]
        along_m = [START_M[name] + 0.1 * SPEED_MPS * frame for name in START_M]
        expected = np.array([[along_m[0], 0.0], [0.0, along_m[1]]])
        there = np.array(row["Boxes3D:centers"])[:, :2] + origin
        np.testing.assert_allclose(there, expected, atol=1e-4)
        sizes_m = 2.0 * np.array(row["Boxes3D:half_sizes"])[:, :2]
        np.testing.assert_allclose(sizes_m, [[4.0, 1.8]] * 2, atol=1e-5)


def _read_back(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Rows of each entity, by Rerun's own reader."""
    reader = pytest.importorskip("rerun.chunk").RrdReader
    told: dict[str, list[dict[str, Any]]] = {}
    for chunk in reader(path).stream().to_chunks():
        told.setdefault(chunk.entity_path, []).extend(chunk.to_record_batch().to_pylist())
    return told


def _origin(told: dict[str, list[dict[str, Any]]]) -> np.ndarray:
    (road,) = told["/road"]
    return np.array([next(v[0] for k, v in road.items() if f"origin_{of}_m" in k) for of in AXES])


@pytest.mark.skipif(find_spec("rerun") is None, reason="rerun-sdk (extra `viz`) is not installed")
def test_slots_and_what_happened_are_in_the_export_as_in_the_log(
    crossing: Run, tmp_path: Path
) -> None:
    words = ["export", str(crossing.path), "--format", "rrd", "--out", str(tmp_path / "x")]
    assert main(words) == 0
    told = _read_back(tmp_path / "x" / "run.rrd")
    origin = _origin(told)
    happened = {row["frame"]: row for row in told["/happened"]}
    for frame, points_s in (
        (10, np.arange(0.0, 3.01, 0.5)),
        (62, np.minimum([0.0, 0.5, 1.0], 0.7)),
    ):
        path = np.array(happened[frame]["LineStrips3D:strips"][0])[:, :2] + origin
        along_m = START_M["eastbound"] + SPEED_MPS * (0.1 * frame + points_s)
        np.testing.assert_allclose(path[: len(points_s), 0], along_m, atol=1e-4)
        np.testing.assert_allclose(path[:, 1], 0.0, atol=1e-4)
        assert path[-1, 0] == pytest.approx(along_m[-1], abs=1e-4), "no farther than it was seen"
    slots = {row["frame"]: row for row in told["/slots"]}
    moment = moment_at(crossing, 10, "eastbound")
    labels, strips = slots[10]["LineStrips3D:labels"], slots[10]["LineStrips3D:strips"]
    for slot, said in zip(moment.slots, ("yield", "pass before northbound"), strict=True):
        assert slot.probability is not None
        at = labels.index(f"eastbound: {said} {100.0 * slot.probability:.0f} %")
        ends = np.array(strips[at])[[0, -1], :2] + origin
        np.testing.assert_allclose(ends, slot.strip_xy_m[[0, -1]], atol=1e-3)
    table = crossing.predictions(crossing.predictors[0])
    counted = (table.slot_mask & table.slot_in_focus)[
        table.has_slot_probability & table.has_conflict
    ]
    sent = [row["LineStrips3D:labels"] or [] for row in told["/slots"]]
    assert sum(map(len, sent)) == counted.sum() > 0


@pytest.mark.skipif(find_spec("rerun") is None, reason="rerun-sdk (extra `viz`) is not installed")
def test_signals_and_events_are_in_the_export(tmp_path: Path) -> None:
    lanes = [
        lane("in", [(-80.0, 0.0), (0.0, 0.0)], gate=Gate.SIGNAL, signals={"out": 1}),
        lane("out", [(0.0, 0.0), (90.0, 0.0)]),
    ]
    frames = driving(30)
    log(tmp_path / "run", frames)
    write_road(tmp_path / "run" / ROAD_FILE, lanes)
    assert main(["export", str(tmp_path / "run"), "--format", "rrd"]) == 0
    told = _read_back(tmp_path / "run" / "rrd" / "run.rrd")
    closed = [bool(frame.scene.signal_closed[1]) for frame in frames]
    changes = [k for k in range(30) if not k or closed[k] != closed[k - 1]]
    assert len(changes) > 5
    rows = {row["frame"]: row for row in told["/signals"]}
    assert sorted(rows) == changes
    for frame in changes:
        assert rows[frame]["LineStrips3D:labels"] == ["closed" if closed[frame] else "open"]
    stop = np.array(rows[0]["LineStrips3D:strips"][0])[:, :2] + _origin(told)
    np.testing.assert_allclose(stop[:, 0], 0.0, atol=1e-4)
    driven = driven_in(read_run(tmp_path / "run"))
    found = [one for one in severe_events(driven) if one.tier in ("T1", "T2")]
    said = [text for row in told["/events"] for text in row["TextLog:text"]]
    expected = {f"{one.tier}, {one.cause}: {one.first_id}" for one in found}
    assert found and all(any(text.startswith(one) for text in said) for one in expected)


# -- who goes when --------------------------------------------------------------------------------


def test_ways_meet_at_the_conflict_when_they_did(crossing: Run) -> None:
    frame = 10
    story = space_time(crossing, frame, "eastbound")
    (other,) = story.others
    assert (story.ego.vehicle_id, other.vehicle_id) == ("eastbound", "northbound")
    # At frame 10 the ego is 12 m before the crossing at (0, 0), the other 28 m; both keep 8 m/s.
    now = int(np.flatnonzero(story.frames == frame)[0])
    assert story.ego.s_m[now] == 0.0
    assert other.conflict_s_m == pytest.approx(12.0, abs=0.3)
    assert other.s_m[now] == pytest.approx(-16.0, abs=0.6)
    np.testing.assert_allclose(np.diff(story.ego.s_m), SPEED_MPS * 0.1, atol=1e-9)
    # Cars of 4 m: at (0, 0) from 2 m before it to 2 m behind it, 2.5 and 4.5 s after the start.
    for strand, middle_s in ((story.ego, 102.5), (other, 104.5)):
        taken = strand.occupied_s(story.time_s, other.conflict_s_m or 0.0)
        assert taken == pytest.approx((middle_s - 0.25, middle_s + 0.25), abs=0.08)
    ((free_s, _),) = free_spans(story)
    assert free_s == pytest.approx((102.75, 104.25), abs=0.08)
    # They do what was predicted.
    told = next(one for one in story.ego.forecasts if one.frame == frame)
    np.testing.assert_allclose(told.s_m[0], SPEED_MPS * 0.1 * np.arange(31), atol=1e-4)
    # The other is there at frame 45, and 1.5 s more are told.
    assert story.frames[-1] == 60
    assert [one.frame for one in story.ego.forecasts] == [0, 10, 20, 30, 40, 50, 60]
    assert story.chance[now] == pytest.approx([1.0 - SURE_OF_PASS, SURE_OF_PASS])


def test_others_are_on_the_egos_way_only_where_they_cross_it(crossing: Run) -> None:
    story = space_time(crossing, 10, "eastbound")
    (other,) = story.others
    assert story.ego.on_way.all()
    # The other drives along x = 0 from y = -36 m at 8 m/s, the ego along y = 0.
    y_m = START_M["northbound"] + 0.1 * SPEED_MPS * story.frames
    np.testing.assert_array_equal(other.on_way, np.abs(y_m) <= 1.75)
    assert 0 < other.on_way.sum() < 6


def test_who_the_ego_is_told_of_goes_before_those_met_for_longer() -> None:
    """Eight others in the ego's choice for ever fewer frames; told of the one met least."""
    others, frames = np.arange(1, 9), np.arange(10)
    node = np.tile(np.append(0, others), (len(frames), 1))
    focus = np.column_stack([frames < 10 - k for k in range(9)])
    focus[:, 0] = True
    focus[6] = np.isin(node[6], (0, 3, 2))  # the choice at the moment, frame 6
    other_m = np.tile(20.0 + np.arange(9), (len(frames), 1))
    chance = np.zeros(node.shape)
    chance[6, [2, 3]] = 0.3, 0.7
    choices: Any = SimpleNamespace(
        frame=frames,
        node=node,
        focus=focus,
        chance=chance,
        other_m=other_m,
        ego_m=np.full(node.shape, 9.0),
    )
    told = [vehicle for vehicle, _, _ in space_time_of._met(choices, frames, 6, [8])]
    assert told == [8, 3, 2, 1, 4, 5]
    # Frame 9 is the last with each of them in its graph; the one told of is looked for in all.
    assert {(v, row) for v, row, _ in space_time_of._met(choices, frames, 6, [8])} >= {(8, 9)}


def test_who_is_in_no_slot_is_said_not_to_be_drawn(
    crossing: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert space_time(crossing, 10, "eastbound").unplaced == ()
    # Nobody but the two is there: the ego itself, which is in none of the slots to pass before.
    monkeypatch.setattr(space_time_of, "named_at", lambda *_: ("northbound", "eastbound"))
    story = space_time(crossing, 10, "eastbound")
    assert [one.vehicle_id for one in story.others] == ["northbound"]
    assert story.unplaced == ("eastbound",)
    drawn: list[Figure] = []
    monkeypatch.setattr(space_time_figure, "save_figure", lambda figure, _: drawn.append(figure))
    space_time_figure.draw_space_time(story, "here", [])
    words = {text.get_text() for text in drawn[0].findobj(Text)}
    assert any(one.startswith("not drawn: eastbound, of whom the ego is told") for one in words)


def test_figures_name_what_is_in_them(crossing: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bands, whiskers, hollow rings, panels; read off the figures that are about to be written."""
    drawn: list[Figure] = []
    for module in (calibration_figure, steps_figure, space_time_figure):
        monkeypatch.setattr(module, "save_figure", lambda figure, paths: drawn.append(figure))
    wish = run_figures.Wish(101.0, "eastbound")
    for name in ("calibration", "errors", "spacetime"):
        run_figures.RUN_FIGURES[name](crossing, wish, [])
    calibration, errors, ways = (
        {text.get_text() for text in figure.findobj(Text)} for figure in drawn
    )
    assert {"95 % interval over vehicles", "fewer than 5 samples: no interval"} <= calibration
    assert {"95 % interval of the mean", "the same, both axes logarithmic"} <= errors
    assert {"car northbound", "likeliest prediction, once a second"} <= ways
    assert {"on the ego's way, bumper to bumper", "the conflict is free"} <= ways
    assert {"upright: the moment, 101.0 s", "level: conflict with who has its colour"} <= ways
    assert any("black, to yield" in words for words in ways)


def test_recall_is_told_with_its_events() -> None:
    def score(scene: str, rule: str, subset: str, n: int, measure: str = "event_recall") -> Score:
        return Score(measure, rule, scene, subset, "none", None, "share", n, None, None)

    scores = [
        *(score("a", "oracle", "all", 7), score("a", "hatn", "all", 7)),
        *(score("a", "hatn", "courteous", 3), score("b", "hatn", "all", 0)),
        score("c", "hatn", "all", 5, "recall_1s5"),
    ]
    assert events_by_scene(scores) == {"a": 7, "b": 0}
    # Where all drivers of a scene are alike, there is no "all" of it, whatever others have.
    assert events_by_scene([*scores, score("c", "hatn", "courteous", 4)])["c"] == 4


def test_what_nobody_can_say_of_all_is_not_told_of_some() -> None:
    told = {("event_recall", "all"): None, ("event_recall", "inattentive"): 0.4}
    told |= {("lead_time_s", "inattentive"): 2.0, ("lead_time_s", "all"): 3.0}
    scores = [
        Score(measure, "hatn", "a", subset, "none", value, "1", 5, None, None)
        for (measure, subset), value in told.items()
    ]
    found = compared_by_scene(scores)["a"]
    assert {measure: one.value for (_, measure), one in found.items()} == {
        "event_recall": None, "lead_time_s": 3.0,
    }  # fmt: skip


def test_intervals_of_a_tables_folder_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whiskers end where the scores say, at the false alarms of the courteous."""
    drawn: list[Figure] = []
    monkeypatch.setattr(
        assistance_figure, "save_figure", lambda figure, paths: drawn.append(figure)
    )
    told = {
        ("event_recall", "all"): (0.5, 0.2, 0.8), ("event_recall", "courteous"): (0.1, 0.0, 0.3),
        ("false_alarms_per_hour", "courteous"): (2.0, 1.0, 3.0),
        ("false_alarms_per_hour", "all"): (9.0, 8.0, 10.0),
        ("recall_1s5", "all"): (0.5, 0.5, 0.5), ("lead_time_s", "all"): (None, None, None),
    }  # fmt: skip
    write_scores(
        tmp_path,
        [
            Score(measure, "hatn", "a", subset, "none", value, "1", 2, low, high)
            for (measure, subset), (value, low, high) in told.items()
        ],
    )
    curves = {
        "a": {"hatn": [Operating(0.5, 1.0, 0.9, 0.8, 2.0), Operating(0.2, 3.0, 1.0, 1.0, 2.0)]}
    }
    write_curves(tmp_path / "curves.csv", curves)
    assert main(["figures", str(tmp_path), "--formats", "png"]) == 0
    lines = [
        [
            line.get_xydata().tolist()
            for line in axes.lines
            if line.get_transform() != axes.transData
        ]
        for axes in drawn[0].axes
    ]
    whisker, mark = [[2.0, 0.2], [2.0, 0.8]], [[2.0, 0.5]]
    at = [[one for one in of_axes if one[0][0] == 2.0] for of_axes in lines]
    assert at == [[whisker, mark], [mark], []]  # nobody differs: no interval; no value: no mark


def test_who_was_trained_on_a_scene_is_marked_in_the_figure_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(steps_figure, "save_figure", lambda figure, paths: drawn.append(figure))
    rising = np.linspace(0.1, 3.0, HORIZON_FRAMES)
    of = {name: StepErrors("a", name, "moving", *[rising] * 4, n=9) for name in ("hatn", "idm")}
    path = tmp_path / "steps.csv"
    write_steps(path, [replace(of["hatn"], trained=True), of["idm"]])
    assert [one.trained for one in read_steps(path)] == [True, False]
    assert main(["figures", str(tmp_path), "--formats", "png"]) == 0
    words = {text.get_text() for text in drawn[0].findobj(Text)}
    assert {"hatn*", "idm", "* its weights were trained or tuned on runs of this scene"} <= words
    # Tables made before this was kept are still read.
    rows = path.read_text().splitlines()
    path.write_text("\n".join(row.rsplit(",", 1)[0] for row in rows) + "\n")
    assert [one.trained for one in read_steps(path)] == [False, False]


def test_the_figure_of_a_run_says_whose_training_scenes_it_does_not_know(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are noted of the first predictor alone; rules without weights learnt from nothing."""
    drawn: list[Figure] = []
    monkeypatch.setattr(steps_figure, "save_figure", lambda figure, paths: drawn.append(figure))
    run = write_run(tmp_path / "run")
    first = run.predictors[0]
    told = {
        (): f"training scenes of {first} not known",
        (run.header["scene"],): "* its weights were trained or tuned on runs of this scene",
    }
    for scenes, words in told.items():
        run.header["trained_on"], run.header["weights_sha256"] = list(scenes), {first: "0f"}
        run_figures.RUN_FIGURES["errors"](run, run_figures.Wish(), [tmp_path / "errors.png"])
        legend = {text.get_text() for text in drawn[-1].findobj(Text)}
        assert legend & set(told.values()) == {words}
    run.header["weights_sha256"] = {}
    run.header["trained_on"] = []
    run_figures.RUN_FIGURES["errors"](run, run_figures.Wish(), [tmp_path / "errors.png"])
    assert not {text.get_text() for text in drawn[-1].findobj(Text)} & set(told.values())


@pytest.mark.parametrize(
    ("values", "places"),
    [
        ([1.0, 5.0], [1.0, 5.0]),
        ([5.0, 5.2], [4.6, 5.6]),  # around 5.1
        ([5.2, 20.0, 5.0], [5.6, 20.0, 4.6]),
        ([5.0, 5.2, 5.9], [13.1 / 3.0, 16.1 / 3.0, 19.1 / 3.0]),  # around 5.37
        ([], []),
    ],
)
def test_labels_of_marks_lie_beside_each_other(values: list[float], places: list[float]) -> None:
    assert spread(values, 1.0) == pytest.approx(places)


def test_who_is_not_seen_at_a_place_does_not_pass_it() -> None:
    time_s, s_m = np.arange(4.0), np.array([np.nan, 1.0, 3.0, 4.0])
    assert passing_time_s(time_s, s_m, 2.0) == 1.5
    assert passing_time_s(time_s, s_m, 0.5) is None  # it came into view behind it
    assert passing_time_s(time_s, s_m, 5.0) is None


def test_an_ego_without_slots_has_no_ways_to_draw(
    crossing: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["figures", str(crossing.path), "--only", "spacetime"]
    assert main([*words, "--ego", "eastbound", "--time", "106.9"]) == 2
    assert "has no slots to choose from around 106.9 s" in capsys.readouterr().err
    assert main([*words, "--ego", "eastbond"]) == 2
    assert "did you mean 'eastbound'" in capsys.readouterr().err
