"""What an alert tells the ego of a moment, in a red field over the map's upper left corner."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.artist import Artist

from hatn_sim.datatypes import FloatArray
from hatn_sim.report.canvas import ALERT, Sheet, Style
from hatn_sim.report.label_width import HINTED, fitting_pt, width_pt
from hatn_sim.report.moment import Moment

SIZE: Final = 1.25
"""Of its letters, in those of the sheet."""
PAD: Final = 0.55
"""Around its words, in their size; the field itself is as far from the border."""
WEIGHT: Final = 6
"""How much labels shun it: as many points at each place."""


def covered_in(style: Style) -> float:
    """How far down from the map's upper border the field reaches, at most, in inches."""
    return (1.3 + 3.0 * PAD) * SIZE * style.font_pt / 72.0


def draw_warning(sheet: Sheet, moment: Moment) -> list[Artist]:
    """The field; nothing where no alert warns the ego."""
    words, size_pt = _words(sheet, moment)
    if not words:
        return []
    style, inset_in = sheet.style, 2.0 * PAD * size_pt / 72.0
    text = sheet.page.text(
        style.margin_in + inset_in,
        style.height_in - style.header_in - inset_in,
        words,
        fontsize=size_pt,
        fontweight="bold",
        color="white",
        va="top",
        bbox={"boxstyle": f"round,pad={PAD}", "facecolor": ALERT, "edgecolor": "white"},
        zorder=40,
    )
    return [text]


def warning_xy_m(sheet: Sheet, moment: Moment) -> FloatArray:
    """[P, 2] places on the map that the field covers; labels had better not."""
    words, size_pt = _words(sheet, moment)
    if not words:
        return np.zeros((0, 2))
    wide_m, high_m = (
        length_pt / sheet.points_per_m
        for length_pt in (
            HINTED * width_pt(words, size_pt, bold=True) + 3.0 * PAD * size_pt,
            (1.0 + 3.0 * PAD) * size_pt,
        )
    )
    x, y = np.meshgrid(
        sheet.box.west_m + np.arange(0.0, wide_m + 0.5, 0.5),
        sheet.box.north_m - np.arange(0.0, high_m + 0.5, 0.5),
    )
    return np.repeat(np.stack((x.ravel(), y.ravel()), axis=1), WEIGHT, axis=0)


def _words(sheet: Sheet, moment: Moment) -> tuple[str, float]:
    """What it says, and in which size; nothing: there is no field."""
    warning, style = moment.warning, sheet.style
    size_pt = SIZE * style.font_pt
    if warning is None:
        return "", size_pt
    words = f"\u26a0  {warning.text or 'Alert'}"
    wide_pt = 72.0 * (style.width_in - 2.0 * style.margin_in) - 4.0 * PAD * size_pt
    return words, fitting_pt(words, size_pt, wide_pt, bold=True)
