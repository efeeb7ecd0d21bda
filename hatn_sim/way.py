"""How far a vehicle has come along the way that it really drives, and where that crosses others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, Lane, Route
from hatn_sim.geometry import arc_length_m, resample
from hatn_sim.road import Road

STEP_M: Final = 0.5
BACK_M: Final = 3.0
AHEAD_M: Final = 12.0
"""Where to look for the next position, from the last one on."""
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
    s_m: float
    last_junction_s_m: float | None  # where it is left; None: there is none
    first_crossing: Crossing | None  # of the whole route; None: it leads through no junction
    ends_m: Sequence[float]  # where each lane of the route ends

    def moved(self, xy_m: FloatArray) -> Way:
        """The vehicle is here [2] now, a frame later."""
        low = min(max(int((self.s_m - BACK_M) / STEP_M), 0), len(self.xy_m) - 2)
        near = self.xy_m[low : int((self.s_m + AHEAD_M) / STEP_M) + 2]
        s_m = _along(near, xy_m) + low * STEP_M
        last, first = self.last_junction_s_m, self.first_crossing
        return Way(self.route, self.xy_m, s_m, last, first, self.ends_m)  # faster than `replace`

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
    return Way(route, points, _along(points, xy_m), left, first, ends)


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


def _along(points_m: FloatArray, xy_m: FloatArray) -> float:
    """Arc length, from the first of points [P, 2] on, of the nearest place to `xy_m` [2]."""
    away = xy_m - points_m
    nearest = int(np.einsum("px,px->p", away, away).argmin())
    first = min(nearest, len(points_m) - 2)
    along = points_m[first + 1] - points_m[first]
    length_m = max(float(np.hypot(*along)), 1e-9)
    # Whoever is beyond an end of the way, or was steered off it, gets no farther than that.
    s_m = STEP_M * first + float(away[first] @ along) / length_m
    return min(max(s_m, 0.0), STEP_M * (len(points_m) - 1))
