"""A table of the paper as a figure: its numbers beside ours, a panel for each measure and scene.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from hatn_sim.report.canvas import INK, SOFT_INK
from hatn_sim.report.figures import (
    LABEL_PT,
    NOTE_PT,
    PAGE_IN,
    TICK_PT,
    TITLE_PT,
    dress,
    head_chart,
    new_chart,
    save_figure,
)
from hatn_sim.report.kept_numbers import Beside
from hatn_sim.report.paper_table import FORMS

OURS: Final = "#0072b2"
PAPER: Final = "#8a8f98"
COLUMNS: Final = 4
ROW_IN: Final = 0.17
PANEL_IN: Final = 0.62
EDGES_IN: Final = 0.6
FAR: Final = 20.0
"""Where the worst is so many times the best, an axis is logarithmic."""


def draw_beside(numbers: Sequence[Beside], title: str, paths: Sequence[Path]) -> None:
    """Draw the panels, those of each part of a table on lines of their own."""
    panels = list(dict.fromkeys((one.table, one.scene, one.measure) for one in numbers))
    lines: list[list[tuple[str, str, str]]] = []
    for of_table in (list(same) for _, same in groupby(panels, key=lambda panel: panel[0])):
        lines += [of_table[k : k + COLUMNS] for k in range(0, len(of_table), COLUMNS)]
    names = {
        table: list(dict.fromkeys(one.row for one in numbers if one.table == table))
        for table, _, _ in panels
    }
    heights_in = [PANEL_IN + ROW_IN * len(names[line[0][0]]) for line in lines]
    figure = new_chart((PAGE_IN, EDGES_IN + sum(heights_in)))
    columns = max(len(line) for line in lines)
    grid = figure.subplots(len(lines), columns, squeeze=False, height_ratios=heights_in)
    for row, line in zip(grid, lines, strict=True):
        for axes in row[len(line) :]:
            axes.set_axis_off()
        for k, (axes, panel) in enumerate(zip(row, line, strict=False)):
            table, scene, measure = panel
            of_panel = [one for one in numbers if (one.table, one.scene, one.measure) == panel]
            _panel(axes, of_panel, names[table], measure)
            axes.tick_params(labelleft=not k)
            part = "" if k or len(names) == 1 else f"({table.rpartition('.')[2]}) "
            axes.set_title(f"{part}{scene}", loc="left", fontsize=TICK_PT, color=INK)
    look: dict[str, Any] = {"ls": "", "ms": 4.0}
    handles = [
        Line2D([], [], marker="o", color=OURS, label="ours, with 95 % interval", **look),
        Line2D([], [], marker="D", mfc="white", mec=PAPER, label="the paper's", **look),
    ]
    figure.legend(
        handles=handles, loc="outside lower left", ncols=2, frameon=False, fontsize=NOTE_PT
    )
    head_chart(figure, title, TITLE_PT)
    save_figure(figure, paths)


def _panel(axes: Axes, numbers: Sequence[Beside], names: Sequence[str], measure: str) -> None:
    """A line for each of `names`, from above."""
    form = FORMS[measure]
    for one in numbers:
        at, (paper, ours, low, high) = (
            names.index(one.row),
            form.factor * np.array([one.paper, one.ours, one.low, one.high]),
        )
        axes.plot(paper, at, "D", mfc="white", mec=PAPER, ms=4.0)
        axes.plot([low, high], [at, at], color=OURS, lw=1.1)
        axes.plot(ours, at, "o", color=OURS, ms=4.0)
    known = [value for one in numbers for value in (one.paper, one.ours) if value > 0.0]
    if known and max(known) > FAR * min(known) and "change" not in measure:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
    else:
        axes.xaxis.set_major_locator(MaxNLocator(4))
    dress(axes, TICK_PT)
    axes.grid(axis="both", color="#e3e3df", lw=0.6)
    axes.set_axisbelow(True)
    axes.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    axes.tick_params(axis="y", labelcolor=INK, length=0.0)
    axes.set_ylim(len(names) - 0.5, -0.5)
    if not known:
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, color=SOFT_INK, ha="center")
    axes.set_xlabel(form.title, fontsize=LABEL_PT, color=INK)
