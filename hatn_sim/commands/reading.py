"""Runs as commands read them: it is said what of an unfinished or damaged one there is not."""

from __future__ import annotations

import sys
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hatn_sim.log import Part, Run


def read_and_tell(path: Path, wanted: Collection[Part] | None = None) -> Run:
    """The run in a folder, as far as it is there; see `read_run`, which is not asked for all.

    Args:
        path: the folder.
        wanted: of what the command shows, all that a run may lack (None: everything).

    Raises:
        InputError: there is no run that can be read.
    """
    from hatn_sim.datatypes import DT_S
    from hatn_sim.log import read_run

    run = read_run(path, whole=False)
    if not run.finished:
        written = f"its first {run.frame_count * DT_S:.1f} s were written"
        there = written if run.frame_count else "it ended before any of its traffic was written"
        print(f"hatn-sim: {path} is of an unfinished run: {there}", file=sys.stderr)
    for gap in run.gaps:
        if wanted is None or gap.part in wanted:
            print(f"hatn-sim: {path}: {gap}", file=sys.stderr)
    return run
