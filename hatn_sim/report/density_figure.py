"""The paper's figure of interacting car density: four panels, a row for each scene (PNG, PDF).

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, PercentFormatter

from hatn_sim.datatypes import IntArray
from hatn_sim.report.canvas import INK
from hatn_sim.report.figures import dress, head_chart, new_chart, save_figure
from hatn_sim.score.density import CRITERIA, Density, counts_of, histogram, summary_of

TITLES: Final = {
    "all": "(a) all vehicles in the scene",
    "30m": "(b) within 30 m",
    "10m": "(c) within 10 m",
    "conflict": "(d) conflicting lines",
}
COLOURS: Final = {"all": "#8a8f98", "30m": "#56b4e9", "10m": "#0072b2", "conflict": "#d55e00"}
"""Grey and three of Okabe and Ito's colours, told apart by the colour-blind and in grey."""
MAX_BARS: Final = 40
WIDTH_IN: Final = 11.0
ROW_IN: Final = 1.95
LABEL_PT: Final = 58.0
"""From the axis to the name of the scene."""
MAX_LABEL: Final = 22
EDGES_IN: Final = 1.15
"""Title and axis labels, above and below the rows."""


Counts = Mapping[str, IntArray]
"""Criterion -> [S] vehicles that each sample's ego interacts with."""


def all_counts(density: Density) -> Counts:
    """What is drawn of the samples of a scene."""
    return {criterion: counts_of(density, criterion) for criterion in CRITERIA}


def draw_density(scenes: Mapping[str, Counts], paths: Sequence[Path]) -> None:
    """Draw the distributions of the scenes into files, in the format that their suffix names.

    The first panel has an axis of its own, the other three of a row share theirs.
    """
    rows = len(scenes)
    figure = new_chart((WIDTH_IN, EDGES_IN + ROW_IN * rows))
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.06)  # type: ignore[union-attr]
    grid = figure.subplots(rows, len(CRITERIA), squeeze=False)
    for row, (label, counts) in zip(grid, scenes.items(), strict=True):
        shared = max((int(counts[c].max(initial=0)) for c in CRITERIA[1:]), default=0)
        for axes, criterion in zip(row, CRITERIA, strict=True):
            last = int(counts["all"].max(initial=0)) if criterion == "all" else shared
            _panel(axes, counts, criterion, last)
        row[0].set_ylabel("share of samples", color=INK)
        row[0].annotate(
            label if len(label) <= MAX_LABEL else f"…{label[1 - MAX_LABEL :]}",
            (0.0, 0.5),
            (-LABEL_PT, 0.0),
            xycoords="axes fraction",
            textcoords="offset points",
            rotation=90,
            ha="center",
            va="center",
            weight="bold",
            fontsize=8.5,
            color=INK,
        )
    figure.align_ylabels(grid[:, 0])
    for axes, criterion in zip(grid[0], CRITERIA, strict=True):
        axes.set_title(TITLES[criterion], loc="left", fontsize=10.5, color=INK)
    for axes in grid[-1]:
        axes.set_xlabel("interacting vehicles", color=INK)
    head_chart(figure, "Vehicles that interact with an ego, chosen by four criteria", 13)
    save_figure(figure, paths)


def _panel(axes: Axes, counts: Counts, criterion: str, last: int) -> None:
    """The histogram of one criterion, with bars for 0 to `last` vehicles."""
    count = counts[criterion]
    width = bar_width(last)
    dress(axes, 8.5)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.set_xlim(-0.75, max(last, 1) // width * width + width - 0.25)
    if len(count):
        first, samples = histogram(count, width)
        share = samples / len(count)
        axes.bar(first - 0.5, share, 0.86 * width, align="edge", color=COLOURS[criterion])
        top = 1.45 * float(share.max())  # leaves room for the caption
        axes.set_yticks([at for at in MaxNLocator(4).tick_values(0.0, top) if at <= min(top, 1.0)])
        axes.set_ylim(0.0, top)
    axes.text(
        0.98,
        0.97,
        _caption(counts, criterion, width),
        transform=axes.transAxes,
        ha="right",
        va="top",
        fontsize=8.5,
        color=INK,
    )


def bar_width(last: int) -> int:
    """Counts that one bar stands for: 1, 2, 5, 10 ..., so that there are at most `MAX_BARS`."""
    widths = (step * 10**power for power in range(9) for step in (1, 2, 5))
    return next(width for width in widths if last // width < MAX_BARS)


def _caption(counts: Counts, criterion: str, width: int) -> str:
    summary = summary_of(criterion, counts[criterion])
    if summary.mean is None:
        return "no samples"
    notes: list[str] = []
    # The same in every panel, but for vehicles without a reference line.
    if criterion == "all" or summary.n != len(counts["all"]):
        notes.append(f"n = {summary.n:,}")
    if width > 1:
        notes.append(f"{width} counts a bar")
    return f"mean {summary.mean:.1f}, 90 % ≤ {summary.ninetieth:g}\n{', '.join(notes)}"
