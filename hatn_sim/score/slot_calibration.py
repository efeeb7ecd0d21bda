"""Whether slots that are said to be taken with 80 % are taken 8 times in 10."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray
from hatn_sim.labels import SAMPLE_EVERY_FRAMES
from hatn_sim.log import Run
from hatn_sim.score import intervals
from hatn_sim.score.prediction import ECE_BINS
from hatn_sim.score.samples import reported_name, rows_of, scored_samples, taken_slots

ANSWERS: Final = {"likeliest": "the likeliest slot", "yield": "to yield"}


@dataclass(frozen=True, eq=False)
class Reliability:
    """What was said of an answer, and how often it came true, in `ECE_BINS` equal bins [B]."""

    predictor: str
    answer: str  # a key of ANSWERS
    n: IntArray  # [B] samples
    said: FloatArray  # [B] mean probability; NaN where there is no sample
    came_true: FloatArray  # [B] share
    low: FloatArray  # [B] 95 % interval of the share, over vehicles; NaN where there is none
    high: FloatArray  # [B]

    @property
    def ece(self) -> float:
        """Expected calibration error; NaN without samples."""
        if not self.n.sum():
            return float("nan")
        there = self.n > 0
        gap = np.abs(self.said - self.came_true)[there] * self.n[there]
        return float(gap.sum() / self.n.sum())


def slot_reliability(run: Run) -> list[Reliability]:
    """Both answers of every predictor that gives slots probabilities; none where nobody chose.

    The samples are those of `prediction.score_runs`: egos with two slots or more to choose from, of
    which it is known which one they took. `ece` of "likeliest" is its `slot_ece`.
    """
    scored = scored_samples(run)
    found: list[Reliability] = []
    for predictor in run.predictors:
        table = run.predictions(predictor, SAMPLE_EVERY_FRAMES)
        rows = rows_of(table, scored)
        rows = rows[table.has_conflict[rows] & table.has_slot_probability[rows]]
        rows = rows[table.slot_in_focus[rows].sum(axis=1) > 1]
        taken = taken_slots(run, table, rows)
        rows, taken = rows[taken >= 0], taken[taken >= 0]
        if not len(rows):
            continue
        chance = np.where(table.slot_in_focus[rows], table.slot_probability[rows], -1.0)
        name, vehicle = reported_name(run, predictor), table.vehicle[rows]
        right = chance.argmax(axis=1) == taken
        found.append(reliability(name, "likeliest", chance.max(axis=1), right, vehicle))
        found.append(reliability(name, "yield", chance[:, 0], taken == 0, vehicle))
    return found


def reliability(
    predictor: str, answer: str, said: FloatArray, came_true: BoolArray, cluster: IntArray
) -> Reliability:
    """Of probabilities [S] and what came true [S]; samples of a cluster [S] belong together."""
    in_bin = np.minimum((said * ECE_BINS).astype(np.int64), ECE_BINS - 1)
    n = np.bincount(in_bin, minlength=ECE_BINS)
    some = np.maximum(n, 1)
    means = [np.bincount(in_bin, weights=w, minlength=ECE_BINS) / some for w in (said, came_true)]
    bounds = np.full((2, ECE_BINS), np.nan)
    for k in np.flatnonzero(n).tolist():
        inside = in_bin == k
        terms = np.column_stack([came_true[inside].astype(np.float64), np.ones(int(n[k]))])
        ends = intervals.share_interval(intervals.cluster_sums(terms, cluster[inside]))
        bounds[:, k] = ends or (np.nan, np.nan)
    said_mean, true_mean = (np.where(n > 0, mean, np.nan) for mean in means)
    return Reliability(predictor, answer, n, said_mean, true_mean, bounds[0], bounds[1])
