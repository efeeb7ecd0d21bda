"""Runs as commands read them: it is said of an unfinished one how much of it there is."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hatn_sim.log import Run


def read_and_tell(path: Path) -> Run:
    """The run in a folder. Raises InputError where there is none that can be read."""
    from hatn_sim.datatypes import DT_S
    from hatn_sim.log import read_run

    run = read_run(path)
    if not run.finished:
        written = f"its first {run.frame_count * DT_S:.1f} s were written"
        there = written if run.frame_count else "it ended before any of its traffic was written"
        print(f"hatn-sim: {path} is of an unfinished run: {there}", file=sys.stderr)
    return run
