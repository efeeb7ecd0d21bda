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
    from hatn_sim.log import read_run

    run = read_run(path, whole=False)
    for line in said_of(run, wanted):
        print(f"hatn-sim: {line}", file=sys.stderr)
    return run


def said_of(run: Run, wanted: Collection[Part] | None = None) -> list[str]:
    """A line for each thing that a run lacks, with its folder; `wanted` as in `read_and_tell`."""
    from hatn_sim.datatypes import DT_S

    said: list[str] = []
    if not run.finished:
        written = f"its first {run.frame_count * DT_S:.1f} s were written"
        there = written if run.frame_count else "it ended before any of its traffic was written"
        said.append(f"{run.path} is of an unfinished run: {there}")
    lacks = [gap for gap in run.gaps if wanted is None or gap.part in wanted]
    return said + [f"{run.path}: {gap}" for gap in lacks]
