"""One seed of a scene, driven again and again: by the simulator, then by an agent with predictors.

The simulator drives everybody first. That run is the reference: in it those are found who are to be
driven, and all predictors are scored on it, open loop. Then each of those vehicles, one at a time,
is driven by the agent, once with each predictor. Up to the moment at which it comes on the road
each of these runs is the reference to the last bit, so that all are pairs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from hatn_sim.config import Scenario
from hatn_sim.datatypes import (
    DT_S,
    TRACK_FRAMES,
    Advice,
    Frame,
    Kind,
    Predictor,
    SafetyEvent,
    Simulator,
)
from hatn_sim.errors import HatnSimError, InputError, SimulatorError
from hatn_sim.evaluation.closed_loop_oracle import BranchOracle
from hatn_sim.evaluation.pool import Teller
from hatn_sim.evaluation.runs import predictor_of_process
from hatn_sim.labels import SAMPLE_EVERY_FRAMES
from hatn_sim.log import RunWriter, read_run
from hatn_sim.loop import Adviser, begin, begin_to_drive, decide, observe, run, tick, warm_up
from hatn_sim.plugins import load_agent
from hatn_sim.score.close_passes import close_passes
from hatn_sim.score.closed_loop import drive_measures
from hatn_sim.score.closed_loop_rows import (
    ORACLE,
    REFERENCE,
    DrivenEgo,
    DrivenRow,
    OpenLoop,
    read_row,
    write_row,
)
from hatn_sim.score.drive import CROSSED, Drive, DriveRecorder
from hatn_sim.score.driven import driven_by
from hatn_sim.score.prediction import score_run
from hatn_sim.traffic import open_traffic

BEFORE_FRAMES: Final = 11
"""Of the others' motion before the ego comes that a drive is measured with."""
OPEN_LOOP: Final = ("ade_3s", "fde_3s", "goal_error", "slot_accuracy")
"""Measures of `score.prediction` that are kept."""
DRIVEN_KINDS: Final = (Kind.CAR, Kind.VAN, Kind.LORRY, Kind.BUS, Kind.MOTORCYCLE)


@dataclass(frozen=True, eq=False)
class SeedPlan:
    """A seed of a scene that is wanted; a process of its own can make it."""

    label: str  # what it is called in progress and errors
    folder: Path  # of its rows
    scenario: Scenario
    seed: int
    agent: str
    predictors: tuple[str, ...]
    weights: Path | None
    egos: int  # vehicles that are driven, at most
    warm_up_s: float
    duration_s: float  # of the reference
    limit_s: float  # of a drive
    made_with: Mapping[str, Mapping[str, Any]]  # by row: what another in its place is held against

    @property
    def rows(self) -> tuple[str, ...]:
        return REFERENCE, *self.predictors


@dataclass(frozen=True)
class SeedMade:
    """What making a seed came to."""

    frames: int
    lost: tuple[str, ...]  # a line for each row that is missing


def row_path(plan: SeedPlan, row: str) -> Path:
    """The file of a row."""
    return plan.folder / f"{row.replace(':', '.')}.json"


def missing_rows(plan: SeedPlan) -> list[str]:
    """Those that are not there. Raises InputError where others are in their place, or damage."""
    missing: list[str] = []
    for row in plan.rows:
        path = row_path(plan, row)
        if not path.exists():
            missing.append(row)
            continue
        found = read_row(path).made_with
        for key, wanted in plan.made_with[row].items():
            if found.get(key) != wanted:
                raise InputError(
                    f"{path}: was made otherwise: expected {key} {wanted}, found "
                    f"{found.get(key)}; choose another --out"
                )
    return missing


def make_seed(plan: SeedPlan, teller: Teller) -> SeedMade:
    """All rows of the seed that are not there, each kept as soon as it is made.

    A simulator that fails or is killed costs its row, and is told in `lost`. Raises HatnSimError,
    with the seed's label, for everything else that goes wrong.
    """
    missing = missing_rows(plan)
    steps = _Steps(teller)
    try:
        with closing(open_traffic(plan.scenario)) as simulator:
            reference = _reference(plan, simulator, missing, steps)
        _keep(plan, REFERENCE, reference.egos, ())
        lost: list[str] = []
        egos = _same_drives(plan, missing)
        for row in missing:
            if row != REFERENCE:
                try:
                    if egos is None or not drives_alike(plan.agent):
                        egos = tuple(_driven(plan, row, ego, steps) for ego in reference.egos)
                except SimulatorError as error:
                    lost.append(f"{plan.label}, {row}: lost: {error}")
                else:
                    _keep(plan, row, egos, reference.open_loop.get(row, ()))
        return SeedMade(steps.done, tuple(lost))
    except SimulatorError as error:
        return SeedMade(steps.done, (f"{plan.label}: lost: {error}",))
    except HatnSimError as error:
        raise type(error)(f"{plan.label}: {error}") from None


def drives_alike(agent: str) -> bool:
    """Whether an agent decides by the scene alone, and so drives the same with each predictor."""
    loaded = load_agent(agent)
    reads_predictions = getattr(loaded, "reads_predictions", True)
    return not reads_predictions and not getattr(loaded, "reads_suggestions", True)


def _same_drives(plan: SeedPlan, missing: Sequence[str]) -> tuple[DrivenEgo, ...] | None:
    """Those of a row that is there already, of an agent that drives alike."""
    there = [row for row in plan.predictors if row not in missing]
    if not there or not drives_alike(plan.agent):
        return None
    return read_row(row_path(plan, there[0])).egos


def _keep(
    plan: SeedPlan, row: str, egos: Sequence[DrivenEgo], open_loop: Sequence[OpenLoop]
) -> None:
    made_with = plan.made_with[row]
    kept = DrivenRow(plan.scenario.name, plan.seed, row, tuple(egos), tuple(open_loop), made_with)
    write_row(row_path(plan, row), kept)


class _Steps:
    """Counts the frames of all runs of a seed, and tells."""

    def __init__(self, teller: Teller) -> None:
        self.done = 0
        self._teller = teller

    def tell(self) -> None:
        """One more. Raises Stopped where the work is not wanted any more."""
        self._teller.tell(self.done)
        self.done += 1


# ---------------------------------------------------------------------------------------------
# The reference


@dataclass(frozen=True, eq=False)
class _Reference:
    egos: list[DrivenEgo]
    open_loop: Mapping[str, tuple[OpenLoop, ...]]  # by predictor


def _reference(
    plan: SeedPlan, simulator: Simulator, rows: Sequence[str], steps: _Steps
) -> _Reference:
    """Everybody driven by the simulator, and predicted by the predictors among `rows`."""
    names = [row for row in rows if row not in (REFERENCE, ORACLE)]
    advisers = [Adviser(_predictor(plan, name), egos=frozenset()) for name in names]
    frames: list[Frame] = []
    first = warm_up(simulator, simulator.reset(plan.seed), round(plan.warm_up_s / DT_S))
    header = {"scene": plan.scenario.name, "seed": plan.seed}
    with TemporaryDirectory(prefix="hatn-sim-") as folder:
        log = Path(folder) / "run"
        with RunWriter(log, header) as writer:

            def write(index: int, frame: Frame, advice: Mapping[str, Advice]) -> None:
                steps.tell()
                frames.append(frame)
                writer.write(index, frame, advice)

            wanted = round(plan.duration_s / DT_S)
            run(simulator, advisers, first, wanted, write, every_frames=SAMPLE_EVERY_FRAMES)
        scores = score_run(read_run(log)) if names else []
    told = {adviser.predictor.name: name for adviser, name in zip(advisers, names, strict=True)}
    open_loop = {name: list[OpenLoop]() for name in names}
    for score in scores:
        if score.measure in OPEN_LOOP and score.value is not None:
            one = OpenLoop(score.measure, score.subset, score.unit, score.value, score.n)
            open_loop[told[score.predictor]].append(one)
    egos = [
        DrivenEgo(drive.ego_id, drive.end, drive_measures(drive, plan.limit_s))
        for drive in _chosen(plan, simulator, frames)
    ]
    return _Reference(egos, {name: tuple(each) for name, each in open_loop.items()})


def _chosen(plan: SeedPlan, simulator: Simulator, frames: Sequence[Frame]) -> Iterator[Drive]:
    """The drives of those who are to be driven: by lot, of those who can be.

    They come on the road while the reference is watched, cross in it within the limit, and are at
    some place of their way, at an angle, within 3 s of somebody else: they meet a conflict.
    """
    met = {name for event in close_passes(driven_by(frames)) for name in _pair(event)}
    there = set(frames[0].scene.ids) if plan.warm_up_s else set[str]()
    appears: dict[str, int] = {}
    for number, frame in enumerate(frames):
        for name, kind in zip(frame.scene.ids, frame.scene.kind.tolist(), strict=True):
            if name in met and name not in there and kind in DRIVEN_KINDS:
                appears.setdefault(name, number)
    names = sorted(appears)
    count = 0
    for k in np.random.default_rng(plan.seed).permutation(len(names)).tolist():
        if count == plan.egos:
            return
        first = max(appears[names[k]] - BEFORE_FRAMES + 1, 0)
        recorder = DriveRecorder(names[k], simulator.road, plan.limit_s)
        for frame in frames[first:]:
            recorder.see(frame)
            if recorder.is_over:
                break
        if recorder.is_over and recorder.end == CROSSED:
            count += 1
            yield recorder.drive()


def _pair(event: SafetyEvent) -> tuple[str, ...]:
    return tuple(name for name in (event.first_id, event.second_id) if name is not None)


# ---------------------------------------------------------------------------------------------
# The agent's drives


def _driven(plan: SeedPlan, row: str, ego: DrivenEgo, steps: _Steps) -> DrivenEgo:
    """A vehicle driven by the agent, with the predictor of a row."""
    with closing(open_traffic(plan.scenario)) as simulator:
        drive = _drive(plan, row, ego.ego_id, simulator, steps)
    return DrivenEgo(ego.ego_id, drive.end, drive_measures(drive, plan.limit_s))


def _drive(plan: SeedPlan, row: str, ego_id: str, simulator: Simulator, steps: _Steps) -> Drive:
    frame = simulator.reset(plan.seed)
    frame = warm_up(simulator, frame, round(plan.warm_up_s / DT_S))
    before = deque([frame], TRACK_FRAMES)
    while ego_id not in frame.scene.ids:
        steps.tell()
        if frame.done:
            raise SimulatorError(f"{ego_id!r} did not come as it had come in the reference")
        frame = simulator.step()
        before.append(frame)
    predictor = BranchOracle(simulator, ego_id) if row == ORACLE else _predictor(plan, row)
    agent = load_agent(plan.agent)
    is_advised = getattr(agent, "reads_suggestions", True)
    adviser = Adviser(predictor, egos=frozenset({ego_id} if is_advised else ()))
    state = begin(adviser, simulator.road)
    memory = begin_to_drive(agent, ego_id, simulator.road, frame.scene)
    recorder = DriveRecorder(ego_id, simulator.road, plan.limit_s)
    for earlier in list(before)[:-1]:
        state = observe(adviser, state, earlier)
    for earlier in list(before)[-BEFORE_FRAMES:]:
        recorder.see(earlier)
    while not recorder.is_over:
        steps.tell()
        commands = ()
        if ego_id in frame.scene.ids:
            state, advice = tick(adviser, state, frame)
            memory, command = decide(agent, memory, ego_id, frame, advice)
            commands = () if command is None else (command,)
        frame = simulator.step(commands)
        recorder.see(frame)
    return recorder.drive()


def _predictor(plan: SeedPlan, name: str) -> Predictor:
    return predictor_of_process(name, plan.weights, "none")
