"""`hatn-sim evaluate --table lines`: how often the inferred line is the simulator's route."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.evaluate import by_label
from hatn_sim.commands.folders import free_or_own_folder

if TYPE_CHECKING:
    from rich.table import Table

    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Frame, Score, Simulator
    from hatn_sim.score.line_accuracy import LineSamples

FIGURES: Final = ("lines.png", "lines.pdf")
TITLES: Final = {
    "line_right_inside": "inside a junction",
    "line_right_inside_choice": "  of those with a choice of exits",
    "line_right_20m_blinker": "last 20 m before it, blinker on",
    "line_told_20m_blinker": "  what approach and blinker tell",
    "line_right_20m": "last 20 m before it",
    "line_right_20m_choice": "  of those with a choice of exits",
    "line_right_when_given": "up to 80 m before it, with a line",
    "line_mean_probability": "  as the probabilities have it",
    "line_wrong_lane_share": "wrong lane behind it, inside",
    "line_fallback_share": "no line (fallback)",
}


def main(arguments: argparse.Namespace) -> int:
    """Simulate, judge, print, draw."""
    from hatn_sim.report.line_figure import draw_line_accuracy
    from hatn_sim.report.table import SCORES_FILE, scores_json, write_scores
    from hatn_sim.score.line_accuracy import line_scores

    scenarios = _scenarios(arguments.scenes, arguments.quiet)
    out = free_or_own_folder(arguments.out, "lines", (SCORES_FILE, *FIGURES))
    samples = {label: _measure(arguments, label, one) for label, one in scenarios.items()}
    scores = {label: line_scores(one, label) for label, one in samples.items()}
    draw_line_accuracy(samples, [out / name for name in FIGURES])
    every = [score for of_scene in scores.values() for score in of_scene]
    path = write_scores(out, every)
    if arguments.json:
        print(scores_json(every))
        return 0
    _print(scores, samples)
    print(f"figure in {out / FIGURES[0]} and {FIGURES[1]}, scores in {path}")
    return 0


def _scenarios(words: Sequence[str], quiet: bool) -> dict[str, Scenario]:
    """The scenes by the name they go by: where two have the same, by the words that name them.

    Those of recorded tracks are left out: they know no routes.
    """
    from hatn_sim.config import load_scenario
    from hatn_sim.errors import InputError

    named = {word: load_scenario(word) for word in words}
    recorded = [word for word, scenario in named.items() if scenario.recorded is not None]
    for word in recorded:
        del named[word]
    if not named:
        raise InputError(
            f"{', '.join(recorded)}: recorded tracks know no routes to hold lines against; "
            "name other --scenes"
        )
    if recorded and not quiet:
        print(f"hatn-sim: left out, without routes: {', '.join(recorded)}", file=sys.stderr)
    return by_label(named)


def _measure(arguments: argparse.Namespace, label: str, scenario: Scenario) -> LineSamples:
    """The samples of a scene over all seeds."""
    from hatn_sim.commands.options import default_warm_up_s
    from hatn_sim.score.line_accuracy import pooled
    from hatn_sim.simulators.sumo_lanes import edge_of
    from hatn_sim.traffic import open_traffic

    warm_up_s = default_warm_up_s(scenario) if arguments.warm_up is None else arguments.warm_up
    # Where lanes have no names of SUMO's, every lane is an edge of its own.
    edge = edge_of if scenario.simulator == "sumo" else str
    parts: list[LineSamples] = []
    for seed in arguments.seeds:
        with closing(open_traffic(scenario)) as simulator:
            first = simulator.reset(seed)
            if not arguments.quiet and not parts:
                for notice in simulator.notices:
                    print(f"hatn-sim: {label}: {notice}", file=sys.stderr)
            title = f"{label}, seed {seed}"
            spans_s = (warm_up_s, arguments.duration)
            parts.append(_judge_run(simulator, first, title, spans_s, edge, arguments.quiet))
    return pooled(parts)


def _judge_run(
    simulator: Simulator,
    frame: Frame,
    title: str,
    spans_s: tuple[float, float],
    edge_of: Callable[[str], str],
    quiet: bool,
) -> LineSamples:
    """The samples of one run; `spans_s` is how long it warms up and is looked at then."""
    from hatn_sim.commands.progress import Progress
    from hatn_sim.labels import SAMPLE_EVERY_FRAMES
    from hatn_sim.lines import WARP_FRAMES
    from hatn_sim.loop import warm_up
    from hatn_sim.score.line_accuracy import LineJudge

    before, wanted = (round(span_s / simulator.dt_s) for span_s in spans_s)
    watched = min(before, WARP_FRAMES)  # what lines are inferred from
    frame = warm_up(simulator, frame, before - watched)
    judge = LineJudge(simulator.road, edge_of, title)
    total = watched + max(1, wanted)
    with Progress(title, total, simulator.dt_s, quiet) as progress:
        for index in range(total):
            counts = index >= watched and index % SAMPLE_EVERY_FRAMES == 0
            judge.see(frame, counts=counts)
            progress.show(index + 1, len(frame.scene.ids))
            if frame.done or index == total - 1:
                break
            frame = simulator.step()
    samples = judge.samples()
    if not len(samples.vehicle) and not quiet:
        print(f"hatn-sim: {title}: no vehicle came near a junction", file=sys.stderr)
    return samples


def _print(scores: Mapping[str, Sequence[Score]], samples: Mapping[str, LineSamples]) -> None:
    from hatn_sim.commands.console import make_console

    console = make_console()
    for label, of_scene in scores.items():
        console.print(_measures(label, of_scene))
        console.print(_by_distance(samples[label]))
        console.print()
    console.print("[low high] 95 % interval, bootstrapped over vehicles", markup=False, style="dim")


def _measures(label: str, scores: Sequence[Score]) -> Table:
    from hatn_sim.report.plain_table import plain_table

    table = plain_table(f"{label}: inferred lines that are right")
    table.add_column("vehicle-frames", min_width=36)
    for column in ("share", "[low high]", "n"):
        table.add_column(column, justify="right", no_wrap=True)
    by_measure = {score.measure: score for score in scores}
    for measure, title in TITLES.items():
        score = by_measure[measure]
        interval = (
            "-"
            if score.low is None or score.high is None
            else f"[{100.0 * score.low:.1f} {100.0 * score.high:.1f}]"
        )
        share = "-" if score.value is None else f"{100.0 * score.value:.1f} %"
        table.add_row(title, share, interval, f"{score.n:,}")
    return table


def _by_distance(samples: LineSamples) -> Table:
    from itertools import pairwise

    from rich.table import Table

    from hatn_sim.score.line_accuracy import BINS_M, share_by_distance

    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="italic")
    table.add_column("metres to the junction", min_width=22)
    for name in ("inside", *(f"{low:.0f}-{high:.0f}" for low, high in pairwise(BINS_M))):
        table.add_column(name, justify="right", no_wrap=True)
    blinks = samples.blinker != 0
    for name, among in (("blinker on", blinks), ("blinker off", ~blinks)):
        share, count = share_by_distance(samples, among)
        cells = [
            f"{100.0 * s:.1f} %" if n else "-"
            for s, n in zip(share.tolist(), count.tolist(), strict=True)
        ]
        table.add_row(name, *cells)
    return table
