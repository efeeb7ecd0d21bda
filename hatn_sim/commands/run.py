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
from dataclasses import dataclass
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

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hatn_sim.assist.settings import AssistSettings
    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Advice, Frame, Predictor, Simulator
    from hatn_sim.learn.others_choice import OthersChoice
    from hatn_sim.log import RunWriter
    from hatn_sim.loop import Driver
    from hatn_sim.report.window import Window
    from hatn_sim.score.what_if import WhatIf
    from hatn_sim.simulators.sumo_replay.figures import Divergence, Fidelity

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
NOBODY_DRIVEN = 2
"""Exit status of a run in which none of the vehicles of --drive was there."""


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
        help="with --gui: the vehicle that the window follows (default: none; shown is then who "
        "has to choose, or whom you track in the window)",
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
    advised = frozenset(_driven(arguments)) | frozenset(arguments.egos or ())
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
            if choice is not None:
                choose_lines_by(simulator.road, choice)
            header["settings"] |= found_out(simulator)
            if not arguments.quiet:
                for notice in simulator.notices:
                    print(f"hatn-sim: {notice}", file=sys.stderr)
            with RunWriter(out, header) as writer:
                where = f"; the log up to here is in {out}"
                write_road(out / ROAD_FILE, simulator.road.lanes.values())
                write_run_choice(out, predictors[0], choice)
                done = _simulate(arguments, simulator, first, predictors, drivers, writer)
                timing = {"before_s": done.began - started, "simulated_s": done.seconds}
                writer.close(timing=timing | {"frames": done.frames})
        return _finish(arguments, out, done, started, seen)
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

    agent, driven = load_agent(arguments.agent), _driven(arguments)
    if arguments.agent == SIMULATORS_OWN:
        return {}
    return {name: Driver(agent, from_s) for name, from_s in driven.items()}


def _driven(arguments: argparse.Namespace) -> dict[str, float | None]:
    """The vehicles of --drive, and from when on."""
    from hatn_sim.simulators.sumo_replay.simulator import parse_take_over

    return parse_take_over(arguments.drive or "")


@dataclass(frozen=True)
class Simulated:
    """A run that has been simulated and logged."""

    frames: int
    began: float  # time.monotonic() after the warm-up
    seconds: float  # from then on, of the wall clock
    replay: tuple[Fidelity, Divergence] | None  # of tracks replayed inside SUMO


def _simulate(
    arguments: argparse.Namespace,
    simulator: Simulator,
    frame: Frame,
    predictors: Sequence[Predictor],
    drivers: Mapping[str, Driver],
    writer: RunWriter,
) -> Simulated:
    from hatn_sim.commands.progress import Progress
    from hatn_sim.errors import WindowClosedError
    from hatn_sim.loop import Adviser, run, warm_up
    from hatn_sim.simulators.sumo_replay.simulator import SumoReplay

    egos = None if arguments.egos is None else frozenset(arguments.egos)
    settings: AssistSettings = arguments.assist
    advisers = [Adviser(predictor, arguments.lines, egos, settings) for predictor in predictors]
    frame = warm_up(simulator, frame, round(arguments.warm_up / simulator.dt_s))
    duration_s: float | None = arguments.duration
    total = None if duration_s is None else max(1, round(duration_s / simulator.dt_s))
    began = time.monotonic()
    what_if, main = _what_if(arguments, simulator), predictors[0].name
    window, frames = _window(arguments, simulator), 0
    with Progress(simulator.name, total, simulator.dt_s, arguments.quiet) as progress:

        def write(index: int, frame: Frame, advice: Mapping[str, Advice]) -> None:
            writer.write(index, frame, advice)
            if what_if is not None:
                writer.write_counterfactuals(what_if.see(index, frame, advice[main]))
            progress.show(index + 1, len(frame.scene.ids))
            nonlocal frames
            frames = index + 1
            if window is not None:
                window.show(frame.scene, advice[main])

        try:
            run(simulator, advisers, frame, total or sys.maxsize, write, drivers)
        except WindowClosedError as error:
            print(f"hatn-sim: {error}: the run ends here", file=sys.stderr)
            total = None
        if what_if is not None:
            writer.write_counterfactuals(what_if.finish())
    seconds = time.monotonic() - began
    if total is not None and frames < total and not arguments.quiet:
        print(f"hatn-sim: the scene was over after {frames} of {total} steps", file=sys.stderr)
    replay = None
    if isinstance(simulator, SumoReplay):
        replay = simulator.fidelity, simulator.divergence
    return Simulated(frames, began, seconds, replay)


def _window(arguments: argparse.Namespace, simulator: Simulator) -> Window | None:
    """SUMO's window, if the run is to be watched in it."""
    if not arguments.gui:
        return None
    from hatn_sim.report.window import Window
    from hatn_sim.simulators.sumo import SumoSimulator

    assert isinstance(simulator, SumoSimulator)
    return Window(simulator, frozenset(arguments.egos or ()), arguments.ego)


def _what_if(arguments: argparse.Namespace, simulator: Simulator) -> WhatIf | None:
    """What judges a sample of the advice; None where none is wanted, or nothing can be branched."""
    from hatn_sim.score.counterfactual import CounterfactualSettings
    from hatn_sim.score.what_if import WhatIf

    if arguments.counterfactuals is None:
        return None
    if simulator.cannot_branch is not None:
        print(f"hatn-sim: run without counterfactuals: {simulator.cannot_branch}", file=sys.stderr)
        return None
    settings = CounterfactualSettings()
    return WhatIf(simulator, arguments.counterfactuals, arguments.seed or 0, settings)


def _finish(
    arguments: argparse.Namespace,
    out: Path,
    done: Simulated,
    started: float,
    learnt: Mapping[tuple[str, str], str],
) -> int:
    from hatn_sim.commands.console import make_console
    from hatn_sim.commands.run_results import (
        rates,
        show_run,
        tell_counterfactuals,
        tell_everyday_braking,
        write_replay,
    )
    from hatn_sim.datatypes import DT_S, Kind
    from hatn_sim.evaluation.seen import with_seen
    from hatn_sim.log import read_run
    from hatn_sim.report.table import score_table, scores_json, write_scores
    from hatn_sim.score.prediction import score_run
    from hatn_sim.score.samples import clustered_over

    scoring = time.monotonic()
    logged = read_run(out)
    scores = with_seen(score_run(logged), learnt)
    write_scores(out, scores)
    taken_s = done.seconds + time.monotonic() - scoring
    shown: list[Path] = []
    if not arguments.no_picture:
        shown = show_run(logged, out, arguments.quiet, not arguments.no_page)
    driven = _driven(arguments)
    for option, wanted in (("--egos", arguments.egos or ()), ("--drive", driven)):
        never = [name for name in wanted if name not in logged.ids]
        if never:
            print(f"hatn-sim: never seen in this run: {option} {','.join(never)}", file=sys.stderr)
    # Who asked for a driven vehicle, and had none, has another run than he asked for.
    drove = 0 if not driven or any(name in logged.ids for name in driven) else NOBODY_DRIVEN
    if arguments.acts_on_advice and not arguments.quiet:
        tell_everyday_braking(logged)
    replayed = write_replay(logged, out, done.replay)
    if arguments.json:
        print(scores_json([*scores, *replayed, *rates(logged, done.frames, taken_s)]))
        return drove
    make_console().print(score_table(scores, clustered_over([logged])))
    if done.replay is not None:
        from hatn_sim.report.replay_table import replay_table

        make_console().print(replay_table(str(logged.header["scene"]), *done.replay))
    walking = int((logged.kinds == Kind.PEDESTRIAN).sum())
    seen = f"{len(logged.ids) - walking} vehicles"
    seen += f" and {walking} pedestrians" if walking else ""
    print(
        f"{done.frames} steps of {DT_S:g} s, {seen}, in {taken_s:.1f} s, "
        f"log and scores included: {done.frames / taken_s:.0f} steps per second, "
        f"{DT_S * done.frames / taken_s:.1f} times real time"
    )
    tell_counterfactuals(logged)
    before_s = done.began - started
    print(f"before that {before_s:.1f} s to start and for {arguments.warm_up:g} s of warm-up")
    for path in shown:
        print(f"to look at: {path}")
    print(f"log and scores in {out}")
    return drove
