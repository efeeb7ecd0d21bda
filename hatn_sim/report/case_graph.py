"""The semantic graph under a case's panel: a node for each slot, the darker the likelier."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle

from hatn_sim.datatypes import FloatArray
from hatn_sim.report.canvas import INK, mixed
from hatn_sim.report.case_cast import Part
from hatn_sim.report.case_map import PALE_EDGE, WHITE, shade
from hatn_sim.report.moment import Moment, Slot

NODE_IN: Final = 0.13
SMALL_IN: Final = 0.045
"""Radii of nodes to choose from, and of those of other conflicts."""
EDGE: Final = "#b9bdc1"
NAME_PT: Final = 6.0
SHARE_PT: Final = 5.2


def draw_graph(
    axes: Axes, moment: Moment, cast: Mapping[str, Part], size_in: tuple[float, float]
) -> None:
    """Draws on axes in inches, their origin in the middle."""
    width, height = size_in
    axes.set(xlim=(-0.5 * width, 0.5 * width), ylim=(-0.5 * height, 0.5 * height))
    axes.set_axis_off()
    slots = sorted(moment.slots, key=lambda slot: _order(slot, cast))
    if not any(slot.in_focus and not slot.is_own for slot in slots):
        slots = [slot for slot in slots if slot.is_own]
    places = _around(len(slots), (0.5 * width - NODE_IN - 0.02, 0.5 * height - NODE_IN - 0.06))
    radii = [NODE_IN if _shown(slot) else SMALL_IN for slot in slots]
    lines = [(places[a], places[b]) for a, b in combinations(range(len(slots)), 2)]
    strong = [_shown(slots[a]) and _shown(slots[b]) for a, b in combinations(range(len(slots)), 2)]
    axes.add_collection(
        LineCollection(
            lines,
            colors=[EDGE if both else mixed(to_rgb(EDGE), WHITE, 0.55) for both in strong],
            linewidths=[0.7 if both else 0.4 for both in strong],
            zorder=1,
        )
    )
    for slot, (x, y), radius in zip(slots, places, radii, strict=True):
        _draw_node(axes, slot, (float(x), float(y)), radius, cast)


def _shown(slot: Slot) -> bool:
    return slot.in_focus or slot.is_own


def _order(slot: Slot, cast: Mapping[str, Part]) -> tuple[bool, int, str]:
    """The ego's own first, then as they are named; nodes of other conflicts last."""
    name = cast[slot.rear_id].name if _shown(slot) else "A0"
    return not _shown(slot), int(name[1:]), slot.rear_id


def _around(count: int, radii_in: tuple[float, float]) -> FloatArray:
    """[count, 2] places on an ellipse as far from each other, the first on the left, clockwise."""
    if count <= 1:
        return np.zeros((count, 2))
    wide = radii_in[0] * min(1.0, (count + 2) / 8.0)
    angle = np.pi - np.linspace(0.0, 2.0 * np.pi, 721)
    rim = np.stack((wide * np.cos(angle), radii_in[1] * np.sin(angle)), axis=1)
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(rim, axis=0), axis=1)))
    at = np.searchsorted(along, along[-1] * np.arange(count) / count)
    places: FloatArray = rim[at]
    return places


def _draw_node(
    axes: Axes,
    slot: Slot,
    at_in: tuple[float, float],
    radius_in: float,
    cast: Mapping[str, Part],
) -> None:
    x, y = at_in
    if not _shown(slot):
        axes.add_patch(Circle(at_in, radius_in, fc="white", ec=PALE_EDGE, lw=0.5, zorder=2))
        return
    part, chance = cast[slot.rear_id], slot.probability
    fill = shade(part.colour, 0.0 if chance is None else chance)
    axes.add_patch(
        Circle(at_in, radius_in, fc=fill, ec=part.colour, lw=0.9, ls=(0.0, (2.2, 1.1)), zorder=2)
    )
    ink = "white" if _luminance(fill) < 0.5 else INK
    up = 0.048 if chance is not None else 0.0
    text: dict[str, Any] = {"ha": "center", "va": "center_baseline", "color": ink, "zorder": 3}
    axes.text(x, y + up, part.name, fontsize=NAME_PT, fontweight="bold", **text)
    if chance is not None:
        axes.text(x, y - 0.055, f"{100.0 * chance:.0f} %", fontsize=SHARE_PT, **text)


def _luminance(colour: Sequence[float]) -> float:
    red, green, blue = colour
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue
