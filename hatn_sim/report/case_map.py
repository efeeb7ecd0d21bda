"""The scene of a case's panel: black ego, vehicles met in bright colours, all others pale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle
from matplotlib.path import Path as Outline

from hatn_sim.datatypes import FloatArray, Kind, Lane
from hatn_sim.report.canvas import (
    INK,
    VERGE,
    RoadColours,
    columns,
    draw_road,
    mixed,
    quad,
    signal_look,
)
from hatn_sim.report.case_cast import Part
from hatn_sim.report.label_places import Label, place_labels
from hatn_sim.report.moment import Moment, moves
from hatn_sim.report.road_shapes import Box, RoadShapes, lamps_in, road_shapes
from hatn_sim.report.vehicle_shapes import BODY, outline, placed, vehicle_parts

PAPER_ROAD: Final = RoadColours(
    kerb="#c3c6c2", asphalt="#dcdfe1", path="#e6e4db", rail="#b5b5ae", paint="#ffffff"
)
"""Light, so that darker is likelier, and little ink is used."""
PALE: Final = "#f4f5f5"
PALE_EDGE: Final = "#9ba1a7"
WHITE: Final = (1.0, 1.0, 1.0)
STRIP_HALF_M: Final = 1.25
MIN_STRIP_M: Final = 0.8
"""A slot without room is shown as a bar this long."""
WAY_POINT_FRAMES: Final = 5
LABEL_PT: Final = 6.0


@dataclass(frozen=True, eq=False)
class MapView:
    """A part of the map, as wide as a panel."""

    box: Box
    shapes: RoadShapes
    points_per_m: float


def shade(colour: str, probability: float) -> tuple[float, float, float]:
    """A slot's colour: the likelier, the darker."""
    return mixed(to_rgb(colour), WHITE, 0.94 * (1.0 - probability))


def open_view(
    lanes: Sequence[Lane], centre_xy_m: FloatArray, width_m: float, size_in: tuple[float, float]
) -> MapView:
    """The view around a centre, on paper of this size."""
    half = 0.5 * width_m * np.array([1.0, size_in[1] / size_in[0]])
    (west, south), (east, north) = centre_xy_m - half, centre_xy_m + half
    box = Box(float(west), float(south), float(east), float(north))
    return MapView(box, road_shapes(lanes, box), 72.0 * size_in[0] / width_m)


def draw_map(axes: Axes, view: MapView, moment: Moment, cast: Mapping[str, Part]) -> None:
    """Draws a moment with the names and colours of the case."""
    box = view.box
    axes.set(xlim=(box.west_m, box.east_m), ylim=(box.south_m, box.north_m))
    axes.set(xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(color=PALE_EDGE, linewidth=0.5)
        spine.set_zorder(40)
    verge = Rectangle((box.west_m, box.south_m), box.east_m - box.west_m, box.north_m - box.south_m)
    verge.set(facecolor=VERGE, linewidth=0.0, zorder=0)
    axes.add_patch(verge)
    draw_road(axes, view.shapes, view.points_per_m, PAPER_ROAD)
    _draw_signals(axes, view, moment)
    _draw_slots(axes, moment, cast)
    _draw_forecasts(axes, view, moment, cast)
    _draw_vehicles(axes, view, moment, cast)
    _draw_conflicts(axes, moment)
    _draw_names(axes, view, moment, cast)


def _draw_signals(axes: Axes, view: MapView, moment: Moment) -> None:
    for line, is_closed in lamps_in(view.shapes, view.box, moment.scene):
        axes.fill(*line.corners_xy_m.T, **signal_look(is_closed), zorder=3.2)


def _draw_slots(axes: Axes, moment: Moment, cast: Mapping[str, Part]) -> None:
    for slot in moment.slots:
        strip = quad(_visible(slot.strip_xy_m), STRIP_HALF_M)
        told = slot.in_focus and slot.probability is not None
        colour = cast[slot.rear_id].colour if told else PALE_EDGE
        axes.fill(
            *strip.T,
            facecolor=(*shade(colour, slot.probability or 0.0), 0.92) if told else "none",
            edgecolor=mixed(to_rgb(colour), (0.0, 0.0, 0.0), 0.1 if told else 0.0),
            linewidth=0.75 if told else 0.45,
            linestyle=(0.0, (2.6, 1.6)),
            zorder=5.0 if told else 4.0,
        )


def _visible(strip_xy_m: FloatArray) -> FloatArray:
    along = strip_xy_m[-1] - strip_xy_m[0]
    length_m = float(np.linalg.norm(along))
    if length_m >= MIN_STRIP_M or length_m == 0.0:
        return strip_xy_m
    return np.stack((strip_xy_m[0], strip_xy_m[0] + along / length_m * MIN_STRIP_M))


def _draw_forecasts(axes: Axes, view: MapView, moment: Moment, cast: Mapping[str, Part]) -> None:
    """The likeliest path as a band with dots, and what happened as a thin line on top of it."""
    for vehicle_id in sorted(moment.involved & set(moment.forecasts)):
        forecast, colour = moment.forecasts[vehicle_id], cast[vehicle_id].colour
        path = forecast.predicted_xy_m[int(forecast.mode_probability.argmax())]
        if moves(path):
            band: dict[str, Any] = {"color": colour, "alpha": 0.55, "solid_capstyle": "butt"}
            axes.plot(*path.T, lw=0.8 * view.points_per_m, zorder=6, **band)
            dots = path[WAY_POINT_FRAMES::WAY_POINT_FRAMES]
            size = (1.15 * view.points_per_m) ** 2
            axes.scatter(*dots.T, s=size, color=colour, linewidths=0.0, zorder=7)
        if moves(forecast.actual_xy_m):
            axes.plot(*forecast.actual_xy_m.T, color="white", lw=1.1, zorder=7.4)
            axes.plot(*forecast.actual_xy_m.T, color=INK, lw=0.55, zorder=7.5)
            end = forecast.actual_xy_m[-1]
            axes.plot(*end, "o", ms=2.6, mfc="white", mec=INK, mew=0.55, zorder=7.6)


def _draw_vehicles(axes: Axes, view: MapView, moment: Moment, cast: Mapping[str, Part]) -> None:
    scene = moment.scene
    parts: list[FloatArray] = []
    fills: list[Any] = []
    edges: list[Any] = []
    for i in np.flatnonzero(view.box.near(scene.xy_m, 12.0)).tolist():
        vehicle_id = scene.ids[i]
        length_m, width_m = float(scene.size_m[i, 0]), float(scene.size_m[i, 1])
        body, glass, edge = _paint(vehicle_id, moment, cast)
        if vehicle_id == moment.ego_id:
            ring = placed(outline(length_m, width_m, 0.45), scene.xy_m[i], float(scene.yaw_rad[i]))
            axes.fill(*ring.T, facecolor="white", linewidth=0.0, zorder=11)
        for part in vehicle_parts(Kind(int(scene.kind[i])), length_m, width_m):
            parts.append(placed(part.xy_m, scene.xy_m[i], float(scene.yaw_rad[i])))
            fills.append(body if part.material == BODY else glass)
            edges.append(edge)
    axes.add_collection(
        PathCollection(
            [Outline(part, closed=False) for part in parts],
            facecolors=fills,
            edgecolors=edges,
            linewidths=0.3,
            zorder=12,
        )
    )


def _paint(vehicle_id: str, moment: Moment, cast: Mapping[str, Part]) -> tuple[Any, Any, Any]:
    """Body, glass and edge: full colour for those met now, softer for those met before or later."""
    if vehicle_id not in cast:
        return to_rgb(PALE), to_rgb("#e3e6e8"), to_rgb(PALE_EDGE)
    colour = to_rgb(cast[vehicle_id].colour)
    body = colour if vehicle_id in moment.involved else mixed(colour, to_rgb(PALE), 0.6)
    if vehicle_id == moment.ego_id:
        return body, mixed(body, WHITE, 0.3), body
    return body, mixed(body, WHITE, 0.5), mixed(body, (0.0, 0.0, 0.0), 0.45)


def _draw_conflicts(axes: Axes, moment: Moment) -> None:
    places = [
        slot.conflict_xy_m
        for slot in moment.slots
        if slot.in_focus and not slot.is_own and slot.conflict_xy_m is not None
    ]
    axes.scatter(
        *columns(places),
        s=11.0,
        marker="D",
        facecolors=INK,
        edgecolors="white",
        linewidths=0.5,
        zorder=13,
    )


def _draw_names(axes: Axes, view: MapView, moment: Moment, cast: Mapping[str, Part]) -> None:
    """The names of the slots to choose from, beside the vehicles behind them."""
    scene = moment.scene
    per_pt = 1.0 / view.points_per_m
    labels = [
        Label(
            slot.rear_id,
            scene.xy_m[scene.ids.index(slot.rear_id)],
            (
                (0.7 * LABEL_PT * len(cast[slot.rear_id].name) + 3.0) * per_pt,
                1.6 * LABEL_PT * per_pt,
            ),
        )
        for slot in moment.slots
        if slot.in_focus
    ]
    shown = [label for label in labels if view.box.near(label.anchor_xy_m, 0.0)]
    centres = place_labels(shown, _obstacles(moment), view.box)
    leaders: list[FloatArray] = []
    for label in shown:
        part, centre = cast[label.key], centres[label.key]
        leaders.append(np.stack((label.anchor_xy_m, centre)))
        axes.text(
            float(centre[0]),
            float(centre[1]),
            part.name,
            fontsize=LABEL_PT,
            fontweight="bold",
            color="white",
            ha="center",
            va="center_baseline",
            zorder=31,
            bbox={
                "boxstyle": "round,pad=0.16,rounding_size=0.3",
                "facecolor": mixed(to_rgb(part.colour), (0.0, 0.0, 0.0), 0.12),
                "edgecolor": "white",
                "linewidth": 0.5,
            },
        )
    axes.add_collection(LineCollection(leaders, colors=INK, linewidths=0.4, zorder=9.5))


def _obstacles(moment: Moment) -> FloatArray:
    """Points along what a name had better not cover."""
    scene = moment.scene
    points = [scene.xy_m + step * _heading(scene.yaw_rad) for step in (-1.6, -0.8, 0.0, 0.8, 1.6)]
    for vehicle_id in sorted(moment.involved & set(moment.forecasts)):
        points.append(moment.forecasts[vehicle_id].actual_xy_m)
    for slot in moment.slots:
        if slot.in_focus:
            points.append(slot.strip_xy_m)
            if slot.conflict_xy_m is not None:
                points.append(np.repeat(slot.conflict_xy_m[None], 10, axis=0))
    return np.concatenate(points)


def _heading(yaw_rad: FloatArray) -> FloatArray:
    return np.stack((np.cos(yaw_rad), np.sin(yaw_rad)), axis=1)
