"""How far the ego has come along the way that it really drives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, Route
from hatn_sim.geometry import resample
from hatn_sim.road import Road

STEP_M: Final = 0.5
BACK_M: Final = 3.0
AHEAD_M: Final = 12.0
"""Where to look for the next position, from the last one on."""
CROSSED_M: Final = 10.0
"""Who has left the last junction of its way this far behind has crossed."""


@dataclass(frozen=True, eq=False)
class Way:
    """A way, and where on it the ego is."""

    route: Route
    xy_m: FloatArray  # [P, 2] a point each `STEP_M`
    s_m: float
    last_junction_s_m: float | None  # where it is left; None: there is none

    def moved(self, xy_m: FloatArray) -> Way:
        """The ego is here [2] now, a frame later."""
        low = min(max(int((self.s_m - BACK_M) / STEP_M), 0), len(self.xy_m) - 2)
        near = self.xy_m[low : int((self.s_m + AHEAD_M) / STEP_M) + 2]
        return Way(self.route, self.xy_m, _along(near, xy_m) + low * STEP_M, self.last_junction_s_m)

    def is_crossed(self, length_m: float) -> bool:
        """Whether the rear bumper of an ego of this length has left all junctions behind."""
        last = self.last_junction_s_m
        return last is not None and self.s_m - 0.5 * length_m > last + CROSSED_M


def way_along(road: Road, route: Route, xy_m: FloatArray) -> Way:
    """The way along a route, of an ego that is at `xy_m` [2] now."""
    lanes = [road.lanes[name] for name in route]
    points = resample(np.concatenate([lane.xy_m for lane in lanes]), STEP_M)
    last = max((k for k, lane in enumerate(lanes) if lane.is_connection), default=None)
    left = None
    if last is not None:
        until = np.concatenate([lane.xy_m for lane in lanes[: last + 1]])
        left = float(np.linalg.norm(np.diff(until, axis=0), axis=1).sum())
    return Way(route, points, _along(points, xy_m), left)


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
