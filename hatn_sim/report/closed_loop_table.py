"""Scores of drives in closed loop as tables for a console: each row, changes, open loop, ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from rich.console import Group
from rich.table import Table
from rich.text import Text

from hatn_sim.datatypes import Score
from hatn_sim.report.plain_table import plain_table
from hatn_sim.report.table import notes
from hatn_sim.score.closed_loop_rows import ORACLE, REFERENCE
from hatn_sim.score.closed_loop_scores import (
    ALL,
    CHANGE,
    CLOSED_MEASURES,
    FEWEST_RANKED,
    OPEN_MEASURES,
    RELATIVE_CHANGE,
)

SAFETY: Final = {
    "time_to_cross": "time to cross",
    "crossed": "crossed",
    "collisions": "collisions",
    "t2_t3_events": "T2 and T3",
    "t2_events": "T2",
    "t3_events": "T3",
    "t3_events_1s": "under 1 s",
}
COMFORT: Final = {
    "time_to_enter": "to enter",
    "standing": "standing",
    "missed_gaps": "missed gaps",
    "others_braking": "others brake",
    "jerk_rms": "jerk RMS",
    "jerk_p95": "95 %",
}
CHANGES: Final = {
    "time_to_cross": "time to cross",
    "collisions": "collisions",
    "t2_t3_events": "T2 and T3",
    "others_braking": "others brake",
    "missed_gaps": "missed gaps",
    "jerk_rms": "jerk RMS",
}
OPEN: Final = {
    "ade_3s": "ADE 3 s, m",
    "fde_3s": "FDE 3 s, m",
    "goal_error": "goal error, m",
    "slot_accuracy": "slot accuracy",
}
NONE: Final = "-"

_ByKey = Mapping[tuple[str, str, str, str], Score]


def closed_loop_table(scores: Sequence[Score], agent: str, predictors: Sequence[str]) -> Group:
    """The scores of every scene; each value over its 95 % interval."""
    by_key = {(s.scene, s.subset, s.predictor, s.measure): s for s in scores}
    rows = {**dict.fromkeys(predictors, agent), REFERENCE: REFERENCE}
    baseline = predictors[0].replace("_", " ")
    others = {name: who for name, who in rows.items() if name != predictors[0]}
    parts: list[Table | Text] = []
    for scene in dict.fromkeys(score.scene for score in scores):
        first = by_key[scene, agent, predictors[0], "time_to_cross"]
        head = f"{scene}, {agent}, {first.n:,} drives"
        parts += [_table(f"{head}: time and safety", SAFETY, rows, by_key, scene), Text()]
        parts += [_table(f"{head}: gaps and comfort", COMFORT, rows, by_key, scene), Text()]
        parts += [_changes(f"{head}: minus {baseline}", others, by_key, scene), Text()]
        opened = dict.fromkeys(predictors, "all")
        title = f"{scene}: open loop, nobody driven, all samples"
        parts += [_table(title, OPEN, opened, by_key, scene), Text()]
        parts += [*_ranks(scene, len(predictors), by_key), Text()]
    note = (
        "mean of a drive over its 95 % interval over seeds (none below five, or all alike); "
        "T3: encroachment under 1.5 s; who never crosses counts with the limit; m/s2 and m/s3"
    )
    if ORACLE in predictors:
        note += "; oracle: told the future, without error by definition"
    return Group(*parts, *(Text(line, style="dim") for line in (*notes(scores), note)))


def _table(
    title: str,
    measures: Mapping[str, str],
    rows: Mapping[str, str],
    by_key: _ByKey,
    scene: str,
) -> Table:
    """`rows` are names with the subset of their scores."""
    table = _empty(title, measures)
    for name, subset in rows.items():
        told = [by_key.get((scene, subset, name, measure)) for measure in measures]
        table.add_row(name.replace("_", " "), *map(_cell, told))
    return table


def _changes(title: str, rows: Mapping[str, str], by_key: _ByKey, scene: str) -> Table:
    """Paired differences, and how much that is of the baseline."""
    table = _empty(title, CHANGES)
    for name, subset in rows.items():
        cells: list[str] = []
        for measure in CHANGES:
            change = by_key.get((scene, subset, name, measure + CHANGE))
            share = by_key.get((scene, subset, name, measure + RELATIVE_CHANGE))
            cells.append(f"{_cell(change, '+')}\n{_percent(share)}".rstrip())
        table.add_row(name.replace("_", " "), *cells)
    return table


def _empty(title: str, measures: Mapping[str, str]) -> Table:
    table = plain_table(title, apart=1)
    table.add_column("predictor", min_width=9, max_width=14, overflow="fold")
    for name in measures.values():
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _ranks(scene: str, count: int, by_key: _ByKey) -> list[Text]:
    """Whether who predicts better drives better, in a line for each open-loop measure."""
    if count < FEWEST_RANKED:
        said = (
            f"{scene}: {count} predictor(s): no rank correlation of open and closed loop; name "
            f"{FEWEST_RANKED} or more"
        )
        return [Text(said)]
    lines: list[Text] = []
    for measure, _ in OPEN_MEASURES:
        told: list[str] = []
        n = 0
        for closed in CLOSED_MEASURES:
            found = by_key.get((scene, f"{measure}, {closed}", ALL, "spearman"))
            if found is not None and found.value is not None:
                told.append(f"{closed.replace('_', ' ')} {_cell(found, '+').replace(chr(10), ' ')}")
                n = found.n
        if told:
            ranked = f"{scene}: Spearman's rank correlation of {measure} with "
            lines.append(Text(ranked + ", ".join(told) + f" ({n} predictors: that is few)"))
    return lines


def _cell(score: Score | None, sign: str = "") -> str:
    if score is None or score.value is None:
        return NONE
    cell = _number(score.value, score.unit, sign)
    if score.low is not None and score.high is not None:
        low, high = (_number(v, score.unit, sign).rstrip(" %s") for v in (score.low, score.high))
        cell += f"\n[{low} {high}]"
    return cell


def _percent(score: Score | None) -> str:
    """A relative change with its interval, on one line."""
    if score is None or score.value is None:
        return ""
    told = f"{score.value:+.0%}"
    if score.low is not None and score.high is not None:
        told += f" [{100.0 * score.low:+.0f} {100.0 * score.high:+.0f}]"
    return told


def _number(value: float, unit: str, sign: str) -> str:
    if unit == "share":
        return f"{100.0 * value:{sign}.1f} %"
    digits = 2 if abs(value) < 10.0 else 1
    return f"{value:{sign}.{digits}f}" + (" s" if unit == "s" else "")
