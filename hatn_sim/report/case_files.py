"""A case study of some runs, found and drawn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hatn_sim.log import Run
from hatn_sim.report.cases import KINDS, find_cases, missing


def draw_case_of(runs: Sequence[Run], name: str, paths: Sequence[Path]) -> None:
    """Draw the most telling case of a kind into files.

    Raises InputError where there is none in the runs, or a folder lacks what it takes. A sequence
    is told by another story than the transfer, see `find_cases`.
    """
    from hatn_sim.report.case_figure import draw_case

    found = find_cases(runs, tuple(KINDS))
    if name not in found:
        raise missing(runs, [KINDS[name]])
    draw_case(found[name], paths)
