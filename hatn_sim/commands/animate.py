"""Make a film of a stretch of a run: MP4 (1920 x 1080), or GIF (720 wide).

With --ego the camera follows that vehicle; else it stands over the most telling choice of an ego
between --from and --to. MP4 takes the extra `video`; no ffmpeg of the system is asked for.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.options import seconds_or_none

if TYPE_CHECKING:
    from hatn_sim.log import Run
    from hatn_sim.report.animation import Stretch

EXAMPLES = """examples:
  hatn-sim animate runs/intersection5-1
  hatn-sim animate runs/intersection5-1 --from 70 --to 90 --out talk.mp4
  hatn-sim animate runs/intersection5-1 --ego car7 --speed 0.5 --out car7.gif
"""
FILE: Final = "film.mp4"
SPEEDS: Final = (0.1, 5.0)


def _speed(text: str) -> float:
    low, high = SPEEDS
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"expected {low:g} to {high:g}, found {text!r}")
    return value


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim animate`."""
    parser.add_argument("run", metavar="RUN", type=Path, help="the folder of a run")
    parser.add_argument(
        "--from",
        dest="first",
        type=seconds_or_none,
        metavar="S",
        help="time of the simulation where it begins (default: with --to the run's first; else "
        "8 s around the most telling moment)",
    )
    parser.add_argument(
        "--to",
        dest="last",
        type=seconds_or_none,
        metavar="S",
        help="time where it ends (default: with --from the run's last)",
    )
    parser.add_argument("--ego", metavar="ID", help="the vehicle to advise and follow")
    parser.add_argument(
        "--speed", type=_speed, default=1.0, metavar="X", help="times real time (default: 1)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help=f".mp4 or .gif (default: RUN/{FILE})"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")


def main(arguments: argparse.Namespace) -> int:
    """Draw and say where."""
    from time import perf_counter

    from hatn_sim.commands.bar import open_bar
    from hatn_sim.commands.reading import read_and_tell
    from hatn_sim.errors import HatnSimError
    from hatn_sim.log import Part
    from hatn_sim.report.animation import draw_animation
    from hatn_sim.report.film_file import check_film_file

    out: Path = arguments.out or arguments.run / FILE
    check_film_file(out)
    run = read_and_tell(arguments.run, set(Part) - {Part.SCORES, Part.COUNTERFACTUALS, Part.EVENTS})
    stretch = _stretch(run, arguments)
    count = len(stretch.frames)
    bar = open_bar(arguments.quiet, "{task.completed} of {task.total} frames")
    task = bar.add_task(out.name, total=count) if bar else None

    def tell(done: int) -> None:
        if bar:
            bar.update(task, completed=done)

    began = perf_counter()
    try:
        draw_animation(run, stretch, out, tell)
    except OSError as error:
        raise HatnSimError(
            f"{out}: cannot be written ({error.strerror or error}); make room or choose another "
            "--out"
        ) from error
    finally:
        if bar:
            bar.stop()
    print(out)
    if not arguments.quiet:
        took_s = perf_counter() - began
        print(f"{count} frames of vehicle {stretch.ego_id}, {count / took_s:.1f} drawn a second")
    return 0


def _stretch(run: Run, arguments: argparse.Namespace) -> Stretch:
    """What is shown. InputError where there is no such time or vehicle."""
    import numpy as np

    from hatn_sim.errors import InputError, nearest_vehicle
    from hatn_sim.report.animation import Stretch, around
    from hatn_sim.report.choice import choose_moment

    ego_id: str | None = arguments.ego
    if ego_id is not None and ego_id not in run.ids:
        raise InputError(f"{run.path}: no vehicle {ego_id!r}{nearest_vehicle(ego_id, run.ids)}")
    if not run.frame_count:
        raise InputError(f"{run.path}: expected frames, found a run without any")
    follow, speed = ego_id is not None, arguments.speed
    if arguments.first is None and arguments.last is None:
        frame, found = choose_moment(run, ego_id=ego_id)
        near = around(run, frame, found)
        return Stretch(found, near.start, near.stop, follow, speed)
    start_s, end_s = float(run.times_s[0]), float(run.times_s[-1])
    first_s = start_s if arguments.first is None else arguments.first
    last_s = end_s if arguments.last is None else arguments.last
    # Times are told with one decimal.
    if not (start_s - 0.05 <= first_s < last_s <= end_s + 0.05):
        raise InputError(
            f"{run.path}: from {first_s:g} to {last_s:g} s; expected rising times between "
            f"{start_s:.1f} and {end_s:.1f} s"
        )
    start, last = (int(np.abs(run.times_s - at).argmin()) for at in (first_s, last_s))
    if ego_id is None:
        _, ego_id = choose_moment(run, frames=range(start, last + 1))
    return Stretch(ego_id, start, last + 1, follow, speed)
