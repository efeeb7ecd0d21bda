"""Scores of assistance as tables for a console: alerts of every rule, then suggestions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

from rich.console import Group
from rich.table import Table
from rich.text import Text

from hatn_sim.datatypes import Score
from hatn_sim.report.plain_table import plain_table

ALERTS: Final = {
    "event_recall": "recall",
    "recall_t1": "of T1",
    "recall_t2": "of T2",
    "recall_1s5": "1.5 s ahead",
    "lead_time_s": "lead",
}
FALSE: Final = {
    "precision": "precision",
    "false_alarms_per_hour": "false/h",
    "false_alarms_per_hour_at_equal_recall": "same recall",
    "near_alarms_per_hour": "near/h",
    "duplicates": "again",
}
SUGGESTIONS: Final = {
    "suggestion_agreement": "agreement",
    "always_yield_agreement": "always yield",
    "suggestion_ece": "ECE",
    "suggestion_brier": "Brier",
    "suggestion_switches": "switches",
    "suggestion_abstained": "abstained",
}
WHAT_IF: Final = {
    "useful_share": "useful",
    "harmful_share": "harmful",
    "harmful_to_the_end_share": "to the end",
    "unneeded_share": "unneeded",
    "regret": "regret",
    "always_yield_regret": "always yield",
    "driver_regret": "driver",
    "lost_branches": "lost",
}
NONE: Final = "-"


def assistance_table(
    scores: Sequence[Score], chosen_on: Mapping[str, Sequence[str]] = MappingProxyType({})
) -> Group:
    """The scores of every scene and risk profile; each value over its 95 % interval.

    `chosen_on` names, for a scene, other scenes on which the thresholds of rules were chosen.
    """
    parts: list[Table | Text] = []
    by_key = {(s.scene, s.subset, s.predictor, s.measure): s for s in scores}
    for scene, risk in dict.fromkeys((score.scene, score.subset) for score in scores):
        rules = dict.fromkeys(s.predictor for s in scores if (s.scene, s.subset) == (scene, risk))
        events = by_key.get((scene, risk, next(iter(rules)), "event_recall"))
        count = 0 if events is None else events.n
        if count:
            title = f"{scene}, {risk} drivers: alerts on {count} events (T1 and T2)"
            parts += [_table(title, "rule", list(rules), ALERTS, by_key, scene, risk), Text()]
        title = f"{scene}, {risk} drivers: false alarms"
        if chosen_on.get(scene):
            title += f" at thresholds of {', '.join(chosen_on[scene])}"
        parts += [_table(title, "rule", list(rules), FALSE, by_key, scene, risk), Text()]
        advised = [rule for rule in rules if (scene, risk, rule, "suggestion_ece") in by_key]
        title = f"{scene}, {risk} drivers: suggestions"
        parts += [_table(title, "of", advised, SUGGESTIONS, by_key, scene, risk), Text()]
        judged = [rule for rule in rules if (scene, risk, rule, "regret") in by_key]
        if judged:
            title = f"{scene}, {risk} drivers: what obeying would have changed"
            parts += [_table(title, "of", judged, WHAT_IF, by_key, scene, risk), Text()]
    note = (
        "[low high] 95 % interval, bootstrapped over runs; recall: events with an alert before, "
        "1.5 s ahead: so early; lead: median; precision: hits of hits and false alarms; false/h, "
        "near/h: per vehicle-hour, near: meets a close encounter or a brief braking only; again: "
        "further alerts on an event"
    )
    if any(score.measure == "regret" for score in scores):
        note += (
            "; useful: of alerts with an event to come, those that obeying removes; harmful, "
            "unneeded: of all judged; to the end: harmful, by all events of the branches, not "
            "only those until a second after the driver drives again; regret: cost over that of "
            "the best slot"
        )
    if any(score.predictor == "oracle" for score in scores):
        note += (
            "; rules beside hatn: at no more false alarms than it; same recall: false/h at the "
            "threshold where they recall as much, -: they never do"
        )
    return Group(*parts, Text(note, style="dim"))


def _table(
    title: str,
    head: str,
    rows: Sequence[str],
    measures: Mapping[str, str],
    by_key: Mapping[tuple[str, str, str, str], Score],
    scene: str,
    risk: str,
) -> Table:
    table = plain_table(title, apart=1)
    table.add_column(head, min_width=9, max_width=18, overflow="fold")
    for name in measures.values():
        table.add_column(name, justify="right", no_wrap=True)
    for rule in rows:
        cells = [_cell(by_key.get((scene, risk, rule, measure))) for measure in measures]
        table.add_row(rule.replace("_", " "), *cells)
    return table


def _cell(score: Score | None) -> str:
    if score is None or score.value is None:
        return NONE
    cell = _number(score.value, score.unit)
    if score.low is not None and score.high is not None:
        low, high = (_number(value, score.unit).rstrip(" %s") for value in (score.low, score.high))
        cell += f"\n[{low} {high}]"
    return cell


def _number(value: float, unit: str) -> str:
    if unit == "share":
        return f"{100.0 * value:.{0 if value == 1.0 else 1}f} %"
    digits = 2 if abs(value) < 10.0 else 1 if abs(value) < 100.0 else 0
    return f"{value:.{digits}f}" + (" s" if unit == "s" else "")
