"""A moment drawn on a sheet: slots, paths, vehicles, labels, caption. All that moves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from hatn_sim.datatypes import FloatArray
from hatn_sim.report.canvas import (
    ACTUAL,
    ALERT,
    ASPHALT,
    INK,
    PAPER,
    PREDICTED,
    PROBABILITY,
    SOFT_INK,
    Sheet,
    columns,
    draw_keys,
    mixed,
    plain,
    quad,
    signal_look,
)
from hatn_sim.report.drawing_labels import draw_labels
from hatn_sim.report.drawing_vehicles import draw_vehicles
from hatn_sim.report.label_width import fitting_pt
from hatn_sim.report.moment import Moment, moves
from hatn_sim.report.road_shapes import lamps_in
from hatn_sim.report.vehicle_shapes import placed, rounded

STRIP_HALF_M: Final = 1.05
STRIP_ALPHA: Final = 0.86
WAY_POINT_FRAMES: Final = 5
CORNER_IN: Final = 0.1
FIELD_PAD: Final = 0.35
"""Of the field of an alert, around its words, in their size."""


def draw_moment_on(
    sheet: Sheet,
    moment: Moment,
    caption: str,
    labels_before: Mapping[str, FloatArray] | None = None,
    blinking: bool = False,
) -> tuple[list[Artist], dict[str, FloatArray]]:
    """Draws a moment; returns what was drawn, in drawing order, and the labels' offsets.

    Args:
        sheet: to draw on.
        moment: to be drawn.
        caption: second line of the header.
        labels_before: offsets this function returned for the frame before.
        blinking: blinkers go on and off with the time, as in a film.
    """
    artists = [
        *_draw_signals(sheet, moment),
        *_draw_slots(sheet, moment),
        *_draw_forecasts(sheet, moment),
        *draw_vehicles(sheet, moment, blinking),
        *_draw_conflicts(sheet, moment),
        *_draw_frame(sheet),
        *_draw_header(sheet, moment, caption),
        *draw_keys(
            sheet,
            bool(lamps_in(sheet.shapes, sheet.box, moment.scene)),
            bool(moment.alerts),
        ),
    ]
    labels, offsets = draw_labels(sheet, moment, labels_before)
    return [*artists, *labels], offsets


def _draw_signals(sheet: Sheet, moment: Moment) -> list[Artist]:
    shown = lamps_in(sheet.shapes, sheet.box, moment.scene)
    bars = [
        PolyCollection([line.corners_xy_m], **signal_look(is_closed), zorder=3.2)
        for line, is_closed in shown
    ]
    return [sheet.map.add_collection(bar) for bar in bars]


def _draw_slots(sheet: Sheet, moment: Moment) -> list[Artist]:
    strip_of = {slot.rear_id: slot.strip_xy_m for slot in moment.slots}
    choice = moment.choice
    others = [slot for slot in moment.slots if not slot.in_focus]
    colours = [PROBABILITY(chance) for chance in choice.values()]
    faint = PolyCollection(
        [quad(_visible(slot.strip_xy_m), STRIP_HALF_M) for slot in others],
        facecolors=(1.0, 1.0, 1.0, 0.07),
        edgecolors=(1.0, 1.0, 1.0, 0.4),
        linewidths=0.7,
        linestyles=[(0.0, (3.0, 2.0))],
        zorder=4,
    )
    strips = PolyCollection(
        [quad(_visible(strip_of[rear_id]), STRIP_HALF_M) for rear_id in choice],
        facecolors=[(*colour[:3], STRIP_ALPHA) for colour in colours],
        edgecolors=[(*mixed(colour[:3], (1.0, 1.0, 1.0), 0.55), 1.0) for colour in colours],
        linewidths=0.8,
        zorder=5,
    )
    return [sheet.map.add_collection(faint), sheet.map.add_collection(strips)]


def _visible(strip_xy_m: FloatArray) -> FloatArray:
    """A slot without room (a vehicle at its stop line) is shown as a narrow bar."""
    along = strip_xy_m[-1] - strip_xy_m[0]
    length_m = float(np.linalg.norm(along))
    if length_m >= 0.5 or length_m == 0.0:
        return strip_xy_m
    return np.stack((strip_xy_m[0], strip_xy_m[0] + along / length_m * 0.5))


def _draw_forecasts(sheet: Sheet, moment: Moment) -> list[Artist]:
    shown = moment.involved
    segments: list[FloatArray] = []
    colours: list[tuple[float, ...]] = []
    dots: list[FloatArray] = []
    dot_colours: list[tuple[float, ...]] = []
    happened: list[FloatArray] = []
    happened_alpha: list[float] = []
    for vehicle_id, forecast in moment.forecasts.items():
        strength = 1.0 if vehicle_id in shown else 0.4
        if moves(forecast.actual_xy_m):
            happened.append(forecast.actual_xy_m)
            happened_alpha.append(strength)
        for path, chance in forecast.paths_to_draw():
            fade = strength * chance * np.linspace(1.0, 0.3, len(path))
            segments += [path[k : k + 2] for k in range(len(path) - 1)]
            colours += [(*to_rgb(PREDICTED), alpha) for alpha in fade[1:]]
            dots += list(path[WAY_POINT_FRAMES::WAY_POINT_FRAMES])
            dot_colours += [
                (*to_rgb(PREDICTED), min(1.0, alpha + 0.25 * strength))
                for alpha in fade[WAY_POINT_FRAMES::WAY_POINT_FRAMES]
            ]
    scale = sheet.points_per_m
    edge = LineCollection(
        segments,
        colors=[(*to_rgb(INK), 0.5 * colour[3]) for colour in colours],
        linewidths=0.66 * scale,
        capstyle="butt",
        zorder=5.9,
    )
    predicted = LineCollection(
        segments, colors=colours, linewidths=0.5 * scale, capstyle="butt", zorder=6
    )
    # Round on the map: a way point is 0.9 m wide.
    way_points = sheet.map.scatter(
        *columns(dots),
        s=(0.85 * scale) ** 2,
        c=dot_colours or None,
        linewidths=0.0,
        zorder=7,
    )
    casing = LineCollection(
        happened,
        colors=[(*to_rgb(INK), 0.45 * alpha) for alpha in happened_alpha],
        linewidths=0.34 * scale,
        zorder=7.4,
    )
    actual = LineCollection(
        happened,
        colors=[(*to_rgb(ACTUAL), alpha) for alpha in happened_alpha],
        linewidths=0.17 * scale,
        zorder=7.5,
    )
    ends = sheet.map.scatter(
        *columns([path[-1] for path in happened]),
        s=(0.75 * scale) ** 2,
        facecolors=ASPHALT,
        edgecolors=[(*to_rgb(ACTUAL), max(alpha, 0.5)) for alpha in happened_alpha] or ACTUAL,
        linewidths=0.17 * scale,
        zorder=7.6,
    )
    axes = sheet.map
    return [
        axes.add_collection(edge),
        axes.add_collection(predicted),
        way_points,
        axes.add_collection(casing),
        axes.add_collection(actual),
        ends,
    ]


def _draw_conflicts(sheet: Sheet, moment: Moment) -> list[Artist]:
    points = [
        slot.conflict_xy_m
        for slot in moment.slots
        if slot.in_focus and slot.conflict_xy_m is not None and not slot.is_own
    ]
    marks = sheet.map.scatter(
        *columns(points),
        s=(0.9 * sheet.points_per_m) ** 2,
        marker="D",
        facecolors=INK,
        edgecolors="white",
        linewidths=0.16 * sheet.points_per_m,
        zorder=9,
    )
    return [marks]


def _draw_frame(sheet: Sheet) -> list[Artist]:
    """Paper over the map's corners: they are round."""
    box = sheet.box
    wide_m, high_m = box.east_m - box.west_m, box.north_m - box.south_m
    centre = np.array([box.west_m, box.south_m]) + 0.5 * np.array([wide_m, high_m])
    radius_m = CORNER_IN * 72.0 / sheet.points_per_m
    hole = placed(rounded(-0.5 * wide_m, 0.5 * wide_m, high_m, radius_m), centre, 0.0)
    around = placed(rounded(-wide_m, wide_m, 2.0 * high_m, 0.0), centre, 0.0)
    ring = Outline.make_compound_path(*(Outline(p, closed=True) for p in (around, hole[::-1])))
    return [sheet.map.add_patch(PathPatch(ring, facecolor=PAPER, linewidth=0.0, zorder=30))]


def _draw_header(sheet: Sheet, moment: Moment, caption: str) -> list[Artist]:
    """What the ego is told, an alert in a red field; below it, what this is a picture of."""
    style, page = sheet.style, sheet.page
    top, wide_pt = style.height_in, 72.0 * (style.width_in - 2.0 * style.margin_in)
    said, words, size_pt = moment.suggestion, moment.headline, 1.5 * style.font_pt
    title: dict[str, Any] = {"fontweight": "bold", "va": "center", "color": INK}
    left = style.margin_in
    if words is None:
        words = "No advice needed right now" if moment.is_advised else "Driven without advice"
        title["color"] = SOFT_INK
    elif moment.alarmed:
        words, inset_pt = f"\u26a0  {words}", FIELD_PAD * size_pt
        left, wide_pt = left + inset_pt / 72.0, wide_pt - 2.0 * inset_pt
        box = {"boxstyle": f"round,pad={FIELD_PAD}", "facecolor": ALERT, "edgecolor": ALERT}
        title |= {"color": "white", "bbox": box}
    else:
        words = f"\u201c{words}\u201d"
        age_s = 0.0 if said is None else moment.scene.time_s - said.time_s
        caption += f"  ·  advised {age_s:.1f} s before" if age_s > 0.25 else ""
    words, caption = plain(words), plain(caption)
    return [
        page.text(
            left,
            top - 0.36 * style.header_in,
            words,
            fontsize=fitting_pt(words, size_pt, wide_pt, bold=True),
            **title,
        ),
        page.text(
            style.margin_in,
            top - 0.74 * style.header_in,
            caption,
            fontsize=fitting_pt(
                caption, 0.95 * style.font_pt, 72.0 * (style.width_in - 2.0 * style.margin_in)
            ),
            color=SOFT_INK,
            va="center",
        ),
    ]
