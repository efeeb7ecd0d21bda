"""Recall and lead time of alert rules over their false alarms, a row for each scene (PNG, PDF).

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter
from matplotlib.transforms import offset_copy

from hatn_sim.config import DEFAULT_RISK
from hatn_sim.datatypes import Score
from hatn_sim.report.canvas import INK
from hatn_sim.report.figures import COLOURS, dress, head_chart, new_chart, rule, save_figure
from hatn_sim.score.assistance import FALSE_ALARMS
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
COMPARED: Final = "where the table compares, 95 % interval (none where all runs came to the same)"
WHISKER: Final[dict[str, Any]] = {
    "lw": 0.9, "marker": "D", "ms": 4.0, "mfc": "white", "mew": 0.9,
}  # fmt: skip
ASIDE_PT: Final = 2.4
"""Whiskers stand so far beside each other."""
LEAST_PER_HOUR: Final = 0.1
"""The axis is linear below and logarithmic above, so that no false alarm at all has a place."""


def draw_curves(
    curves: Mapping[str, Mapping[str, Sequence[Operating]]],
    paths: Sequence[Path],
    scores: Sequence[Score],
) -> None:
    """Draw scene -> rule -> operating points into files, in the format that their suffix names.

    Of how many events recall is, and how sure it is at the threshold at which rules are compared,
    is told by the scores made with the curves.
    """
    events, compared = events_by_scene(scores), compared_by_scene(scores)
    figure = new_chart((WIDTH_IN, EDGES_IN + ROW_IN * len(curves)))
    grid = figure.subplots(len(curves), len(PANELS), squeeze=False)
    for row, (scene, of_rule) in zip(grid, curves.items(), strict=True):
        for axes, measure in zip(row, PANELS, strict=True):
            _panel(axes, of_rule, measure, compared.get(scene, {}))
        count = f"\n{events[scene]} event{'s' * (events[scene] != 1)}" if scene in events else ""
        row[0].set_ylabel(f"{scene}{count}", color=INK, weight="bold", fontsize=LABEL_PT)
    for axes, title in zip(grid[0], PANELS.values(), strict=True):
        axes.set_title(title, loc="left", fontsize=10.0, color=INK)
    for axes in grid[-1]:
        axes.set_xlabel("false alarms per vehicle-hour", color=INK, fontsize=LABEL_PT)
    handles = list(grid[0][0].get_legend_handles_labels()[0])
    if compared:
        handles.append(Line2D([], [], color=INK, label=COMPARED, **WHISKER, ls="-"))
    if handles:
        figure.legend(
            handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=LABEL_PT
        )
    head_chart(figure, "Alert rules at all their thresholds", 13)
    save_figure(figure, paths)


def events_by_scene(scores: Sequence[Score]) -> dict[str, int]:
    """Scene -> the events that recall is of, of all drivers."""
    of_scene: dict[str, list[Score]] = {}
    for one in scores:
        if one.measure == "event_recall":
            of_scene.setdefault(one.scene, []).append(one)
    found: dict[str, int] = {}
    for scene, recall in of_scene.items():
        of_all = [one for one in recall if one.subset == "all"]
        found[scene] = max(one.n for one in of_all or recall)  # without "all" drivers are alike
    return found


Compared = Mapping[tuple[str, str], Score]
"""Rule and measure -> the score at the threshold at which rules are compared."""


def compared_by_scene(scores: Sequence[Score]) -> Mapping[str, Compared]:
    """Scene -> where and how sure each rule is: of all drivers, as `all` of the printed table.

    False alarms, which say where a whisker stands, are those of the courteous, where there are
    some, as in the curves; the table's `all` has those of everybody. A value that is None stays so.
    """
    found: dict[str, dict[tuple[str, str], Score]] = {}
    for one in sorted(scores, key=lambda one: one.subset == "all"):
        if one.measure not in (*PANELS, FALSE_ALARMS):
            continue
        of_scene, key = found.setdefault(one.scene, {}), (one.predictor, one.measure)
        before = of_scene.get(key)
        keeps = one.measure == FALSE_ALARMS and before and before.subset == DEFAULT_RISK
        if not keeps or one.subset == DEFAULT_RISK:
            of_scene[key] = one
    return found


def _panel(
    axes: Axes, of_rule: Mapping[str, Sequence[Operating]], measure: str, compared: Compared
) -> None:
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
            zorder=3.0 - 0.01 * number,  # ours over the others
        )
        _interval(axes, compared, name, measure, number, len(of_rule))


def _interval(
    axes: Axes, compared: Compared, name: str, measure: str, number: int, count: int
) -> None:
    """A whisker at the threshold at which the rule is compared, beside those of the others."""
    score, at = compared.get((name, measure)), compared.get((name, FALSE_ALARMS))
    if score is None or at is None or score.value is None or at.value is None:
        return
    figure = axes.get_figure(root=True)
    assert figure is not None
    aside_pt = ASIDE_PT * (number - 0.5 * (count - 1))
    place = offset_copy(axes.transData, figure, aside_pt, 0.0, units="points")
    look: dict[str, Any] = {
        "color": COLOURS[number % len(COLOURS)],
        "transform": place,
        "zorder": 4.0 - 0.01 * number,
    }
    if score.low is not None and score.high is not None and score.low < score.high:
        axes.plot([at.value] * 2, [score.low, score.high], lw=WHISKER["lw"], **look)
    axes.plot([at.value], [score.value], ls="", clip_on=False, **{**WHISKER, **look})
