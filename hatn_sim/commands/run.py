"""Simulate a scene with a predictor on every vehicle, at every tenth of a second.

SCENE is the name of a scene that ships (`hatn-sim scenarios`), a scenario.toml, or your own
.sumocfg. A folder is left behind with the tracks, the predictions, suggestions, alerts, scores, a
picture and an animation; the scores are printed at the end.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hatn_sim.commands.options import add_traffic, names, seconds, seconds_or_none

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Advice, Frame, Predictor, Score
    from hatn_sim.log import RunWriter

EXAMPLES = """examples:
  hatn-sim run intersection5
  hatn-sim run roundabout8 --duration 120 --compare constant_velocity,idm --seed 7
  hatn-sim run my/town.sumocfg --egos bus_12,car_3 --out runs/town
"""
WARM_UP_S = 60.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim run`."""
    parser.add_argument("scene", metavar="SCENE", help="a scene's name, or a .sumocfg")
    parser.add_argument(
        "--duration", type=seconds, default=60.0, metavar="S", help="seconds to log (default: 60)"
    )
    parser.add_argument(
        "--warm-up",
        type=seconds_or_none,
        metavar="S",
        help="seconds to let traffic build up before (default: 60 in a shipped scene, 0 in yours)",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the traffic (default: 1)")
    parser.add_argument(
        "--predictor",
        default="hatn",
        metavar="NAME",
        help="hatn (default), constant_velocity, idm, or your own as module:Class",
    )
    parser.add_argument(
        "--weights", type=Path, metavar="FILE", help="weights of hatn (default: those that ship)"
    )
    parser.add_argument(
        "--compare",
        type=names,
        default=(),
        metavar="A,B",
        help="further predictors to score on the same samples",
    )
    parser.add_argument(
        "--lines",
        choices=("inferred", "route"),
        default="inferred",
        help="reference lines from motion (default), or from the simulator's routes, which no "
        "camera can see: an upper bound",
    )
    parser.add_argument(
        "--egos",
        type=names,
        metavar="A,B",
        help="vehicles that get suggestions and alerts (default: all)",
    )
    add_traffic(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="where the log goes; must not exist (default: the first free runs/SCENE-N)",
    )
    parser.add_argument("--no-picture", action="store_true", help="leave out the pictures")
    parser.add_argument("--json", action="store_true", help="print the scores as JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress, no notices")


def main(arguments: argparse.Namespace) -> int:
    """Run, score, draw."""
    from hatn_sim.config import load_scenario
    from hatn_sim.errors import SimulatorError
    from hatn_sim.log import RunWriter
    from hatn_sim.predictors.find import load_predictor
    from hatn_sim.simulators.sumo import SumoSimulator

    scenario = load_scenario(arguments.scene, arguments.density, arguments.risk)
    wanted = dict.fromkeys((arguments.predictor, *arguments.compare))
    predictors = [load_predictor(name, arguments.weights) for name in wanted]
    if arguments.warm_up is None:
        arguments.warm_up = 0.0 if scenario.is_user_config else WARM_UP_S
    out: Path = arguments.out or _free_folder(scenario.name)
    _check_out(out)
    started = time.monotonic()
    with SumoSimulator(scenario) as simulator:
        first = simulator.reset(arguments.seed)
        header = make_header(arguments, scenario, predictors)
        if not arguments.quiet:
            for notice in simulator.notices:
                print(f"hatn-sim: {notice}", file=sys.stderr)
        from hatn_sim.log.road_file import write_road

        with RunWriter(out, header) as writer:
            try:
                frames = _simulate(arguments, simulator, first, predictors, writer)
                write_road(out, simulator.lanes)
            except KeyboardInterrupt:
                writer.close(finished=False)
                print(f"hatn-sim: interrupted; the log up to here is in {out}", file=sys.stderr)
                return 130
            except SimulatorError as error:
                writer.close(finished=False)
                raise SimulatorError(
                    f"{error}; repeat with `{header['command']}`; the log up to there is in {out}"
                ) from None
    return _finish(arguments, out, frames, started)


def _check_out(out: Path) -> None:
    from hatn_sim.errors import InputError

    if out.exists():
        raise InputError(f"{out}: exists already; expected a new folder: choose another --out")


def _simulate(
    arguments: argparse.Namespace,
    simulator: Any,
    first: Frame,
    predictors: Sequence[Predictor],
    writer: RunWriter,
) -> int:
    from hatn_sim.commands.progress import Progress
    from hatn_sim.loop import Adviser, run

    egos = None if arguments.egos is None else frozenset(arguments.egos)
    advisers = [Adviser(predictor, arguments.lines, egos) for predictor in predictors]
    warm_up = round(arguments.warm_up / simulator.dt_s)
    total = round(arguments.duration / simulator.dt_s)
    with Progress(arguments.scene, total, simulator.dt_s, arguments.quiet) as progress:

        def write(index: int, frame: Frame, advice: Mapping[str, Advice]) -> None:
            writer.write(index, frame, advice)
            progress.show(index + 1, len(frame.scene.ids))

        return run(simulator, advisers, first, warm_up, total, write)


def _finish(arguments: argparse.Namespace, out: Path, frames: int, started: float) -> int:
    from hatn_sim.log import read_run
    from hatn_sim.report.table import score_table, scores_json, write_scores
    from hatn_sim.score.prediction import clustered_over, score_run

    logged = read_run(out)
    scores: list[Score] = score_run(logged)
    write_scores(out, scores)
    seconds_taken = time.monotonic() - started
    simulated_s = frames * 0.1 + arguments.warm_up
    pictures = [] if arguments.no_picture else _draw(logged, out, arguments.quiet)
    if arguments.json:
        print(scores_json(scores))
        return 0
    from rich.console import Console

    console = Console(highlight=False)
    console.print(score_table(scores, clustered_over([logged])))
    print(
        f"{frames} steps of 0.1 s after {arguments.warm_up:g} s of warm-up, "
        f"{len(logged.ids)} vehicles, in {seconds_taken:.1f} s: "
        f"{simulated_s * 10 / seconds_taken:.0f} steps per second, "
        f"{simulated_s / seconds_taken:.1f} times real time, log and scores included"
    )
    print(f"log, scores and pictures in {out}" if pictures else f"log and scores in {out}")
    return 0


def _draw(logged: Any, out: Path, quiet: bool) -> list[Path]:
    from hatn_sim.commands.report import draw
    from hatn_sim.errors import InputError

    try:
        return draw(logged, out, animate=True)
    except InputError as error:
        if not quiet:
            print(f"hatn-sim: no picture: {error}", file=sys.stderr)
        return []


def make_header(
    arguments: argparse.Namespace, scenario: Scenario, predictors: Sequence[Predictor]
) -> dict[str, Any]:
    """What `run.json` says of how the run was made, without paths of this machine's folders."""
    from hatn_sim.commands.versions import installed

    weights = {
        predictor.name: predictor.weights.sha256  # type: ignore[attr-defined]
        for predictor in predictors
        if hasattr(predictor, "weights")
    }
    return {
        "scene": scenario.name,
        "seed": arguments.seed,
        "adapt": "none",
        "settings": {
            "duration_s": arguments.duration,
            "warm_up_s": arguments.warm_up,
            "predictor": predictors[0].name,
            "compare": [predictor.name for predictor in predictors[1:]],
            "lines": arguments.lines,
            "egos": None if arguments.egos is None else list(arguments.egos),
            "density": scenario.density,
            "risk": scenario.risk,
        },
        "versions": installed(),
        "weights_sha256": weights,
        "command": _command(arguments, scenario),
    }


def _command(arguments: argparse.Namespace, scenario: Scenario) -> str:
    words = ["hatn-sim", "run", arguments.scene, "--seed", str(arguments.seed)]
    words += ["--duration", f"{arguments.duration:g}", "--warm-up", f"{arguments.warm_up:g}"]
    words += ["--predictor", arguments.predictor, "--lines", arguments.lines]
    if arguments.weights is not None:
        words += ["--weights", str(arguments.weights)]
    if arguments.compare:
        words += ["--compare", ",".join(arguments.compare)]
    if arguments.egos is not None:
        words += ["--egos", ",".join(arguments.egos)]
    if scenario.density is not None:
        words += ["--density", scenario.density]
    if scenario.risk is not None:
        words += ["--risk", scenario.risk]
    return " ".join(words)


def _free_folder(name: str) -> Path:
    number = 1
    while (folder := Path("runs") / f"{name}-{number}").exists():
        number += 1
    return folder
