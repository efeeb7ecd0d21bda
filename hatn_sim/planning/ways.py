"""How the ego may drive: profiles that differ in where it waits and for how long.

Letters: R profiles, F ticks, G times of `occupancy.TIMES_S`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.assist.outlook import travel_at
from hatn_sim.assist.profile import (
    FAR_S,
    KNOT_AT_S,
    ROAD_REACH_M,
    ROAD_STEP_M,
    SHORT_M,
    SLOWING_MPS2,
    Approach,
    drive,
)
from hatn_sim.datatypes import DT_S, FloatArray, Prediction
from hatn_sim.planning.occupancy import STEP_FRAMES
from hatn_sim.planning.situation import Situation
from hatn_sim.speed_profile import PROFILE_STEP_M

WAITS_S: Final = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, FAR_S])
PACES: Final = np.array([0.8, 0.6, 0.4, 0.2])
STOPS_MPS2: Final = np.array([1.0, 2.0, 3.5])
PLACES: Final = 4
"""So many places to wait at are looked at, the nearest."""
APART_M: Final = 1.5
"""Places nearer to each other than this are one."""
NOSE_M: Final = 0.3
"""Whose front bumper is farther than this in an area does not wait before it any more."""
_AT_M: Final = ROAD_STEP_M * np.arange(round(ROAD_REACH_M / ROAD_STEP_M) + 1)


@dataclass(frozen=True, eq=False)
class Ways:
    """Profiles of the ego, the freest first, the last to stop at once."""

    speed_mps: FloatArray  # [R, F] at the end of each tick
    travelled_m: FloatArray  # [R, G] from here

    @property
    def acceleration_mps2(self) -> FloatArray:
        """[R, F - 1] between ticks."""
        return np.diff(self.speed_mps, axis=1) / DT_S


def sample_ways(now: Situation, prediction: Prediction, acceleration_mps2: float) -> Ways:
    """Profiles within comfort that keep to the road, the leader and the lines to stop at.

    The first waits for nobody. Others drive at a share of its speed, or stop evenly, or wait before
    one of the next areas for one of `WAITS_S`, approaching it so that they can stop there. The last
    stops at once.
    """
    places, paces, evenly = _places(now), len(PACES), len(STOPS_MPS2)
    stops_m = SHORT_M + now.speed_mps**2 / (2.0 * STOPS_MPS2)
    at_m = np.concatenate(([np.inf] * (1 + paces), np.repeat(places, len(WAITS_S)), stops_m, [0.0]))
    open_s = np.concatenate(
        (np.zeros(1 + paces), np.tile(WAITS_S, len(places)), np.full(evenly + 1, FAR_S))
    )
    count = len(at_m)
    pace = np.ones(count)
    pace[1 : 1 + paces] = PACES
    leader_m, leader_mps = _leader(now, prediction)
    allowed = np.interp(_AT_M, PROFILE_STEP_M * np.arange(len(now.allowed_mps)), now.allowed_mps)
    driven = drive(
        Approach(
            start_s=0.0,
            start_m=np.zeros(count),
            speed_mps=np.full(count, now.speed_mps),
            acceleration_mps2=np.full(count, acceleration_mps2),
            allowed_mps=pace[:, None] * allowed,
            leader_m=np.repeat(leader_m[None], count, axis=0),
            leader_mps=np.repeat(leader_mps[None], count, axis=0),
            stop_m=np.full(count, now.stop_m),
            area_m=at_m[:, None],
            open_s=open_s[:, None],
        )
    )
    speed = driven.tick_speed_mps()
    before = np.concatenate((np.full((count, 1), now.speed_mps), speed[:, :-1]), axis=1)
    travelled = np.cumsum(0.5 * DT_S * (before + speed), axis=1)
    return Ways(speed, travelled[:, STEP_FRAMES - 1 :: STEP_FRAMES])


def _places(now: Situation) -> FloatArray:
    room_m = now.meetings.room_m[now.meetings.room_m > -NOSE_M]
    apart = np.diff(room_m, prepend=-np.inf) > APART_M
    return room_m[apart][:PLACES]


def _leader(now: Situation, prediction: Prediction) -> tuple[FloatArray, FloatArray]:
    """Where the leader's rear bumper is at the knots of a profile, and its speed."""
    if now.leader < 0:
        return np.full(len(KNOT_AT_S), np.inf), np.zeros(len(KNOT_AT_S))
    best = int(prediction.mode_probability[now.leader].argmax())
    path = np.concatenate((now.scene.xy_m[[now.leader]], prediction.xy_m[now.leader, best]))
    travelled = np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))
    # Nobody knows what it does beyond the horizon: the ego is to manage if it slows down.
    ahead_m, speed = travel_at(travelled[None], KNOT_AT_S, SLOWING_MPS2)
    return now.gap_m + ahead_m[0], speed[0]
