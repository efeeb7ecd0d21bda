"""How often inferred lines are right, by the distance to the junction: a panel for each scene.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from hatn_sim.report.canvas import INK
from hatn_sim.report.figures import dress, head_chart, new_chart, rule, save_figure
from hatn_sim.score.line_accuracy import BINS_M, LineSamples, share_by_distance

COLUMNS: Final = 3
PANEL_IN: Final = (3.7, 2.5)
EDGES_IN: Final = 1.0
FEW: Final = 20
"""Points of fewer samples are left out."""
CURVES: Final = (
    ("all", "#22262b", "o", "-"),
    ("blinker on", "#d55e00", "s", "-"),
    ("will turn", "#0072b2", "^", "--"),
    ("blinker off", "#8a8f98", "v", ":"),
)
"""Label, colour (of Okabe and Ito's), marker, line style: told apart in grey as well."""


def draw_line_accuracy(samples: Mapping[str, LineSamples], paths: Sequence[Path]) -> None:
    """Draw the curves of the scenes into files, in the format that their suffix names."""
    columns = min(COLUMNS, len(samples))
    rows = math.ceil(len(samples) / columns)
    size = (PANEL_IN[0] * columns, EDGES_IN + PANEL_IN[1] * rows)
    figure = new_chart(size)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for axes, (label, scene) in zip(grid, samples.items(), strict=False):
        _panel(axes, scene)
        axes.set_title(label, loc="left", fontsize=9.5, color=INK)
    for axes in grid[len(samples) :]:
        axes.set_axis_off()
    for axes in grid[max(len(samples) - columns, 0) : len(samples)]:
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("front bumper to the junction [m]", color=INK, fontsize=9)
    for axes in grid[::columns]:
        axes.set_ylabel("right line", color=INK, fontsize=9)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=8.5)
    head_chart(figure, "Share of vehicle-frames whose inferred line is the simulator's route", 11.5)
    save_figure(figure, paths)


def _panel(axes: Axes, samples: LineSamples) -> None:
    """Share right over distance, driving from left to right; inside the junction stands last."""
    at = np.arange(len(BINS_M))[::-1]
    shown = {
        "all": np.ones(len(samples.vehicle), dtype=np.bool_),
        "blinker on": samples.blinker != 0,
        "will turn": samples.turn != 0,
        "blinker off": samples.blinker == 0,
    }
    axes.axvspan(at[0] - 0.5, at[0] + 0.5, color="#eceae4", lw=0)
    for label, colour, marker, style in CURVES:
        share, count = share_by_distance(samples, shown[label])
        share = np.where(count >= FEW, share, np.nan)
        axes.plot(
            at, share, style, color=colour, marker=marker, ms=4, lw=1.3, label=label, clip_on=False
        )
    edges = [f"{low:.0f}-{high:.0f}" for low, high in pairwise(BINS_M)]
    axes.set_xticks(at, ["inside", *edges])
    axes.set_xlim(-0.5, len(BINS_M) - 0.5)
    axes.set_ylim(0.0, 1.0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    dress(axes, 8)
    rule(axes)
