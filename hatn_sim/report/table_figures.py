"""The figures of what `assess`, `compare` and `evaluate` left in a folder, of numbers kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from hatn_sim.errors import InputError
from hatn_sim.report.table import SCORES_FILE

CURVES_FILE: Final = "curves.csv"
STEPS_FILE: Final = "steps.csv"
CLOSED_LOOP_MEASURE: Final = "time_to_cross"


@dataclass(frozen=True)
class TableFigure:
    """A figure, and what draws it into files."""

    name: str
    draw: Callable[[Sequence[Path]], None]


def table_figures(folder: Path) -> list[TableFigure]:
    """Those that the numbers in a folder are enough for.

    Raises:
        InputError: the numbers are damaged, or there are none.
    """
    found: list[TableFigure] = []
    if (folder / STEPS_FILE).is_file():
        found.append(TableFigure("steps", partial(_steps, folder / STEPS_FILE)))
    if (folder / CURVES_FILE).is_file():
        found.append(TableFigure("curves", partial(_curves, folder / CURVES_FILE)))
    if _is_of_drives(folder / SCORES_FILE):
        found.append(TableFigure("closed_loop", partial(_closed_loop, folder / SCORES_FILE)))
    if not found:
        raise InputError(
            f"{folder}: expected the folder of a run, or numbers of `assess`, `compare` or "
            f"`evaluate` ({STEPS_FILE}, {CURVES_FILE}, {SCORES_FILE}); found none to draw: name a "
            "folder that their --out made"
        )
    return found


def _steps(path: Path, paths: Sequence[Path]) -> None:
    from hatn_sim.report.steps_figure import draw_steps, read_steps

    draw_steps(read_steps(path), paths)


def _curves(path: Path, paths: Sequence[Path]) -> None:
    from hatn_sim.report.assistance_figure import draw_curves
    from hatn_sim.report.kept_numbers import read_curves

    draw_curves(read_curves(path), paths)


def _is_of_drives(path: Path) -> bool:
    from hatn_sim.report.kept_numbers import read_scores

    return path.is_file() and any(s.measure == CLOSED_LOOP_MEASURE for s in read_scores(path))


def _closed_loop(path: Path, paths: Sequence[Path]) -> None:
    from hatn_sim.report.closed_loop_figure import draw_closed_loop
    from hatn_sim.report.kept_numbers import read_scores

    scores = read_scores(path)
    agent = next(score.subset for score in scores if score.measure == CLOSED_LOOP_MEASURE)
    draw_closed_loop(scores, agent, paths)
