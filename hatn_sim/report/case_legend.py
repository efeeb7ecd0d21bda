"""What the signs in the figure of a case mean, and its scale."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch, Rectangle

from hatn_sim.report.canvas import INK, signal_look
from hatn_sim.report.case_cast import BLACK, COLOURS
from hatn_sim.report.case_map import PALE, PALE_EDGE, shade
from hatn_sim.report.label_width import width_pt

SCALE_M: Final = 10.0
FONT_PT: Final = 6.2
GAP_IN: Final = 0.05
NEXT_IN: Final = 0.16
CAR_IN: Final = 0.16
TEXT: Final[dict[str, Any]] = {"fontsize": FONT_PT, "color": INK, "va": "center"}


def draw_legend(
    page: Axes,
    span_in: tuple[float, float],
    height_in: float,
    points_per_m: float,
    note: str = "",
    has_signals: bool = False,
) -> None:
    """Two lines at the foot of a page in inches, with a note, and a bar as long as `SCALE_M` is."""
    blue, upper, lower = COLOURS[1], 0.68 * height_in, 0.28 * height_in
    x = span_in[0]
    x = _car(page, x, upper, BLACK, BLACK, "ego")
    x = _car(page, x, upper, COLOURS[0], COLOURS[0], "met, each in its colour")
    x = _car(page, x, upper, PALE, PALE_EDGE, "other")
    for k, chance in enumerate((0.05, 0.35, 0.65, 0.95)):
        slot = Rectangle((x + 0.14 * k, upper - 0.04), 0.12, 0.08, facecolor=shade(blue, chance))
        slot.set(edgecolor=blue, linewidth=0.7, linestyle=(0.0, (2.2, 1.2)))
        page.add_patch(slot)
    x = _words(page, x + 0.54, upper, "slot and node: darker is likelier")
    page.plot([x + 0.03], [upper], "o", ms=3.2, mfc="white", mec=PALE_EDGE, mew=0.5)
    x = _words(page, x + 0.06, upper, "of another conflict")
    for is_closed, words in ((True, "signal closed"), (False, "open")) if has_signals else ():
        bar = (x, upper - 0.02), 0.12, 0.04
        page.add_patch(Rectangle(*bar, **signal_look(is_closed)))
        x = _words(page, x + 0.12, upper, words) - 0.04

    x = span_in[0]
    along = np.linspace(x, x + 0.3, 4)
    page.plot(along, np.full(4, lower), color=blue, alpha=0.55, lw=2.0, solid_capstyle="butt")
    page.plot(along[1:], np.full(3, lower), "o", color=blue, ms=2.8, mec="none")
    x = _words(page, x + 0.32, lower, "predicted, 3 s, a dot each 0.5 s")
    page.plot([x, x + 0.26], [lower, lower], color=INK, lw=0.55)
    page.plot([x + 0.26], [lower], "o", ms=2.6, mfc="white", mec=INK, mew=0.55)
    x = _words(page, x + 0.28, lower, "what happened")
    page.plot([x + 0.03], [lower], "D", ms=3.4, mfc=INK, mec="white", mew=0.5)
    x = _words(page, x + 0.06, lower, "conflict")
    _words(page, x, lower, note)

    right, long_in = span_in[1], SCALE_M * points_per_m / 72.0
    ends = [right - long_in, right]
    page.plot(ends, [lower, lower], color=INK, lw=1.4, solid_capstyle="butt")
    page.text(ends[0] - GAP_IN, lower, f"{SCALE_M:g} m", ha="right", **TEXT)


def _car(page: Axes, x: float, y: float, colour: str, edge: str, words: str) -> float:
    """A vehicle and what it means; returns where the next sign begins."""
    shape = "round,pad=0,rounding_size=0.025"
    car = FancyBboxPatch((x, y - 0.03), CAR_IN, 0.06, boxstyle=shape)
    car.set(facecolor=colour, edgecolor=edge, linewidth=0.5)
    page.add_patch(car)
    return _words(page, x + CAR_IN, y, words)


def _words(page: Axes, x: float, y: float, words: str) -> float:
    """Words after a sign; returns where the next sign begins."""
    page.text(x + GAP_IN, y, words, **TEXT)
    return x + GAP_IN + width_pt(words, FONT_PT) / 72.0 + NEXT_IN
