"""Alert rules over all their thresholds: what each recalls at what rate of false alarms.

False alarms are counted where drivers are courteous, if such runs are there, else in all; events
are recalled in all. "At equal false-alarm rate" means: at the threshold that recalls most among
those with no more false alarms than the rate given; "at equal recall": at the one with the fewest
false alarms among those that recall no less. For a baseline that is the best choice there is, made
with hindsight: the comparison favours baselines.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.assist.settings import AssistSettings
from hatn_sim.config import DEFAULT_RISK
from hatn_sim.datatypes import BoolArray, FloatArray
from hatn_sim.score.assessed import AssessedRun
from hatn_sim.score.assistance import warned

THRESHOLDS: Final = 80
BETWEEN: Final = 6
SMALLEST: Final = 1e-6
ROUNDING: Final = 1e-9


@dataclass(frozen=True)
class Operating:
    """A rule at one threshold; NaN: there was nothing to measure it on."""

    threshold: float
    false_alarms_per_hour: float
    event_recall: float
    recall_1s5: float
    lead_time_s: float  # median


def quiet(runs: Sequence[AssessedRun]) -> BoolArray:
    """[G] those in which false alarms are counted."""
    courteous = np.array([run.risk == DEFAULT_RISK for run in runs], dtype=np.bool_)
    return courteous if courteous.any() else ~courteous


def thresholds_of(runs: Sequence[AssessedRun], rule: str, count: int = THRESHOLDS) -> list[float]:
    """Thresholds that tell the rule's alerts apart, falling: quantiles of what pairs came to."""
    peaks = [_peaks(run, rule) for run in runs]
    danger = np.concatenate([np.zeros(0), *peaks])
    danger = danger[danger > 0.0]
    if not len(danger):
        return []
    # Rare alerts are what matters, so the upper end is told apart more finely.
    rank = np.unique(np.round(np.geomspace(1, len(danger), count)).astype(np.int64)) - 1
    falling = np.sort(danger)[::-1]
    return sorted({float(value) for value in falling[rank]}, reverse=True)


def _peaks(run: AssessedRun, rule: str) -> FloatArray:
    """The greatest danger of each pair."""
    trace = run.traces[rule]
    if not len(trace.danger):
        return trace.danger
    changes = (np.diff(trace.first) != 0) | (np.diff(trace.second) != 0)
    return np.maximum.reduceat(trace.danger, np.flatnonzero(np.append(True, changes)))


def sweep(
    runs: Sequence[AssessedRun],
    rule: str,
    thresholds: Sequence[float],
    settings: AssistSettings | None = None,
) -> list[Operating]:
    """The rule at every threshold."""
    return [operating(runs, rule, threshold, settings) for threshold in thresholds]


def operating(
    runs: Sequence[AssessedRun],
    rule: str,
    threshold: float,
    settings: AssistSettings | None = None,
) -> Operating:
    """The rule at one threshold."""
    found = warned(runs, rule, threshold, settings=settings)
    # The lower of two in the middle, as the scores have it, which draw runs with weights.
    lead_s = np.quantile(found.lead_s, 0.5, method="inverted_cdf") if len(found.lead_s) else np.nan
    return Operating(
        threshold=threshold,
        false_alarms_per_hour=found.of_runs(quiet(runs)).rate("false_alarms_per_hour"),
        event_recall=found.rate("event_recall"),
        recall_1s5=found.rate("recall_1s5"),
        lead_time_s=float(lead_s),
    )


def best_within(curve: Sequence[Operating], false_alarms_per_hour: float) -> Operating | None:
    """The threshold that recalls most within that rate, then soonest; None: none is within it."""
    within = [one for one in curve if one.false_alarms_per_hour <= false_alarms_per_hour + ROUNDING]
    return max(
        within,
        key=lambda one: (
            np.nan_to_num(one.event_recall),
            np.nan_to_num(one.recall_1s5),
            one.threshold,
        ),
        default=None,
    )


def quietest_at(curve: Sequence[Operating], event_recall: float) -> Operating | None:
    """The threshold with the fewest false alarms that recalls so much; None: none does."""
    enough = [one for one in curve if one.event_recall >= event_recall - ROUNDING]
    return min(enough, key=lambda one: (one.false_alarms_per_hour, -one.threshold), default=None)


def sharpest(
    runs: Sequence[AssessedRun],
    rule: str,
    curve: Sequence[Operating],
    choose: Callable[[Sequence[Operating]], Operating | None],
    settings: AssistSettings | None = None,
) -> Operating | None:
    """What `choose` chooses of the curve, looking closer between it and its neighbours."""
    best = choose(curve)
    if best is None:
        return None
    lower = max((one.threshold for one in curve if one.threshold < best.threshold), default=None)
    higher = min((one.threshold for one in curve if one.threshold > best.threshold), default=None)
    between = [
        float(threshold)
        for bound in (lower, higher)
        if bound is not None
        for threshold in np.geomspace(best.threshold, max(bound, SMALLEST), BETWEEN + 2)[1:-1]
    ]
    return choose([*curve, *sweep(runs, rule, between, settings)])
