"""A moment drawn on a sheet: slots, paths, vehicles, labels, caption. All that moves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from hatn_sim.datatypes import FloatArray, Gate
from hatn_sim.report.canvas import (
    ACTUAL,
    ASPHALT,
    CLOSED,
    INK,
    OPEN,
    PAPER,
    PREDICTED,
    PROBABILITY,
    SOFT_INK,
    Sheet,
    columns,
    draw_alert_key,
    mixed,
    plain,
    quad,
)
from hatn_sim.report.drawing_labels import draw_labels
from hatn_sim.report.drawing_vehicles import draw_vehicles
from hatn_sim.report.drawing_warning import draw_warning
from hatn_sim.report.label_width import fitting_pt
from hatn_sim.report.moment import Moment, moves
from hatn_sim.report.vehicle_shapes import placed, rounded

STRIP_HALF_M: Final = 1.05
STRIP_ALPHA: Final = 0.86
WAY_POINT_FRAMES: Final = 5
CORNER_IN: Final = 0.1


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
        *draw_warning(sheet, moment),
        *(draw_alert_key(sheet) if moment.alerts else ()),
    ]
    labels, offsets = draw_labels(sheet, moment, labels_before)
    return [*artists, *labels], offsets


def _draw_signals(sheet: Sheet, moment: Moment) -> list[Artist]:
    closed = moment.scene.signal_closed
    bars: list[FloatArray] = []
    colours: list[str] = []
    for line in sheet.shapes.stop_lines:
        if line.gate is Gate.SIGNAL and line.signals and max(line.signals) < len(closed):
            bars.append(line.corners_xy_m)
            colours.append(CLOSED if closed[list(line.signals)].all() else OPEN)
    lamps = PolyCollection(bars, facecolors=colours, linewidths=0.0, zorder=3.2)
    return [sheet.map.add_collection(lamps)]


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
    style, page = sheet.style, sheet.page
    top = style.height_in
    said = moment.suggestion
    title, colour = "No advice needed right now", SOFT_INK
    if not moment.is_advised:
        title = "Driven without advice"
    if said is not None:
        title, colour = f"\u201c{said.text}\u201d", INK
        if (age_s := moment.scene.time_s - said.time_s) > 0.25:
            caption += f"  ·  advised {age_s:.1f} s before"
    title, caption = plain(title), plain(caption)
    wide_pt = 72.0 * (style.width_in - 2.0 * style.margin_in)
    return [
        page.text(
            style.margin_in,
            top - 0.36 * style.header_in,
            title,
            fontsize=fitting_pt(title, 1.5 * style.font_pt, wide_pt, bold=True),
            fontweight="bold",
            color=colour,
            va="center",
        ),
        page.text(
            style.margin_in,
            top - 0.74 * style.header_in,
            caption,
            fontsize=fitting_pt(caption, 0.95 * style.font_pt, wide_pt),
            color=SOFT_INK,
            va="center",
        ),
    ]
