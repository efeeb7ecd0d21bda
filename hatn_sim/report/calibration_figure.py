"""How often slots were taken that were said to be taken with so much: a panel for each answer.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from hatn_sim.report.canvas import INK, SOFT_INK
from hatn_sim.report.figures import (
    COLOURS,
    LABEL_PT,
    NOTE_PT,
    PAGE_IN,
    TICK_PT,
    TITLE_PT,
    dress,
    head_chart,
    new_chart,
    rule,
    save_figure,
)
from hatn_sim.score.slot_calibration import ANSWERS, Reliability

HEIGHT_IN: Final = 4.3
FEW: Final = 5
"""Points of fewer samples are hollow, without interval."""


def draw_calibration(found: Sequence[Reliability], where: str, paths: Sequence[Path]) -> None:
    """Draw reliability over how many samples there are; bars are 95 % intervals over vehicles."""
    names = list(dict.fromkeys(one.predictor for one in found))
    figure = new_chart((PAGE_IN, HEIGHT_IN))
    above, below = figure.subplots(2, len(ANSWERS), sharex=True, height_ratios=(4, 1))
    for axes, counts, (answer, title) in zip(above, below, ANSWERS.items(), strict=True):
        axes.plot([0, 1], [0, 1], color=SOFT_INK, lw=0.8, ls="--")
        of_answer = [one for one in found if one.answer == answer]
        for one in of_answer:
            number = names.index(one.predictor)
            _points(axes, one, COLOURS[number % len(COLOURS)])
            _counts(counts, one, number, len(names))
        axes.set_title(
            f"Probability given to {_object(answer, title)}",
            fontsize=LABEL_PT + 0.5,
            loc="left",
            color=INK,
        )
        _dress(axes)
        dress(counts, TICK_PT)
        rule(counts)
        counts.set_xlim(0.0, 1.0)
        counts.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        counts.set_xlabel("said", fontsize=LABEL_PT, color=INK)
        # Below the panel: over it, it would cover points.
        handles, _ = axes.get_legend_handles_labels()
        counts.legend(
            handles=[*handles, *(_signs() if axes is above[0] else ())],
            frameon=False,
            fontsize=NOTE_PT,
            labelcolor=INK,
            loc="upper left",
            bbox_to_anchor=(0.0, -0.75),
            borderaxespad=0.0,
        )
    above[0].set_ylabel("came true", fontsize=LABEL_PT, color=INK)
    below[0].set_ylabel("samples", fontsize=LABEL_PT, color=INK)
    head_chart(figure, f"Calibration of slot probabilities: {where}", TITLE_PT)
    save_figure(figure, paths)


def _signs() -> list[Line2D]:
    """What is not a predictor in the legend."""
    grey: dict[str, Any] = {"color": SOFT_INK, "ls": ""}
    hollow: dict[str, Any] = {"marker": "o", "ms": 3.2, "mfc": "white", "mew": 0.7}
    return [
        Line2D([], [], marker="|", ms=7.0, mew=0.9, label="95 % interval over vehicles", **grey),
        Line2D([], [], label=f"fewer than {FEW} samples: no interval", **grey, **hollow),
        Line2D([], [], color=SOFT_INK, lw=0.8, ls="--", label="came true as often as said"),
    ]


def _object(answer: str, title: str) -> str:
    return "yielding" if answer == "yield" else title


def _points(axes: Axes, one: Reliability, colour: str) -> None:
    """What there are enough samples of, with intervals; the others are hollow."""
    many = one.n >= FEW
    few = (one.n > 0) & ~many
    reach = np.stack((one.came_true - one.low, one.high - one.came_true))
    bars = np.nan_to_num(np.maximum(reach, 0.0))[:, many]
    axes.errorbar(
        one.said[many], one.came_true[many], yerr=bars, fmt="none", ecolor=colour, elinewidth=0.9
    )
    name = f"{one.predictor.replace('_', ' ')}: ECE {100.0 * one.ece:.1f} %, n = {one.n.sum():,}"
    axes.plot(
        one.said[many],
        one.came_true[many],
        "o",
        color=colour,
        ms=4.0,
        label=name,
        clip_on=False,
        zorder=3,
    )
    axes.plot(
        one.said[few],
        one.came_true[few],
        "o",
        ms=3.2,
        mfc="white",
        mec=colour,
        mew=0.7,
        clip_on=False,
    )


def _counts(axes: Axes, one: Reliability, number: int, of: int) -> None:
    bins = len(one.n)
    left = (np.arange(bins) + 0.08 + 0.84 * number / of) / bins
    axes.bar(left, one.n, 0.84 / bins / of, align="edge", color=COLOURS[number % len(COLOURS)])


def _dress(axes: Axes) -> None:
    dress(axes, TICK_PT)
    rule(axes)
    axes.set_ylim(-0.03, 1.03)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
