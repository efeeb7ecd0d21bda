"""The vehicles of a moment, drawn on a sheet."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.path import Path as Outline

from hatn_sim.datatypes import FloatArray, Kind
from hatn_sim.report.canvas import ALERT, ASPHALT, INK, PROBABILITY, Sheet, columns, mixed
from hatn_sim.report.moment import Moment
from hatn_sim.report.paint import paint_of
from hatn_sim.report.vehicle_shapes import (
    BODY,
    CARGO,
    DARK,
    GLASS,
    LIGHT,
    blinker_places,
    outline,
    placed,
    vehicle_parts,
)

SHADOW_M: Final = (0.32, -0.36)
MATERIALS: Final = {CARGO: "#d8dadb", GLASS: "#1c242c", LIGHT: "#fff6d8", DARK: "#23272c"}
AMBER: Final = "#ffb000"
BLINKS_PER_S: Final = 1.25
FADED: Final = 0.3
"""How far vehicles that the ego has nothing to do with fade into the asphalt."""


def draw_vehicles(sheet: Sheet, moment: Moment, blinking: bool) -> list[Artist]:
    """Vehicles to scale: the ego in a white ring, those it meets in their slot's colour.

    Those that an alert names have a red one around it.
    """
    scene, scale = moment.scene, sheet.points_per_m
    probability = moment.choice
    shadows: list[list[FloatArray]] = [[], [], []]
    halos: list[FloatArray] = []
    halo_colours: list[Any] = []
    parts: list[FloatArray] = []
    part_colours: list[Any] = []
    edges: list[Any] = []
    lamps: list[FloatArray] = []
    for i in np.flatnonzero(sheet.box.near(scene.xy_m, 12.0)).tolist():
        at, yaw = scene.xy_m[i], float(scene.yaw_rad[i])
        length_m, width_m = float(scene.size_m[i, 0]), float(scene.size_m[i, 1])
        alerted = scene.ids[i] in moment.alerted
        involved = scene.ids[i] == moment.ego_id or scene.ids[i] in probability or alerted
        for layer, grow_m in zip(shadows, (0.28, 0.12, -0.04), strict=True):
            layer.append(placed(outline(length_m, width_m, grow_m), at + SHADOW_M, yaw))
        if alerted:
            halos.append(placed(outline(length_m, width_m, 1.16), at, yaw))
            halo_colours.append("white")
            halos.append(placed(outline(length_m, width_m, 1.04), at, yaw))
            halo_colours.append(ALERT)
        if scene.ids[i] == moment.ego_id:
            halos.append(placed(outline(length_m, width_m, 0.62), at, yaw))
            halo_colours.append(INK)
            halos.append(placed(outline(length_m, width_m, 0.48), at, yaw))
            halo_colours.append("white")
        elif scene.ids[i] in probability:
            halos.append(placed(outline(length_m, width_m, 0.34), at, yaw))
            halo_colours.append(PROBABILITY(probability[scene.ids[i]]))
        paint = np.array(paint_of(*scene.colour[i].tolist())) / 255.0
        body = tuple(mixed(paint, to_rgb(ASPHALT), 0.0 if involved else FADED))
        kind = Kind(int(scene.kind[i]))
        for part in vehicle_parts(kind, length_m, width_m):
            colour = body if part.material == BODY else to_rgb(MATERIALS[part.material])
            if not involved and part.material != BODY:
                colour = tuple(mixed(colour, to_rgb(ASPHALT), FADED))
            parts.append(placed(part.xy_m, at, yaw))
            part_colours.append(colour)
            edges.append((*mixed(colour, (0.0, 0.0, 0.0), 0.55), 0.9))
        lit = not blinking or (scene.time_s * BLINKS_PER_S) % 1.0 < 0.5
        if scene.blinker[i] and lit:
            places = blinker_places(length_m, width_m, int(scene.blinker[i]))
            lamps += list(placed(places, at, yaw))
    axes = sheet.map
    drawn: list[Artist] = [
        axes.add_collection(
            PolyCollection(layer, facecolors=(0.05, 0.06, 0.08, 0.16), linewidths=0.0, zorder=10)
        )
        for layer in shadows
    ]
    drawn.append(
        axes.add_collection(
            PolyCollection(halos, facecolors=halo_colours, linewidths=0.0, zorder=11)
        )
    )
    bodies = PathCollection(
        [Outline(part, closed=False) for part in parts],
        facecolors=part_colours,
        edgecolors=edges,
        linewidths=0.06 * scale,
        zorder=12,
    )
    drawn.append(axes.add_collection(bodies))
    where = columns(lamps)
    for size_m, alpha, zorder in ((1.15, 0.25, 13.0), (0.75, 0.4, 13.1), (0.42, 1.0, 13.2)):
        drawn.append(
            axes.scatter(
                *where,
                s=(size_m * scale) ** 2,
                color=to_rgba(AMBER, alpha),
                linewidths=0.0,
                zorder=zorder,
            )
        )
    return drawn
