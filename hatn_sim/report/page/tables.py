"""Scores as tables of the page: each cell a value over its interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from hatn_sim.datatypes import Score
from hatn_sim.report.table import (
    ERRORS,
    SLOTS,
    SPREADS,
    SUBSETS,
    TITLES,
    by_measure,
    plain_cell,
    row_count,
    row_name,
)

GROUPS: Final = (
    ("Errors in metres", "all", (*ERRORS, "fallback_share")),
    ("Errors in metres", "moving", ERRORS),
    ("Slots", "all", SLOTS),
    ("Modes and probabilities", "all", SPREADS),
)


def score_tables(scores: Sequence[Score]) -> list[dict[str, Any]]:
    """Title, names of columns, and rows of cells of one or more lines."""
    tables: list[dict[str, Any]] = []
    for title, subset, measures in GROUPS:
        found = by_measure(scores, subset)
        rows: list[list[str]] = []
        for predictor in dict.fromkeys(score.predictor for score in scores):
            row = [found.get((predictor, measure)) for measure in measures]
            if any(score and score.n for score in row):
                rows.append([row_name(row), row_count(row), *(plain_cell(one) for one in row)])
        if rows:
            columns = ["predictor", "n", *(TITLES[measure] for measure in measures)]
            tables.append(
                {"title": f"{title}, {SUBSETS[subset]}", "columns": columns, "rows": rows}
            )
    return tables
