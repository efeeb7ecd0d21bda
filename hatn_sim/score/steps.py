"""The displacement error at each of the 30 predicted steps, as in the paper's figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hatn_sim.datatypes import FloatArray, IntArray
from hatn_sim.labels import SAMPLE_EVERY_FRAMES
from hatn_sim.log import Run
from hatn_sim.score import intervals
from hatn_sim.score.pooling import by_scene, check_pool
from hatn_sim.score.samples import (
    ScoredSamples,
    clustered_over,
    clusters,
    displacement_m,
    reported_name,
    rows_of,
    scored_samples,
)

SUBSETS = ("all", "moving")


@dataclass(frozen=True, eq=False)
class StepErrors:
    """Of the most probable mode, at 0.1 s ... 3 s; the same samples as in `prediction`."""

    scene: str
    predictor: str
    subset: str  # "all" or "moving"
    mean_m: FloatArray  # [F]
    std_m: FloatArray  # [F] over samples
    low_m: FloatArray  # [F] 95 % interval of the mean; NaN where there is none
    high_m: FloatArray  # [F]
    n: int
    trained: bool = False  # its weights were trained or tuned on this scene


def errors_by_step(runs: Sequence[Run]) -> list[StepErrors]:
    """Errors of every predictor over all runs of a scene together; none where n = 0.

    Raises InputError as `prediction.score_runs` does.
    """
    clustered = clustered_over(runs)
    found: list[StepErrors] = []
    for scene, of_scene in by_scene(runs).items():
        check_pool(of_scene)
        scored = [scored_samples(run) for run in of_scene]
        cluster = np.concatenate(
            [
                (number << 32) + clusters(run, clustered)[samples.vehicle]
                for number, (run, samples) in enumerate(zip(of_scene, scored, strict=True))
            ]
        )
        moving = np.concatenate([samples.moving for samples in scored])
        for predictor in of_scene[0].predictors:
            parts = [_errors_m(*pair, predictor) for pair in zip(of_scene, scored, strict=True)]
            error_m = np.concatenate(parts)
            name = reported_name(of_scene[0], predictor)
            for subset, chosen in zip(SUBSETS, (np.ones_like(moving), moving), strict=True):
                if chosen.any():
                    found.append(step_errors(scene, name, subset, error_m[chosen], cluster[chosen]))
    return found


def _errors_m(run: Run, scored: ScoredSamples, predictor: str) -> FloatArray:
    table = run.predictions(predictor, SAMPLE_EVERY_FRAMES)
    return displacement_m(table, rows_of(table, scored), scored)


def step_errors(
    scene: str, predictor: str, subset: str, error_m: FloatArray, cluster: IntArray
) -> StepErrors:
    """Of the errors [S, F] of samples, which belong together as `cluster` [S] says; S > 0."""
    sums = intervals.cluster_sums(np.column_stack([error_m, np.ones(len(error_m))]), cluster)
    low_m, high_m = intervals.mean_intervals(sums)
    return StepErrors(
        scene=scene,
        predictor=predictor,
        subset=subset,
        mean_m=error_m.mean(axis=0),
        std_m=error_m.std(axis=0),
        low_m=low_m,
        high_m=high_m,
        n=len(error_m),
    )
