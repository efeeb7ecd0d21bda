"""Tracks in INTERACTION format: read as written, held to their rules, and written so again."""

from __future__ import annotations

import csv
import gc
import math
import re
import tracemalloc
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from conftest import crossing_lanes

from hatn_sim.cli import main
from hatn_sim.config import RecordedSource, load_scenario, load_tracks
from hatn_sim.datatypes import Frame, Kind, Scene, Truth
from hatn_sim.errors import InputError
from hatn_sim.log import RunWriter, read_run
from hatn_sim.log.road_file import ROAD_FILE, write_road
from hatn_sim.recordings.find import open_recording
from hatn_sim.recordings.interaction import checks, scan, spool, table
from hatn_sim.recordings.interaction.export import export_interaction
from hatn_sim.recordings.interaction.recording import CASE_NOW, GAP_FRAMES, InteractionRecording
from hatn_sim.recordings.lanelet2.writer import write_lanelet2
from hatn_sim.score.prediction import score_run
from hatn_sim.traffic import open_traffic

HEADER = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width"
Row = tuple[object, ...]


def car(track: object, first: int, count: int, y_m: float = 0.0, speed: float = 10.0) -> list[Row]:
    """A car that drives east along y, as rows."""
    return [
        (track, f, 100 * f, "car", round(-40 + speed * 0.1 * k, 6), y_m, speed, 0.0, 0.0, 4.5, 1.8)
        for k, f in enumerate(range(first, first + count))
    ]


def write(path: Path, rows: Iterable[Row], header: str = HEADER) -> Path:
    lines = [header, *(",".join(str(value) for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def map_path(tmp_path: Path) -> Path:
    path = tmp_path / "map.osm"
    write_lanelet2(path, crossing_lanes())
    return path


@pytest.fixture
def played(tmp_path: Path, map_path: Path) -> Callable[..., list[Frame]]:
    """Plays files of the folder."""

    def play(*names: str, recordings: tuple[str, ...] = ()) -> list[Frame]:
        paths = tuple(tmp_path / name for name in names)
        return list(open_recording("x", RecordedSource(paths, map_path, recordings)).frames())

    return play


def where(frames: list[Frame], name: str) -> list[int]:
    return [k for k, frame in enumerate(frames) if name in frame.scene.ids]


def test_frames_are_the_file_sorted_by_time(
    tmp_path: Path, played: Callable[..., list[Frame]]
) -> None:
    rows = car(7, 5, 40) + car(3, 1, 20, y_m=-2.0, speed=8.0)
    write(tmp_path / "vehicle_tracks_000.csv", rows)
    frames = played("vehicle_tracks_000.csv")
    # The standard library's reader, row by row, is the other side of the comparison.
    with (tmp_path / "vehicle_tracks_000.csv").open() as file:
        expected = {(r["track_id"], int(r["frame_id"])): r for r in csv.DictReader(file)}
    seen = {
        (name, round(frame.scene.time_s * 10)): (frame.scene, k)
        for frame in frames
        for k, name in enumerate(frame.scene.ids)
    }
    assert seen.keys() == expected.keys()
    for key, row in expected.items():
        scene, k = seen[key]
        assert scene.xy_m[k].tolist() == [float(row["x"]), float(row["y"])]
        assert scene.speed_mps[k] == math.hypot(float(row["vx"]), float(row["vy"]))
        assert scene.yaw_rad[k] == float(row["psi_rad"])
        assert scene.size_m[k].tolist() == [float(row["length"]), float(row["width"])]
        assert scene.kind[k] == Kind.CAR
    assert [frame.scene.time_s for frame in frames] == [k / 10 for k in range(1, 45)]
    assert [frame.done for frame in frames] == [False] * 43 + [True]
    assert frames[4].truth.departed == ("7",) and frames[4].truth.routes == (None, None)
    assert frames[20].truth.arrived == ("3",)
    # A road user keeps its colour, and begins anew at every call.
    assert {
        tuple(f.scene.colour[f.scene.ids.index("7")]) for f in frames if "7" in f.scene.ids
    } == {tuple(frames[10].scene.colour[0])}
    again = played("vehicle_tracks_000.csv")
    assert [f.scene.ids for f in again] == [f.scene.ids for f in frames]


def test_pedestrians_are_read_along_and_get_a_heading_and_a_size(
    tmp_path: Path, map_path: Path
) -> None:
    write(tmp_path / "vehicle_tracks_000.csv", car(1, 1, 30))
    walk = [(0.0, 0.0), (0.0, 1.2), (-0.9, 0.0), (0.1, 0.0), (0.0, 0.0)]
    for header, tail in ((HEADER, ("", "", "")), (HEADER.rpartition(",psi_rad")[0], ())):
        rows = [
            ("P1", k + 3, 100 * k + 300, "pedestrian/bicycle", 5.0, 5.0, *v, *tail)
            for k, v in enumerate(walk)
        ]
        bicycle = ("P2", 3, 300, "bicycle", 9.0, 5.0, 0.0, -3.0, *tail)
        write(tmp_path / "pedestrian_tracks_000.csv", [*rows, bicycle], header)
        source = RecordedSource((tmp_path / "vehicle_tracks_000.csv",), map_path)
        recording = open_recording("x", source)
        assert recording.notices == ["read along with the vehicles: pedestrian_tracks_000.csv"]
        frames = list(recording.frames())
        assert frames[2].scene.ids == ("1", "P1", "P2")
        assert frames[2].scene.kind.tolist() == [Kind.CAR, Kind.PEDESTRIAN, Kind.BICYCLE]
        assert frames[2].scene.size_m.tolist() == [[4.5, 1.8], [0.5, 0.5], [1.8, 0.6]]
        assert frames[2].scene.yaw_rad[2] == -math.pi / 2
        # Not known while it stands at first, held while it stands later.
        yaws = [frames[k].scene.yaw_rad[1] for k in range(2, 7)]
        assert yaws == [0.0, math.pi / 2, math.pi, math.pi, math.pi]


def test_there_may_be_no_pedestrians_and_no_limit_to_turning(
    tmp_path: Path, played: Callable[..., list[Frame]]
) -> None:
    rows = [(*row[:8], 4 * math.pi, *row[9:]) for row in car(1, 1, 30)]
    write(tmp_path / "vehicle_tracks_000.csv", rows)
    write(tmp_path / "pedestrian_tracks_000.csv", [], HEADER.rpartition(",psi_rad")[0])
    frames = played("vehicle_tracks_000.csv")
    assert {frame.scene.ids for frame in frames} == {("1",)}
    assert frames[0].scene.yaw_rad[0] == pytest.approx(0.0, abs=1e-12)


def test_a_map_out_of_place_is_noticed(tmp_path: Path, map_path: Path) -> None:
    path = tmp_path / "vehicle_tracks_000.csv"
    for off_m, count in ((0.0, 0), (2.5, 1)):
        write(path, car(1, 1, 20, y_m=off_m))
        recording = open_recording("x", RecordedSource((path,), map_path))
        next(recording.frames())
        assert len(recording.notices) == count
    expected = (
        r"^vehicle_tracks_000.csv: vehicles are \d\.\d m from the middle .*is map.osm the map"
    )
    assert re.match(expected, recording.notices[0])
    assert recording.doubts == recording.notices
    write(path, car(1, 1, 20, y_m=7.0))
    with pytest.raises(
        InputError, match=r"found 0% .* \d\.\d m off at the median\): map and tracks"
    ):
        next(open_recording("x", RecordedSource((path,), map_path)).frames())


def test_recordings_follow_each_other(tmp_path: Path, played: Callable[..., list[Frame]]) -> None:
    names = [f"vehicle_tracks_{k:03d}.csv" for k in range(3)]
    for k, name in enumerate(names):
        write(tmp_path / name, car(1, 1, 20 + k))
    frames = played(*names)
    assert where(frames, "000:1") == list(range(20))
    assert where(frames, "001:1") == list(range(20 + GAP_FRAMES, 41 + GAP_FRAMES))
    assert where(frames, "002:1") == list(range(41 + 2 * GAP_FRAMES, 63 + 2 * GAP_FRAMES))
    assert np.allclose(np.diff([frame.scene.time_s for frame in frames]), 0.1)
    assert [frame.done for frame in frames] == [False] * (len(frames) - 1) + [True]
    # A pattern that takes everything takes the names of vehicles too.
    (tmp_path / "vehicle_ids_001.csv").write_text("track_id,id\n1,blue car\n")
    assert where(played(*names, "vehicle_ids_001.csv"), "001:blue car")[0] == 20 + GAP_FRAMES
    (tmp_path / "vehicle_ids_001.csv").unlink()
    chosen = played(*names, recordings=("2", "000"))
    assert {name for f in chosen for name in f.scene.ids} == {"000:1", "002:1"}
    assert {name for f in played(*names, recordings=("001",)) for name in f.scene.ids} == {"1"}
    with pytest.raises(InputError, match=r"there is no recording '7'; known: 000, 001, 002$"):
        played(*names, recordings=("7",))
    # Through a pattern and the one way in, as a user gives them.
    scenario = load_tracks(
        (str(tmp_path / "vehicle_tracks_*.csv"),), tmp_path / "map.osm", ("001",)
    )
    with open_traffic(scenario) as simulator:
        assert simulator.reset(1).scene.ids == ("1",)
        assert simulator.notices == []
        assert set(simulator.road.lanes) == {lane.id for lane in crossing_lanes()}


def test_cases_are_laid_so_that_their_present_is_sampled(
    tmp_path: Path, played: Callable[..., list[Frame]]
) -> None:
    lengths = {"1.0": 40, "2.0": 40, "5.0": 38}
    rows = [
        (case, *row)
        for case, length in lengths.items()
        for row in [*car("1.0", 1, length), *car(2, 4, 12, y_m=3.0)]
    ]
    write(tmp_path / "PLACE_train.csv", rows, f"case_id,{HEADER}")
    frames = played("PLACE_train.csv")
    ends = -1
    for case, length in zip(("1", "2", "5"), lengths.values(), strict=True):
        there = where(frames, f"{case}:1")
        assert len(there) == length and there == list(range(there[0], there[0] + length))
        assert (there[0] + CASE_NOW) % 5 == 0
        assert there[0] > ends + (GAP_FRAMES if ends >= 0 else 0)
        assert where(frames, f"{case}:2") == list(range(there[0] + 3, there[0] + 15))
        ends = there[-1]
    assert len(frames) == ends + 1
    chosen = played("PLACE_train.csv", recordings=("5",))
    assert {name for f in chosen for name in f.scene.ids} == {"5:1", "5:2"}
    with pytest.raises(InputError, match=r"there is no recording '4'; known: 1, 2, 5$"):
        played("PLACE_train.csv", recordings=("4",))


def test_cases_are_scored_once_each_and_apart(
    tmp_path: Path, map_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("ONE_train", "TWO_train"):
        rows = [(case, *row) for case in range(3) for row in car(1, 1, 40, speed=8.0 + case)]
        write(tmp_path / f"{name}.csv", rows, f"case_id,{HEADER}")
    words = ["run", "--tracks", str(tmp_path / "*_train.csv"), "--map", str(map_path)]
    words += ["--predictor", "constant_velocity", "--no-picture", "--out", str(tmp_path / "run")]
    assert main(words) == 0
    printed = capsys.readouterr()
    assert "cases have 10 frames behind what is scored" in printed.err
    assert "95 % interval, bootstrapped over cases" in printed.out
    logged = read_run(tmp_path / "run")
    assert logged.ids[:4] == ("ONE_train/0:1", "ONE_train/1:1", "ONE_train/2:1", "TWO_train/0:1")
    assert logged.recording_of.tolist() == list(range(6))
    scores = {(s.measure, s.subset): s for s in score_run(logged)}
    ade = scores["ade_3s", "all"]
    assert ade.n == 6 and ade.value == pytest.approx(0.0, abs=1e-6)
    # Played again, a log of cases is still one of cases.
    again = ["run", str(tmp_path / "run"), "--predictor", "constant_velocity", "--no-picture"]
    assert main([*again, "--out", str(tmp_path / "again")]) == 0
    assert {s.n for s in score_run(read_run(tmp_path / "again")) if s.measure == "ade_3s"} == {6}


def test_observations_of_a_challenge_have_a_column_more(
    tmp_path: Path, played: Callable[..., list[Frame]]
) -> None:
    rows = [(3, *row, 1) for row in car(1, 1, 10)]
    write(tmp_path / "PLACE_obs.csv", rows, f"case_id,{HEADER},track_to_predict")
    assert len(where(played("PLACE_obs.csv"), "3:1")) == 10


def as_text(rows: list[Row], header: str = HEADER, between: str = ",", end: str = "\n") -> str:
    table = [header.split(","), *([str(value) for value in row] for row in rows)]
    return "".join(between.join(row) + end for row in table)


def in_a_frame(frames: list[Frame]) -> list[tuple[float, dict[str, tuple[float, ...]]]]:
    """What is seen, whatever the order within a frame."""
    return [
        (
            f.scene.time_s,
            {
                name: (*f.scene.xy_m[k], f.scene.yaw_rad[k], f.scene.speed_mps[k], f.scene.kind[k])
                for k, name in enumerate(f.scene.ids)
            },
        )
        for f in frames
    ]


@pytest.mark.parametrize("way", ["by frame", "shuffled", "semicolons", "tabs", "dressed up"])
def test_files_may_be_sorted_and_written_otherwise(
    tmp_path: Path, played: Callable[..., list[Frame]], way: str
) -> None:
    # Longer than one bucket of tracks, some of them pedestrians whose heading is held.
    rows = [row for k in range(70) for row in car(k, 1 + 4 * k, 30)]
    walk = [("P1", f, 100 * f, "pedestrian/bicycle", 1.0, 2.0, *v) for f, v in
            enumerate([(0.0, -1.0), (0.0, 0.0), (1.0, 0.0), (0.0, 0.0)], start=90)]  # fmt: skip
    rows += [(*row, "", "", "") for row in walk]
    path = tmp_path / "vehicle_tracks_000.csv"
    path.write_text(as_text(rows))
    expected = in_a_frame(played(path.name))
    assert [seen["P1"][2] for _, seen in expected[89:93]] == [-math.pi / 2, -math.pi / 2, 0.0, 0.0]
    others = {
        "by frame": lambda: as_text(sorted(rows, key=lambda row: (row[1], str(row[0])))),
        "shuffled": lambda: as_text([rows[k] for k in np.random.default_rng(1).permutation(2104)]),
        "semicolons": lambda: as_text(rows, between=";"),
        "tabs": lambda: as_text(rows, between="\t"),
        "dressed up": lambda: (
            "\ufeff"
            + as_text(
                [(f'"{row[0]}"', *row[1:]) for row in rows], HEADER.replace(",", ", "), end="\r\n"
            )
            + "\r\n\r\n"
        ),
    }
    path.write_bytes(others[way]().encode())
    assert in_a_frame(played(path.name)) == expected


def test_a_large_file_that_loses_its_order_is_refused(
    tmp_path: Path, played: Callable[..., list[Frame]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table, "BLOCK_BYTES", 1000)
    rows = car(1, 1, 30) + car(2, 1, 30)
    rows.append(rows.pop(29))
    write(tmp_path / "vehicle_tracks_000.csv", rows)
    expected = ":61: track 1: expected its rows together, found it again after another track; sort"
    with pytest.raises(InputError, match=expected):
        played("vehicle_tracks_000.csv")


def test_small_blocks_and_temporary_files_change_nothing(
    tmp_path: Path, played: Callable[..., list[Frame]], monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(5)
    tracks = [car(k, int(rng.integers(1, 1500)), 90, float(rng.normal())) for k in range(60)]
    write(tmp_path / "vehicle_tracks_000.csv", [row for rows in tracks for row in rows])
    walkers = [
        (k, f, 100 * f, "pedestrian", 3.0, 3.0, 0.0, 1.0 * (f % 3 == 0), "", "", "")
        for k in range(20)
        for f in range(40 * k + 1, 40 * k + 30)
    ]
    write(tmp_path / "pedestrian_tracks_000.csv", walkers)
    expected = played("vehicle_tracks_000.csv")
    assert where(expected, "P3") == [k - 1 for k in range(121, 150)]
    made: list[Path] = []
    to_files = spool.Spool._to_files

    def watched(self: spool.Spool) -> None:
        to_files(self)
        made.append(Path(self._folder.name))  # type: ignore[union-attr]

    monkeypatch.setattr(spool.Spool, "_to_files", watched)
    monkeypatch.setattr(spool, "MEMORY_BYTES", 20_000)
    monkeypatch.setattr(table, "BLOCK_BYTES", 2_000)
    frames = played("vehicle_tracks_000.csv")
    assert len(made) > 5 and not made[0].exists()
    assert len(frames) == len(expected)
    for one, other in zip(frames, expected, strict=True):
        assert one.scene.ids == other.scene.ids and asdict(one.truth) == asdict(other.truth)
        for field in ("xy_m", "yaw_rad", "speed_mps", "size_m", "kind", "colour"):
            assert np.array_equal(getattr(one.scene, field), getattr(other.scene, field))


def test_memory_does_not_grow_with_the_file(
    tmp_path: Path, map_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spool, "MEMORY_BYTES", 100_000)
    monkeypatch.setattr(table, "BLOCK_BYTES", 50_000)
    monkeypatch.setattr(checks, "MOST_STEPS", 1000)
    monkeypatch.setattr(scan, "MOST_PLACES", 1000)
    peaks: list[int] = []
    for count in (100, 800):
        rows = [row for k in range(count) for row in car(k, 1 + 10 * k, 90)]
        path = write(tmp_path / "vehicle_tracks_000.csv", rows)
        del rows
        gc.collect()
        recording = InteractionRecording("x", RecordedSource((path,), map_path))
        assert len(recording.lanes) == 7
        tracemalloc.start()
        assert sum(1 for _ in recording.frames()) == 10 * count + 80
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert path.stat().st_size > 3_500_000
    assert peaks[1] < 1.5 * peaks[0]


def changed(row: int, column: str, value: object) -> Callable[[list[list[str]]], None]:
    """Overwrites a value; row 0 is the header."""

    def change(table: list[list[str]]) -> None:
        table[row][table[0].index(column)] = str(value)

    return change


def each(column: str, value: Callable[[float], object]) -> Callable[[list[list[str]]], None]:
    def change(table: list[list[str]]) -> None:
        at = table[0].index(column)
        for row in table[1:]:
            row[at] = str(value(float(row[at])))

    return change


def both(*changes: Callable[[list[list[str]]], None]) -> Callable[[list[list[str]]], None]:
    def change(table: list[list[str]]) -> None:
        for one in changes:
            one(table)

    return change


def without(column: str) -> Callable[[list[list[str]]], None]:
    def change(table: list[list[str]]) -> None:
        at = table[0].index(column)
        for row in table:
            del row[at]

    return change


FAULTS: dict[str, tuple[Callable[[list[list[str]]], object], str]] = {
    "missing column": (without("vy"), ":1: expected the columns track_id,.* found no 'vy'; "),
    "extra column": (
        lambda t: [row.append("lane" if k == 0 else "2") for k, row in enumerate(t)],
        ":1: expected the columns .* found unknown 'lane'; ",
    ),
    "hole": (
        lambda t: t.__delitem__(slice(11, 14)),
        ":12: track 1: expected frame 11 after 10, found 14: the track has a hole of 3 frames; ",
    ),
    "repeated frame": (
        lambda t: t.insert(8, list(t[7])),
        ":9: track 1: expected frame 8 after 7, found 7 again; take the repeated row out",
    ),
    "backwards": (
        lambda t: t.__setitem__(slice(5, 7), [t[6], t[5]]),
        ":6: track 1: expected frame 5 after 4, found 6",
    ),
    "not a number": (changed(4, "x", "abc"), ":5: x: expected a number, found 'abc'"),
    "nan": (changed(4, "x", "nan"), ":5: x: expected a number, found none; correct the row"),
    "inf": (changed(4, "vy", "inf"), ":5: vy: expected a number, found inf; correct the row"),
    "blank": (changed(4, "psi_rad", ""), ":5: psi_rad: expected a number, found none; "),
    "no name": (changed(4, "track_id", ""), ":5: track_id: expected a name, found none"),
    "half a frame": (changed(4, "frame_id", 4.5), ":5: frame_id: expected a whole number"),
    "short row": (lambda t: t[6].pop(), ":7: expected 11 columns, found 10; correct the row"),
    "25 Hz": (
        each("timestamp_ms", lambda ms: ms * 0.4),
        r":3: track 1: expected 100 ms from row to row \(10 Hz\), found 40 ms \(25 Hz\); resample ",
    ),
    "video frames": (
        each("frame_id", lambda frame: frame * 3),
        ":3: track 1: frame_id and timestamp_ms do not agree: 3 frames in 100 ms, expected 100 ms ",
    ),
    "two clocks": (
        lambda t: [changed(k, "timestamp_ms", 100 * (k + 7))(t) for k in range(31, 61)],
        ":32: frame_id and timestamp_ms do not agree: expected frame 11 at 1100 ms as in the rows "
        "above, found 3800 ms; ",
    ),
    "km/h": (
        each("vx", lambda v: 3.6 * v),
        ": expected m/s in vx, vy at which x, y move in metres, found 3.6 times that "
        r"\(median of 58 steps\); km/h in vx, vy\? divide them by 3.6",
    ),
    "centimetres": (
        both(each("x", lambda x: 100 * x), each("y", lambda y: 100 * y)),
        r": expected m/s in vx, .* found 0.01 times that .* cm in x, y\? divide them by 100",
    ),
    "degrees": (
        each("psi_rad", lambda _: 90.0),
        r":2: psi_rad: expected radians within -4 pi and 4 pi, found 90; degrees\? correct the row",
    ),
    "from north": (
        each("psi_rad", lambda yaw: math.pi / 2 - yaw),
        r": expected psi_rad as x, y move, counter-clockwise from \+x, found it more than 60 "
        r"degrees off in 100% of 58 steps; clockwise, or from north\? convert it",
    ),
    "length in cm": (
        each("length", lambda m: 100 * m),
        r":2: length: expected metres above 0 and up to 80, found 450; another unit\?",
    ),
    "off the map": (
        each("x", lambda x: x + 1000),
        r": expected vehicles on the map .*map.osm, found 100% of their places more than 30 m from "
        r"every lane \(median 8\d\d m, the farthest 8\d\d m; tracks around \(97\d, 0\), lanes "
        r"around \(-?\d+, -?\d+\)\): map and tracks seem not to belong together; give the map of ",
    ),
    "a slip in the times": (
        both(*(lambda t, c=c, by=by: [changed(k, c, float(t[k][t[0].index(c)]) + by)(t)
                                      for k in range(31, 61)]
               for c, by in (("frame_id", 40_000), ("timestamp_ms", 4_000_000)))),
        ": frame 40011: expected pauses of at most 3600 s, found nobody for 3998 s; ",
    ),
    "no rows": (lambda t: t.__delitem__(slice(1, None)), ": expected tracks, found none; "),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_one_clear_line(
    tmp_path: Path, played: Callable[..., list[Frame]], fault: str
) -> None:
    change, expected = FAULTS[fault]
    rows = [*car(1, 1, 30), *car(2, 11, 30, y_m=1.0)]
    table = [HEADER.split(","), *([str(value) for value in row] for row in rows)]
    change(table)
    path = tmp_path / "vehicle_tracks_000.csv"
    path.write_text("\n".join(",".join(row) for row in table) + "\n")
    with pytest.raises(InputError, match=f"^{path}{expected}") as error:
        played("vehicle_tracks_000.csv")
    assert "\n" not in str(error.value)


def test_files_that_are_no_tracks(
    tmp_path: Path, map_path: Path, played: Callable[..., list[Frame]]
) -> None:
    path = tmp_path / "vehicle_tracks_000.csv"
    for content, expected in (
        (b"", "expected CSV with a header, found an empty file or line"),
        (b"PAR1\xff\xfe\x00" * 100, "expected CSV, found no text; give the right file"),
        (b"PK\x03\x04" * 40, "expected the columns"),
        (HEADER.encode() + b"\n1,1,100,c\xe9r,1,1,1,1,0,4,2\n", "agent_type: expected UTF-8 text"),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=expected) as error:
            played(path.name)
        assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)
    path.write_text(HEADER + "\n")
    with pytest.raises(InputError, match=r"expected tracks as .*found files of other or mixed"):
        open_recording("x", RecordedSource((path, map_path), map_path))
    with pytest.raises(InputError, match="found a folder that is not of a run"):
        open_recording("x", RecordedSource((tmp_path,), map_path))
    write(path, car(1, 1, 9))
    write(tmp_path / "b.csv", [(1, *row) for row in car(1, 1, 9)], f"case_id,{HEADER}")
    with pytest.raises(InputError, match="found some with cases"):
        played(path.name, "b.csv")
    write(
        tmp_path / "pedestrian_tracks_000.csv",
        [(*row[:2], row[2] + 50, *row[3:]) for row in car(2, 1, 9)],
    )
    with pytest.raises(
        InputError, match="expected frame 0 at 0 ms as with the vehicles, found it at 50"
    ):
        played(path.name)
    for name in (path.name, "pedestrian_tracks_000.csv"):
        write(tmp_path / name, [(1, *row) for row in car(1, 1, 9)], f"case_id,{HEADER}")
    with pytest.raises(InputError, match="found 2 files of one recording; join them"):
        played(path.name)
    write(path, car(1, 1, 9))
    (tmp_path / "pedestrian_tracks_000.csv").unlink()
    (tmp_path / "vehicle_ids_000.csv").write_text("a,b,c\n")
    with pytest.raises(
        InputError, match=r"vehicle_ids_000.csv: expected rows of track_id,id below"
    ):
        played(path.name)


def drive(
    rng: np.random.Generator, names: dict[str, tuple[int, int, Kind]], count: int
) -> list[Frame]:
    """Road users near the crossing from their first to before their last frame."""
    state = {name: (rng.uniform(-20, 20, 2), rng.uniform(-math.pi, math.pi)) for name in names}
    frames: list[Frame] = []
    for k in range(count):
        ids = tuple(n for n, (first, last, _) in names.items() if first <= k < last and k != 17)
        speed = {n: 5.0 + rng.uniform(-0.1, 0.1) for n in names}
        for name in names:
            xy_m, yaw = state[name]
            step = 0.1 * speed[name] * np.array([math.cos(yaw), math.sin(yaw)])
            state[name] = (xy_m + step, yaw)
        scene = Scene(
            time_s=round(3.0 + 0.1 * k, 6),
            ids=ids,
            xy_m=np.array([state[n][0] for n in ids]).reshape(-1, 2),
            yaw_rad=np.array([state[n][1] for n in ids]),
            speed_mps=np.array([speed[n] for n in ids]),
            size_m=np.array([[4.0 + 0.1 * len(n), 1.9] for n in ids]).reshape(-1, 2),
            kind=np.array([names[n][2] for n in ids], dtype=np.int64),
            colour=np.full((len(ids), 3), 9),
            blinker=np.zeros(len(ids), dtype=np.int64),
            signal_closed=np.zeros(0, dtype=np.bool_),
        )
        frames.append(Frame(scene, Truth((None,) * len(ids)), k == count - 1))
    return frames


@pytest.mark.parametrize("plain", [True, False])
def test_a_run_comes_back_from_its_export(tmp_path: Path, plain: bool) -> None:
    kinds = list(Kind) if not plain else [Kind.CAR, Kind.BUS, Kind.OTHER]
    # Names as SUMO and users make them; everybody is away for frame 17 or comes later.
    names = {
        (str(11 + k) if plain else f"fl,ow \"{k}\".é"): (18 + k if plain else 2 * k, 50 - k, kind)
        for k, kind in enumerate(kinds)
    }  # fmt: skip
    frames = drive(np.random.default_rng(3), names, 60)
    run_folder, out = tmp_path / "run", tmp_path / "out"
    with RunWriter(run_folder, {"scene": "x"}) as writer:
        write_road(run_folder / ROAD_FILE, crossing_lanes())
        for index, frame in enumerate(frames):
            writer.write(index, frame, {})
    out.mkdir()
    files = export_interaction(read_run(run_folder), out)
    expected_files = ["vehicle_tracks_000.csv", "map.osm"] if plain else [
        "vehicle_tracks_000.csv", "pedestrian_tracks_000.csv", "vehicle_ids_000.csv", "map.osm"
    ]  # fmt: skip
    assert [path.name for path in files] == expected_files
    back = {f.scene.time_s: f.scene for f in
            open_recording("x", RecordedSource((files[0],), files[-1])).frames()}  # fmt: skip
    seen = 0
    for frame in frames:
        scene = frame.scene
        if not scene.ids:
            assert scene.time_s not in back or not back[scene.time_s].ids
            continue
        other = back[scene.time_s]
        assert sorted(other.ids) == sorted(scene.ids)
        order = [other.ids.index(name) for name in scene.ids]
        for field in ("xy_m", "yaw_rad", "size_m", "kind"):
            assert np.array_equal(getattr(other, field)[order], getattr(scene, field))
        assert np.allclose(other.speed_mps[order], scene.speed_mps, rtol=0, atol=1e-12)
        seen += len(scene.ids)
    assert seen > 80


def test_the_sample_is_a_scene() -> None:
    scenario = load_scenario("recorded_sample")
    with open_traffic(scenario) as simulator:
        frame = simulator.reset(1)
        frames = [frame]
        while not frame.done:
            frame = simulator.step()
            frames.append(frame)
        road = simulator.road
    assert len(frames) == 450
    assert max(len(frame.scene.ids) for frame in frames) >= 5
    on_lane = [
        bool(road.lane_graph.near(xy_m, yaw, Kind(kind)))
        for frame in frames[::20]
        for xy_m, yaw, kind in zip(
            frame.scene.xy_m, frame.scene.yaw_rad.tolist(), frame.scene.kind, strict=True
        )
    ]
    assert len(on_lane) > 80 and np.mean(on_lane) > 0.99
