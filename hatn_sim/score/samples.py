"""The samples of a run that all its predictors are scored on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hatn_sim.datatypes import HORIZON_FRAMES, BoolArray, FloatArray, IntArray, Kind
from hatn_sim.labels import MOVING_M, SAMPLE_EVERY_FRAMES, goal_m, samples, slot_label
from hatn_sim.log import PredictionTable, Run
from hatn_sim.score import intervals
from hatn_sim.score.pooling import by_scene

USES_NO_LINES = "constant_velocity"
"""The predictor that routes cannot help."""


@dataclass(frozen=True, eq=False)
class ScoredSamples:
    """Vehicles at moments, and what happened next."""

    vehicle: IntArray  # [S]
    frame: IntArray  # [S]
    future_xy_m: FloatArray  # [S, F, 2]
    goal_m: FloatArray  # [S] distance travelled in 3 s

    @property
    def moving(self) -> BoolArray:
        """[S] more than 1 m in 3 s."""
        return np.asarray(self.goal_m > MOVING_M)


def scored_samples(run: Run) -> ScoredSamples:
    """The samples that every predictor of the run has an answer for, pedestrians left out."""
    trajectories = run.trajectories
    vehicle, frame = samples(trajectories, history_frames=run.history_frames)
    kept = run.kinds[vehicle] != Kind.PEDESTRIAN
    for predictor in run.predictors:
        answered = _key(*run.predicted(predictor, SAMPLE_EVERY_FRAMES))
        kept &= np.isin(_key(vehicle, frame), answered)
    vehicle, frame = vehicle[kept], frame[kept]
    ahead = frame[:, None] + np.arange(1, HORIZON_FRAMES + 1)
    goal, _ = goal_m(trajectories, vehicle, frame)
    future_xy_m, _ = trajectories.xy_at(vehicle[:, None], ahead)
    return ScoredSamples(vehicle, frame, future_xy_m, goal)


def rows_of(table: PredictionTable, scored: ScoredSamples) -> IntArray:
    """[S] the row of the table that answers each sample."""
    key = _key(table.vehicle, table.frame)
    order = np.argsort(key)
    return order[np.searchsorted(key[order], _key(scored.vehicle, scored.frame))]


def taken_slots(run: Run, table: PredictionTable, rows: IntArray) -> IntArray:
    """[R] the slot that the ego of each row of the table really took, see `labels.slot_label`."""
    return slot_label(
        run.trajectories,
        table.vehicle[rows],
        table.frame[rows],
        table.slot_vehicle[rows],
        table.slot_in_focus[rows],
        table.ego_to_conflict_m[rows],
        table.rear_to_conflict_m[rows],
        table.conflict_xy_m[rows],
    )


def displacement_m(table: PredictionTable, rows: IntArray, scored: ScoredSamples) -> FloatArray:
    """[S, F] how far the most probable mode is from what happened."""
    mode = table.mode_probability[rows].argmax(axis=1) if len(rows) else rows
    return np.linalg.norm(table.xy_m[rows, mode] - scored.future_xy_m, axis=2)


def clustered_over(runs: Sequence[Run]) -> str:
    """What intervals over runs are bootstrapped over: "runs", "recordings", "cases" or
    "vehicles"."""
    # One answer for all scenes, so that a table can say it once.
    scenes = by_scene(runs).values()
    if min(map(len, scenes), default=0) >= intervals.MIN_RUNS:
        return "runs"
    kinds = {run.ids_by for run in runs}
    counts = [sum(len(set(run.recording_of.tolist())) for run in one) for one in scenes]
    if len(kinds) == 1 and min(counts, default=0) >= intervals.MIN_RUNS:
        return kinds.pop() or "vehicles"
    return "vehicles"


def clusters(run: Run, clustered: str) -> IntArray:
    """[V] the cluster of every vehicle in its run, as `clustered_over` says."""
    if clustered == "runs":
        return np.zeros(len(run.ids), dtype=np.int64)
    return np.arange(len(run.ids)) if clustered == "vehicles" else run.recording_of


def reported_name(run: Run, predictor: str) -> str:
    """A predictor's name in scores: one that was handed routes is told from one that was not."""
    return f"{predictor}+route" if run.by_route and predictor != USES_NO_LINES else predictor


def _key(vehicle: IntArray, frame: IntArray) -> IntArray:
    return (frame << 32) + vehicle
