"""Everybody rolled out together along the own lines, by the intelligent driver model.

Treiber, Hennecke and Helbing (2000), "Congested traffic states in empirical observations and
microscopic simulations", eq. 2 and 3, with the urban values of Liebner et al. (2012), the variant
whose desired speed is limited by the lane and by the curvature ahead. Above the desired speed it
brakes as gently as Treiber and Kesting's improved model (Traffic Flow Dynamics, 2013, eq. 11.24).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES, BoolArray, FloatArray, IntArray
from hatn_sim.graph import next_gates
from hatn_sim.perception import Perception
from hatn_sim.predictors.present import Present
from hatn_sim.road import Road
from hatn_sim.speed_profile import PROFILE_STEP_M, allowed_speed_mps

DESIRED_SPEED_MPS: Final = 54.0 / 3.6
HEADWAY_S: Final = 0.8
STANDSTILL_M: Final = 2.0
ACCELERATION_MPS2: Final = 1.5
"""Liebner et al. found 1.5 to 2.5."""
BRAKING_MPS2: Final = 3.0
EXPONENT: Final = 4
HARDEST_MPS2: Final = 8.0
START_FADE_S: Final = 3.0
"""How long today's acceleration lasts on; a driver does not jump to what the model says."""

STOP_BEFORE_M: Final = 0.5
"""How far before a stop line bumpers come to stand."""
STOOD_MPS: Final = 0.3
STOOD_WITHIN_M: Final = 4.0
"""Who has stood this near to a stop line has done what it asks for."""
TOO_LATE_MPS2: Final = 5.0
"""A stop that would take more than this is not made."""
CLEAR_M: Final = 2.0
"""A crossing is free when the rear bumper is this far behind its point."""


@dataclass(frozen=True, eq=False)
class Meetings:
    """Vehicles on other lines to be followed as if ahead on the own one, one row each.

    `scale` turns the leader's distance to the conflict into one on the follower's line: 1, or the
    ratio of the speeds where they are compared by time.
    """

    follower: IntArray  # [Q] vehicle, each at most once
    leader: IntArray  # [Q] vehicle
    follower_to_m: FloatArray  # [Q] to the conflict
    leader_to_m: FloatArray  # [Q]
    scale: FloatArray  # [Q]
    merges: BoolArray  # [Q] the leader stays ahead once it has passed the conflict


NOBODY: Final = Meetings(
    *(np.zeros(0, dtype=kind) for kind in (int, int, float, float, float, bool))
)


def idm_acceleration(
    speed_mps: FloatArray, desired_mps: FloatArray, gap_m: FloatArray, closing_mps: FloatArray
) -> FloatArray:
    """Acceleration in m/s2; `gap_m` is bumper to bumper, inf without a leader."""
    braking = speed_mps * closing_mps / (2.0 * np.sqrt(ACCELERATION_MPS2 * BRAKING_MPS2))
    wanted_m = STANDSTILL_M + np.maximum(0.0, speed_mps * HEADWAY_S + braking)
    desired = np.maximum(desired_mps, 0.1)
    share = speed_mps / desired
    slower = ACCELERATION_MPS2 * (1.0 - share**EXPONENT)
    back = np.maximum(share, 1.0) ** (-ACCELERATION_MPS2 * EXPONENT / BRAKING_MPS2)
    free = np.where(share <= 1.0, slower, -BRAKING_MPS2 * (1.0 - back))
    interaction = ACCELERATION_MPS2 * (wanted_m / np.maximum(gap_m, 0.1)) ** 2
    return np.clip(free - interaction, -HARDEST_MPS2, None)


def roll_out(road: Road, seen: Perception, now: Present, meetings: Meetings = NOBODY) -> FloatArray:
    """Distances travelled [N, F] along the own lines; of no meaning for vehicles on none.

    Everybody follows the leader, stops at closed signals and stop lines, and keeps behind the
    vehicle of its meeting until that has cleared a crossing.
    """
    scene, line = seen.scene, np.maximum(seen.lines.line, 0)
    if not len(road.count):
        return np.zeros((len(line), HORIZON_FRAMES))
    rows = np.arange(len(line))
    has_leader, lead = seen.leader >= 0, np.maximum(seen.leader, 0)
    half_m = 0.5 * scene.size_m[:, 0]
    lead_m = np.where(has_leader, seen.leader_s_m - seen.lines.s_m - half_m - half_m[lead], np.inf)
    lead_on_line = seen.lines.line[lead] >= 0
    allowed = allowed_speed_mps(road, line, seen.lines.s_m)
    stop_m = _stop_m(road, seen, now) - STOP_BEFORE_M + STANDSTILL_M
    one, other = meetings.follower, meetings.leader
    between_m = half_m[one] + half_m[other]

    travelled, speed = np.zeros(len(line)), now.speed_mps
    out = np.zeros((len(line), HORIZON_FRAMES))
    for frame in range(HORIZON_FRAMES):
        column = np.minimum((travelled / PROFILE_STEP_M).astype(np.int64), allowed.shape[1] - 1)
        desired = np.minimum(DESIRED_SPEED_MPS, allowed[rows, column])
        # A leader on no line of its own keeps its speed, on one it is rolled out as well.
        led_m = np.where(lead_on_line, travelled[lead], now.speed_mps[lead] * DT_S * frame)
        lead_mps = np.where(lead_on_line, speed[lead], now.speed_mps[lead])
        gap_m = np.where(has_leader, lead_m + led_m - travelled, np.inf)
        closing = np.where(has_leader, speed - lead_mps, 0.0)
        wanted = idm_acceleration(speed, desired, gap_m, closing)
        wanted = np.minimum(wanted, idm_acceleration(speed, desired, stop_m - travelled, speed))
        ego_m = meetings.follower_to_m - travelled[one]
        other_m = meetings.leader_to_m - travelled[other]
        over = (other_m < -half_m[other] - CLEAR_M) & ~meetings.merges
        ahead_m = ego_m - meetings.scale * other_m - between_m
        ahead_m = np.where(over | (ego_m <= 0.0), np.inf, ahead_m)
        closing = speed[one] - meetings.scale * speed[other]
        behind = idm_acceleration(speed[one], desired[one], ahead_m, closing)
        wanted[one] = np.minimum(wanted[one], behind)

        as_now = np.exp(-DT_S * (frame + 0.5) / START_FADE_S)
        acceleration = as_now * now.acceleration_mps2 + (1.0 - as_now) * wanted
        after = np.maximum(speed + acceleration * DT_S, 0.0)
        travelled = travelled + 0.5 * (speed + after) * DT_S
        speed = after
        out[:, frame] = travelled
    return out


def _stop_m(road: Road, seen: Perception, now: Present) -> FloatArray:
    """Distance [N] of front bumpers to where they have to stop; inf: nowhere."""
    gates = next_gates(road, seen)
    slowest = np.where(seen.tracks.valid, seen.tracks.speed_mps, np.inf).min(axis=1)
    has_stood = (slowest < STOOD_MPS) & (gates.stop_m < STOOD_WITHIN_M)
    stop_m = np.minimum(np.where(has_stood, np.inf, gates.stop_m), gates.closed_m)
    too_late = now.speed_mps**2 > 2.0 * TOO_LATE_MPS2 * np.maximum(stop_m, 0.01)
    return np.where(too_late, np.inf, stop_m)
