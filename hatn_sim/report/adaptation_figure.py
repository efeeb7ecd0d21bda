"""The paper's figures of online adaptation: ADE 1 to 4 over the steps looked back, and by layer.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, Protocol

from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from hatn_sim.report.canvas import INK, SOFT_INK
from hatn_sim.report.figures import dress, head_chart, new_chart, rule, save_figure

TRAINED: Final = "#8a8f98"
ADAPTED: Final = "#0072b2"
TITLES: Final = {
    "ade1": "ADE 1: the steps looked back",
    "ade2": "ADE 2: as many steps from now",
    "ade3": "ADE 3: 3 s from then",
    "ade4": "ADE 4: 3 s from now",
}
LAYERS: Final = {
    "encoder_input": r"$W^E_{ih}$",
    "encoder_hidden": r"$W^E_{hh}$",
    "decoder_input": r"$W^D_{ih}$",
    "decoder_hidden": r"$W^D_{hh}$",
    "dense1": r"$W^F_1$",
    "dense2": r"$W^F_2$",
    "dense3": r"$W^F_3$",
}
"""The paper's names, in the order that a signal meets the layers."""
COLOURS: Final = ("#56b4e9", "#0072b2", "#009e73", "#e69f00", "#cc79a7", "#8a8f98", "#d55e00")
"""Of Okabe and Ito, told apart by the colour-blind."""
MARKERS: Final = "osv^DPX"
PANEL_IN: Final = (2.9, 2.3)
EDGES_IN: Final = 0.9
LEAST_WIDTH_IN: Final = 6.5
"""Of title and legend."""


class Row(Protocol):
    """What is drawn of a row of the study (`learn.adaptation_study.AdaptationRow`)."""

    @property
    def steps(self) -> int: ...

    @property
    def layer(self) -> str: ...

    def error_m(self, measure: str, which: str) -> float: ...

    def change(self, measure: str) -> float: ...


def draw_steps(scenes: Mapping[str, Sequence[Row]], paths: Sequence[Path]) -> None:
    """Errors with and without adaptation over the steps, a row of four panels for each scene."""
    size = (PANEL_IN[0] * len(TITLES), EDGES_IN + PANEL_IN[1] * len(scenes))
    figure = new_chart(size)
    grid = figure.subplots(len(scenes), len(TITLES), squeeze=False, sharex=True)
    for row, (scene, results) in zip(grid, scenes.items(), strict=True):
        results = sorted(results, key=lambda result: result.steps)
        for axes, measure in zip(row, TITLES, strict=True):
            _errors(axes, results, measure)
        row[0].set_ylabel(f"{scene}\nerror [m]", color=INK, fontsize=9)
    for axes, title in zip(grid[0], TITLES.values(), strict=True):
        axes.set_title(title, loc="left", fontsize=9.5, color=INK)
    for axes in grid[-1]:
        axes.set_xlabel("steps looked back (0.1 s)", color=INK, fontsize=9)
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8.5)
    head_chart(figure, "Prediction error without and with online adaptation", 11.5)
    save_figure(figure, paths)


def draw_layers(scenes: Mapping[str, Sequence[Row]], paths: Sequence[Path]) -> None:
    """Change of ADE 2 over the steps, a line for each layer and a panel for each scene."""
    size = (max(1.35 * PANEL_IN[0] * len(scenes), LEAST_WIDTH_IN), EDGES_IN + 1.4 * PANEL_IN[1])
    figure = new_chart(size)
    grid = figure.subplots(1, len(scenes), squeeze=False, sharey=True)[0]
    for axes, (scene, results) in zip(grid, scenes.items(), strict=True):
        for (layer, name), colour, marker in zip(LAYERS.items(), COLOURS, MARKERS, strict=True):
            found = sorted((r for r in results if r.layer == layer), key=lambda r: r.steps)
            if found:
                axes.plot(
                    [result.steps for result in found],
                    [result.change("ade2") for result in found],
                    color=colour,
                    marker=marker,
                    ms=4,
                    lw=1.3,
                    label=name,
                )
        axes.axhline(0.0, color=SOFT_INK, lw=0.8)
        axes.set_xticks(sorted({result.steps for result in results}))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        axes.set_title(scene, loc="left", fontsize=9.5, color=INK)
        axes.set_xlabel("steps looked back (0.1 s)", color=INK, fontsize=9)
        dress(axes, 8)
        rule(axes)
    grid[0].set_ylabel("change of ADE 2", color=INK, fontsize=9)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(LAYERS), fontsize=8.5)
    head_chart(figure, "Change of the short-term error by the layer that is adapted", 11.5)
    save_figure(figure, paths)


def _errors(axes: Axes, results: Sequence[Row], measure: str) -> None:
    """One measure without and with adaptation, its change in per cent above the points."""
    steps = [result.steps for result in results]
    for which, colour, marker in (("trained", TRAINED, "s"), ("adapted", ADAPTED, "o")):
        error_m = [result.error_m(measure, which) for result in results]
        label = "trained network" if which == "trained" else "adapted"
        axes.plot(steps, error_m, color=colour, marker=marker, ms=3.5, lw=1.3, label=label)
    for result in results:
        higher = max(result.error_m(measure, which) for which in ("trained", "adapted"))
        axes.annotate(
            f"{100 * result.change(measure):+.0f}",
            (result.steps, higher),
            (0, 4),
            textcoords="offset points",
            ha="center",
            fontsize=6.5,
            color=SOFT_INK,
        )
    axes.set_ylim(0.0, 1.2 * axes.get_ylim()[1])
    axes.set_xticks(steps)
    dress(axes, 8)
    rule(axes)
