"""Whether a recording and its map belong together: how far positions are from the lanes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import FloatArray, Lane

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
