"""Show a run: a page that plays it (report.html), and its most telling moment as a picture.

The page opens from disk, without a network, at the moment of the picture; the seconds around it
are drawn as an animation, too. An unfinished run is shown as far as it is there.

With --cases, the paper's three case studies are found in one or more runs instead, and each is
drawn as a figure (PNG and PDF): one interaction, a sequence of interactions, and transfer to a
scene that the networks were not trained on.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.options import names, seconds_or_none
from hatn_sim.errors import InputError, nearest

if TYPE_CHECKING:
    from hatn_sim.log import Run

EXAMPLES = """examples:
  hatn-sim report runs/intersection5-1
  hatn-sim report runs/intersection5-1 --time 82.3 --ego car7
  hatn-sim report runs/intersection5-1 runs/roundabout8-1 --cases --out figures
  hatn-sim report runs/roundabout8-1 --cases sequence,transfer
"""
ALL: Final = ("all",)
SUFFIXES: Final = (".png", ".pdf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim report`."""
    parser.add_argument("runs", metavar="RUN", type=Path, nargs="+", help="the folder of a run")
    parser.add_argument(
        "--time", type=seconds_or_none, metavar="S", help="the moment to draw and to open with"
    )
    parser.add_argument("--ego", metavar="ID", help="the vehicle to follow")
    parser.add_argument("--no-animation", action="store_true", help="only the page and the picture")
    parser.add_argument(
        "--cases",
        type=names,
        nargs="?",
        const=ALL,
        metavar="A,B",
        help="find and draw the paper's case studies in the runs: interaction, sequence, transfer "
        "(default: all that there are)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help="where all goes (default: the first run's)"
    )


def main(arguments: argparse.Namespace) -> int:
    """Draw and say where."""
    from hatn_sim.log import read_run

    _check(arguments)
    runs = [read_run(path) for path in arguments.runs]
    out: Path = arguments.out or arguments.runs[0]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made: {error.strerror}; name another") from None
    if arguments.cases is not None:
        paths = draw_cases(runs, out, arguments.cases)
    else:
        paths = show(runs[0], out, not arguments.no_animation, arguments.time, arguments.ego)
    for path in paths:
        print(path)
    return 0


def _check(arguments: argparse.Namespace) -> None:
    if arguments.cases is None:
        if len(arguments.runs) > 1:
            raise InputError(
                f"{len(arguments.runs)} runs, but a picture is of one; name one, or add --cases"
            )
        return
    for option in ("time", "ego"):
        if getattr(arguments, option) is not None:
            raise InputError(f"--{option}: without effect with --cases, which finds both itself")


def draw_cases(runs: Sequence[Run], out: Path, wanted: Sequence[str]) -> list[Path]:
    """Write `case-NAME.png` and `.pdf` into `out` for the cases wanted.

    InputError where a case named is in none of the runs, or none at all is.
    """
    from hatn_sim.report.cases import KINDS, find_cases, missing

    everything = tuple(wanted) == ALL
    asked = tuple(KINDS) if everything else tuple(wanted)
    for name in asked:
        if name not in KINDS:
            raise InputError(
                f"--cases: expected some of {', '.join(KINDS)}, found {name!r}"
                f"{nearest(name, KINDS)}"
            )
    found = find_cases(runs, asked)
    absent = [KINDS[name] for name in asked if name not in found]
    if absent and not (everything and found):
        raise missing(runs, absent)
    if absent:
        print(f"hatn-sim: {missing(runs, absent)}", file=sys.stderr)
    from hatn_sim.report.case_figure import draw_case

    written: list[Path] = []
    for name in asked:
        if name in found:
            paths = [out / f"case-{name}{suffix}" for suffix in SUFFIXES]
            draw_case(found[name], paths)
            written += paths
    return written


def show(
    logged: Run,
    out: Path,
    animate: bool,
    time_s: float | None = None,
    ego_id: str | None = None,
) -> list[Path]:
    """Write `report.html`, and `moment.png` and `moment.gif` where there is a moment to draw.

    InputError where a time or an ego is asked for that there is not.
    """
    from hatn_sim.report.choice import choose_moment
    from hatn_sim.report.page.page import write_page

    try:
        moment = choose_moment(logged, time_s=time_s, ego_id=ego_id)
    except InputError as error:
        if time_s is not None or ego_id is not None:
            raise
        print(f"hatn-sim: no picture: {error}", file=sys.stderr)
        return [write_page(logged, out)]
    return [write_page(logged, out, moment), *draw(logged, out, moment, animate)]


def draw(logged: Run, out: Path, moment: tuple[int, str], animate: bool) -> list[Path]:
    """Write `moment.png`, and `moment.gif` if it is to be an animation, of (frame, ego)."""
    from hatn_sim.report.animation import around, draw_animation
    from hatn_sim.report.picture import draw_moment

    frame, ego = moment
    paths = [out / "moment.png"]
    draw_moment(logged, frame, ego, [paths[0]])
    if animate:
        paths.append(out / "moment.gif")
        draw_animation(logged, around(logged, frame, ego), paths[1])
    return paths
