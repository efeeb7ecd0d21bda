"""How fast the road ahead lets a vehicle drive, and how far it gets on it undisturbed."""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, IntArray
from hatn_sim.road import LINE_STEP_M, Road

PROFILE_STEP_M: Final = 2.0
REACH_M: Final = 110.0
LATERAL_MPS2: Final = 2.5
"""Lateral acceleration drivers accept in a bend."""
BRAKING_MPS2: Final = 1.5
"""Braking drivers plan with, ahead of a bend or a lower limit."""
ACCELERATION_MPS2: Final = 2.0
FREE_STEP_S: Final = 0.5
FREE_STEPS: Final = 6  # 3 s


def allowed_speed_mps(road: Road, line: IntArray, s_m: FloatArray) -> FloatArray:
    """Speed [N, P] every `PROFILE_STEP_M` from now on, by lane limits and curvature.

    Bends and limits ahead are braked for before they are reached: v(s)^2 <= v(s')^2 + 2 b (s' - s)
    for every s' ahead, which is one running minimum from the far end.
    """
    points = int(REACH_M / PROFILE_STEP_M) + 1
    stride = int(PROFILE_STEP_M / LINE_STEP_M)
    index = (s_m[:, None] / LINE_STEP_M).astype(np.int64) + stride * np.arange(points)
    index = np.clip(index, 0, road.count[line][:, None] - 1) + road.offset[line][:, None]
    bend = LATERAL_MPS2 / np.maximum(np.abs(road.curvature_per_m[index]), 1e-4)
    square = np.minimum(road.speed_limit_mps[index] ** 2, bend)
    fall = 2.0 * BRAKING_MPS2 * PROFILE_STEP_M * np.arange(points)
    reachable = np.minimum.accumulate((square + fall)[:, ::-1], axis=1)[:, ::-1] - fall
    return np.sqrt(reachable)


def free_travel_m(allowed_mps: FloatArray, speed_mps: FloatArray) -> FloatArray:
    """Distance [N] driven in 3 s with nobody in the way: accelerate, but never above the profile.

    `allowed_mps` [N, P] is what `allowed_speed_mps` gave, `speed_mps` [N] is now.
    """
    rows = np.arange(len(speed_mps))
    s, speed = np.zeros(len(speed_mps)), speed_mps.astype(np.float64)
    last = allowed_mps.shape[1] - 1
    for _ in range(FREE_STEPS):
        ahead = s + speed * FREE_STEP_S
        column = np.minimum((ahead / PROFILE_STEP_M).astype(np.int64), last)
        low = speed - 2.0 * BRAKING_MPS2 * FREE_STEP_S
        wanted = np.minimum(allowed_mps[rows, column], speed + ACCELERATION_MPS2 * FREE_STEP_S)
        after = np.maximum(np.maximum(wanted, low), 0.0)
        s = s + 0.5 * (speed + after) * FREE_STEP_S
        speed = after
    return s
