"""A vehicle from above as a few outlines, in metres in its own frame: x forward, y left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, Kind

GLASS: Final = "glass"
BODY: Final = "body"
CARGO: Final = "cargo"
LIGHT: Final = "light"
DARK: Final = "dark"


@dataclass(frozen=True, eq=False)
class Part:
    """An outline, and what it is made of."""

    material: str
    xy_m: FloatArray  # [P, 2]


def outline(length_m: float, width_m: float, grow_m: float = 0.0) -> FloatArray:
    """The rounded body [P, 2], grown on all sides."""
    corner_m = min(0.34 * width_m, 0.45 * length_m) + grow_m
    return rounded(
        -0.5 * length_m - grow_m, 0.5 * length_m + grow_m, width_m + 2.0 * grow_m, corner_m
    )


def vehicle_parts(kind: Kind, length_m: float, width_m: float) -> list[Part]:
    """What a vehicle is drawn of, from the ground up."""
    if kind is Kind.PEDESTRIAN:
        return [Part(BODY, _disc(0.0, 0.35)), Part(DARK, _disc(0.05, 0.17))]
    if kind in (Kind.MOTORCYCLE, Kind.BICYCLE):
        return _two_wheeler(length_m, width_m)
    body = Part(BODY, outline(length_m, width_m))
    lights = [Part(LIGHT, lamp) for lamp in _lamps(length_m, width_m)]
    half_m = 0.5 * length_m
    if kind is Kind.LORRY and length_m > 5.0:
        cab_m = min(2.3, 0.35 * length_m)
        cab = Part(BODY, rounded(half_m - cab_m, half_m, 0.94 * width_m, 0.35))
        glass = Part(GLASS, _trapezoid(half_m - 0.85, half_m - 0.3, 0.74 * width_m, 0.86 * width_m))
        box = Part(CARGO, rounded(-half_m, half_m - cab_m - 0.2, width_m, 0.18))
        return [cab, *lights, glass, box]
    if kind in (Kind.BUS, Kind.TRAM):
        glass = Part(GLASS, rounded(-half_m + 0.25, half_m - 0.2, 0.9 * width_m, 0.4))
        roof = Part(BODY, rounded(-half_m + 0.6, half_m - 0.9, 0.76 * width_m, 0.3))
        return [body, *lights, glass, roof]
    if kind in (Kind.VAN, Kind.LORRY):
        glass = Part(GLASS, rounded(-0.1 * length_m, 0.36 * length_m, 0.84 * width_m, 0.35))
        roof = Part(BODY, rounded(-0.44 * length_m, 0.22 * length_m, 0.74 * width_m, 0.3))
        return [body, *lights, glass, roof]
    glass = Part(GLASS, rounded(-0.38 * length_m, 0.22 * length_m, 0.82 * width_m, 0.5))
    roof = Part(BODY, rounded(-0.27 * length_m, 0.06 * length_m, 0.68 * width_m, 0.3))
    return [body, *lights, glass, roof]


def blinker_places(length_m: float, width_m: float, side: int) -> FloatArray:
    """Where the two lamps of a blinker are: [2, 2]; side +1 is left."""
    x, y = 0.5 * length_m - 0.22, side * (0.5 * width_m - 0.16)
    return np.array([[x, y], [-x, y]])


def placed(xy_m: FloatArray, at_m: FloatArray, yaw_rad: float) -> FloatArray:
    """Points [P, 2] of a vehicle's own frame on the map."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    turned: FloatArray = xy_m @ np.array([[cos, sin], [-sin, cos]]) + at_m
    return turned


def rounded(back_m: float, front_m: float, width_m: float, corner_m: float) -> FloatArray:
    """A rectangle along x with round corners [28, 2]."""
    corner_m = min(corner_m, 0.5 * width_m, 0.5 * (front_m - back_m))
    angle = np.linspace(0.0, 0.5 * np.pi, 7)
    arc = corner_m * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    x, y = front_m - corner_m, 0.5 * width_m - corner_m
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    pieces: list[FloatArray] = []
    for centre in ((x, y), (back_m + corner_m, y), (back_m + corner_m, -y), (x, -y)):
        pieces.append(arc + np.array(centre))
        arc = arc @ quarter.T
    return np.concatenate(pieces)


def _trapezoid(
    back_m: float, front_m: float, back_width_m: float, front_width_m: float
) -> FloatArray:
    back, front = 0.5 * back_width_m, 0.5 * front_width_m
    return np.array([[back_m, back], [front_m, front], [front_m, -front], [back_m, -back]])


def _lamps(length_m: float, width_m: float) -> list[FloatArray]:
    x = 0.5 * length_m
    lamp = np.array([[-0.42, -0.2], [-0.16, -0.24], [-0.1, 0.18], [-0.3, 0.2]])
    left = lamp * (1.0, -1.0) + (x, 0.5 * width_m - 0.38)
    return [left, left * (1.0, -1.0)]


def _disc(x_m: float, radius_m: float) -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, 20, endpoint=False)
    return np.stack((x_m + radius_m * np.cos(angle), radius_m * np.sin(angle)), axis=1)


def _two_wheeler(length_m: float, width_m: float) -> list[Part]:
    half_m = 0.5 * length_m
    frame = rounded(-half_m, half_m, 0.42 * width_m, 0.21 * width_m)
    bar = rounded(0.18 * length_m, 0.18 * length_m + 0.16, width_m, 0.08)
    shoulders = rounded(-0.16 * length_m, 0.06 * length_m, 0.74 * width_m, 0.24)
    return [
        Part(DARK, frame),
        Part(DARK, bar),
        Part(BODY, shoulders),
        Part(GLASS, _disc(-0.03 * length_m, 0.2)),
    ]
