"""Recall and lead time of alert rules over their false alarms, a row for each scene (PNG, PDF).

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from hatn_sim.datatypes import Score
from hatn_sim.report.canvas import INK
from hatn_sim.report.figures import COLOURS, dress, head_chart, new_chart, rule, save_figure
from hatn_sim.score.sweep import Operating

PANELS: Final = {
    "event_recall": "events preceded by an alert",
    "recall_1s5": "preceded by 1.5 s or more",
    "lead_time_s": "median lead time in s",
}
WIDTH_IN: Final = 11.0
ROW_IN: Final = 2.6
EDGES_IN: Final = 1.1
LABEL_PT: Final = 8.5
LEAST_PER_HOUR: Final = 0.1
"""The axis is linear below and logarithmic above, so that no false alarm at all has a place."""


def draw_curves(
    curves: Mapping[str, Mapping[str, Sequence[Operating]]],
    paths: Sequence[Path],
    scores: Sequence[Score],
) -> None:
    """Draw scene -> rule -> operating points into files, in the format that their suffix names.

    Of how many events recall is, is told by the scores made with the curves.
    """
    events = events_by_scene(scores)
    figure = new_chart((WIDTH_IN, EDGES_IN + ROW_IN * len(curves)))
    grid = figure.subplots(len(curves), len(PANELS), squeeze=False)
    for row, (scene, of_rule) in zip(grid, curves.items(), strict=True):
        for axes, measure in zip(row, PANELS, strict=True):
            _panel(axes, of_rule, measure)
        count = f"\n{events[scene]} event{'s' * (events[scene] != 1)}" if scene in events else ""
        row[0].set_ylabel(f"{scene}{count}", color=INK, weight="bold", fontsize=LABEL_PT)
    for axes, title in zip(grid[0], PANELS.values(), strict=True):
        axes.set_title(title, loc="left", fontsize=10.0, color=INK)
    for axes in grid[-1]:
        axes.set_xlabel("false alarms per vehicle-hour", color=INK, fontsize=LABEL_PT)
    handles, labels = grid[0][0].get_legend_handles_labels()
    if handles:
        figure.legend(
            handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=LABEL_PT
        )
    head_chart(figure, "Alert rules at all their thresholds", 13)
    save_figure(figure, paths)


def events_by_scene(scores: Sequence[Score]) -> dict[str, int]:
    """Scene -> the events that recall is of, of all drivers."""
    recall = [one for one in scores if (one.measure, one.subset) == ("event_recall", "all")]
    scenes = dict.fromkeys(one.scene for one in recall)
    return {scene: max(one.n for one in recall if one.scene == scene) for scene in scenes}


def _panel(axes: Axes, of_rule: Mapping[str, Sequence[Operating]], measure: str) -> None:
    dress(axes, LABEL_PT)
    rule(axes)
    axes.set_xscale("symlog", linthresh=LEAST_PER_HOUR, linscale=0.4)
    axes.set_xlim(0.0, 1000.0)
    if measure != "lead_time_s":
        axes.set_ylim(0.0, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.axvline(1.0, color="#c9c9c4", lw=0.8, zorder=0)
    for number, (name, curve) in enumerate(of_rule.items()):
        points = sorted((one.false_alarms_per_hour, getattr(one, measure)) for one in curve)
        axes.plot(
            [x for x, _ in points],
            [y for _, y in points],
            color=COLOURS[number % len(COLOURS)],
            lw=1.8 if number == 0 else 1.2,
            marker="o",
            ms=2.0,
            label=name.replace("_", " "),
        )
