"""The acceleration that keeps to the road, the leader and the lines to stop at, by the IDM."""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray
from hatn_sim.planning.situation import Situation
from hatn_sim.predictors.car_following import (
    DESIRED_SPEED_MPS,
    STANDSTILL_M,
    STOP_BEFORE_M,
    TOO_LATE_MPS2,
    idm_acceleration,
)

SHORT_M: Final = 1.0
"""Who has to let others go stops so far before their area."""
GAP_S: Final = 1.5
"""Accepted in front of others: from when the ego is out of the area until they come."""
BEHIND_S: Final = 0.5
"""Accepted behind them."""
STANDING_MPS: Final = 0.5
START_MPS2: Final = 1.5
"""How fast the ego is taken to get over a crossing."""


def safe_acceleration(now: Situation, halt_m: float = np.inf) -> float:
    """What the IDM does of a moment, stopping `halt_m` from here at the latest, in m/s2."""
    too_late = now.speed_mps**2 > 2.0 * TOO_LATE_MPS2 * max(now.stop_m, 0.01)
    stop_m = min(np.inf if too_late else now.stop_m - STOP_BEFORE_M, halt_m)
    gap_m = np.array([now.gap_m, stop_m + STANDSTILL_M])
    closing_mps = now.speed_mps - np.array([now.leader_mps, 0.0])
    desired_mps = min(DESIRED_SPEED_MPS, float(now.allowed_mps[0]))
    speed, desired = np.full(2, now.speed_mps), np.full(2, desired_mps)
    return float(idm_acceleration(speed, desired, gap_m, closing_mps).min())


def halt_before_m(now: Situation) -> float:
    """How far it is to where the ego has to wait for others, by time gaps; inf: nowhere.

    All drive on at their present speeds, the ego from its own with a steady acceleration. It waits
    for whoever is in the area, or comes while it is there, or sooner than `GAP_S` after it. Those
    who stand, and those who have to give way, are not waited for.
    """
    met = now.meetings
    speed_mps = now.scene.speed_mps[met.other]
    inside = (met.other_room_m <= 0.0) & (met.other_clear_m > 0.0)
    moving = speed_mps > STANDING_MPS
    pace = np.maximum(speed_mps, STANDING_MPS)
    comes_s, leaves_s = met.other_room_m / pace, met.other_clear_m / pace
    limit_mps = max(float(now.allowed_mps.max()), STANDING_MPS)
    enters_s, clear_s = (
        time_over_s(way_m, now.speed_mps, limit_mps) for way_m in (met.room_m, met.clear_m)
    )
    blocked = moving & ~met.gives_way
    blocked &= (comes_s < clear_s + GAP_S) & (leaves_s + BEHIND_S > enters_s)
    ahead_m = met.room_m - SHORT_M
    can_stop = now.speed_mps**2 <= 2.0 * TOO_LATE_MPS2 * np.maximum(met.room_m, 0.01)
    waits = (blocked | inside) & (met.room_m > 0.0) & can_stop
    return float(np.where(waits, np.maximum(ahead_m, 0.0), np.inf).min(initial=np.inf))


def time_over_s(
    way_m: FloatArray,
    speed_mps: float,
    limit_mps: FloatArray | float,
    gain_mps2: float = START_MPS2,
) -> FloatArray:
    """For ways, gaining speed steadily up to limits above 0; 0 for those that lie behind."""
    way_m = np.maximum(way_m, 0.0)
    gain_mps = np.maximum(limit_mps - speed_mps, 0.0)
    gaining_m = (speed_mps + 0.5 * gain_mps) * gain_mps / gain_mps2
    root = np.sqrt(speed_mps**2 + 2.0 * gain_mps2 * np.minimum(way_m, gaining_m))
    return (root - speed_mps) / gain_mps2 + np.maximum(way_m - gaining_m, 0.0) / limit_mps
