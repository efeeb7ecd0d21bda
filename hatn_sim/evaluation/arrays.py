"""Scores of a network straight from arrays of samples, without logging a run.

Ablations judge many networks on the same cached samples: predictions and truth are arrays, one row
for each sample, and `cluster` says what belongs together in the bootstrap (the run or recording).
The measures are those of `score.prediction`, over moving samples too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Score
from hatn_sim.labels import MOVING_M
from hatn_sim.score import intervals
from hatn_sim.score.prediction import SHORT_FRAMES, UNITS


def displacement_scores(
    name: str,
    scene: str,
    predicted_xy_m: NDArray[Any],
    future_xy_m: NDArray[Any],
    goal_m: NDArray[Any],
    cluster: IntArray,
) -> tuple[Score, ...]:
    """ADE and FDE over 3 s and 0.3 s.

    Args:
        name: of the network; the scores' predictor.
        scene: that the samples are of.
        predicted_xy_m: [S, F, 2] in any frame that is the same for the truth, in metres.
        future_xy_m: [S, F, 2]
        goal_m: [S] distance really travelled in 3 s, which tells moving samples.
        cluster: [S]
    """
    error_m = np.linalg.norm(predicted_xy_m - future_xy_m, axis=2)
    return error_scores(name, scene, error_m, goal_m, cluster)


def error_scores(
    name: str, scene: str, error_m: NDArray[Any], goal_m: NDArray[Any], cluster: IntArray
) -> tuple[Score, ...]:
    """The same of displacements [S, F] in metres."""
    error_m = error_m.astype(np.float64)
    values = {
        "ade_3s": error_m.mean(axis=1),
        "ade_0s3": error_m[:, :SHORT_FRAMES].mean(axis=1),
        "fde_3s": error_m[:, -1],
        "fde_0s3": error_m[:, SHORT_FRAMES - 1],
    }
    return _over_subsets(name, scene, values, goal_m > MOVING_M, cluster)


def goal_scores(
    name: str,
    scene: str,
    predicted_m: NDArray[Any],
    goal_m: NDArray[Any],
    cluster: IntArray,
) -> tuple[Score, ...]:
    """The goal error of predicted goals [S], of samples whose goal is known."""
    values = {"goal_error": np.abs(predicted_m - goal_m).astype(np.float64)}
    return _over_subsets(name, scene, values, goal_m > MOVING_M, cluster)


def slot_scores(
    name: str, scene: str, probability: NDArray[Any], slot: IntArray, cluster: IntArray
) -> tuple[Score, ...]:
    """Slot accuracy and Brier score of probabilities [S, M], of samples whose slot [S] is known.

    Slots that are not there have probability 0, and every sample has at least two that are.
    """
    taken = np.arange(probability.shape[1]) == slot[:, None]
    values = {
        "slot_accuracy": (probability.argmax(axis=1) == slot).astype(np.float64),
        "slot_brier": ((probability - taken) ** 2).sum(axis=1).astype(np.float64),
    }
    every = np.ones(len(slot), dtype=np.bool_)
    return tuple(
        mean_score(measure, name, scene, "all", value, every, cluster)
        for measure, value in values.items()
    )


def mean_score(
    measure: str,
    name: str,
    scene: str,
    subset: str,
    value: FloatArray,
    chosen: BoolArray,
    cluster: IntArray,
    unit: str | None = None,
) -> Score:
    """The mean of the chosen values [S], with its deviation and 95 % interval over clusters [S].

    The unit is that of the measure, where `score.prediction` knows it.
    """
    unit = UNITS[measure] if unit is None else unit
    if not chosen.any():
        return Score(measure, name, scene, subset, "none", None, unit, 0, None, None)
    of = value[chosen]
    sums = intervals.cluster_sums(np.column_stack([of, np.ones(len(of))]), cluster[chosen])
    low, high = intervals.interval(sums, intervals.ratio) or (None, None)
    mean, std = float(of.mean()), float(of.std())
    return Score(measure, name, scene, subset, "none", mean, unit, len(of), low, high, std)


def _over_subsets(
    name: str,
    scene: str,
    values: Mapping[str, FloatArray],
    moving: BoolArray,
    cluster: IntArray,
) -> tuple[Score, ...]:
    of_subset = {"all": np.ones(len(moving), dtype=np.bool_), "moving": moving}
    return tuple(
        mean_score(measure, name, scene, subset, value, chosen, cluster)
        for subset, chosen in of_subset.items()
        for measure, value in values.items()
    )
