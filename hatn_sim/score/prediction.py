"""Scores of the predictors in the log of a run (METHOD 1.8 and 6).

Every predictor is scored on the same samples: every vehicle but pedestrians with 11 frames behind
(in cases of the INTERACTION data set, which begin 10 frames before their present: 10) and 30 ahead,
every 0.5 s, those without a reference line included.

| measure | unit | what it is |
|---|---|---|
| `ade_3s`, `ade_0s3` | m | mean displacement of the most probable mode over 30, 3 frames |
| `fde_3s`, `fde_0s3` | m | its displacement at frame 30, 3 |
| `goal_error` | m | absolute difference of the goal mixture's mean and the distance travelled |
| `slot_accuracy` | share | most probable slot = slot taken, where the slot taken is known |
| `slot_macro_f1` | share | mean F1 of yield and pass; a pass is right with the right vehicle |
| `slot_ece` | share | expected calibration error of the most probable slot, 15 bins |
| `slot_masked_share` | share | of graphs with a choice: nobody can say which slot was taken |
| `yield_base_rate` | share | of the slots taken: what "always yield" would get right |
| `single_slot_share` | share | of graphs with a conflict: one slot only, left out of the above |
| `fallback_share` | share | of samples: a physical extrapolation stood in for the predictor |

Under `--lines route` the names of predictors end in `+route`: they saw what no camera can see, so
their scores are upper bounds (see `reported_name`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hatn_sim.datatypes import HORIZON_FRAMES, BoolArray, FloatArray, IntArray, Kind, Score
from hatn_sim.errors import InputError
from hatn_sim.labels import MOVING_M, SAMPLE_EVERY_FRAMES, goal_m, samples, slot_label
from hatn_sim.log import PredictionTable, Run
from hatn_sim.score import intervals
from hatn_sim.score.pooling import by_scene, check_pool

SHORT_FRAMES = 3
"""0.3 s."""
ECE_BINS = 15
USES_NO_LINES = "constant_velocity"
"""The predictor that routes cannot help."""


@dataclass(frozen=True, eq=False)
class _Samples:
    vehicle: IntArray  # [S]
    frame: IntArray  # [S]
    future_xy_m: FloatArray  # [S, F, 2]
    goal_m: FloatArray  # [S]


@dataclass(frozen=True, eq=False)
class _Measured:
    """What a measure is made of: terms of each sample, to be summed and put into a statistic."""

    terms: FloatArray  # [S, D]
    vehicle: IntArray  # [S]
    statistic: intervals.Statistic


@dataclass(frozen=True, eq=False)
class _OfPredictor:
    adapt: str
    measures: Mapping[tuple[str, str], _Measured]  # by (measure, subset)


UNITS = {
    "ade_3s": "m",
    "fde_3s": "m",
    "ade_0s3": "m",
    "fde_0s3": "m",
    "goal_error": "m",
    "slot_accuracy": "share",
    "slot_macro_f1": "share",
    "slot_ece": "share",
    "slot_masked_share": "share",
    "yield_base_rate": "share",
    "single_slot_share": "share",
    "fallback_share": "share",
}
"""Measure -> unit, in the order of the table."""

MOVING_MEASURES = ("ade_3s", "fde_3s", "ade_0s3", "fde_0s3", "goal_error")
"""Measures given over moving samples too."""

ROWS = tuple(
    (measure, subset)
    for subset in ("all", "moving")
    for measure in UNITS
    if subset == "all" or measure in MOVING_MEASURES
)


def score_run(run: Run) -> list[Score]:
    """Scores of every predictor in a run; see `score_runs`."""
    return score_runs([run])


def score_runs(runs: Sequence[Run]) -> list[Score]:
    """Scores of every predictor, over all runs of a scene together; one list for each scene.

    Intervals are bootstrapped over runs, or over recordings or cases, where a scene has at least
    five of them, else over vehicles (see `clustered_over`). What a predictor cannot have is there
    with value None and n = 0.

    Raises:
        InputError: runs of one scene cannot be pooled (see `check_pool`), a predictor said
            something that is not finite, or a log is damaged.
    """
    scores: list[Score] = []
    clustered = clustered_over(runs)
    for scene, of_scene in by_scene(runs).items():
        check_pool(of_scene)
        measured = [_measure_run(run) for run in of_scene]
        clusters = [_clusters(run, clustered) for run in of_scene]
        for predictor in of_scene[0].predictors:
            name = reported_name(of_scene[0], predictor)
            adapt = measured[0][predictor].adapt
            for measure, subset in ROWS:
                parts = [each[predictor].measures.get((measure, subset)) for each in measured]
                value, n, bounds = _pooled(parts, clusters)
                low, high = bounds or (None, None)
                unit = UNITS[measure]
                scores.append(Score(measure, name, scene, subset, adapt, value, unit, n, low, high))
    return scores


def reported_name(run: Run, predictor: str) -> str:
    """A predictor's name in scores: one that was handed routes is told from one that was not."""
    return f"{predictor}+route" if run.by_route and predictor != USES_NO_LINES else predictor


def clustered_over(runs: Sequence[Run]) -> str:
    """What the intervals of `score_runs` are bootstrapped over: "runs", "recordings", "cases" or
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


def _clusters(run: Run, clustered: str) -> IntArray:
    """[V] the cluster of every vehicle in its run."""
    if clustered == "runs":
        return np.zeros(len(run.ids), dtype=np.int64)
    return np.arange(len(run.ids)) if clustered == "vehicles" else run.recording_of


def _measure_run(run: Run) -> dict[str, _OfPredictor]:
    common = _samples(run)
    return {name: _measure_predictor(run, name, common) for name in run.predictors}


def _samples(run: Run) -> _Samples:
    """The samples that every predictor of the run has an answer for."""
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
    return _Samples(vehicle, frame, future_xy_m, goal)


def _key(vehicle: IntArray, frame: IntArray) -> IntArray:
    return (frame << 32) + vehicle


def _measure_predictor(run: Run, predictor: str, common: _Samples) -> _OfPredictor:
    table = run.predictions(predictor, SAMPLE_EVERY_FRAMES)
    key = _key(table.vehicle, table.frame)
    order = np.argsort(key)
    rows = order[np.searchsorted(key[order], _key(common.vehicle, common.frame))]
    measures = {
        **_displacements(run, table, rows, common),
        **_goals(run, table, rows, common),
        **_slots(run, table, rows),
        ("fallback_share", "all"): _mean(table.fallback[rows], common.vehicle),
    }
    adapt = str(run.header.get("adapt", "none")) if table.adapted.any() else "none"
    return _OfPredictor(adapt, measures)


def _displacements(
    run: Run, table: PredictionTable, rows: IntArray, common: _Samples
) -> dict[tuple[str, str], _Measured]:
    mode = table.mode_probability[rows].argmax(axis=1) if len(rows) else rows
    error_m = np.linalg.norm(table.xy_m[rows, mode] - common.future_xy_m, axis=2)
    _check_finite(run, table, rows, error_m.sum(axis=1), "positions")
    values = {
        "ade_3s": error_m.mean(axis=1),
        "fde_3s": error_m[:, -1],
        "ade_0s3": error_m[:, :SHORT_FRAMES].mean(axis=1),
        "fde_0s3": error_m[:, SHORT_FRAMES - 1],
    }
    every = np.ones(len(rows), dtype=np.bool_)
    subsets = [_subsets(name, value, every, common) for name, value in values.items()]
    return {key: measured for of_measure in subsets for key, measured in of_measure.items()}


def _goals(
    run: Run, table: PredictionTable, rows: IntArray, common: _Samples
) -> dict[tuple[str, str], _Measured]:
    given: BoolArray = np.asarray(table.goal_mask[rows].any(axis=1))
    mean_m = (table.goal_weight[rows] * table.goal_mean_m[rows]).sum(axis=1)
    error_m = np.where(given, np.abs(mean_m - common.goal_m), 0.0)
    _check_finite(run, table, rows, error_m, "goals")
    return _subsets("goal_error", error_m, given, common)


def _check_finite(
    run: Run, table: PredictionTable, rows: IntArray, error_m: FloatArray, what: str
) -> None:
    """Samples are the same for all predictors, so nobody gets out of one by an answer of NaN."""
    unfit = rows[~np.isfinite(error_m)]
    if len(unfit):
        raise InputError(
            f"{run.path}: expected finite {what} of predictor {table.predictor!r}, found others "
            f"for vehicle {run.ids[table.vehicle[unfit[0]]]!r} at frame {table.frame[unfit[0]]}; "
            "mend the predictor and make the run again"
        )


def _subsets(
    measure: str, value: FloatArray, given: BoolArray, common: _Samples
) -> dict[tuple[str, str], _Measured]:
    """Means over all and over moving samples, of those given."""
    moving = given & (common.goal_m > MOVING_M)
    return {
        (measure, "all"): _mean(value[given], common.vehicle[given]),
        (measure, "moving"): _mean(value[moving], common.vehicle[moving]),
    }


def _slots(run: Run, table: PredictionTable, rows: IntArray) -> dict[tuple[str, str], _Measured]:
    """Measures of the slots, over the graphs with a conflict that the predictor decided on."""
    rows = rows[table.has_conflict[rows] & table.has_slot_probability[rows]]
    single = table.slot_in_focus[rows].sum(axis=1) < 2
    measures = {("single_slot_share", "all"): _mean(single, table.vehicle[rows])}

    rows = rows[~single]
    label = slot_label(
        run.trajectories,
        table.vehicle[rows],
        table.frame[rows],
        table.slot_vehicle[rows],
        table.slot_in_focus[rows],
        table.ego_to_conflict_m[rows],
        table.rear_to_conflict_m[rows],
        table.conflict_xy_m[rows],
    )
    measures["slot_masked_share", "all"] = _mean(label < 0, table.vehicle[rows])
    rows, label = rows[label >= 0], label[label >= 0]
    if not len(rows):
        return measures
    vehicle = table.vehicle[rows]
    probability = np.where(table.slot_in_focus[rows], table.slot_probability[rows], -1.0)
    answer, confidence = probability.argmax(axis=1), probability.max(axis=1)
    right = answer == label
    yields, passes = label == 0, label > 0
    f1_terms = [
        *(right & yields, yields, answer == 0),
        *(right & passes, passes, answer > 0),
    ]
    in_bin = np.minimum((confidence * ECE_BINS).astype(np.int64), ECE_BINS - 1)
    gaps = np.zeros((len(rows), ECE_BINS))
    gaps[np.arange(len(rows)), in_bin] = confidence - right
    ece_terms = np.column_stack([np.ones(len(rows)), gaps])
    return measures | {
        ("slot_accuracy", "all"): _mean(right, vehicle),
        ("yield_base_rate", "all"): _mean(yields, vehicle),
        ("slot_macro_f1", "all"): _Measured(
            np.column_stack(f1_terms).astype(np.float64), vehicle, intervals.macro_f1
        ),
        ("slot_ece", "all"): _Measured(ece_terms, vehicle, intervals.expected_calibration_error),
    }


def _mean(value: NDArray[Any], vehicle: IntArray) -> _Measured:
    terms = np.column_stack([value.astype(np.float64), np.ones(len(value))])
    return _Measured(terms, vehicle, intervals.ratio)


def _pooled(
    parts: Sequence[_Measured | None], clusters: Sequence[IntArray]
) -> tuple[float | None, int, tuple[float, float] | None]:
    """(value, n, interval) of a measure over runs; `parts` has None where a run has no value.

    `clusters` [V] are those of the vehicles of each run.
    """
    present = [(number, part) for number, part in enumerate(parts) if part is not None]
    if not present:
        return None, 0, None
    statistic = present[0][1].statistic
    terms = np.concatenate([part.terms for _, part in present])
    cluster = np.concatenate(
        [(number << 32) + clusters[number][part.vehicle] for number, part in present]
    )
    sums = intervals.cluster_sums(terms, cluster)
    value = float(statistic(sums.sum(axis=0)))
    if not np.isfinite(value):
        return None, 0, None
    return value, len(terms), intervals.interval(sums, statistic)
