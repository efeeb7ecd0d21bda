"""A run replayed from its log: the same frames, the same truth, the same advice line for line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import pytest
from conftest import crossing_lanes

from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Frame, Simulator
from hatn_sim.errors import InputError
from hatn_sim.log import RunWriter, parts, read_run, schema
from hatn_sim.log.road_file import ROAD_FILE, write_road
from hatn_sim.loop import Adviser, run, warm_up
from hatn_sim.predictors.find import load_predictor
from hatn_sim.recordings.run_log import RunRecording
from hatn_sim.simulators.recorded import RecordedSimulator
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.traffic import open_traffic

HEADER = {"scene": "roundabout8", "seed": 1}
FRAMES = 80
EVENT_FILES = (schema.SUGGESTIONS_FILE, schema.ALERTS_FILE)


def frame_bytes(frame: Frame) -> list[object]:
    """All of a frame but `done`, floats to their last bit."""
    values = [getattr(frame.scene, field.name) for field in fields(frame.scene)]
    exact = [
        (value.dtype, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value
        for value in values
    ]
    return [*exact, asdict(frame.truth)]


def log_a_run(
    simulator: Simulator,
    first: Frame,
    out: Path,
    predictors: Sequence[str],
    egos: frozenset[str] | None,
    frames: int,
) -> list[Frame]:
    """Logs as `hatn-sim run` does; returns the frames that were logged."""
    advisers = [Adviser(load_predictor(name), egos=egos) for name in predictors]
    seen: list[Frame] = []
    with RunWriter(out, HEADER) as writer:
        write_road(out / ROAD_FILE, simulator.road.lanes.values())

        def write(index: int, frame: Frame, advice: object) -> None:
            seen.append(frame)
            writer.write(index, frame, advice)  # type: ignore[arg-type]

        run(simulator, advisers, first, frames, write)
    return seen


ADVISED_BY = ("hatn", "idm")


def simulated(out: Path, predictors: Sequence[str], egos: frozenset[str] | None) -> list[Frame]:
    scenario = load_scenario("roundabout8", density="dense", risk="inattentive")
    with SumoSimulator(scenario) as simulator:
        first = warm_up(simulator, simulator.reset(5), 300)
        return log_a_run(simulator, first, out, predictors, egos, FRAMES)


def replayed(log: Path, out: Path, predictors: Sequence[str], egos: frozenset[str] | None) -> None:
    simulator = open_traffic(load_scenario(str(log)))
    try:
        log_a_run(simulator, simulator.reset(0), out, predictors, egos, 10_000)
    finally:
        simulator.close()


@pytest.fixture(autouse=True)
def short_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the runs here have several."""
    monkeypatch.setattr(schema, "PART_FRAMES", 50)


@pytest.fixture(scope="module")
def all_told(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Frame]]:
    """A run in which everybody is told, and its frames."""
    folder = tmp_path_factory.mktemp("all") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(schema, "PART_FRAMES", 50)
        return folder, simulated(folder, ADVISED_BY, None)


@pytest.mark.parametrize("some_egos_only", [False, True])
def test_replayed_with_the_same_egos_the_advice_is_the_same_line_for_line(
    all_told: tuple[Path, list[Frame]], tmp_path: Path, some_egos_only: bool
) -> None:
    predictors, egos = ADVISED_BY, None
    log, frames = all_told
    if some_egos_only:
        alerted = {alert.ego_id for _, alert in read_run(log).alerts}
        egos = frozenset(alerted | {frames[0].scene.ids[0]})
        assert len(egos) < len(read_run(log).ids)
        log = tmp_path / "some"
        simulated(log, predictors, egos)
    replayed(log, tmp_path / "again", predictors, egos)

    for name in EVENT_FILES:
        assert (tmp_path / "again" / name).read_bytes() == (log / name).read_bytes()
    first, second = read_run(log), read_run(tmp_path / "again")
    assert first.suggestions and first.alerts
    assert egos is None or {change.ego_id for change in first.suggestions} <= egos
    assert len(frames) == second.frame_count == FRAMES
    for predictor in predictors:
        one, other = first.predictions(predictor), second.predictions(predictor)
        assert len(one.frame)
        for field in fields(one):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


def test_frames_are_those_of_the_run_to_the_last_bit(tmp_path: Path) -> None:
    frames = simulated(tmp_path / "run", ("constant_velocity",), None)
    recording = RunRecording(tmp_path / "run")
    assert recording.name == "roundabout8"
    assert recording.notices == ()
    again = list(recording.frames())
    assert [frame_bytes(frame) for frame in again] == [frame_bytes(frame) for frame in frames]
    assert [frame.done for frame in again] == [False] * (FRAMES - 1) + [True]
    assert frames[0].truth.routes[0] is not None
    with SumoSimulator(load_scenario("roundabout8")) as simulator:
        lanes = {lane.id: lane for lane in simulator.lanes}
    assert {lane.id for lane in recording.lanes} == lanes.keys()
    for lane in recording.lanes:
        assert lane.xy_m.tobytes() == lanes[lane.id].xy_m.tobytes()
        assert lane.signals == lanes[lane.id].signals
        assert lane.kinds == lanes[lane.id].kinds


def made_up_log(out: Path, frames: int, finished: bool = True) -> None:
    from test_log import make_frame

    rng = np.random.default_rng(4)
    writer = RunWriter(out, HEADER)
    write_road(out / ROAD_FILE, crossing_lanes())
    for index in range(frames):
        writer.write(index, make_frame(rng, index), {})
    if finished:
        writer.close()


def test_the_log_is_read_part_by_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made_up_log(tmp_path / "run", 175)
    frames = RunRecording(tmp_path / "run").frames()
    read: list[Path] = []
    really_read = parts._read_part

    def noted(path: Path, names: list[str]) -> object:
        read.append(path)
        return really_read(path, names)

    monkeypatch.setattr(parts, "_read_part", noted)
    next(frames)
    assert {path.name for path in read} == {"part-00000.parquet"}
    read.clear()
    assert len(list(frames)) == 174
    assert len(read) == 3 * 3  # three tables, three parts to go, each once


def test_an_unfinished_run_is_played_as_far_as_it_goes(tmp_path: Path) -> None:
    made_up_log(tmp_path / "run", 120, finished=False)
    recording = RunRecording(tmp_path / "run")
    assert "unfinished" in recording.notices[0]
    assert "10.0 s" in recording.notices[0]
    with RecordedSimulator(recording) as simulator:
        frame = simulator.reset(0)
        count = 1
        while not frame.done:
            frame, count = simulator.step(), count + 1
    assert count == 100


def test_what_is_no_run_to_be_played_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"found no run\.json"):
        RunRecording(tmp_path)
    made_up_log(tmp_path / "empty", 0)
    with pytest.raises(InputError, match="empty: expected frames"):
        RunRecording(tmp_path / "empty")
    made_up_log(tmp_path / "run", 3)
    (tmp_path / "run" / ROAD_FILE).unlink()
    with pytest.raises(InputError, match="expected the lanes of the run"):
        _ = RunRecording(tmp_path / "run").lanes
