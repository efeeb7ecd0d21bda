"""From SUMO's ways of telling where vehicles are to ours, for runs and their branches alike."""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray

OBEY_SPEED_MODE: Final = 32
"""All of SUMO's checks off (safe gap, acceleration limits, right of way, red lights): a commanded
vehicle does what it is told, into a collision if need be."""
FOLLOW_SPEED_MODE: Final = 33
"""As told, but no faster than SUMO's driver follows whoever is ahead of him on his way: right of
way, red lights and the vehicle's own limits do not count."""
OWN_SPEED_MODE: Final = 31
"""All checks on: SUMO's own driver."""
ROUNDING_MPS: Final = 1e-6
"""What a difference of two speeds may be off."""
INVALID_M: Final = -1e9
"""SUMO gives coordinates below this where a vehicle is nowhere (while it teleports)."""


def centred(
    front_xy_m: FloatArray, angle_deg: FloatArray, length_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Box centres [N, 2] and yaw [N] from front bumpers and compass angles."""
    yaw_rad = np.radians(90.0 - angle_deg)
    yaw_rad = np.pi - np.mod(np.pi - yaw_rad, 2 * np.pi)
    half = 0.5 * length_m
    centre = np.column_stack((half * np.cos(yaw_rad), half * np.sin(yaw_rad)))
    return front_xy_m - centre, yaw_rad
