"""Draw figures for papers: of runs, or of what assess, compare and evaluate left behind.

Of a run: moment (the most telling one), spacetime (who is at the conflict when, predicted and
real), traffic (speeds, alerts and what really happened over time), calibration (of slot
probabilities), errors (over the horizon), and the paper's case studies: interaction, sequence,
transfer, sought in all runs that are named. Of a table: its curves, drawn again from the numbers in
its folder; nothing is computed anew. Every figure is written as PDF with its fonts inside, as SVG
and as PNG.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.options import names, seconds_or_none

if TYPE_CHECKING:
    from hatn_sim.log import Run
    from hatn_sim.report.run_figures import Wish

EXAMPLES = """examples:
  hatn-sim figures runs/intersection5-1
  hatn-sim figures runs/intersection5-1 --only calibration,errors --formats pdf
  hatn-sim figures runs/intersection5-1 --only moment,spacetime --time 82.3 --ego car7
  hatn-sim figures runs/intersection5-1 runs/roundabout8-1 --only sequence --out figures
  hatn-sim figures runs/assess-1
"""
FORMATS: Final = ("pdf", "svg", "png")
FOLDER: Final = "figures"

Job = tuple[str, Callable[[Sequence[Path]], None]]
"""The name of a figure, and what draws it into files."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim figures`."""
    parser.add_argument(
        "folders",
        metavar="RUN|TABLE",
        type=Path,
        nargs="+",
        help="the folder of a run, or one that assess, compare or evaluate made",
    )
    parser.add_argument(
        "--only", type=names, metavar="A,B", help="these figures (default: all that there are)"
    )
    parser.add_argument(
        "--time", type=seconds_or_none, metavar="S", help="the moment of moment and spacetime"
    )
    parser.add_argument("--ego", metavar="ID", help="whom moment and spacetime look at")
    parser.add_argument(
        "--formats",
        type=names,
        default=FORMATS,
        metavar="A,B",
        help=f"of {', '.join(FORMATS)} (default: all)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help=f"where figures go (default: {FOLDER}/ in the first folder)",
    )


def main(arguments: argparse.Namespace) -> int:
    """Draw, and say where; what cannot be drawn is said, and is an error if it was named."""
    from hatn_sim.errors import InputError, nearest
    from hatn_sim.report.run_figures import OF_A_MOMENT, Wish

    for suffix in arguments.formats:
        if suffix not in FORMATS:
            raise InputError(f"--formats: unknown format {suffix!r}{nearest(suffix, FORMATS)}")
    wish = Wish(arguments.time, arguments.ego)
    known, jobs = _jobs(arguments.folders, arguments.only, wish)
    for name in arguments.only or ():
        if name not in known:
            raise InputError(f"--only: unknown figure {name!r}{nearest(name, known)}")
    told = [option for option in ("time", "ego") if getattr(arguments, option) is not None]
    if told and not any(name in OF_A_MOMENT for name, _ in jobs):
        names_of = ", ".join(name for name, _ in jobs)
        raise InputError(f"--{told[0]}: without effect on {names_of}; draw moment or spacetime")
    out: Path = arguments.out or arguments.folders[0] / FOLDER
    drawn = 0
    for name, draw in jobs:
        paths = [out / f"{name}.{suffix}" for suffix in arguments.formats]
        try:
            draw(paths)
        except InputError as error:
            if arguments.only:
                raise
            print(f"hatn-sim: {name} is left out: {error}", file=sys.stderr)
            continue
        drawn += 1
        for path in paths:
            print(path)
    if not drawn:
        raise InputError(f"{arguments.folders[0]}: there is nothing to draw")
    return 0


def _jobs(
    folders: Sequence[Path], only: Sequence[str] | None, wish: Wish
) -> tuple[list[str], list[Job]]:
    """The names of all figures there could be, and those to be drawn."""
    from hatn_sim.commands.reading import read_and_tell
    from hatn_sim.errors import InputError
    from hatn_sim.log import Part
    from hatn_sim.log.schema import RUN_FILE
    from hatn_sim.report.table_figures import table_figures

    are_runs = [(folder / RUN_FILE).is_file() for folder in folders]
    if all(are_runs):
        drawn = set(Part) - {Part.SCORES, Part.COUNTERFACTUALS}
        runs = [read_and_tell(folder, drawn) for folder in folders]
        every = _jobs_of_runs(runs, only, wish)
    elif len(folders) > 1:
        raise InputError(
            f"{folders[are_runs.index(False)]}: expected the folder of a run, found none; several "
            "folders can only be runs"
        )
    else:
        every = [(figure.name, figure.draw) for figure in table_figures(folders[0])]
    known = [name for name, _ in every]
    return known, [(name, draw) for name, draw in every if only is None or name in only]


def _jobs_of_runs(runs: Sequence[Run], only: Sequence[str] | None, wish: Wish) -> list[Job]:
    from functools import partial

    from hatn_sim.report.case_files import case_drawers
    from hatn_sim.report.cases import KINDS
    from hatn_sim.report.run_figures import RUN_FIGURES

    sought = [name for name in KINDS if only is None or name in only]
    cases = list(case_drawers(runs, sought).items())
    if len(runs) > 1:  # all else is of one run
        return cases
    of_run = [(name, partial(draw, runs[0], wish)) for name, draw in RUN_FIGURES.items()]
    return [*of_run, *cases]
