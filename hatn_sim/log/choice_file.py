"""How a run's main predictor chose reference lines, in a file of the run's folder.

The file is there only where that is not the choice that ships: its networks were trained with one
of their own, fitted to a site, or one was fitted to other recordings for all predictors. Lines are
not logged, but worked out again from scenes, lanes and this.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from hatn_sim.datatypes import Predictor
from hatn_sim.line_choice import LineChoice, load_line_choice, save_line_choice

CHOICE_FILE: Final = "line_choice.json"


def write_run_choice(folder: Path, main: Predictor, given: LineChoice | None = None) -> None:
    """Write the main predictor's choice of lines, if it is not the one that ships.

    `given`: the choice for all predictors, in place of their own.
    """
    choice = given or getattr(getattr(main, "weights", None), "line_choice", None)
    if choice is not None:
        save_line_choice(folder / CHOICE_FILE, choice, {})


def read_run_choice(folder: Path) -> LineChoice | None:
    """The choice of lines of a run, None: the one that ships. Raises InputError for damage."""
    path = folder / CHOICE_FILE
    return load_line_choice(path) if path.is_file() else None
