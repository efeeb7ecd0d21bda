"""Show a run: a page that plays it (report.html), and its most telling moment as a picture.

The page opens from disk, without a network, at the moment of the picture; the seconds around it
are drawn as an animation, too. An unfinished run is shown as far as it is there. Pictures for
papers, the paper's case studies among them, are drawn by `hatn-sim figures`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hatn_sim.commands.options import seconds_or_none
from hatn_sim.errors import InputError

if TYPE_CHECKING:
    from hatn_sim.log import Run

EXAMPLES = """examples:
  hatn-sim report runs/intersection5-1
  hatn-sim report runs/intersection5-1 --time 82.3 --ego car7
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim report`."""
    parser.add_argument("run", metavar="RUN", type=Path, help="the folder of a run")
    parser.add_argument(
        "--time", type=seconds_or_none, metavar="S", help="the moment to draw and to open with"
    )
    parser.add_argument("--ego", metavar="ID", help="the vehicle to follow")
    parser.add_argument("--no-animation", action="store_true", help="only the page and the picture")
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help="where all goes (default: the run's)"
    )


def main(arguments: argparse.Namespace) -> int:
    """Draw and say where."""
    from hatn_sim.commands.reading import read_and_tell

    run = read_and_tell(arguments.run)
    out: Path = arguments.out or arguments.run
    paths = show(run, out, not arguments.no_animation, arguments.time, arguments.ego)
    for path in paths:
        print(path)
    return 0


def show(
    logged: Run,
    out: Path,
    animate: bool,
    time_s: float | None = None,
    ego_id: str | None = None,
) -> list[Path]:
    """Write `report.html`, and `moment.png` and `moment.gif` where there is a moment to draw.

    InputError where a time or an ego is asked for that there is not, or the log is damaged; what
    cannot be drawn leaves nothing behind.
    """
    from hatn_sim.report.choice import choose_moment
    from hatn_sim.report.page.page import PAGE_FILE, page
    from hatn_sim.whole_file import save_whole

    moment: tuple[int, str] | None = None
    try:
        moment = choose_moment(logged, time_s=time_s, ego_id=ego_id)
    except InputError as error:
        if time_s is not None or ego_id is not None:
            raise
        print(f"hatn-sim: no picture: {error}", file=sys.stderr)
    text = page(logged, moment)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made: {error.strerror}; name another") from None
    drawn = draw(logged, out, moment, animate) if moment is not None else []
    save_whole(out / PAGE_FILE, text)
    return [out / PAGE_FILE, *drawn]


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
