"""A table of the paper beside ours, for a console."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from rich.console import Group
from rich.table import Table
from rich.text import Text

from hatn_sim.datatypes import Score
from hatn_sim.evaluation.paper import Cell, PaperTable
from hatn_sim.evaluation.table import Entry
from hatn_sim.report.plain_table import plain_table

BESIDE: Final = 2
"""Measures in one table: more would not fit a hundred columns."""
NONE: Final = "-"


@dataclass(frozen=True)
class Form:
    """How the numbers of a measure are printed."""

    title: str
    factor: float
    decimals: int
    more_is_better: bool = False


FORMS: Final = {
    "ade_3s": Form("ADE 3 s, m", 1.0, 3),
    "ade_0s3": Form("ADE 0.3 s, m", 1.0, 3),
    "fde_3s": Form("FDE 3 s, m", 1.0, 3),
    "fde_0s3": Form("FDE 0.3 s, m", 1.0, 3),
    "slot_accuracy": Form("accuracy, %", 100.0, 2, more_is_better=True),
    "goal_error": Form("goal error, m", 1.0, 2),
    "ade_2_change": Form("change of ADE 2, %", 100.0, 1),
}


def paper_table(table: PaperTable, entries: Sequence[Entry], clustered_over: str) -> Group:
    """The entries that `compare` made of a table: for each scene, two measures side by side.

    Mean and deviation over samples, as the paper prints them; below ours, its 95 % interval. The
    best of every column has a star. Where measures are of different samples, n is of each.
    """
    parts: list[Table | Text] = [Text(table.title, style="bold"), Text()]
    for scene in dict.fromkeys(entry.scene for entry in entries):
        of_scene = [entry for entry in entries if entry.scene == scene]
        for first in range(0, len(table.measures), BESIDE):
            measures = table.measures[first : first + BESIDE]
            parts += [_side_by_side(scene, measures, of_scene), Text()]
    note = f"paper: {table.source}; * best; ± of samples"
    if any(entry.ours is not None for entry in entries):
        note += f"; [low high] 95 % interval, bootstrapped over {clustered_over}"
    parts.append(Text(note, style="dim"))
    return Group(*parts)


def _side_by_side(scene: str, measures: Sequence[str], entries: Sequence[Entry]) -> Table:
    scenario = entries[0].paper_scenario
    like = f"; paper: {scenario}" if scenario is not None and scenario != scene else ""
    grid = plain_table(f"{scene}{like}")
    grid.add_column("", min_width=12, max_width=20, overflow="fold")
    for measure in measures:
        grid.add_column(f"{FORMS[measure].title}\npaper", justify="right", no_wrap=True)
        grid.add_column("\nours", justify="right", no_wrap=True)
    grid.add_column("\nn", justify="right", no_wrap=True)
    best = {measure: _best(measure, entries) for measure in measures}
    for row in dict.fromkeys(entry.row for entry in entries):
        of_row = {entry.measure: entry for entry in entries if entry.row == row}
        cells: list[str] = []
        for measure in measures:
            form, entry, (of_paper, of_ours) = FORMS[measure], of_row[measure], best[measure]
            cells += [_of_paper(entry.paper, of_paper), _of_ours(entry.ours, form, of_ours)]
        ours = [of_row[measure].ours for measure in measures]
        counts = dict.fromkeys(score.n for score in ours if score is not None and score.n)
        grid.add_row(row.replace("_", " "), *cells, "\n".join(f"{n:,}" for n in counts) or NONE)
    return grid


def _best(measure: str, entries: Sequence[Entry]) -> tuple[float | None, float | None]:
    """The best of the paper's means of a measure, and the best of ours."""
    best = max if FORMS[measure].more_is_better else min
    of_measure = [entry for entry in entries if entry.measure == measure]
    paper = [entry.paper.mean for entry in of_measure if entry.paper is not None]
    ours = [entry.ours.value for entry in of_measure if entry.ours is not None]
    known = [value for value in ours if value is not None]
    return best(paper, default=None), best(known, default=None)


def _of_paper(cell: Cell | None, best: float | None) -> str:
    if cell is None:
        return NONE
    return cell.printed + ("*" if cell.mean == best else "")


def _of_ours(score: Score | None, form: Form, best: float | None) -> str:
    if score is None or score.value is None:
        return NONE
    star = "*" if score.value == best else ""
    text = f"{form.factor * score.value:.{form.decimals}f}"
    if score.std is not None:
        text += f" ± {form.factor * score.std:.{form.decimals}f}"
    text += star
    if score.low is not None and score.high is not None:
        low, high = (
            f"{form.factor * value:.{form.decimals}f}" for value in (score.low, score.high)
        )
        text += f"\n[{low} {high}]"
    return text
