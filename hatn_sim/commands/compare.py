"""Drive the same vehicles by one agent with several predictors, and see which drives best.

For every seed of every scene the simulator's own drivers drive first: that run is the reference.
In it the vehicles to be driven are drawn by lot, among those who come while it is watched, cross,
and pass within 3 s of somebody else; and in it the errors of all predictors are measured, open
loop. Then --agent drives each of these vehicles, one at a time, once with each predictor. Until it
comes on the road each of these runs is the reference to the last bit: all differences are paired.

An agent that reads no predictions, such as idm, drives the same with each of --predictors: it
drives once, and a line says so. One of them is enough to compare such an agent with `sumo_driver`.

The first of --predictors is the baseline. `oracle` is told the future, by a branch of the very
simulation in which the vehicle goes on at its speed. The row `sumo_driver` is the simulator's own
driver, who knows what the others will do.

Finished drives stay in OUT/driven; the same command with the same --out goes on where it was
stopped, and takes in more seeds and predictors. What a measure is, `score/closed_loop.py` says.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hatn_sim.commands.options import (
    add_traffic,
    names,
    seconds,
    seconds_or_none,
    seeds,
    whole_number,
)

if TYPE_CHECKING:
    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Predictor, Score
    from hatn_sim.evaluation.closed_loop import SeedPlan
    from hatn_sim.score.closed_loop_rows import DrivenRow

EXAMPLES = """examples:
  hatn-sim compare --agent mpc --predictors constant_velocity,hatn --scenes intersection5
  hatn-sim compare --predictors constant_velocity,idm,hatn,oracle --seeds 701-800 --out closed-loop
"""
HELD_OUT: Final = tuple(range(701, 721))
PREDICTORS: Final = ("constant_velocity", "hatn")
AGENT: Final = "mpc"
DURATION_S: Final = 60.0
LIMIT_S: Final = 60.0
RUNS_FOLDER: Final = "driven"
FIGURES: Final = ("closed_loop.png", "closed_loop.pdf")
MOST_KILLS: Final = 2
"""Seeds whose process was killed as often are given up."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim compare`."""
    parser.add_argument(
        "--agent",
        default=AGENT,
        metavar="NAME",
        help=f"who drives (default: {AGENT}; your own as module:Class)",
    )
    parser.add_argument(
        "--predictors",
        type=names,
        default=PREDICTORS,
        metavar="A,B",
        help=f"that it drives with, the baseline first (default: {','.join(PREDICTORS)}; oracle: "
        "told the future; your own as module:Class)",
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
        default=HELD_OUT,
        metavar="A-B",
        help="of the traffic (default: 701-720, that no weights that ship were trained on)",
    )
    parser.add_argument(
        "--egos",
        type=whole_number,
        default=1,
        metavar="N",
        help="vehicles of each seed that are driven, each in runs of its own (default: 1)",
    )
    parser.add_argument("--weights", type=Path, metavar="FILE", help="weights of hatn")
    add_traffic(parser)
    parser.add_argument(
        "--duration",
        type=seconds,
        default=DURATION_S,
        metavar="S",
        help="in which the vehicles to be driven have to come and cross, while the simulator "
        "drives (default: 60)",
    )
    parser.add_argument(
        "--limit",
        type=seconds,
        default=LIMIT_S,
        metavar="S",
        help="of a drive, from the vehicle's appearance on: whoever has not crossed until then is "
        "counted, and with this time (default: 60)",
    )
    parser.add_argument(
        "--warm-up",
        type=seconds_or_none,
        metavar="S",
        help="seconds to let traffic build up before (default: 60 in a shipped scene, 0 in yours)",
    )
    parser.add_argument(
        "--workers",
        type=whole_number,
        metavar="N",
        help="seeds driven at once (default: as many as there are cores)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="where drives, figure and numbers go (default: the first free runs/compare-N)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    parser.add_argument("--quiet", action="store_true", help="no progress, no notices")


def main(arguments: argparse.Namespace) -> int:
    """Drive, score, print, draw."""
    from hatn_sim.commands.console import make_console
    from hatn_sim.commands.folders import free_or_own_folder
    from hatn_sim.evaluation.seen import Judged, said_of_seen, with_seen
    from hatn_sim.report.closed_loop_figure import draw_closed_loop
    from hatn_sim.report.closed_loop_table import closed_loop_table
    from hatn_sim.report.table import scores_json, write_scores
    from hatn_sim.score.closed_loop_scores import closed_loop_scores

    predictors = _predictors(arguments)
    out = free_or_own_folder(arguments.out, "compare")
    plans = list(_plans(arguments, predictors, out))
    _tell_unread(arguments)
    judged = [Judged(plan.label, plan.scenario, plan.seed) for plan in plans]
    seen = said_of_seen(predictors.values(), judged)
    rows = _driven_rows(arguments, plans, out)
    names_of = tuple(dict.fromkeys(arguments.predictors))
    wanted = [(plan.scenario.name, plan.seed) for plan in plans]
    scores: list[Score] = with_seen(
        closed_loop_scores(rows, arguments.agent, names_of, wanted), seen
    )
    path = write_scores(out, scores)
    draw_closed_loop(scores, arguments.agent, [out / name for name in FIGURES])
    _tell_missing(arguments, rows)
    if arguments.json:
        print(scores_json(scores))
        return 0
    make_console().print(closed_loop_table(scores, arguments.agent, names_of))
    print(f"scores in {path}, figure in {out / FIGURES[0]}, drives in {out / RUNS_FOLDER}")
    return 0


def _tell_unread(arguments: argparse.Namespace) -> None:
    """Where predictors are compared by an agent that drives the same with each of them."""
    from hatn_sim.evaluation.closed_loop import drives_alike

    several = len(dict.fromkeys(arguments.predictors)) > 1
    if arguments.quiet or not several:
        return
    if drives_alike(arguments.agent):
        print(
            f"hatn-sim: {arguments.agent} reads no predictions: it drives the same with each of "
            "--predictors, so it drives once, and their rows are equal but for the errors of the "
            "predictions",
            file=sys.stderr,
        )


def _predictors(arguments: argparse.Namespace) -> dict[str, Predictor]:
    """By the words that name them; the oracle is made where there is something to branch."""
    from hatn_sim.commands.chosen_predictors import load_predictors
    from hatn_sim.errors import InputError, nearest
    from hatn_sim.predictors.find import PREDICTORS as RULES
    from hatn_sim.predictors.find import READS_WEIGHTS
    from hatn_sim.score.closed_loop_rows import ORACLE, REFERENCE

    wanted: Sequence[str] = tuple(dict.fromkeys(arguments.predictors))
    known = (ORACLE, *READS_WEIGHTS, *RULES)
    if not wanted:
        raise InputError("--predictors: expected names, found none; name some as A,B")
    for name in wanted:
        if name == REFERENCE:
            raise InputError(f"--predictors {name}: that row is always there; leave it out")
        if ":" not in name and name not in known:
            raise InputError(
                f"--predictors: unknown predictor {name!r}{nearest(name, known)} "
                "(your own as module:Class)"
            )
    told = [name for name in wanted if name != ORACLE]
    loaded = load_predictors(told, arguments.weights, "none", arguments.quiet) if told else []
    return dict(zip(told, loaded, strict=True))


def _plans(
    arguments: argparse.Namespace, predictors: Mapping[str, Predictor], out: Path
) -> Iterator[SeedPlan]:
    """Every seed of every scene."""
    from hatn_sim.commands.evaluate import by_label
    from hatn_sim.commands.options import default_warm_up_s
    from hatn_sim.config import load_scenario
    from hatn_sim.errors import InputError
    from hatn_sim.evaluation.closed_loop import SeedPlan
    from hatn_sim.plugins import load_agent
    from hatn_sim.resources import scenes_to_test_on

    agent = load_agent(arguments.agent)
    words: Sequence[str] = arguments.scenes or scenes_to_test_on()
    named = {word: load_scenario(word, arguments.density, arguments.risk) for word in words}
    for label, scenario in by_label(named).items():
        if scenario.recorded is not None:
            raise InputError(f"{label}: recorded traffic cannot react; name a simulated scene")
        warm_up_s = default_warm_up_s(scenario)
        warm_up_s = warm_up_s if arguments.warm_up is None else arguments.warm_up
        common = {
            **_made_by(scenario),
            "scene": scenario.name,
            "density": scenario.density,
            "risk": scenario.risk,
            "warm_up_s": warm_up_s,
            "duration_s": arguments.duration,
            "limit_s": arguments.limit,
            "egos": arguments.egos,
        }
        for seed in arguments.seeds:
            said = f"{label}, seed {seed}"
            yield SeedPlan(
                label=said,
                folder=out / RUNS_FOLDER / re.sub(r"[^\w.-]+", "-", said),
                scenario=_called(scenario, label),
                seed=seed,
                agent=arguments.agent,
                predictors=tuple(dict.fromkeys(arguments.predictors)),
                weights=arguments.weights,
                egos=arguments.egos,
                warm_up_s=warm_up_s,
                duration_s=arguments.duration,
                limit_s=arguments.limit,
                made_with=_made_with(
                    arguments, {**common, "seed": seed}, predictors, _source_of(agent)
                ),
            )


def _called(scenario: Scenario, label: str) -> Scenario:
    from dataclasses import replace

    return replace(scenario, name=label)


def _made_by(scenario: Scenario) -> dict[str, Any]:
    from hatn_sim.commands.versions import installed
    from hatn_sim.evaluation.made_by import NO_PART_IN_DRIVES, made_by

    return {"versions": installed(), **made_by(scenario, NO_PART_IN_DRIVES)}


def _made_with(
    arguments: argparse.Namespace,
    common: Mapping[str, Any],
    predictors: Mapping[str, Predictor],
    agent_source: str,
) -> dict[str, dict[str, Any]]:
    """By row: what a row that is there has to agree with."""
    from hatn_sim.score.closed_loop_rows import REFERENCE

    rows = {REFERENCE: dict(common)}
    for name in dict.fromkeys(arguments.predictors):
        predictor = predictors.get(name)
        rows[name] = {
            **common,
            "agent": arguments.agent,
            "source of the agent": agent_source,
            "source of the predictor": None if predictor is None else _source_of(predictor),
            "weights": getattr(getattr(predictor, "weights", None), "sha256", None),
        }
    return rows


def _source_of(plugged_in: object) -> str:
    """A hash of the file that defines it."""
    import inspect

    from hatn_sim.content import content_hash
    from hatn_sim.evaluation.made_by import SHOWN

    return content_hash(Path(inspect.getfile(type(plugged_in))))[:SHOWN]


def _driven_rows(
    arguments: argparse.Namespace, plans: Sequence[SeedPlan], out: Path
) -> list[DrivenRow]:
    """All rows that are asked for, made where they are not there; without those that are lost.

    Raises HatnSimError, and KeyboardInterrupt, where one of them fails; the others stay.
    """
    from hatn_sim.commands.folders import finished_runs_stay
    from hatn_sim.commands.progress import RunsProgress
    from hatn_sim.datatypes import DT_S
    from hatn_sim.evaluation.closed_loop import missing_rows, row_path
    from hatn_sim.evaluation.pool import cores
    from hatn_sim.score.closed_loop_rows import read_row

    wanted = [plan for plan in plans if missing_rows(plan)]
    if len(wanted) < len(plans) and not arguments.quiet:
        there = len(plans) - len(wanted)
        said = f"hatn-sim: {there} of {len(plans)} seeds are in {out / RUNS_FOLDER} already"
        print(said, file=sys.stderr)
    labels = [plan.label for plan in wanted]
    progress = RunsProgress(labels, [None] * len(wanted), DT_S, arguments.quiet)
    with finished_runs_stay(out), progress:
        lost = _make(wanted, arguments.workers or cores(), progress)
    for line in lost:
        print(f"hatn-sim: {line}", file=sys.stderr)
    if lost:
        print(
            f"hatn-sim: lost seeds are counted and left out; the same command with --out {out} "
            "makes them again",
            file=sys.stderr,
        )
    paths = [row_path(plan, row) for plan in plans for row in plan.rows]
    return [read_row(path) for path in paths if path.exists()]


def _make(plans: Sequence[SeedPlan], workers: int, progress: Any) -> list[str]:
    """Makes them; a line for each that was lost, because a process was killed."""
    from hatn_sim.evaluation.closed_loop import make_seed
    from hatn_sim.evaluation.pool import WorkerKilledError, work_on

    lost: list[str] = []
    kills: Counter[int] = Counter()
    waiting = list(range(len(plans)))
    while waiting:
        begun, done, these = set[int](), set[int](), tuple(waiting)

        def show(number: int, steps: int, these: Sequence[int] = these) -> None:
            begun.add(these[number])  # noqa: B023 - used within this turn only
            progress.show(these[number], steps)

        try:
            chosen = [plans[k] for k in these]
            for number, made in work_on(make_seed, chosen, workers, show):
                done.add(these[number])
                progress.finish(these[number], made.frames)
                lost += made.lost
        except WorkerKilledError:
            # Those that it had at work; nobody had told of them yet if it died at once.
            kills.update((begun - done) or these[:workers])
        given_up = [k for k in these if kills[k] >= MOST_KILLS and k not in done]
        lost += [f"{plans[k].label}: lost: its process was killed from outside" for k in given_up]
        waiting = [k for k in these if k not in done and k not in given_up]
    return lost


def _tell_missing(arguments: argparse.Namespace, rows: Sequence[DrivenRow]) -> None:
    """Where nobody was there to be driven."""
    from hatn_sim.score.closed_loop_rows import REFERENCE

    if arguments.quiet:
        return
    of = [row for row in rows if row.row == REFERENCE]
    for scene in dict.fromkeys(row.scene for row in of):
        seeds_of = [row for row in of if row.scene == scene]
        fewer = sum(len(row.egos) < arguments.egos for row in seeds_of)
        if fewer:
            print(
                f"hatn-sim: {scene}: in {fewer} of {len(seeds_of)} seeds fewer than "
                f"{arguments.egos} came, crossed and met somebody; try a longer --duration",
                file=sys.stderr,
            )
