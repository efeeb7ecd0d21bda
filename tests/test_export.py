"""A run written for other programs: it reads back as the same tracks, also by other readers."""

from __future__ import annotations

import gzip
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import crossing_lanes
from test_log import make_frame

from hatn_sim.cli import main
from hatn_sim.config import load_scenario, load_tracks
from hatn_sim.datatypes import Frame, Kind, Recording
from hatn_sim.errors import InputError
from hatn_sim.log import RunWriter, read_run
from hatn_sim.log.road_file import ROAD_FILE, write_road
from hatn_sim.recordings.fcd.export import export_fcd
from hatn_sim.recordings.find import open_recording
from hatn_sim.simulators.sumo import SumoSimulator

FRAMES = 60


def log(out: Path, frames: Sequence[Frame], finished: bool = True) -> None:
    with RunWriter(out, {"scene": "made_up", "seed": 1}) as writer:
        write_road(out / ROAD_FILE, crossing_lanes())
        for index, frame in enumerate(frames):
            writer.write(index, frame, {})
        writer.close(finished=finished)


def driving(frames: int) -> list[Frame]:
    """Vehicles of all kinds and any names, some walkers among them, along the crossing's street."""
    rng = np.random.default_rng(7)
    made: list[Frame] = []
    names = np.array(["a & b", '<"c">', "d'e", "ä ö", "person:7", "8", "f\tg", "h"])
    speeds_mps = rng.uniform(2, 9, len(names))
    kinds = np.array([*range(7), Kind.PEDESTRIAN])
    sizes_m = rng.uniform(0.3, 9, (len(names), 2))
    for index in range(frames):
        there = rng.permutation(len(names))[: rng.integers(4, len(names) + 1)]
        scene = make_frame(rng, index).scene
        x_m = -60 + 0.1 * index * speeds_mps[there] + rng.normal(size=len(there)) * 1e-3
        scene = replace(
            scene,
            time_s=50.3 + 0.1 * index,
            ids=tuple(names[there].tolist()),
            xy_m=np.column_stack((x_m, rng.normal(size=len(there)))),
            yaw_rad=rng.uniform(-np.pi, np.pi, len(there)),
            speed_mps=speeds_mps[there],
            size_m=sizes_m[there],
            kind=kinds[there],
            colour=rng.integers(0, 256, (len(there), 3)),
            blinker=rng.integers(-1, 2, len(there)),
            signal_closed=rng.random(3) < 0.5,
        )
        nowhere = (None,) * len(there)
        made.append(Frame(scene, replace(make_frame(rng, 0).truth, routes=nowhere), done=False))
    return made


def assert_same_tracks(frames: Sequence[Frame], expected: Sequence[Frame]) -> None:
    assert len(frames) == len(expected)
    for frame, other in zip(frames, expected, strict=True):
        here, there = frame.scene, other.scene
        assert here.ids == there.ids
        assert here.time_s == there.time_s
        for name in ("xy_m", "yaw_rad"):
            np.testing.assert_allclose(getattr(here, name), getattr(there, name), rtol=0, atol=1e-9)
        for name in ("speed_mps", "size_m", "kind", "colour", "blinker", "signal_closed"):
            np.testing.assert_array_equal(getattr(here, name), getattr(there, name))


def played_back(words: str) -> Recording:
    """What the printed command would play."""
    verb = words.split()
    assert verb[:3] == ["hatn-sim", "run", "--tracks"] and verb[4] == "--map"
    scenario = load_tracks((verb[3],), Path(verb[5]))
    assert scenario.recorded is not None
    return open_recording("back", scenario.recorded)


def test_a_simulated_run_comes_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = load_scenario("roundabout4_two_lane", density="dense")
    with SumoSimulator(scenario) as simulator:
        simulator.reset(2)
        frames = [simulator.step() for _ in range(400)][-FRAMES:]
        lanes = simulator.lanes
        with RunWriter(tmp_path / "run", {"scene": "x", "seed": 1}) as writer:
            write_road(tmp_path / "run" / ROAD_FILE, lanes)
            for index, frame in enumerate(frames):
                writer.write(index, frame, {})
    out = tmp_path / "out"
    words = ["export", str(tmp_path / "run"), "--format", "fcd", "--out", str(out), "--json"]
    assert main(words) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["files"] == [str(out / "fcd.xml.gz"), str(out / ROAD_FILE)]
    played = played_back(printed["command"])
    assert_same_tracks(list(played.frames()), frames)
    assert len(frames[-1].scene.ids) > 5
    assert [lane.id for lane in played.lanes] == [lane.id for lane in lanes]
    assert all(
        (lane.xy_m == other.xy_m).all() for lane, other in zip(played.lanes, lanes, strict=True)
    )
    assert played.notices == ()


def test_names_kinds_and_signals_come_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = driving(FRAMES)
    log(tmp_path / "run", frames)
    assert main(["export", str(tmp_path / "run"), "--format", "fcd"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [Path(line) for line in lines[:2]] == [
        tmp_path / "run" / "fcd" / "fcd.xml.gz",
        tmp_path / "run" / "fcd" / ROAD_FILE,
    ]
    played = played_back(lines[2].removeprefix("to read them: "))
    assert_same_tracks(list(played.frames()), frames)
    assert played.notices == ()


def test_another_reader_finds_front_bumpers_and_compass_angles(tmp_path: Path) -> None:
    frames = driving(FRAMES)
    log(tmp_path / "run", frames)
    tracks, _ = export_fcd(read_run(tmp_path / "run"), tmp_path)
    with gzip.open(tracks) as file:
        root = ElementTree.parse(file).getroot()
    assert root.tag == "fcd-export"
    assert [float(step.attrib["time"]) for step in root] == [f.scene.time_s for f in frames]
    for step, frame in zip(root, frames, strict=True):
        scene = frame.scene
        walks = scene.kind == Kind.PEDESTRIAN
        assert [user.tag == "person" for user in step] == walks.tolist()
        assert [user.attrib["id"] for user in step] == list(scene.ids)
        for place, user in enumerate(step):
            x_m, y_m, angle_deg, length_m, signals = (
                float(user.attrib[key]) for key in ("x", "y", "angle", "length", "signals")
            )
            # A unit vector by the compass: north is y.
            east, north = np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))
            assert 0 <= angle_deg < 360
            centre_m = (x_m - length_m / 2 * east, y_m - length_m / 2 * north)
            np.testing.assert_allclose(centre_m, scene.xy_m[place], atol=1e-9)
            assert int(signals) == {1: 2, 0: 0, -1: 1}[int(scene.blinker[place])]


def test_sumo_s_own_library_reads_it(tmp_path: Path) -> None:
    sumolib = pytest.importorskip("sumolib", reason="comes with eclipse-sumo")
    frames = driving(FRAMES)
    log(tmp_path / "run", frames)
    tracks, _ = export_fcd(read_run(tmp_path / "run"), tmp_path)
    plain = tmp_path / "fcd.xml"
    plain.write_bytes(gzip.decompress(tracks.read_bytes()))
    steps = list(sumolib.xml.parse(str(plain), "timestep"))
    assert [float(step.time) for step in steps] == [frame.scene.time_s for frame in frames]
    for step, frame in zip(steps, frames, strict=True):
        speeds_mps = {user.id: float(user.speed) for user in (step.vehicle or [])}
        cars = frame.scene.kind != Kind.PEDESTRIAN
        assert speeds_mps == dict(
            zip(
                np.array(frame.scene.ids)[cars].tolist(),
                frame.scene.speed_mps[cars].tolist(),
                strict=True,
            )
        )


def test_tracks_in_the_other_format_are_played_by_the_printed_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with SumoSimulator(load_scenario("tjunction")) as simulator:
        simulator.reset(1)
        frames = [simulator.step() for _ in range(300)][-FRAMES:]
        lanes = simulator.lanes
    log(tmp_path / "run", frames)
    write_road(tmp_path / "run" / ROAD_FILE, lanes)
    words = ["export", str(tmp_path / "run"), "--format", "interaction", "--json"]
    assert main(words) == 0
    printed = json.loads(capsys.readouterr().out)
    assert all(Path(name).is_file() for name in printed["files"])
    back = list(played_back(printed["command"]).frames())
    assert len(back) == FRAMES
    for frame, other in zip(back, frames, strict=True):
        here, there = frame.scene, other.scene
        assert set(here.ids) == set(there.ids) and there.ids
        rows = [here.ids.index(name) for name in there.ids]
        np.testing.assert_allclose(here.xy_m[rows], there.xy_m, rtol=0, atol=1e-9)
        np.testing.assert_allclose(here.speed_mps[rows], there.speed_mps, rtol=0, atol=1e-9)


def test_the_same_run_gives_the_same_bytes(tmp_path: Path) -> None:
    log(tmp_path / "run", driving(20))
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        export_fcd(read_run(tmp_path / "run"), tmp_path / name)
    for name in ("fcd.xml.gz", ROAD_FILE):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_an_unfinished_run_is_written_as_far_as_it_goes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log(tmp_path / "run", driving(20), finished=False)
    assert main(["export", str(tmp_path / "run"), "--format", "fcd"]) == 0
    assert "unfinished run: its first 2.0 s were written" in capsys.readouterr().err


def test_what_cannot_be_exported_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log(tmp_path / "empty", [])
    frame = driving(1)[0]
    odd = replace(frame, scene=replace(frame.scene, ids=("\x01", *frame.scene.ids[1:])))
    log(tmp_path / "odd", [odd])
    log(tmp_path / "bare", [frame])
    (tmp_path / "bare" / ROAD_FILE).unlink()
    log(tmp_path / "good", [frame])
    (tmp_path / "taken").mkdir()
    cases = {
        ("none",): "expected the folder of a run, found no run.json",
        ("empty",): "expected frames, found a run without any",
        ("odd",): "has a character in its name that XML cannot hold",
        ("bare",): "expected the lanes of the run",
        ("good", "--out", str(tmp_path / "taken")): "taken: exists already",
        ("good", "--out", str(tmp_path / "good" / "run.json" / "x")): "cannot be made",
    }
    for (name, *more), words in cases.items():
        assert main(["export", str(tmp_path / name), "--format", "fcd", *more]) == 2
        complaint = capsys.readouterr().err
        assert words in complaint
        assert complaint.count("\n") == 1
    with pytest.raises(SystemExit, match="2"):
        main(["export", str(tmp_path / "good"), "--format", "csv"])


def test_a_log_without_lanes_cannot_be_played(tmp_path: Path) -> None:
    log(tmp_path / "run", driving(3))
    write_road(tmp_path / "run" / ROAD_FILE, [])
    tracks, road = export_fcd(read_run(tmp_path / "run"), tmp_path)
    scenario = load_tracks((str(tracks),), road)
    assert scenario.recorded is not None
    with pytest.raises(InputError, match="expected lanes for vehicles, found none"):
        list(open_recording("x", scenario.recorded).frames())
