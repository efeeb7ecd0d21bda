"""Evaluate scenes in a table and a figure, each simulated anew for every seed.

`density`: how many vehicles interact with an ego, chosen as all of the scene, those within 30 m,
those within 10 m, or those whose reference lines conflict with the ego's.

`lines`: how often the inferred reference line is the simulator's route.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.options import add_tracks, names, seconds, seconds_or_none, seeds

if TYPE_CHECKING:
    from hatn_sim.config import Scenario

EXAMPLES = """examples:
  hatn-sim evaluate --table density
  hatn-sim evaluate --table density --scenes intersection5,my/town.sumocfg --seeds 1-5 --out town
  hatn-sim evaluate --table density --tracks 'site/vehicle_tracks_*.csv' --map site.osm
"""
TABLES: Final = ("density", "lines")
"""Each in a module `evaluate_TABLE` beside this one."""
DURATION_S: Final = 120.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim evaluate`."""
    parser.add_argument("--table", choices=TABLES, required=True, help="what to evaluate")
    parser.add_argument(
        "--scenes",
        type=names,
        default=(),
        metavar="A,B",
        help="names of scenes, or .sumocfg files (default: all that ship)",
    )
    parser.add_argument(
        "--seeds", type=seeds, default=(1,), metavar="A-B", help="of the traffic (default: 1)"
    )
    parser.add_argument(
        "--duration",
        type=seconds,
        metavar="S",
        help="seconds to look at for each seed (default: 120, of recorded tracks: all)",
    )
    parser.add_argument(
        "--warm-up",
        type=seconds_or_none,
        metavar="S",
        help="seconds to let traffic build up before (default: 60 in a shipped scene, 0 in yours)",
    )
    add_tracks(parser, "as a further scene")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="where figure and histograms go (default: the first free runs/TABLE-N)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--quiet", action="store_true", help="no progress, no notices")


def main(arguments: argparse.Namespace) -> int:
    """Find the scenes and hand over to the table's module."""
    from hatn_sim.errors import InputError
    from hatn_sim.resources import find_scenarios

    if arguments.tracks is None:
        for option, value in (("--map", arguments.map), ("--recordings", arguments.recordings)):
            if value is not None:
                raise InputError(f"{option} {value} goes with --tracks; leave it out")
        arguments.scenes = arguments.scenes or tuple(find_scenarios())
    elif arguments.table == "lines":
        raise InputError("--table lines: recorded tracks know no routes; leave --tracks out")
    if arguments.table == "lines" and arguments.duration is None:
        arguments.duration = DURATION_S
    code: int = import_module(f"hatn_sim.commands.evaluate_{arguments.table}").main(arguments)
    return code


def by_label(named: Mapping[str, Scenario]) -> dict[str, Scenario]:
    """Scenes by the name they go by: where two have the same, by the words that name them."""
    uses = Counter(scenario.name for scenario in named.values())
    return {
        scenario.name if uses[scenario.name] == 1 else word: scenario
        for word, scenario in named.items()
    }


def chosen_folder(arguments: argparse.Namespace, files: Sequence[str]) -> Path:
    """Where the table's files go, none of which may be there; not made yet. Raises InputError."""
    from hatn_sim.errors import InputError

    out: Path | None = arguments.out
    number = 1
    while out is None:
        folder = Path("runs") / f"{arguments.table}-{number}"
        out = None if folder.exists() else folder
        number += 1
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: expected a folder, found a file; choose another --out")
    for name in files:
        if (out / name).exists():
            raise InputError(f"{out / name}: exists already; move it away or choose another --out")
    return out
