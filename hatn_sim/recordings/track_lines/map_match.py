"""Where the lanes of a map are, for points and directions beside them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import FloatArray, IntArray, Lane
from hatn_sim.geometry import resample, wrap_angle
from hatn_sim.recordings.track_lines.paths import STEP_M, poses

FAR_M: Final = 5.0
"""Nobody strays further from a lane that is still the one driven on."""
TURNED_RAD: Final = np.deg2rad(60.0)


class LaneMatch:
    """Finds the lane of a map that a pose belongs to."""

    def __init__(self, lanes: Sequence[Lane]) -> None:
        # Points between the ends, which belong to the lanes that follow as well.
        parts = [resample(lane.xy_m, STEP_M) for lane in lanes]
        steps = np.concatenate([np.diff(part, axis=0) for part in parts])
        self._xy_m = np.concatenate([(part[1:] + part[:-1]) / 2.0 for part in parts])
        self._yaw_rad = np.arctan2(steps[:, 1], steps[:, 0])
        self._owner = np.repeat(np.arange(len(lanes)), [len(part) - 1 for part in parts])
        self._tree = KDTree(poses(self._xy_m, self._yaw_rad))

    def lane_at(self, xy_m: FloatArray, yaw_rad: FloatArray) -> IntArray:
        """The number [N] of the lane nearest to each pose, -1 where none is near."""
        _, found = self._tree.query(poses(xy_m, yaw_rad))
        near = np.asarray(found, dtype=np.int64)
        away_m = np.linalg.norm(self._xy_m[near] - xy_m, axis=1)
        turned = np.abs(wrap_angle(self._yaw_rad[near] - yaw_rad))
        return np.where((away_m <= FAR_M) & (turned <= TURNED_RAD), self._owner[near], -1)
