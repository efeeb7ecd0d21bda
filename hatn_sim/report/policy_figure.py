"""How a policy learnt to cross: time and collisions over the decisions it took, as a PNG.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes

from hatn_sim.report.canvas import INK, SOFT_INK
from hatn_sim.report.figures import dress, head_chart, new_chart, rule, save_figure

SIZE_IN: Final = (7.5, 4.2)
LEARNT: Final = "#d55e00"
COLLIDED: Final = "#0072b2"


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
    for name, seconds in marks_s.items():
        above.axhline(seconds, color=SOFT_INK, linewidth=1.0, linestyle="--")
        above.annotate(
            f"{name} {seconds:.1f} s",
            (0.0, seconds),  # where nothing has been learnt yet the curve is far above
            xycoords=("axes fraction", "data"),
            xytext=(2, -11),
            textcoords="offset points",
            ha="left",
            fontsize=8.5,
            color=INK,
        )
    above.set_ylim(bottom=0.0)
    below.plot(thousands, 100.0 * collided, color=COLLIDED, linewidth=1.8)
    below.set_ylim(bottom=0.0, top=max(10.0, 110.0 * float(collided.max())))
    _name(above, "s to cross")
    _name(below, "% collided")
    below.set_xlabel("decisions, thousands", color=INK)
    head_chart(figure, title, 12)
    save_figure(figure, [path])


def _name(axes: Axes, what: str) -> None:
    dress(axes, 8.5)
    rule(axes)
    axes.set_ylabel(what, color=INK)
