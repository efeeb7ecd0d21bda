"""`hatn-sim evaluate --table density`: how many vehicles interact with an ego."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.evaluate import DURATION_S, chosen_scenarios
from hatn_sim.commands.folders import free_or_own_folder

if TYPE_CHECKING:
    from rich.table import Table

    from hatn_sim.commands.progress import Progress
    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Frame, Simulator
    from hatn_sim.score.density import Density, Summary

TITLES: Final = {
    "all": "all vehicles in the scene",
    "30m": "within 30 m",
    "10m": "within 10 m",
    "conflict": "conflicting lines",
    "conflict_capped": "conflicting lines, capped",
}
HISTOGRAMS: Final = "density.csv"
FIGURES: Final = ("density.png", "density.pdf")


def main(arguments: argparse.Namespace) -> int:
    """Simulate, count, print, draw."""
    from hatn_sim.report.density_figure import all_counts, draw_density
    from hatn_sim.report.table import scores_json
    from hatn_sim.score.density import density_scores

    scenarios = chosen_scenarios(arguments)
    out = free_or_own_folder(arguments.out, "density", (HISTOGRAMS, *FIGURES))
    densities = {
        label: _measure(arguments, label, scenario) for label, scenario in scenarios.items()
    }
    _write_histograms(out / HISTOGRAMS, densities)
    counts = {label: all_counts(density) for label, density in densities.items()}
    draw_density(counts, [out / name for name in FIGURES])
    if arguments.json:
        scores = [s for label, density in densities.items() for s in density_scores(label, density)]
        print(scores_json(scores))
        return 0
    _print(densities)
    print(f"figure in {out / FIGURES[0]} and {FIGURES[1]}, histograms in {out / HISTOGRAMS}")
    return 0


def _measure(arguments: argparse.Namespace, label: str, scenario: Scenario) -> Density:
    """The samples of a scene over all seeds; recorded traffic has none and is played once."""
    from hatn_sim.commands.options import default_warm_up_s
    from hatn_sim.score.density import pool_runs
    from hatn_sim.traffic import open_traffic

    recorded = scenario.recorded is not None
    warm_up_s = default_warm_up_s(scenario) if arguments.warm_up is None else arguments.warm_up
    duration_s = arguments.duration
    if duration_s is None and not recorded:
        duration_s = DURATION_S
    runs: list[Density] = []
    with closing(open_traffic(scenario)) as simulator:
        for seed in (0,) if recorded else arguments.seeds:
            first = simulator.reset(seed)
            if not arguments.quiet and not runs:
                for notice in simulator.notices:
                    print(f"hatn-sim: {label}: {notice}", file=sys.stderr)
            title = label if recorded else f"{label}, seed {seed}"
            runs.append(_run(simulator, first, title, warm_up_s, duration_s, arguments.quiet))
    return pool_runs(runs)


def _run(
    simulator: Simulator,
    first: Frame,
    title: str,
    warm_up_s: float,
    duration_s: float | None,
    quiet: bool,
) -> Density:
    from hatn_sim.commands.progress import Progress
    from hatn_sim.lines import WARP_FRAMES
    from hatn_sim.loop import warm_up
    from hatn_sim.score.density import count_interacting

    before = round(warm_up_s / simulator.dt_s)
    watched = min(before, WARP_FRAMES)  # lines are inferred from what was seen in this time
    frame = warm_up(simulator, first, before - watched)
    total = None if duration_s is None else watched + max(1, round(duration_s / simulator.dt_s))
    with Progress(title, total, simulator.dt_s, quiet) as progress:
        density = count_interacting(
            simulator.road, _frames(simulator, frame, total, progress), watched
        )
    if not len(density.run) and not quiet:
        print(f"hatn-sim: {title}: no vehicle was seen", file=sys.stderr)
    return density


def _frames(
    simulator: Simulator, frame: Frame, total: int | None, progress: Progress
) -> Iterator[Frame]:
    """`frame` and those that follow, `total` of them or to the end."""
    done = 0
    while True:
        yield frame
        done += 1
        progress.show(done, len(frame.scene.ids))
        if frame.done or done == total:
            return
        frame = simulator.step()


def _write_histograms(path: Path, densities: Mapping[str, Density]) -> None:
    from hatn_sim.score.density import counts_of, criteria_of, histogram
    from hatn_sim.whole_file import save_csv

    rows: list[Sequence[object]] = [
        ("scene", "criterion", "interacting_vehicles", "samples", "share")
    ]
    for label, density in densities.items():
        for criterion in criteria_of(density):
            numbers, samples = histogram(counts_of(density, criterion))
            for number, n in zip(numbers.tolist(), samples.tolist(), strict=True):
                rows.append((label, criterion, number, n, f"{n / samples.sum():.6f}"))
    save_csv(path, rows)


def _print(densities: Mapping[str, Density]) -> None:
    from hatn_sim.commands.console import make_console
    from hatn_sim.score.density import MAX_OTHERS, criteria_of, density_scores, summarise

    console = make_console()
    capped = False
    for label, density in densities.items():
        intervals = [(score.low, score.high) for score in density_scores(label, density)]
        summaries = [summarise(density, criterion) for criterion in criteria_of(density)]
        console.print(_table(label, summaries, intervals))
        console.print(_without_line(density))
        console.print()
        capped = capped or len(summaries) > 4
    seeds = {_clustered_over(density) for density in densities.values()}
    note = f"[low high] 95 % interval of the mean, bootstrapped over {' or '.join(sorted(seeds))}"
    console.print(note, markup=False, style="dim")
    if capped:
        console.print(f"capped: at most {MAX_OTHERS}, the nodes of a semantic graph", style="dim")


def _clustered_over(density: Density) -> str:
    from hatn_sim.score.density import clustered_over

    return clustered_over(density)


def _without_line(density: Density) -> str:
    n = len(density.has_line)
    without = int((~density.has_line).sum())
    share = f" ({100.0 * without / n:.1f} %)" if n else ""
    return f"{without:,} of {n:,} samples{share} are of vehicles without a reference line"


def _table(
    label: str,
    summaries: Sequence[Summary],
    intervals: Sequence[tuple[float | None, float | None]],
) -> Table:
    from hatn_sim.report.plain_table import plain_table

    table = plain_table(f"{label}: vehicles interacting with an ego")
    table.add_column("chosen by", min_width=25)
    for column in ("mean", "[low high]", "median", "90 %", "maximum", "none", "n"):
        table.add_column(column, justify="right", no_wrap=True)
    for summary, (low, high) in zip(summaries, intervals, strict=True):
        interval = "-" if low is None or high is None else f"[{low:.2f} {high:.2f}]"
        if summary.none_share is None:
            cells = ["-"] * 6
        else:
            cells = [
                f"{summary.mean:.2f}",
                interval,
                f"{summary.median:g}",
                f"{summary.ninetieth:g}",
                f"{summary.maximum}",
                f"{100.0 * summary.none_share:.1f} %",
            ]
        table.add_row(TITLES[summary.criterion], *cells, f"{summary.n:,}")
    return table
