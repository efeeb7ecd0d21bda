"""The case studies of some runs, found and drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path

from hatn_sim.log import Run
from hatn_sim.report.cases import KINDS, Case, find_cases, missing

Draw = Callable[[Sequence[Path]], None]


def case_drawers(runs: Sequence[Run], sought: Sequence[str]) -> dict[str, Draw]:
    """What draws the most telling case of each kind into files, by its name.

    The runs are searched once, when the first is drawn, for all those `sought` together: see
    `find_cases` for how they shape each other. A drawer raises InputError where there is no such
    case in the runs, or a folder lacks what it takes.
    """

    @cache
    def found() -> dict[str, Case]:
        return find_cases(runs, sought)

    def draw(name: str, paths: Sequence[Path]) -> None:
        from hatn_sim.report.case_figure import draw_case

        if name not in found():
            raise missing(runs, [KINDS[name]])
        draw_case(found()[name], paths)

    return {name: partial(draw, name) for name in KINDS}
