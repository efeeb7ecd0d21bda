"""Trained networks of the ablations, judged on the same samples: those with a known future."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from hatn_sim.datatypes import FloatArray, IntArray, Score
from hatn_sim.evaluation.arrays import error_scores, goal_scores, slot_scores
from hatn_sim.evaluation.table import AblationRow
from hatn_sim.hatn.inputs import Float32Array
from hatn_sim.learn import edn_training
from hatn_sim.learn.ablation_training import (
    Study,
    goals_told,
    load_edn,
    load_sgn,
    rows_where,
    whole,
)
from hatn_sim.learn.ablations import EdnModel, Model, Row
from hatn_sim.learn.batches import batches, graph_batch
from hatn_sim.learn.dataset import Samples
from hatn_sim.score.intervals import MIN_RUNS
from hatn_sim.score.steps import StepErrors, step_errors


@dataclass(frozen=True, eq=False)
class Judged:
    """What rows of tables reach."""

    rows: tuple[AblationRow, ...]
    steps: tuple[StepErrors, ...]  # of the rows that were asked for
    clustered_over: str  # what the intervals were bootstrapped over


def judge(
    study: Study,
    rows: Sequence[Row],
    test: Mapping[str, Samples],
    curves: Mapping[str, tuple[str, str]],
) -> Judged:
    """Scores of trained rows on the test samples of every scene.

    Args:
        study: where the networks are.
        rows: all of whose networks are trained.
        test: by scene, of one run or recording or several.
        curves: name -> (table, row), whose error at each predicted step is wanted too.
    """
    fewest = min(len(np.unique(samples.run)) for samples in test.values())
    over = "runs" if fewest >= MIN_RUNS else "vehicles"
    scores: list[list[Score]] = [[] for _ in rows]
    steps: list[StepErrors] = []
    for scene, everything in test.items():
        samples = rows_where(everything, whole(everything))
        cluster = _clusters(samples, over)
        answers = {model: _answer(study, model, samples) for model in {row.model for row in rows}}
        for row, of_row in zip(rows, scores, strict=True):
            of_row += _scores(answers[row.model], row.name, scene, samples, cluster)
        answer_of = {(row.table, row.name): answers[row.model] for row in rows}
        for name, place in curves.items():
            if isinstance(error_m := answer_of.get(place), np.ndarray):
                steps.append(step_errors(scene, name, "all", error_m, cluster))
    told = [
        AblationRow(row.table, row.name, tuple(of_row))
        for row, of_row in zip(rows, scores, strict=True)
    ]
    return Judged(tuple(told), tuple(steps), over)


@dataclass(frozen=True, eq=False)
class _Intention:
    """What a semantic graph network says of the ego of each sample."""

    goal_m: Float32Array  # [S]
    probability: Float32Array  # [S, M] of the slots


Answer = _Intention | FloatArray
"""Of an encoder-decoder network: displacements [S, F] in metres."""


def _answer(study: Study, model: Model, samples: Samples) -> Answer:
    if isinstance(model, EdnModel):
        goals_m = goals_told(study, model, samples)
        error_m = edn_training.displacements_m(load_edn(study, model), samples, goals_m)
        return error_m.astype(np.float64)
    network = load_sgn(study, model)
    goal_m, probability = [], []
    for rows in batches(len(samples)):
        with torch.no_grad():
            intention = network(graph_batch(samples, rows))
        goal_m.append(intention.goal_m()[:, 0].numpy())
        probability.append(intention.slot_logit.softmax(-1).numpy())
    return _Intention(np.concatenate(goal_m), np.concatenate(probability))


def _scores(
    answer: Answer, name: str, scene: str, samples: Samples, cluster: IntArray
) -> tuple[Score, ...]:
    goal_m = samples.goal_m[:, 0]
    if not isinstance(answer, _Intention):
        return error_scores(name, scene, answer, goal_m, cluster)
    several = (samples.slot >= 0) & (samples.focus_mask.sum(axis=1) > 1)
    slots = slot_scores(
        name, scene, answer.probability[several], samples.slot[several], cluster[several]
    )
    return (*slots, *goal_scores(name, scene, answer.goal_m, goal_m, cluster))


def _clusters(samples: Samples, over: str) -> IntArray:
    """[S] what belongs together in the bootstrap."""
    return samples.run if over == "runs" else (samples.run << 32) + samples.vehicle
