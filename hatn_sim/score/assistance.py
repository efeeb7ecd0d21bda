"""Scores of assistance over many runs (METHOD 7), with 95 % intervals bootstrapped over runs.

| measure | unit | what it is |
|---|---|---|
| `event_recall` | share | of T1 and T2 events: an alert came before |
| `recall_1s0` ... `recall_2s5` | share | of T1 and T2 events: it came 1.0, 1.5, 2.0, 2.5 s before |
| `recall_in_time` | share | of T1 and T2 events: it came 1.5 s before, or by \
when the offender first did otherwise than lawfully, if that was later (see `offences`) |
| `recall_t1`, `recall_t2`, `recall_brief` | share | of the events of one tier |
| `recall_t3_1s5`, `_1s0` | share | of T3 events with an encroachment time under 1.5, 1.0 s |
| `recall_t3_rare` | share | of those under the 1 % quantile of courteous drivers in that scene |
| `precision` | share | hits of hits and false alarms |
| `false_alarms_per_hour` | 1/h | per hour of a vehicle in view |
| `false_alarms_per_hour_at_equal_recall` | 1/h | the same at the threshold where a rule recalls \
as much as ours (`evaluation.comparison`) |
| `false_alarms_per_100_crossings` | 1 | see `advised` for what a crossing is |
| `near_alarms_per_hour` | 1/h | alerts that meet only T3 or brief events: neither hit nor false |
| `lead_time_s`, `_q1`, `_q3` | s | median and quartiles over events that an alert preceded |
| `duplicates` | 1 | further alerts on an event that one preceded |
| `events_per_hour` | 1/h | T1 and T2, per vehicle-hour |
| `unattributed_per_hour`, `brief_per_hour` | 1/h | braking for nobody, braking in single frames |
| `suggestion_agreement` | share | see `advised` |
| `suggestion_brier`, `_ece` | 1, share | of the probability of the slot advised; 15 bins |
| `suggestion_switches` | 1 | per encounter: changes between yield and pass, see `advised` |
| `suggestion_abstained` | share | of the sampled suggestions |
| `useful_share` | share | of judged alerts that an event would follow: obeying removes it |
| `harmful_share`, `unneeded_share` | share | of judged alerts |
| `regret` | 1 | mean cost of the slot advised over that of the best, of judged suggestions |
| `always_yield_regret`, `driver_regret` | 1 | the same of yielding, and of what the driver did |
| `regret_where_different`, `driver_regret_where_different` | 1 | where the driver passed \
before the vehicle that the advice names instead of yielding to it, or the reverse |
| `regret_to_best`, `always_yield_regret_to_best` | 1 | the same over the best of the slots and \
what the driver did |
| `slots_differ` | share | of judged suggestions: it makes a difference which slot is taken |
| `all_slots_collide` | share | of judged suggestions: each slot ends in a collision |
| `lost_branches` | share | of what was to be judged: a branch died |

`subset` is the risk profile, "all" where several are pooled. A measure of which there is nothing
has no value and n = 0: without events there is no recall, be it 0 or 1. Of rates, n is the number
of runs, and where nothing was counted in H hours (or hundreds of crossings) the interval ends at
3.7 / H (97.5 % of a Poisson count), since a bootstrap of nothing is nothing. For the same reason a
share of 0 or of 1 has the interval of Clopper and Pearson.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from hatn_sim.assist.settings import AssistSettings
from hatn_sim.config import DEFAULT_RISK
from hatn_sim.datatypes import AlertInterval, BoolArray, FloatArray, IntArray, SafetyEvent, Score
from hatn_sim.score import intervals
from hatn_sim.score.assessed import AssessedRun
from hatn_sim.score.counterfactual_tally import driver_differs
from hatn_sim.score.dangers import alerts_at, oracle_alerts
from hatn_sim.score.events import BRIEF
from hatn_sim.score.matching import SEVERE, Outcome, match

LEADS_S: Final = {"recall_1s0": 1.0, "recall_1s5": 1.5, "recall_2s0": 2.0, "recall_2s5": 2.5}
IN_TIME_S: Final = 1.5
NEAR_S: Final = {"recall_t3_1s5": 1.5, "recall_t3_1s0": 1.0}
RARE: Final = "recall_t3_rare"
FALSE_ALARMS: Final = "false_alarms_per_hour"
AT_EQUAL_RECALL: Final = "false_alarms_per_hour_at_equal_recall"
RARE_SHARE: Final = 0.01
QUARTILES: Final = {"lead_time_s": 0.5, "lead_time_s_q1": 0.25, "lead_time_s_q3": 0.75}
ALERT, SUGGESTION, ANY = "alert", "suggestion", "any"
"""What a line of counterfactuals is about."""
Line = Mapping[str, Any]
ORACLE: Final = "oracle"
ORACLE_LEAD_S: Final = 5.0
ECE_BINS: Final = 15
NONE_SEEN: Final = -np.log(0.5 * (1.0 - intervals.LEVEL))
"""Up to this mean a Poisson count is still 0 in 2.5 % of cases."""
ROUNDING_S: Final = 1e-6

COLUMNS: Final = (
    "events", "recalled", *LEADS_S, "asked", "in_time",
    *(f"{tier}{part}" for tier in ("t1", "t2", "brief") for part in ("", "_recalled")),
    *(f"{name}{part}" for name in (*NEAR_S, RARE) for part in ("", "_recalled")),
    "hits", "duplicates", "near", "false", "hours", "crossings", "unattributed", "all_brief",
)  # fmt: skip
"""What is counted in every run."""
_OF: Final = {name: k for k, name in enumerate(COLUMNS)}
RATIOS: Final = {
    "event_recall": ("recalled", "events", "share"),
    **{name: (name, "events", "share") for name in LEADS_S},
    "recall_in_time": ("in_time", "asked", "share"),
    "recall_t1": ("t1_recalled", "t1", "share"),
    "recall_t2": ("t2_recalled", "t2", "share"),
    "recall_brief": ("brief_recalled", "brief", "share"),
    **{name: (f"{name}_recalled", name, "share") for name in (*NEAR_S, RARE)},
    "false_alarms_per_hour": ("false", "hours", "1/h"),
    "false_alarms_per_100_crossings": ("false", "crossings", "1"),
    "near_alarms_per_hour": ("near", "hours", "1/h"),
    "duplicates": ("duplicates", "recalled", "1"),
    "events_per_hour": ("events", "hours", "1/h"),
    "unattributed_per_hour": ("unattributed", "hours", "1/h"),
    "brief_per_hour": ("all_brief", "hours", "1/h"),
}
"""Measure -> numerator, denominator, unit."""
PER_TIME_OR_CROSSINGS: Final = tuple(
    name for name, (_, bottom, _) in RATIOS.items() if bottom in ("hours", "crossings")
)


@dataclass(frozen=True, eq=False)
class Warned:
    """What a rule's alerts came to in several runs [G]."""

    counts: FloatArray  # [G, len(COLUMNS)]
    lead_s: FloatArray  # [L] of every event that an alert preceded
    run_of_lead: IntArray  # [L]

    def of_runs(self, chosen: BoolArray) -> Warned:
        """The same of some of the runs [G]."""
        kept = chosen[self.run_of_lead]
        number = np.cumsum(chosen) - 1
        return Warned(self.counts[chosen], self.lead_s[kept], number[self.run_of_lead[kept]])

    def rate(self, measure: str) -> float:
        """A ratio over all runs; NaN where there is nothing to divide by."""
        top, bottom, _ = RATIOS[measure]
        sums = self.counts.sum(axis=0)
        return float(sums[_OF[top]] / sums[_OF[bottom]]) if sums[_OF[bottom]] else np.nan


def rare_s(runs: Sequence[AssessedRun]) -> dict[str, float]:
    """Scene -> the 1 % quantile of the encroachment times of its courteous drivers.

    Of pairs on crossing ways that came within 3 s of each other; scenes without such have none.
    """
    near_s: dict[str, list[float]] = {}
    for run in runs:
        if run.risk == DEFAULT_RISK:
            near_s.setdefault(run.scene, []).extend(
                one.encroachment_s or 0.0 for one in run.events if one.tier == "T3"
            )
    return {
        scene: float(np.quantile(times_s, RARE_SHARE))
        for scene, times_s in near_s.items()
        if times_s
    }


def warned(
    runs: Sequence[AssessedRun],
    rule: str,
    threshold: float,
    rare: Mapping[str, float] = MappingProxyType({}),
    settings: AssistSettings | None = None,
) -> Warned:
    """What the rule's alerts come to at a threshold; `rare` is as `rare_s` says."""
    alerts = [_alerts(run, rule, threshold, settings) for run in runs]
    return warned_by(runs, alerts, rare)


def warned_by(
    runs: Sequence[AssessedRun],
    alerts: Sequence[Sequence[AlertInterval]],
    rare: Mapping[str, float] = MappingProxyType({}),
) -> Warned:
    """What the alerts of each run come to."""
    found = [
        _count(run, own, rare.get(run.scene, 0.0)) for run, own in zip(runs, alerts, strict=True)
    ]
    leads = [leads for _, leads in found]
    return Warned(
        counts=np.array([counts for counts, _ in found]).reshape(-1, len(COLUMNS)),
        lead_s=np.concatenate([np.zeros(0), *leads]),
        run_of_lead=np.repeat(np.arange(len(runs)), [len(one) for one in leads]),
    )


def _alerts(
    run: AssessedRun, rule: str, threshold: float, settings: AssistSettings | None
) -> list[AlertInterval]:
    if rule == ORACLE:
        return oracle_alerts(run.events, ORACLE_LEAD_S)
    return alerts_at(run.traces[rule], threshold, settings)


def _count(
    run: AssessedRun, alerts: Sequence[AlertInterval], rare: float
) -> tuple[FloatArray, FloatArray]:
    """(counts, lead times of the severe events that were preceded)."""
    counted = [k for k, one in enumerate(run.events) if one.tier != "T3" or is_close(one)]
    events = [run.events[k] for k in counted]
    unasked = np.full(len(events), np.nan)
    warnable_s = unasked if run.warnable_s is None else run.warnable_s[counted]
    found = match(events, alerts, run.window_s)
    low_s, high_s = run.window_s
    tier = np.array([event.tier for event in events], dtype=np.str_)
    near_s = np.array([event.encroachment_s or 0.0 for event in events])
    inside = np.array([low_s <= event.start_s < high_s for event in events], dtype=np.bool_)
    alone = np.array([event.second_id is None for event in events], dtype=np.bool_)
    severe, recalled = np.isin(tier, SEVERE), found.alert_of_event >= 0
    of = found.is_scored
    leads = found.lead_s[of & severe & recalled]
    asked = of & severe & ~np.isnan(warnable_s)
    in_time = recalled & (found.lead_s >= np.minimum(warnable_s, IN_TIME_S) - ROUNDING_S)
    outcome = np.bincount(found.outcome, minlength=len(Outcome))
    counts = {
        "events": (of & severe).sum(),
        "recalled": (of & severe & recalled).sum(),
        **{name: (leads >= least - ROUNDING_S).sum() for name, least in LEADS_S.items()},
        "asked": asked.sum(),
        "in_time": (asked & in_time).sum(),
        "hits": outcome[Outcome.HIT],
        "duplicates": outcome[Outcome.DUPLICATE],
        "near": outcome[Outcome.NEAR],
        "false": outcome[Outcome.FALSE],
        "hours": run.vehicle_hours,
        "crossings": run.advised.crossings / 100.0,
        "unattributed": (inside & alone & severe).sum(),
        "all_brief": (inside & (tier == BRIEF)).sum(),
    }
    for name, its_tier in (("t1", "T1"), ("t2", "T2"), ("brief", BRIEF)):
        own = of & (tier == its_tier)
        counts |= {name: own.sum(), f"{name}_recalled": (own & recalled).sum()}
    for name, most_s in {**NEAR_S, RARE: rare}.items():
        own = of & (tier == "T3") & (near_s < most_s - ROUNDING_S)
        counts |= {name: own.sum(), f"{name}_recalled": (own & recalled).sum()}
    return np.array([float(counts[name]) for name in COLUMNS]), leads


def is_close(event: SafetyEvent) -> bool:
    """Near enough that an alert on it is not false."""
    return (event.encroachment_s or 0.0) < max(NEAR_S.values()) - ROUNDING_S


# ---------------------------------------------------------------------------------------------
# Scores


def alert_scores(
    found: Warned, rule: str, scene: str, risk: str, ratios: Sequence[str] = ()
) -> list[Score]:
    """The measures of a rule's alerts, or some of `RATIOS` alone."""

    def score(
        measure: str, unit: str, n: float, sums: FloatArray, of: intervals.Statistic
    ) -> Score:
        if not n:
            return Score(measure, rule, scene, risk, "none", None, unit, 0, None, None)
        value = float(of(sums.sum(axis=0)))
        low, high = _bounds(sums, unit, of)
        if value == 0.0 and measure in PER_TIME_OR_CROSSINGS:
            low, high = 0.0, float(NONE_SEEN / sums[:, 1].sum())
        return Score(measure, rule, scene, risk, "none", value, unit, int(n), low, high)

    scores: list[Score] = []
    for measure in ratios or RATIOS:
        top, bottom, unit = RATIOS[measure]
        pair = found.counts[:, [_OF[top], _OF[bottom]]]
        of_what = pair[:, 1].sum()
        n = len(pair) if measure in PER_TIME_OR_CROSSINGS and of_what else of_what
        scores.append(score(measure, unit, n, pair, intervals.ratio))
    if ratios:
        return scores
    hits, false = found.counts[:, _OF["hits"]], found.counts[:, _OF["false"]]
    judged = np.column_stack([hits, hits + false])
    scores.append(score("precision", "share", judged[:, 1].sum(), judged, intervals.ratio))
    each = np.eye(len(found.counts))
    for measure, share in QUARTILES.items():
        quantile = partial(_quantile, found, share)
        scores.append(score(measure, "s", len(found.lead_s), each, quantile))
    return scores


def _bounds(
    sums: FloatArray, unit: str, of: intervals.Statistic
) -> tuple[float | None, float | None]:
    found = intervals.share_interval(sums) if unit == "share" else intervals.interval(sums, of)
    return found or (None, None)


def _quantile(found: Warned, share: float, drawn: FloatArray) -> FloatArray:
    """The quantile of lead times where runs count as often as they were drawn [..., G]."""
    order = np.argsort(found.lead_s)
    weight = np.atleast_2d(drawn)[:, found.run_of_lead[order]]
    reached = np.cumsum(weight, axis=1)
    total = reached[:, -1:]
    at = (reached < share * total - 1e-9).sum(axis=1)
    value = np.where(total[:, 0] > 0, found.lead_s[order][np.minimum(at, len(order) - 1)], np.nan)
    return value if drawn.ndim > 1 else value[0]


def suggestion_scores(runs: Sequence[AssessedRun], name: str, scene: str, risk: str) -> list[Score]:
    """The measures of the suggestions of a predictor."""
    brier, bins = [], []
    for run in runs:
        chance, right = run.advised.probability, run.advised.agrees.astype(np.float64)
        brier.append([((chance - right) ** 2).sum(), len(chance)])
        place = np.minimum((chance * ECE_BINS).astype(np.int64), ECE_BINS - 1)
        bins.append([len(chance), *np.bincount(place, chance - right, minlength=ECE_BINS)])
    told: Mapping[str, tuple[list[list[float]], str, intervals.Statistic]] = {
        "suggestion_agreement": (
            [[run.advised.agrees.sum(), len(run.advised.agrees)] for run in runs],
            "share",
            intervals.ratio,
        ),
        "always_yield_agreement": (
            [[run.advised.always_yield_agrees.sum(), len(run.advised.agrees)] for run in runs],
            "share",
            intervals.ratio,
        ),
        "suggestion_brier": (brier, "1", intervals.ratio),
        "suggestion_ece": (bins, "share", intervals.expected_calibration_error),
        "suggestion_switches": (
            [[run.advised.switches, run.advised.encounters] for run in runs],
            "1",
            intervals.ratio,
        ),
        "suggestion_abstained": (
            [[run.advised.abstained, run.advised.sampled] for run in runs],
            "share",
            intervals.ratio,
        ),
    }
    scores: list[Score] = []
    for measure, (rows, unit, statistic) in told.items():
        sums = np.array(rows, dtype=np.float64)
        n = int(sums[:, 0 if measure == "suggestion_ece" else 1].sum())
        low, high = (intervals.interval(sums, statistic) or (None, None)) if n else (None, None)
        value = float(statistic(sums.sum(axis=0))) if n else None
        scores.append(Score(measure, name, scene, risk, "none", value, unit, n, low, high))
    return scores


def counterfactual_scores(
    runs: Sequence[AssessedRun], name: str, scene: str, risk: str
) -> list[Score]:
    """What branches of the runs said of alerts and suggestions; nothing where none was asked."""
    if not any(run.counterfactuals for run in runs):
        return []

    def mean(measure: str, unit: str, about: str, of: Callable[[Line], float | None]) -> Score:
        sums = np.zeros((len(runs), 2))
        for row, run in zip(sums, runs, strict=True):
            lines = (line for line in run.counterfactuals if about in (ANY, line["about"]))
            values = [value for line in lines if (value := of(line)) is not None]
            row[:] = sum(values), len(values)
        n = int(sums[:, 1].sum())
        if not n:
            return Score(measure, name, scene, risk, "none", None, unit, 0, None, None)
        low, high = _bounds(sums, unit, intervals.ratio)
        value = float(intervals.ratio(sums.sum(axis=0)))
        return Score(measure, name, scene, risk, "none", value, unit, n, low, high)

    def verdict(
        wanted: str, on_events: bool = False, key: str = "verdict"
    ) -> Callable[[Line], float | None]:
        def of(line: Line) -> float | None:
            if line["lost"] or (on_events and not line["ignored"]):
                return None
            return float(line[key] == wanted)

        return of

    def cost(key: str, where_different: bool = False) -> Callable[[Line], float | None]:
        def of(line: Line) -> float | None:
            if line["lost"] or (where_different and not driver_differs(line)):
                return None
            return float(line[key])

        return of

    def always_yield_to_best(line: Line) -> float | None:
        if line["lost"]:
            return None
        return float(line["always_yield_regret"] - line["regret"] + line["regret_to_best"])

    def all_collide(line: Line) -> float | None:
        return None if line["lost"] else float(all(slot["collisions"] for slot in line["slots"]))

    return [
        mean("useful_share", "share", ALERT, verdict("useful", on_events=True)),
        mean("harmful_share", "share", ALERT, verdict("harmful")),
        mean("harmful_to_the_end_share", "share", ALERT, verdict("harmful", key="to_the_end")),
        mean("unneeded_share", "share", ALERT, verdict("unneeded")),
        mean("regret", "1", SUGGESTION, cost("regret")),
        mean("always_yield_regret", "1", SUGGESTION, cost("always_yield_regret")),
        mean("driver_regret", "1", SUGGESTION, cost("driver_regret")),
        mean("regret_where_different", "1", SUGGESTION, cost("regret", True)),
        mean("driver_regret_where_different", "1", SUGGESTION, cost("driver_regret", True)),
        mean("regret_to_best", "1", SUGGESTION, cost("regret_to_best")),
        mean("always_yield_regret_to_best", "1", SUGGESTION, always_yield_to_best),
        mean("slots_differ", "share", SUGGESTION, cost("slots_differ")),
        mean("all_slots_collide", "share", SUGGESTION, all_collide),
        mean("lost_branches", "share", ANY, lambda line: float(line["lost"])),
    ]
