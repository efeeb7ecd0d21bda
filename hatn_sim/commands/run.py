"""Simulate a scene with a predictor on every vehicle, at every tenth of a second.

SCENE is the name of a scene that ships (`hatn-sim scenarios`), a scenario.toml, your own .sumocfg,
or the folder of a run, to be replayed. Recorded tracks are given by --tracks and --map instead. A
folder is left behind with tracks, predictions, suggestions, alerts, scores, a picture and a page
that plays the run (report.html); the scores are printed at the end.
"""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from hatn_sim.commands.options import (
    SIMULATORS_OWN,
    add_choice_from,
    add_driving,
    add_lines,
    add_lines_from,
    add_networks,
    add_scene,
    add_traffic,
    chosen_scenario,
    chosen_seed,
    default_warm_up_s,
    milliseconds,
    names,
    rates,
    seconds,
    seconds_or_none,
    with_driving,
)
from hatn_sim.commands.run_names import check_egos, check_recording, check_routes, driven

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Predictor
    from hatn_sim.learn.others_choice import OthersChoice
    from hatn_sim.loop import Driver

EXAMPLES = """examples:
  hatn-sim run intersection5
  hatn-sim run roundabout8 --duration 120 --compare constant_velocity,idm --seed 7
  hatn-sim run my/town.sumocfg --egos bus_12,car_3 --out runs/town
  hatn-sim run --tracks 'site/vehicle_tracks_*.csv' --map site.osm --recordings 000-004
  hatn-sim run --tracks site/vehicle_tracks_000.csv --map site.osm --net site.net.xml --drive 12@8
"""
DURATION_S = 60.0
DELAY_MS = 200.0
"""For a warm-up that does not take a minute, and traffic that the eye can follow."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim run`."""
    add_scene(parser)
    parser.add_argument(
        "--duration",
        type=seconds,
        metavar="S",
        help="seconds to log (default: 60, of recorded tracks: all)",
    )
    parser.add_argument(
        "--warm-up",
        type=seconds_or_none,
        metavar="S",
        help="seconds to let traffic build up before (default: 60 in a shipped scene, 0 in yours "
        "and where vehicles of highway-env are driven)",
    )
    parser.add_argument("--seed", type=int, help="of the traffic (default: 1)")
    parser.add_argument(
        "--predictor",
        default="hatn",
        metavar="NAME",
        help="hatn (default), constant_velocity, idm, or your own as module:Class",
    )
    add_networks(parser)
    parser.add_argument(
        "--compare",
        type=names,
        default=(),
        metavar="A,B",
        help="further predictors to score on the same samples",
    )
    add_lines(parser)
    trained_on = "of weights trained on lines from tracks auto, else"
    add_lines_from(parser, None, f"{trained_on} lanes")
    add_choice_from(parser, None, f"{trained_on} weights")
    parser.add_argument(
        "--egos",
        type=names,
        metavar="A,B",
        help="vehicles that get suggestions and alerts (default: all)",
    )
    parser.add_argument(
        "--assist",
        action="store_true",
        dest="acts_on_advice",
        help="take whoever is advised (--egos, default: all) for one who acts on it: never adapted",
    )
    parser.add_argument(
        "--assist-settings",
        type=Path,
        metavar="FILE.toml",
        help="thresholds of alerts (default: those that ship)",
    )
    parser.add_argument(
        "--counterfactuals",
        type=rates,
        metavar="RATE",
        help="share of alerts and suggestions to be judged by branches of the run, above 0 up to "
        "1; two of them as ALERTS,SUGGESTIONS (default: none)",
    )
    add_traffic(parser)
    add_driving(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="where the log goes; must not exist (default: the first free runs/SCENE-N)",
    )
    parser.add_argument(
        "--gui",
        action="store_true",
        help="watch the run in SUMO's own window, with predictions, slots and alerts drawn over "
        "the traffic; closing it ends the run",
    )
    parser.add_argument(
        "--delay",
        type=milliseconds,
        metavar="MS",
        help="with --gui: milliseconds for each second of the scene, predictions excepted, as on "
        f"the window's own slider (default: {DELAY_MS:g})",
    )
    parser.add_argument(
        "--ego",
        metavar="ID",
        help="with --gui: the vehicle that the window follows (default: none; shown is then whom "
        "you track in the window, else, of those in view, who is warned or has to choose)",
    )
    parser.add_argument("--no-page", action="store_true", help="leave out report.html")
    parser.add_argument(
        "--no-picture", action="store_true", help="leave out the picture and report.html"
    )
    parser.add_argument("--json", action="store_true", help="print the scores as JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress, no notices")


def main(arguments: argparse.Namespace) -> int:
    """Run, score, draw."""
    from hatn_sim.assist.settings import AssistSettings, read_assist_settings
    from hatn_sim.commands.chosen_predictors import load_predictors
    from hatn_sim.commands.folders import free_folder
    from hatn_sim.commands.line_choices import choice_header, drawing_lines
    from hatn_sim.commands.recorded_lines import with_lines_for, with_lines_said
    from hatn_sim.commands.run_header import make_header
    from hatn_sim.commands.run_results import finish
    from hatn_sim.commands.run_simulated import simulate
    from hatn_sim.errors import SimulatorError
    from hatn_sim.evaluation.seen import pieces_of, said_of_seen
    from hatn_sim.log import RunWriter
    from hatn_sim.log.choice_file import write_run_choice
    from hatn_sim.log.road_file import ROAD_FILE, write_road
    from hatn_sim.perception import choose_lines_by
    from hatn_sim.traffic import found_out, open_traffic

    started = time.monotonic()
    _check_assist(arguments)
    _check_window(arguments)
    scenario = with_driving(chosen_scenario(arguments), arguments)
    check_egos(arguments)
    check_routes(arguments, scenario)
    arguments.seed = chosen_seed(arguments, scenario)
    given: Path | None = arguments.assist_settings
    arguments.assist = AssistSettings() if given is None else read_assist_settings(given)
    if arguments.warm_up is None:
        arguments.warm_up = default_warm_up_s(scenario, arguments.drive)
    if arguments.duration is None and scenario.recorded is None:
        arguments.duration = DURATION_S
    out: Path = arguments.out or free_folder(scenario.name)
    _check_out(out)
    wanted = (arguments.predictor, *arguments.compare)
    # Who acts on advice would teach the network what it said (METHOD section 4).
    advised = frozenset(driven(arguments)) | frozenset(arguments.egos or ())
    predictors = load_predictors(
        wanted, arguments.weights, arguments.adapt, arguments.quiet, advised
    )
    drivers = _load_drivers(arguments)
    with drawing_lines(None, arguments.quiet) as drawing:
        scenario, why = with_lines_for(scenario, predictors, arguments, drawing)
    fitted = _fitted_choice(arguments, scenario, predictors)
    choice = None if fitted is None else fitted.choice
    header = make_header(arguments, scenario, predictors, choice_header(fitted))
    scenario = with_lines_said(scenario, choice is not None, why)
    seen = said_of_seen(predictors, pieces_of(scenario, arguments.seed))
    where = ""
    try:
        with closing(open_traffic(scenario, arguments.delay)) as simulator:
            first = simulator.reset(arguments.seed or 0)
            check_recording(arguments, simulator)
            if choice is not None:
                choose_lines_by(simulator.road, choice)
            header["settings"] |= found_out(simulator, first)
            if not arguments.quiet:
                for notice in simulator.notices:
                    print(f"hatn-sim: {notice}", file=sys.stderr)
            with RunWriter(out, header) as writer:
                where = f"; the log up to here is in {out}"
                write_road(out / ROAD_FILE, simulator.road.lanes.values())
                write_run_choice(out, predictors[0], choice)
                done = simulate(arguments, scenario, simulator, first, predictors, drivers, writer)
                timing = {"before_s": done.began - started, "simulated_s": done.seconds}
                writer.close(timing=timing | {"frames": done.frames})
        return finish(arguments, out, done, started, seen)
    except KeyboardInterrupt:
        print(f"hatn-sim: interrupted{where if out.exists() else ''}", file=sys.stderr)
        return 130
    except SimulatorError as error:
        where = where if out.exists() else ""
        raise SimulatorError(f"{error}; repeat with `{header['command']}`{where}") from None


def _check_assist(arguments: argparse.Namespace) -> None:
    from hatn_sim.errors import InputError

    if arguments.acts_on_advice and arguments.egos is None and arguments.adapt != "none":
        raise InputError(
            f"--assist --adapt {arguments.adapt}: everybody is advised, and nobody who is advised "
            "is adapted; name those advised with --egos, or leave out --adapt"
        )


def _check_window(arguments: argparse.Namespace) -> None:
    from hatn_sim.errors import InputError

    if arguments.gui:
        if arguments.counterfactuals is not None:
            raise InputError(
                "--counterfactuals goes with no --gui: a run with a window cannot be branched; "
                "leave one of them out"
            )
        arguments.delay = DELAY_MS if arguments.delay is None else arguments.delay
        return
    for option, value in (("--delay", arguments.delay), ("--ego", arguments.ego)):
        if value is not None:
            raise InputError(f"{option} {value} goes with --gui; add it")


def _check_out(out: Path) -> None:
    from hatn_sim.errors import InputError

    if out.exists():
        raise InputError(f"{out}: exists already; expected a new folder: choose another --out")


def _fitted_choice(
    arguments: argparse.Namespace, scenario: Scenario, predictors: Sequence[Predictor]
) -> OthersChoice | None:
    """The choice of lines of --choice-from; None: each predictor has its own."""
    from hatn_sim.commands.line_choices import choices_for
    from hatn_sim.evaluation.pool import cores

    scenes, asked = {scenario.name: scenario}, arguments.choice_from
    found = choices_for(scenes, predictors, asked, None, cores(), arguments.quiet)
    return found.get(scenario.name)


def _load_drivers(arguments: argparse.Namespace) -> dict[str, Driver]:
    """The drivers of the vehicles of --drive; the simulator's own is none of ours."""
    from hatn_sim.loop import Driver
    from hatn_sim.plugins import load_agent

    agent, wanted = load_agent(arguments.agent), driven(arguments)
    if arguments.agent == SIMULATORS_OWN:
        return {}
    return {name: Driver(agent, from_s) for name, from_s in wanted.items()}
