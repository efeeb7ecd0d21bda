"""Write a run in a format that other programs read.

interaction: vehicle and pedestrian tracks as CSV files of the INTERACTION data set, and the road as
a Lanelet2 map. fcd: SUMO's floating car data, and the road as hatn-sim keeps it. hatn-sim reads
both. rrd: all that there is to be seen, for Rerun's viewer (extra `viz`).
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hatn_sim.log import Part, Run

EXAMPLES = """examples:
  hatn-sim export runs/intersection5-1 --format fcd
  hatn-sim export runs/intersection5-1 --format interaction --out tracks/intersection5
  hatn-sim export runs/intersection5-1 --format rrd
"""
FORMATS = ("interaction", "fcd", "rrd")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim export`."""
    parser.add_argument("run", metavar="RUN", type=Path, help="the folder of a run")
    parser.add_argument("--format", choices=FORMATS, required=True, help="what to write")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="where to; must not exist (default: RUN/FORMAT)",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def main(arguments: argparse.Namespace) -> int:
    """Export, and say how to read it."""
    from hatn_sim.commands.reading import read_and_tell
    from hatn_sim.errors import InputError
    from hatn_sim.log import Part
    from hatn_sim.log.road_file import ROAD_FILE

    run = read_and_tell(arguments.run, _wanted(arguments.format))
    out: Path = arguments.out or arguments.run / arguments.format
    if not run.frame_count:
        raise InputError(f"{arguments.run}: expected frames, found a run without any")
    if arguments.format == "rrd":
        from hatn_sim.report.rerun_file import rerun_or_error

        rerun_or_error()
    elif Part.ROAD in run.parts_left_out:
        raise InputError(
            f"{arguments.run}: expected the lanes of the run in {ROAD_FILE}, without which "
            f"{arguments.format} cannot be read; make the run again with `hatn-sim run`"
        )
    _make_folder(out)
    try:
        files = _export(run, arguments.format, out)
    except BaseException:
        shutil.rmtree(out, ignore_errors=True)  # it is ours: nothing half made stays
        raise
    for lost in _lost(run) if arguments.format == "interaction" else ():
        print(f"hatn-sim: the INTERACTION format has no place for {lost}", file=sys.stderr)
    command = _reader(files, arguments.format)
    if arguments.json:
        print(json.dumps({"files": [str(path) for path in files], "command": command}, indent=2))
        return 0
    for path in files:
        print(path)
    print(f"to read them: {command}")
    return 0


def _wanted(form: str) -> Collection[Part]:
    """Of what a run may lack, that which goes into a format."""
    from hatn_sim.log import Part

    if form != "rrd":
        return ()  # without its lanes there is nothing to write
    return set(Part) - {Part.SCORES, Part.COUNTERFACTUALS}


def _reader(files: Sequence[Path], wanted: str) -> str:
    """The command that reads what was written."""
    if wanted == "rrd":
        return shlex.join(["rerun", str(files[0])])
    return shlex.join(["hatn-sim", "run", "--tracks", str(files[0]), "--map", str(files[-1])])


def _lost(run: Run) -> list[str]:
    """What of a run the INTERACTION format and its maps cannot say."""
    from hatn_sim.datatypes import Gate
    from hatn_sim.geometry import arc_length_m
    from hatn_sim.recordings.lanelet2.writer import SHORTEST_M

    lanes = run.lanes
    short = sum(bool(arc_length_m(lane.xy_m)[-1] < SHORTEST_M) for lane in lanes)
    found = {
        "blinkers": bool(run.tracks.blinker.any()),
        "the states of signals": any(lane.gate is Gate.SIGNAL for lane in lanes),
        f"lanes shorter than {SHORTEST_M:g} m: {short} are bridged": short > 0,
    }
    return [what for what, there in found.items() if there]


def _export(run: Run, wanted: str, out: Path) -> tuple[Path, ...]:
    """The files written: the tracks first, the road last."""
    from hatn_sim.errors import HatnSimError

    try:
        if wanted == "fcd":
            from hatn_sim.recordings.fcd.export import export_fcd

            return export_fcd(run, out)
        if wanted == "rrd":
            from hatn_sim.report.rerun_file import RRD_FILE, write_rrd

            write_rrd(run, out / RRD_FILE)
            return (out / RRD_FILE,)
        from hatn_sim.recordings.interaction.export import export_interaction

        return export_interaction(run, out)
    except OSError as error:
        raise HatnSimError(
            f"{out}: cannot be written on ({error.strerror or error}); make room or choose "
            "another --out"
        ) from error


def _make_folder(out: Path) -> None:
    from hatn_sim.errors import InputError

    try:
        out.mkdir(parents=True)
    except FileExistsError:
        raise InputError(
            f"{out}: exists already; expected a new folder: choose another --out"
        ) from None
    except OSError as error:
        raise InputError(
            f"{out}: the folder cannot be made ({error.strerror}); choose another --out"
        ) from error
