"""How a policy learnt to cross: time and collisions over the decisions it took, as a PNG.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes

from hatn_sim.report.canvas import INK, SOFT_INK, plain
from hatn_sim.report.figures import dress, head_chart, new_chart, rule, save_figure

SIZE_IN: Final = (7.5, 4.2)
LEARNT: Final = "#d55e00"
COLLIDED: Final = "#0072b2"
LABEL_PT: Final = 8.5
LINE_HEIGHT: Final = 1.3
ABOVE_IN: Final = 2.2
"""About the height of the upper panel."""


def draw_learning(
    title: str,
    thousands: np.ndarray,
    time_s: np.ndarray,
    collided: np.ndarray,
    marks_s: Mapping[str, float],
    path: Path,
) -> None:
    """Draw the curves [R]: seconds until an episode's end and the share of those that collided.

    `thousands` of decisions were taken until then; `marks_s` are the times of other drivers.
    """
    figure = new_chart(SIZE_IN)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot(thousands, time_s, color=LEARNT, linewidth=1.8)
    for seconds in marks_s.values():
        above.axhline(seconds, color=SOFT_INK, linewidth=1.0, linestyle="--")
    above.set_ylim(bottom=0.0)
    least_s = LABEL_PT * LINE_HEIGHT / (72.0 * ABOVE_IN) * above.get_ylim()[1]
    for (name, seconds), at_s in zip(
        marks_s.items(), spread(list(marks_s.values()), least_s), strict=True
    ):
        above.annotate(
            plain(f"{name} {seconds:.1f} s"),
            (1.0, seconds),
            xycoords=("axes fraction", "data"),
            xytext=(1.02, at_s),
            textcoords=("axes fraction", "data"),
            arrowprops={
                "arrowstyle": "-",
                "color": SOFT_INK,
                "lw": 0.8,
                "shrinkA": 0,
                "shrinkB": 0,
            },
            va="center",
            fontsize=LABEL_PT,
            color=INK,
        )
    below.plot(thousands, 100.0 * collided, color=COLLIDED, linewidth=1.8)
    below.set_ylim(bottom=0.0, top=max(10.0, 110.0 * float(collided.max())))
    _name(above, "s to cross")
    _name(below, "% collided")
    below.set_xlabel("decisions, thousands", color=INK)
    head_chart(figure, title, 12)
    save_figure(figure, [path])


def spread(values: Sequence[float], least: float) -> list[float]:
    """Places for labels of these values: in their order, each at least so far from the next.

    Those too near to each other are moved apart evenly, around their mean.
    """
    order = sorted(range(len(values)), key=values.__getitem__)
    groups: list[list[int]] = []
    for k in order:
        groups.append([k])
        while len(groups) > 1 and _top(groups[-2], values, least) > _foot(
            groups[-1], values, least
        ):
            groups[-2:] = [groups[-2] + groups[-1]]
    places = list(values)
    for group in groups:
        foot = _foot(group, values, least) + 0.5 * least
        for n, k in enumerate(group):
            places[k] = foot + n * least
    return places


def _foot(group: Sequence[int], values: Sequence[float], least: float) -> float:
    return float(np.mean([values[k] for k in group])) - 0.5 * least * len(group)


def _top(group: Sequence[int], values: Sequence[float], least: float) -> float:
    return _foot(group, values, least) + least * len(group)


def _name(axes: Axes, what: str) -> None:
    dress(axes, 8.5)
    rule(axes)
    axes.set_ylabel(what, color=INK)
