"""Predict traffic with several predictors, score them on the same samples, and print one table.

Every seed of a scene, and every recording, is a run of its own; all cores work on them. They are
logged in OUT/runs and used again by the same command with the same --out. The reference lines of a
recording are drawn from the tracks of other recordings of --tracks, never from its own; where there
are too few, they are the map's lanes. What chooses among them is fitted to the same recordings, if
that is better on those held out, and used by all predictors; the table says so. What the weights
alone can do at a new place, --choice-from weights shows.

With --table, something else is put into a table:

`sgn`, `edn`, `intention`, `summary`: the paper's ablations. Every network of the table is trained
on some 20,000 samples of the first scene and judged on all of them, its numbers beside the paper's;
OUT/models keeps what is trained. `--split` names other traffic, such as recordings.

`adaptation`: what online adaptation of `hatn-paper` and `hatn` changes, over the steps looked back,
by layer and by method, beside what the paper says of its figures.

`sota`: the paper's comparison with other methods beside the predictors that there are here.

`runtime`: how long each network takes for 1, 10, 50 and 100 agents.

`density`: how many vehicles interact with an ego, chosen as all of the scene, those within 30 m,
those within 10 m, or those whose reference lines conflict with the ego's.

`lines`: how often the inferred reference line is the simulator's route.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.options import (
    add_choice_from,
    add_lines,
    add_lines_from,
    add_networks,
    add_tracks,
    add_traffic,
    names,
    seconds,
    seconds_or_none,
    seeds,
    whole_number,
)

if TYPE_CHECKING:
    from hatn_sim.config import Scenario

EXAMPLES = """examples:
  hatn-sim evaluate --scenes intersection5,roundabout8 --seeds 601-605
  hatn-sim evaluate --tracks 'site/vehicle_tracks_*.csv' --map site.osm --recordings 017-021
  hatn-sim evaluate --table intention --out ablations
  hatn-sim evaluate --table edn --split site.toml --out ablations-of-site
  hatn-sim evaluate --table adaptation --scenes intersection5,roundabout8 --out adaptation
  hatn-sim evaluate --table density
  hatn-sim evaluate --table density --scenes intersection5,my/town.sumocfg --seeds 1-5 --out town
  hatn-sim evaluate --table density --tracks 'site/vehicle_tracks_*.csv' --map site.osm
"""
ABLATIONS: Final = ("sgn", "edn", "intention", "summary")
MODULES: Final = {
    **dict.fromkeys(ABLATIONS, "evaluate_ablations"),
    "adaptation": "evaluate_adaptation",
    "sota": "evaluate_sota",
    "runtime": "evaluate_runtime",
    "density": "evaluate_density",
    "lines": "evaluate_lines",
}
"""Table -> its module, beside this one."""
TRAFFIC: Final = {
    "scenes": (),
    "seeds": None,
    "duration": None,
    "warm_up": None,
    "tracks": None,
    "map": None,
    "recordings": None,
}
PREDICTED: Final = {
    "predictors": None,
    "weights": None,
    "adapt": "none",
    "lines": "inferred",
    "lines_from": "auto",
    "choice_from": "auto",
    "density": None,
    "risk": None,
    "workers": None,
}
TRAINED: Final = {"split": None, "epochs": None, "torch_seed": 0, "cache": None, "rows": None}
"""Options -> what they are when they are not given."""
USED_BY: Final = {
    **{table: {*TRAINED, "scenes", "seeds", "duration", "workers"} for table in ABLATIONS},
    "adaptation": {
        *("scenes", "seeds", "duration", "tracks", "map", "recordings"),
        *("predictors", "weights", "workers"),
    },
    "sota": {*TRAFFIC, *PREDICTED, "cache"},
    "runtime": {"scenes", "seeds", "weights"},
    "density": {*TRAFFIC},
    "lines": {*TRAFFIC},
}
"""Table -> the options that it knows."""
OF_TRACKS: Final = ("tracks", "map", "recordings")
INSTEAD: Final = "name recordings in a file: --split FILE.toml"
DURATION_S: Final = 120.0
HELD_OUT: Final = (601, 602, 603, 604, 605)
"""Seeds that the networks that ship have never seen; five of them make intervals over seeds."""
PREDICTORS: Final = ("hatn", "constant_velocity", "idm")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim evaluate`."""
    parser.add_argument(
        "--table", choices=tuple(MODULES), help="what to print instead of the errors of predictors"
    )
    parser.add_argument(
        "--scenes",
        type=names,
        default=(),
        metavar="A,B",
        help="names of scenes, or .sumocfg files (default: all shipped but those to learn on)",
    )
    parser.add_argument(
        "--seeds",
        type=seeds,
        metavar="A-B",
        help="of the traffic (default: 601-605, that no weights that ship were trained on; of "
        "--table density, lines and runtime: 1)",
    )
    parser.add_argument(
        "--predictors",
        type=names,
        metavar="A,B",
        help=f"to compare (default: {','.join(PREDICTORS)}; your own as module:Class)",
    )
    add_networks(parser)
    add_lines(parser)
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
    add_traffic(parser)
    add_tracks(parser, "as a further scene")
    add_lines_from(parser, "auto")
    add_choice_from(parser, "auto")
    parser.add_argument(
        "--rows",
        type=Path,
        metavar="FILE",
        help="of the ablations' tables: print what an earlier one wrote, TABLE-rows.json, and "
        "train nothing",
    )
    parser.add_argument(
        "--split",
        type=Path,
        metavar="FILE.toml",
        help="of the ablations' tables: what to learn from, tune on and judge on, see `train`",
    )
    parser.add_argument(
        "--epochs",
        type=whole_number,
        metavar="N",
        help="of each network of an ablation, at most (default: 20)",
    )
    parser.add_argument(
        "--torch-seed",
        type=int,
        default=0,
        metavar="N",
        help="of the networks of an ablation: another one tells how much chance is in it",
    )
    parser.add_argument(
        "--cache",
        metavar="FOLDER|none",
        help="where samples for the ablations, lines drawn from tracks and choices among them are "
        "kept (default: the system's)",
    )
    parser.add_argument(
        "--workers",
        type=whole_number,
        metavar="N",
        help="runs made, or networks trained, at once (default: as many as there are cores)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="where figure and numbers go (default: the first free runs/evaluate-N, "
        "runs/TABLE-N); runs that are there already are not made again",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--quiet", action="store_true", help="no progress, no notices")


def main(arguments: argparse.Namespace) -> int:
    """Hand over to the table's module."""
    from hatn_sim.errors import InputError
    from hatn_sim.resources import scenes_to_test_on

    table: str | None = arguments.table
    _check_used(arguments)
    if arguments.tracks is None:
        for option in ("map", "recordings", "lines_from", "choice_from"):
            value = getattr(arguments, option)
            if value != {**TRAFFIC, **PREDICTED}[option]:
                name = option.replace("_", "-")
                raise InputError(f"--{name} {value} goes with --tracks; leave it out")
        if table in (None, "density", "lines"):
            arguments.scenes = arguments.scenes or scenes_to_test_on()
    elif table == "lines":
        raise InputError("--table lines: recorded tracks know no routes; leave --tracks out")
    if table in ("density", "lines"):
        arguments.seeds = arguments.seeds or (1,)
    if table == "lines" and arguments.duration is None:
        arguments.duration = DURATION_S
    module = "evaluate_predictors" if table is None else MODULES[table]
    code: int = import_module(f"hatn_sim.commands.{module}").main(arguments)
    return code


def _check_used(arguments: argparse.Namespace) -> None:
    """InputError for an option that what is to be printed does not know."""
    from hatn_sim.errors import InputError

    table: str | None = arguments.table
    known = {*TRAFFIC, *PREDICTED, "cache"} if table is None else USED_BY[table]
    given = table in ABLATIONS and arguments.rows is not None
    for option, value in {**TRAFFIC, **PREDICTED, **TRAINED}.items():
        if getattr(arguments, option) != value and option not in ({"rows"} if given else known):
            where = "without --table" if table is None else f"to --table {table}"
            where = "with --rows" if given else where
            name = option.replace("_", "-")
            instead = f", or {INSTEAD}" if option in OF_TRACKS and "split" in known else ""
            raise InputError(f"--{name} is of no use {where}; leave it out{instead}")


def chosen_scenarios(arguments: argparse.Namespace) -> dict[str, Scenario]:
    """The scenes by the name they go by: where two have the same, by the words that name them."""
    from hatn_sim.config import load_scenario, load_tracks, recording_names

    named = {
        word: load_scenario(word, arguments.density, arguments.risk) for word in arguments.scenes
    }
    if arguments.tracks is not None:
        wanted = () if arguments.recordings is None else recording_names(arguments.recordings)
        word = " ".join(arguments.tracks)
        named[word] = load_tracks(arguments.tracks, arguments.map, wanted)
    return by_label(named)


def by_label(named: Mapping[str, Scenario]) -> dict[str, Scenario]:
    """Scenes by the name they go by: where two have the same, by the words that name them."""
    uses = Counter(scenario.name for scenario in named.values())
    return {
        scenario.name if uses[scenario.name] == 1 else word: scenario
        for word, scenario in named.items()
    }
