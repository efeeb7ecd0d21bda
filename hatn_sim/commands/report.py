"""Draw the most telling moment of a run as a picture, and the seconds around it as an animation."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from hatn_sim.commands.options import seconds_or_none

if TYPE_CHECKING:
    from hatn_sim.log import Run

EXAMPLES = """examples:
  hatn-sim report runs/intersection5-1
  hatn-sim report runs/intersection5-1 --time 82.3 --ego car7
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim report`."""
    parser.add_argument("run", metavar="RUN", type=Path, help="the folder of a run")
    parser.add_argument("--time", type=seconds_or_none, metavar="S", help="the moment to draw")
    parser.add_argument("--ego", metavar="ID", help="the vehicle to follow")
    parser.add_argument("--no-animation", action="store_true", help="only the picture")


def main(arguments: argparse.Namespace) -> int:
    """Draw and say where."""
    from hatn_sim.log import read_run

    logged = read_run(arguments.run)
    for path in draw(
        logged,
        arguments.run,
        animate=not arguments.no_animation,
        time_s=arguments.time,
        ego_id=arguments.ego,
    ):
        print(path)
    return 0


def draw(
    logged: Run,
    out: Path,
    animate: bool,
    time_s: float | None = None,
    ego_id: str | None = None,
) -> list[Path]:
    """Write `moment.png` and `moment.gif` into `out`; InputError where there is nothing to draw."""
    from hatn_sim.report.animation import draw_animation
    from hatn_sim.report.picture import choose_moment, draw_moment

    frame, ego = choose_moment(logged, time_s=time_s, ego_id=ego_id)
    paths = [out / "moment.png"]
    draw_moment(logged, frame, ego, paths[0])
    if animate:
        paths.append(out / "moment.gif")
        draw_animation(logged, frame, ego, paths[1])
    return paths
