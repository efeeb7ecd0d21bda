"""How far a vehicle has come along the way that it really drives, and where that crosses others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, Lane, Route
from hatn_sim.geometry import arc_length_m, resample
from hatn_sim.road import Road

STEP_M: Final = 0.5
OFF_M: Final = 0.5
AHEAD_POINTS: Final = 32
"""Who is off its way by more is looked for 16 m ahead, too."""
CROSSED_M: Final = 10.0
"""Who has left the last junction of its way this far behind has crossed."""
JOINED_M: Final = 50.0
"""Junctions no farther apart than this are one crossing: a roundabout is many of them."""


@dataclass(frozen=True)
class Crossing:
    """A stretch of a way that leads through one junction, or several close by."""

    entry_s_m: float
    exit_s_m: float
    from_lane: str | None  # the lane before it; None: the way begins inside
    into_lane: str


@dataclass(frozen=True, eq=False)
class Way:
    """A way, and where on it the vehicle is."""

    route: Route
    xy_m: FloatArray  # [P, 2] a point each `STEP_M`
    points_m: Sequence[tuple[float, float]]  # the same as plain numbers, to be looked up fast
    s_m: float
    last_junction_s_m: float | None  # where it is left; None: there is none
    first_crossing: Crossing | None  # of the whole route; None: it leads through no junction
    ends_m: Sequence[float]  # where each lane of the route ends

    def moved(self, xy_m: FloatArray) -> Way:
        """The vehicle is here [2] now, a frame later."""
        s_m = _along(self.points_m, round(self.s_m / STEP_M), *xy_m.tolist())
        last, first = self.last_junction_s_m, self.first_crossing
        # Faster than `replace`.
        return Way(self.route, self.xy_m, self.points_m, s_m, last, first, self.ends_m)

    def is_crossed(self, length_m: float) -> bool:
        """Whether the rear bumper of a vehicle of this length has left all junctions behind."""
        last = self.last_junction_s_m
        return last is not None and self.s_m - 0.5 * length_m > last + CROSSED_M


def way_along(road: Road, route: Route, xy_m: FloatArray) -> Way:
    """The way along a route, of a vehicle that is at `xy_m` [2] now."""
    lanes = [road.lanes[name] for name in route]
    points = resample(np.concatenate([lane.xy_m for lane in lanes]), STEP_M)
    inside = [k for k, lane in enumerate(lanes) if lane.is_connection]
    ends = _ends_m(lanes)
    left = ends[inside[-1]] if inside else None
    first = _first_crossing(route, inside, ends)
    away = xy_m - points
    nearest = int(np.einsum("px,px->p", away, away).argmin())
    plain: list[tuple[float, float]] = list(map(tuple, points.tolist()))
    s_m = _along(plain, nearest, *xy_m.tolist())
    return Way(route, points, plain, s_m, left, first, ends)


def _ends_m(lanes: Sequence[Lane]) -> list[float]:
    """Arc length at which each of the lanes, one after the other, ends."""
    s_m = arc_length_m(np.concatenate([lane.xy_m for lane in lanes]))
    return s_m[np.cumsum([len(lane.xy_m) for lane in lanes]) - 1].tolist()


def _first_crossing(
    route: Route, inside: Sequence[int], ends_m: Sequence[float]
) -> Crossing | None:
    """`inside` are the places in the route of the lanes that lead through junctions."""
    if not inside:
        return None
    first = last = inside[0]
    for place in inside[1:]:
        if ends_m[place - 1] - ends_m[last] > JOINED_M:
            break
        last = place
    before = first - 1
    return Crossing(
        entry_s_m=ends_m[before] if first else 0.0,
        exit_s_m=ends_m[last],
        from_lane=route[before] if first else None,
        into_lane=route[first],
    )


def _along(points_m: Sequence[tuple[float, float]], near: int, x_m: float, y_m: float) -> float:
    """Arc length, from the first of points [P] on, of the nearest place to x, y.

    The way there is down from the point `near`: a vehicle passes few points in a frame, and those
    of another lap of its way are not meant. Plain numbers, as arrays take longer for so few.
    """

    def away_m2(point: int) -> float:
        px, py = points_m[point]
        return (x_m - px) ** 2 + (y_m - py) ** 2

    def down_from(at: int) -> int:
        least = away_m2(at)
        step = 1 if at < last and away_m2(at + 1) < least else -1
        while 0 <= at + step <= last and (next_m2 := away_m2(at + step)) < least:
            at, least = at + step, next_m2
        return at

    last = len(points_m) - 1
    at = down_from(min(max(near, 0), last))
    if away_m2(at) > OFF_M**2:
        # In a bend tighter than it is long its centre is nearer to where it came from for a while.
        ahead = min(range(at, min(at + AHEAD_POINTS, last) + 1), key=away_m2)
        if away_m2(ahead) < away_m2(at):
            at = down_from(ahead)
    first = min(at, last - 1)
    (px, py), (qx, qy) = points_m[first], points_m[first + 1]
    dx, dy = qx - px, qy - py
    along_m = ((x_m - px) * dx + (y_m - py) * dy) / max(math.hypot(dx, dy), 1e-9)
    # Whoever is beyond an end of the way, or was steered off it, gets no farther than that.
    return min(max(STEP_M * first + along_m, 0.0), STEP_M * last)
