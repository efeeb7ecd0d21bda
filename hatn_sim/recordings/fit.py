"""Whether a recording and its map belong together: do vehicles drive where, and as, lanes lead?

Maps of other places often overlap the tracks, each around the middle of its own frame. Within a few
metres of some lane a third or half of all places is then by chance; along that lane far fewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import FloatArray, Lane
from hatn_sim.errors import InputError
from hatn_sim.geometry import tangent_rad

ON_LANE_M: Final = 3.0
"""Who cuts corners is nearer than this to the middle of a lane ..."""
ALONG_RAD: Final = np.deg2rad(45.0)
"""... and drives along it, within this."""
LEAST_SHARE: Final = 1 / 3
"""With fewer of all places on lanes, the map is of another place; a map that covers but a part of
the tracks has more, and a notice."""
WHOLE_SHARE: Final = 0.9
"""From this share on there is nothing to say: some park or leave the road anywhere."""
_STEP_M = 2.0


def distance_to_lanes_m(lanes: Sequence[Lane], xy_m: FloatArray) -> FloatArray:
    """[N] metres from each position to the nearest centre line of some, exact to `_STEP_M` / 2."""
    points_m = np.concatenate([_dense(lane.xy_m) for lane in lanes])
    distance_m, _ = KDTree(points_m).query(xy_m)
    return np.asarray(distance_m, dtype=np.float64)


def _dense(xy_m: FloatArray) -> FloatArray:
    """Points along a polyline, at most `_STEP_M` apart."""
    s_m = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(xy_m, axis=0).T))))
    at_m = np.linspace(0.0, s_m[-1], 1 + int(np.ceil(s_m[-1] / _STEP_M)))
    return np.column_stack((np.interp(at_m, s_m, xy_m[:, 0]), np.interp(at_m, s_m, xy_m[:, 1])))


def check_place(
    path: Path, map_path: Path, lanes: Sequence[Lane], xy_m: FloatArray, yaw_rad: FloatArray
) -> str:
    """A notice where many places that motor vehicles drive through [N, 2] are on no lane.

    Raises:
        InputError: almost all are on none, so that the map must be of another place.
    """
    if not len(xy_m):
        return ""
    share = share_on_lanes(lanes, xy_m, yaw_rad)
    if share >= WHOLE_SHARE:
        return ""
    found = (
        f"{share:.0%} of the places of vehicles on a lane (within {ON_LANE_M:g} m of its middle, "
        f"along it; {np.median(distance_to_lanes_m(lanes, xy_m)):.1f} m off at the median)"
    )
    if share < LEAST_SHARE:
        raise InputError(
            f"{path}: expected vehicles on the lanes of {map_path}, found {found}: map and tracks "
            "seem not to belong together; give the map of this place, in its place"
        )
    return f"{path.name}: only {found}: is {map_path.name} the map of this place, and whole?"


def share_on_lanes(lanes: Sequence[Lane], xy_m: FloatArray, yaw_rad: FloatArray) -> float:
    """Share of N places [N, 2] within `ON_LANE_M` of a lane that leads within `ALONG_RAD` of their
    direction [N]; of who is a little off in both, fewer."""
    # A direction is a point on a circle so wide that ALONG_RAD is ON_LANE_M across.
    radius_m = ON_LANE_M / (2.0 * np.sin(ALONG_RAD / 2.0))

    def point(xy_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
        circle_m = radius_m * np.stack((np.cos(yaw_rad), np.sin(yaw_rad)), axis=1)
        return np.concatenate((xy_m, circle_m), axis=1)

    middles_m = [_dense(lane.xy_m) for lane in lanes if len(lane.xy_m) > 1]
    tree = KDTree(np.concatenate([point(one, tangent_rad(one)) for one in middles_m]))
    off_m, _ = tree.query(point(xy_m, yaw_rad))
    return float((off_m <= ON_LANE_M).mean())
