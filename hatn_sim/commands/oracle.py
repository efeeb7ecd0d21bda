"""`hatn-sim doctor --oracle`: our conflicts held against SUMO's own, over a stretch of traffic."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.table import Table

    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Frame, Score
    from hatn_sim.score.oracle_scores import Tally
    from hatn_sim.simulators.sumo import SumoSimulator

DURATION_S: Final = 600.0
SAMPLE_EVERY_S: Final = 1.0
MAX_LINES: Final = 20
"""Disagreements written out; the rest are counted."""


def main(arguments: argparse.Namespace) -> int:
    """Simulate, compare once a second, print."""
    from hatn_sim.commands.options import WARM_UP_S
    from hatn_sim.config import load_scenario
    from hatn_sim.errors import InputError, SimulatorError
    from hatn_sim.loop import warm_up
    from hatn_sim.report.table import scores_json
    from hatn_sim.simulators.sumo import SumoSimulator

    scenario = load_scenario(arguments.oracle)
    if scenario.simulator != "sumo":
        raise InputError(
            f"--oracle {arguments.oracle}: expected a scene simulated by SUMO, which alone lists "
            f"the conflicts it sees, found {scenario.simulator}; choose another scene"
        )
    warm_up_s: float | None = arguments.warm_up
    if warm_up_s is None:
        warm_up_s = 0.0 if scenario.is_user_config else WARM_UP_S
    try:
        with SumoSimulator(scenario) as simulator:
            first = simulator.reset(arguments.seed)
            if not arguments.json:
                for notice in simulator.notices:
                    print(f"hatn-sim: {notice}", file=sys.stderr)
            frame = warm_up(simulator, first, round(warm_up_s / simulator.dt_s))
            duration_s = arguments.duration or DURATION_S
            tally = _compare(simulator, frame, duration_s, quiet=arguments.json)
    except SimulatorError as error:
        repeat = f"hatn-sim doctor --oracle {arguments.oracle} --seed {arguments.seed}"
        raise SimulatorError(f"{error}; repeat with `{repeat}`") from None
    scores = tally.scores(scenario.name)
    if arguments.json:
        print(scores_json(scores))
    else:
        _print(scenario, scores, tally)
    return 0


def _compare(simulator: SumoSimulator, frame: Frame, duration_s: float, quiet: bool) -> Tally:
    from hatn_sim.commands.progress import Progress
    from hatn_sim.perception import begin, perceive
    from hatn_sim.score.oracle import ASK_M, Moment, Oracle
    from hatn_sim.score.oracle_lanes import read_junctions
    from hatn_sim.score.oracle_scores import Tally

    lanes = read_junctions(simulator.lanes, simulator.lane_foes())
    oracle, tally = Oracle(simulator.road, lanes), Tally(lanes)
    state = begin(simulator.road)
    every = round(SAMPLE_EVERY_S / simulator.dt_s)
    total = max(1, round(duration_s / simulator.dt_s))
    with Progress(simulator.scenario.name, total, simulator.dt_s, quiet) as progress:
        for step in range(total):
            scene = frame.scene
            state = perceive(state, scene, frame.truth.routes)
            if step % every == 0:
                lines = state.seen.lines
                front_s_m = lines.s_m + 0.5 * scene.size_m[:, 0]
                foes = simulator.junction_foes(ASK_M)
                moment = Moment(scene.xy_m, lines.line, front_s_m, foes)
                tally.add(oracle.compare(moment), scene.ids)
            progress.show(step + 1, len(scene.ids))
            if frame.done or step + 1 == total:
                break
            frame = simulator.step()
    return tally


def _print(scenario: Scenario, scores: Sequence[Score], tally: Tally) -> None:
    from hatn_sim.commands.console import make_console
    from hatn_sim.score.oracle_scores import ERRORS, MEANING, Outcome

    console = make_console()
    by_name = {score.measure: score for score in scores}
    table = _table(f"{scenario.name}: conflicts held against SUMO's", "measure", "value", "n", "")
    for name, words in _MEASURES.items():
        table.add_row(name, _value(by_name[name]), f"{by_name[name].n:,}", words)
    console.print(table)
    groups = {
        "meetings compared": (Outcome.BOTH, *ERRORS),
        "meetings left out": [
            kind for kind in Outcome if kind not in ERRORS and kind is not Outcome.BOTH
        ],
    }
    for title, kinds in groups.items():
        table = _table(title, "class", "meetings", "what it is")
        for kind in kinds:
            count = by_name[f"meetings_{kind.name.lower()}"].value or 0.0
            table.add_row(kind.name.lower(), f"{count:,.0f}", MEANING[kind])
        console.print()
        console.print(table)
    waiting = by_name["distances_to_waiting_places"].value or 0.0
    console.print(f"\ndistances left out, SUMO's being to a place to wait: {waiting:,.0f}")
    found = tally.disagreements()
    for kind, count, words in found[:MAX_LINES]:
        console.print(f"{count:>7,} {kind.name.lower()}: {words}", soft_wrap=True)
    if len(found) > MAX_LINES:
        console.print(f"and {len(found) - MAX_LINES} more pairs of ways")


_MEASURES: Final = {
    "conflict_recall": "share of SUMO's meetings that we have",
    "conflict_precision": "share of ours that SUMO's list has",
    "conflict_precision_with_table": "the same, where SUMO's table of foes counts as its list",
    "distance_median_m": "to the same place: middle of a crossing, begin of a merge by SUMO's rule",
    "entry_distance_median_m": "to the begin of the area, each by its own width",
}


def _table(title: str, *columns: str) -> Table:
    from hatn_sim.report.plain_table import plain_table

    table = plain_table(title)
    for column in columns:
        table.add_column(
            column, justify="right" if column in ("n", "value", "meetings") else "left"
        )
    return table


def _value(score: Score) -> str:
    if score.value is None:
        return "-"
    value = f"{score.value:.4f}" if score.unit == "1" else f"{score.value:.2f} m"
    if score.low is not None and score.high is not None:
        value += f" [{score.low:.4f} {score.high:.4f}]"
    return value
