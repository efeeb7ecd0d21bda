"""Scores of the predictors in the log of a run (METHOD 1.8 and 6).

Every predictor is scored on the same samples: every vehicle but pedestrians with 11 frames behind
(in cases of the INTERACTION data set, which begin 10 frames before their present: 10) and 30 ahead,
every 0.5 s, those without a reference line included.

| measure | unit | what it is |
|---|---|---|
| `ade_3s`, `ade_0s3` | m | mean displacement of the most probable mode over 30, 3 frames |
| `fde_3s`, `fde_0s3` | m | its displacement at frame 30, 3 |
| `goal_error` | m | absolute difference of the goal mixture's mean and the distance travelled |
| `min_ade_3s` | m | `ade_3s` of the mode that is best in hindsight, of those not ruled out |
| `miss_rate_2m` | share | the most probable mode is more than 2 m off at frame 30 |
| `goal_coverage_50`, `_90` | share | goals inside the central 50, 90 % interval of the mixture |
| `slot_accuracy` | share | most probable slot = slot taken, where the slot taken is known |
| `slot_macro_f1` | share | mean F1 of yield and pass; a pass is right with the right vehicle |
| `slot_ece` | share | expected calibration error of the most probable slot, 15 bins |
| `slot_brier` | 1 | sum over slots of (probability - taken)^2, from 0 to 2 (Brier, 1950) |
| `slot_masked_share` | share | of graphs with a choice: nobody can say which slot was taken |
| `yield_base_rate` | share | of the slots taken: what "always yield" would get right |
| `single_slot_share` | share | of graphs with a conflict: one slot only, left out of the above |
| `fallback_share` | share | of samples: a physical extrapolation stood in for the predictor |

`std` is the standard deviation over samples (divided by n, not n - 1), as the paper prints it
behind its means; measures that are no means have none. Errors step by step are in `steps`.

Under `--lines route` the names of predictors end in `+route`: they saw what no camera can see, so
their scores are upper bounds (see `reported_name`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Score
from hatn_sim.errors import InputError
from hatn_sim.labels import SAMPLE_EVERY_FRAMES
from hatn_sim.log import PredictionTable, Run
from hatn_sim.score import intervals
from hatn_sim.score.line_origin import said_lines
from hatn_sim.score.pooling import by_scene, check_pool
from hatn_sim.score.samples import (
    ScoredSamples,
    clustered_over,
    clusters,
    displacement_m,
    reported_name,
    rows_of,
    scored_samples,
    taken_slots,
)

SHORT_FRAMES = 3
"""0.3 s."""
ECE_BINS = 15
MISS_M = 2.0
COVERED = {"goal_coverage_50": 0.5, "goal_coverage_90": 0.9}
"""Measure -> the probability that the central interval of the mixture holds."""


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
    "min_ade_3s": "m",
    "miss_rate_2m": "share",
    "goal_coverage_50": "share",
    "goal_coverage_90": "share",
    "slot_accuracy": "share",
    "slot_macro_f1": "share",
    "slot_ece": "share",
    "slot_brier": "1",
    "slot_masked_share": "share",
    "yield_base_rate": "share",
    "single_slot_share": "share",
    "fallback_share": "share",
}
"""Measure -> unit, in the order of the table."""

MOVING_MEASURES = tuple(list(UNITS)[:9])
"""Measures given over moving samples too: all but those of slots and fallbacks."""

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
        of_vehicles = [clusters(run, clustered) for run in of_scene]
        lines = said_lines([run.header for run in of_scene])
        for predictor in of_scene[0].predictors:
            name = reported_name(of_scene[0], predictor)
            adapt = measured[0][predictor].adapt
            for measure, subset in ROWS:
                parts = [each[predictor].measures.get((measure, subset)) for each in measured]
                pooled = _pooled(parts, of_vehicles)
                told = Score(measure, name, scene, subset, adapt, unit=UNITS[measure], **pooled)
                scores.append(replace(told, lines=lines))
    return scores


def _measure_run(run: Run) -> dict[str, _OfPredictor]:
    common = scored_samples(run)
    return {name: _measure_predictor(run, name, common) for name in run.predictors}


def _measure_predictor(run: Run, predictor: str, common: ScoredSamples) -> _OfPredictor:
    table = run.predictions(predictor, SAMPLE_EVERY_FRAMES)
    rows = rows_of(table, common)
    measures = {
        **_displacements(run, table, rows, common),
        **_goals(run, table, rows, common),
        **_slots(run, table, rows),
        ("fallback_share", "all"): _mean(table.fallback[rows], common.vehicle),
    }
    adapt = str(run.header.get("adapt", "none")) if table.adapted.any() else "none"
    return _OfPredictor(adapt, measures)


def _displacements(
    run: Run, table: PredictionTable, rows: IntArray, common: ScoredSamples
) -> dict[tuple[str, str], _Measured]:
    error_m = displacement_m(table, rows, common)
    _check_finite(run, table, rows, error_m.sum(axis=1), "positions")
    values = {
        "ade_3s": error_m.mean(axis=1),
        "fde_3s": error_m[:, -1],
        "ade_0s3": error_m[:, :SHORT_FRAMES].mean(axis=1),
        "fde_0s3": error_m[:, SHORT_FRAMES - 1],
        "min_ade_3s": _least_ade_m(table, rows, common),
        "miss_rate_2m": error_m[:, -1] > MISS_M,
    }
    every = np.ones(len(rows), dtype=np.bool_)
    return _subsets(values, every, common)


def _least_ade_m(table: PredictionTable, rows: IntArray, common: ScoredSamples) -> FloatArray:
    """[S] of the best mode; those of probability 0 are no answers, nor is padding."""
    if not len(rows):
        return np.zeros(0)
    away_m = np.linalg.norm(table.xy_m[rows] - common.future_xy_m[:, None], axis=3).mean(axis=2)
    least: FloatArray = np.where(table.mode_probability[rows] > 0.0, away_m, np.inf).min(axis=1)
    return least


def _goals(
    run: Run, table: PredictionTable, rows: IntArray, common: ScoredSamples
) -> dict[tuple[str, str], _Measured]:
    given: BoolArray = np.asarray(table.goal_mask[rows].any(axis=1))
    weight, mean_m = table.goal_weight[rows], table.goal_mean_m[rows]
    std_m = table.goal_std_m[rows]
    error_m = np.where(given, np.abs((weight * mean_m).sum(axis=1) - common.goal_m), 0.0)
    _check_finite(run, table, rows, error_m + (weight * std_m).sum(axis=1), "goals")
    # Inside the central interval is where the mixture's distribution function is near one half;
    # a component without width is a step there, whose middle is its mean.
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.nan_to_num((common.goal_m[:, None] - mean_m) / std_m)
    off_centre = np.abs((weight * ndtr(z)).sum(axis=1) - 0.5)
    covered = {name: off_centre <= share / 2.0 for name, share in COVERED.items()}
    return _subsets({"goal_error": error_m, **covered}, given, common)


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
    values: Mapping[str, NDArray[Any]], given: BoolArray, common: ScoredSamples
) -> dict[tuple[str, str], _Measured]:
    """Means over all and over moving samples, of those given."""
    of_subset = {"all": given, "moving": given & common.moving}
    return {
        (measure, subset): _mean(value[chosen], common.vehicle[chosen])
        for measure, value in values.items()
        for subset, chosen in of_subset.items()
    }


def _slots(run: Run, table: PredictionTable, rows: IntArray) -> dict[tuple[str, str], _Measured]:
    """Measures of the slots, over the graphs with a conflict that the predictor decided on."""
    rows = rows[table.has_conflict[rows] & table.has_slot_probability[rows]]
    single = table.slot_in_focus[rows].sum(axis=1) < 2
    measures = {("single_slot_share", "all"): _mean(single, table.vehicle[rows])}

    rows = rows[~single]
    label = taken_slots(run, table, rows)
    measures["slot_masked_share", "all"] = _mean(label < 0, table.vehicle[rows])
    rows, label = rows[label >= 0], label[label >= 0]
    if not len(rows):
        return measures
    vehicle = table.vehicle[rows]
    probability = np.where(table.slot_in_focus[rows], table.slot_probability[rows], -1.0)
    answer, confidence = probability.argmax(axis=1), probability.max(axis=1)
    right = answer == label
    taken = np.arange(probability.shape[1]) == label[:, None]
    brier = np.where(table.slot_in_focus[rows], (probability - taken) ** 2, 0.0).sum(axis=1)
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
        ("slot_brier", "all"): _mean(brier, vehicle),
        ("yield_base_rate", "all"): _mean(yields, vehicle),
        ("slot_macro_f1", "all"): _Measured(
            np.column_stack(f1_terms).astype(np.float64), vehicle, intervals.macro_f1
        ),
        ("slot_ece", "all"): _Measured(ece_terms, vehicle, intervals.expected_calibration_error),
    }


def _mean(value: NDArray[Any], vehicle: IntArray) -> _Measured:
    terms = np.column_stack([value.astype(np.float64), np.ones(len(value))])
    return _Measured(terms, vehicle, intervals.ratio)


def _pooled(parts: Sequence[_Measured | None], of_vehicles: Sequence[IntArray]) -> dict[str, Any]:
    """Value, n, interval and deviation of a measure over runs, as fields of a `Score`.

    `parts` has None where a run has no value; `of_vehicles` [V] are the clusters of the vehicles
    of each run.
    """
    nothing = {"value": None, "n": 0, "low": None, "high": None, "std": None}
    present = [(number, part) for number, part in enumerate(parts) if part is not None]
    if not present:
        return nothing
    statistic = present[0][1].statistic
    terms = np.concatenate([part.terms for _, part in present])
    cluster = np.concatenate(
        [(number << 32) + of_vehicles[number][part.vehicle] for number, part in present]
    )
    sums = intervals.cluster_sums(terms, cluster)
    value = float(statistic(sums.sum(axis=0)))
    if not np.isfinite(value):
        return nothing
    low, high = intervals.interval(sums, statistic) or (None, None)
    std = float(terms[:, 0].std()) if statistic is intervals.ratio else None
    return {"value": value, "n": len(terms), "low": low, "high": high, "std": std}
