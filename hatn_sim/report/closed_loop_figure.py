"""Open loop against closed loop: does who predicts better drive better? As PNG and PDF.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes

from hatn_sim.datatypes import Score
from hatn_sim.report.canvas import INK, SOFT_INK
from hatn_sim.report.figures import COLOURS, dress, head_chart, new_chart, rule, save_figure
from hatn_sim.score.closed_loop_rows import REFERENCE

ACROSS: Final = "ade_3s"
UP: Final = {
    "time_to_cross": "time to cross, s",
    "t2_t3_events": "T2 and T3 events in a drive",
    "collisions": "collisions in a drive",
}
WIDTH_IN: Final = 10.5
ROW_IN: Final = 3.1
EDGES_IN: Final = 0.9
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X")
LEAST_EVENTS: Final = 0.1
"""No axis of events ends lower: where there were none, that is seen."""

_ByKey = Mapping[tuple[str, str, str, str], Score]


def draw_closed_loop(scores: Sequence[Score], agent: str, paths: Sequence[Path]) -> None:
    """Draw a row for each scene: every predictor's error against what driving with it came to.

    Bars are 95 % intervals; the dashed line is the simulator's own driver. The format of a file is
    what its suffix names.
    """
    by_key = {(s.scene, s.subset, s.predictor, s.measure): s for s in scores}
    scenes = list(dict.fromkeys(score.scene for score in scores))
    names = list(dict.fromkeys(s.predictor for s in scores if s.subset == agent))
    names = [name for name in names if name != REFERENCE]
    figure = new_chart((WIDTH_IN, EDGES_IN + ROW_IN * len(scenes)))
    grid = figure.subplots(len(scenes), len(UP), squeeze=False)
    for row, scene in zip(grid, scenes, strict=True):
        for axes, (measure, label) in zip(row, UP.items(), strict=True):
            for number, name in enumerate(names):
                error = by_key.get((scene, "all", name, ACROSS))
                drive = by_key.get((scene, agent, name, measure))
                if error is not None and drive is not None:
                    look = COLOURS[number % len(COLOURS)], MARKERS[number % len(MARKERS)]
                    _point(axes, error, drive, name, *look)
            reference = by_key.get((scene, REFERENCE, REFERENCE, measure))
            if reference is not None and reference.value is not None:
                axes.axhline(reference.value, color=SOFT_INK, lw=1.0, ls="--")
            dress(axes, 8.5)
            rule(axes)
            axes.margins(0.12)
            axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
            if measure != "time_to_cross":
                axes.set_ylim(bottom=0.0, top=max(axes.get_ylim()[1], LEAST_EVENTS))
            axes.set_ylabel(label, color=INK, fontsize=9)
        row[0].set_title(scene, loc="left", fontsize=10.5, color=INK)
    for axes in grid[-1]:
        axes.set_xlabel("open loop: mean error over 3 s, m", color=INK, fontsize=9)
    named = {
        label: handle
        for axes in grid.flat
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    if named:
        figure.legend(
            list(named.values()),
            list(named),
            loc="outside lower center",
            ncols=6,
            frameon=False,
            fontsize=9,
        )
    title = f"Driven by {agent}: error of the prediction against the drive (dashed: {REFERENCE})"
    head_chart(figure, title, 12)
    save_figure(figure, paths)


def _point(axes: Axes, error: Score, drive: Score, name: str, colour: str, marker: str) -> None:
    if error.value is None or drive.value is None:
        return
    axes.errorbar(
        [error.value],
        [drive.value],
        xerr=_beside(error),
        yerr=_beside(drive),
        fmt=marker,
        ms=5.5,
        clip_on=False,  # none at all is on the edge
        lw=1.2,
        color=colour,
        label=name.replace("_", " "),
    )


def _beside(score: Score) -> list[list[float]] | None:
    """How far the interval reaches to both sides, as matplotlib has it."""
    if score.value is None or score.low is None or score.high is None:
        return None
    return [[max(score.value - score.low, 0.0)], [max(score.high - score.value, 0.0)]]
