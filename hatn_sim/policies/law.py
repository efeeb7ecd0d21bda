"""How fast the ego may be: what no driver decides, so that a policy need not learn it.

Limits, bends, stop lines, closed signals, the leader ahead, and whoever crosses or merges and will
be in the way, each as a speed not to be exceeded some way on. When to go, and whom of those to let
go who come a little later or can still wait, is left to the policy.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import DT_S, BoolArray, FloatArray
from hatn_sim.envs.action import FASTER_MPS2, SLOWER_MPS2
from hatn_sim.planning.following import (
    SHORT_M,
    STANDSTILL_M,
    TOO_LATE_MPS2,
    time_over_s,
)
from hatn_sim.planning.situation import Situation
from hatn_sim.policies.timing import steady_gain_s
from hatn_sim.speed_profile import PROFILE_STEP_M

LEVELS_MPS2: Final = (-6.0, -3.0, -1.5, 0.0, 0.7, 1.4, 2.0)
"""What a policy chooses from, as far as it is allowed."""
BRAKING_MPS2: Final = 2.5
"""What is ahead is to be met by braking no harder than this."""
REACTION_S: Final = 0.5
"""The time of one decision."""
HOLDS_FRAMES: Final = round(REACTION_S / DT_S)
HEADWAY_S: Final = 1.0
FALLS_BACK_S: Final = 1.0
BEFORE_LINE_M: Final = 0.7
"""Where front bumpers stop."""
MOVING_MPS: Final = 0.5
"""Who is slower is not waited for outside the area."""
AHEAD_S: Final = 1.0
"""From when the ego is out of an area until somebody comes who can no longer stop before it."""
LIKELY_MPS2: Final = 3.5
"""It brakes no harder than this for who could brake, too."""
LEADER_GAIN_MPS2: Final = 1.0
"""How a leader that moves is taken to drive on; one that stands does not."""
LEAST_MPS: Final = 0.1
HARDEST_GAIN_MPS2: Final = 2.5
"""Others do not gain speed faster than this for long."""


def lawful_mps2(now: Situation | None, gains_mps2: FloatArray) -> float:
    """The highest acceleration that is allowed until the next decision.

    `gains_mps2` [N] are the accelerations of all in the scene. An ego that is on no known road
    (None) keeps its speed at most.
    """
    return 0.0 if now is None else (allowed_mps(now, gains_mps2) - now.speed_mps) / REACTION_S


def level_mps2(level: int, lawful: float) -> float:
    """What comes of a level where no more than `lawful` is allowed."""
    return float(np.clip(min(LEVELS_MPS2[level], lawful), SLOWER_MPS2, FASTER_MPS2))


def allowed_mps(now: Situation, gains_mps2: FloatArray) -> float:
    """The speed that an ego may have when it decides next."""
    # What the road allows here has been slowed down for already (`speed_profile`).
    some = [now.allowed_mps[:1], yielding_mps(now, gains_mps2)]
    if not _too_late(now.speed_mps, now.stop_m, TOO_LATE_MPS2):
        some.append(safe_mps(np.array([now.stop_m - BEFORE_LINE_M]), 0.0))
    if now.leader >= 0:
        gap_m, leader_mps = np.array([now.gap_m - STANDSTILL_M]), now.leader_mps
        some.append(safe_mps(gap_m, leader_mps, HEADWAY_S))
    return float(np.concatenate(some).min())


def yielding_mps(now: Situation, gains_mps2: FloatArray) -> FloatArray:
    """The speeds [K] that all at conflicts ahead ask for who are not to be hindered.

    Those are who is in the area, who can no longer stop before it, and who would be there, without
    having to give way, while the ego is: at its present acceleration, and the ego at its highest.
    For all of them it keeps able to stop before the area, or to follow whoever merges ahead of it.
    Where it is too late for either, it gains no speed; in front of who is in the area already it
    brakes all the same, and it goes no farther in where somebody crosses before it.
    """
    met, ego_mps = now.meetings, now.speed_mps
    speed_mps = now.scene.speed_mps[met.other]
    inside = (met.other_room_m <= 0.0) & (met.other_clear_m > 0.0)
    moving = speed_mps > MOVING_MPS
    braking_m = speed_mps**2 / (2.0 * BRAKING_MPS2) + REACTION_S * speed_mps
    bound = moving & (braking_m > met.other_room_m)
    certain = inside | (bound & _meets(now, gains_mps2, AHEAD_S))
    likely = moving & ~met.will_wait & _meets(now, gains_mps2, 0.0)
    # Who stands beyond its line is in the way of others: it waits there for who comes for certain.
    line_m = now.gate_m - BEFORE_LINE_M
    at_line = certain & ~_too_late(ego_mps, line_m, BRAKING_MPS2)
    wait_m = np.minimum(met.room_m - SHORT_M, np.where(at_line, line_m, np.inf))
    hardest_mps2 = np.where(certain, TOO_LATE_MPS2, LIKELY_MPS2)
    stops = (met.room_m > 0.0) & ~_too_late(ego_mps, met.room_m, hardest_mps2)
    stays = inside & (met.room_m > 0.0) & (met.other_clear_m * ego_mps >= met.room_m * speed_mps)
    blocked = inside & ~met.merges & (met.room_m <= 0.0) & (met.other_room_m < met.room_m)
    wait_mps = np.where(stops | stays, safe_mps(wait_m, 0.0), ego_mps)
    wait_mps = np.where(met.room_m > 0.0, wait_mps, np.where(blocked, 0.0, np.inf))
    # Who is beside the ego is not followed: it waits until there is room behind.
    behind_m = met.room_m - met.other_room_m - now.scene.size_m[met.other, 0] - STANDSTILL_M
    merges_ahead = met.merges & (met.other_room_m < met.room_m)
    follows = merges_ahead & ((behind_m >= 0.0) | ~stops)
    follow_mps = np.where(follows, safe_mps(behind_m, speed_mps), 0.0)
    wait_mps = np.where(merges_ahead & ~stops, 0.0, wait_mps)
    return np.maximum(wait_mps, follow_mps)[certain | likely]


def _meets(now: Situation, gains_mps2: FloatArray, ahead_s: float) -> BoolArray:
    """Who comes before the ego has been out of the area so long, and leaves after it comes [J]."""
    met = now.meetings
    pace_mps = np.maximum(now.scene.speed_mps[met.other], MOVING_MPS)
    gain_mps2 = np.clip(gains_mps2[met.other], 0.0, HARDEST_GAIN_MPS2)
    comes_s = steady_gain_s(met.other_room_m, pace_mps, gain_mps2)
    leaves_s = met.other_clear_m / pace_mps
    limit_mps = np.maximum(_limit_mps(now, met.room_m), MOVING_MPS)
    enters_s, clear_s = (
        time_over_s(way_m, now.speed_mps, limit_mps, LEVELS_MPS2[-1])
        for way_m in (met.room_m, met.clear_m)
    )
    # It is not out before there is room behind its leader.
    leader_mps = np.full(len(clear_s), max(now.leader_mps, LEAST_MPS))
    leader_gain = np.full(len(clear_s), LEADER_GAIN_MPS2 * (now.leader_mps > MOVING_MPS))
    needed_m = met.clear_m + STANDSTILL_M - now.gap_m  # -inf without a leader
    clear_s = np.maximum(clear_s, steady_gain_s(needed_m, leader_mps, leader_gain))
    return (comes_s < clear_s + ahead_s) & (leaves_s > enters_s)


def _limit_mps(now: Situation, way_m: FloatArray) -> FloatArray:
    """What the road allows so far on [K]."""
    there = np.clip(way_m, 0.0, None) / PROFILE_STEP_M
    return np.interp(there, np.arange(len(now.allowed_mps)), now.allowed_mps)


def _too_late(speed_mps: float, way_m: FloatArray | float, hardest_mps2: FloatArray | float) -> Any:
    """Whether a stop within so many metres would take harder braking than that."""
    return speed_mps**2 > 2.0 * hardest_mps2 * np.maximum(way_m, 0.01)


def safe_mps(
    away_m: FloatArray, there_mps: FloatArray | float, reaction_s: float = REACTION_S
) -> FloatArray:
    """From which speeds one is down to `there_mps`, `away_m` on (Krauss 1998).

    Who is nearer than it should be already falls back within `FALLS_BACK_S`.
    """
    slack = BRAKING_MPS2 * reaction_s
    square = slack**2 + there_mps**2 + 2.0 * BRAKING_MPS2 * np.maximum(away_m, 0.0)
    return np.maximum(np.sqrt(square) - slack + np.minimum(away_m, 0.0) / FALLS_BACK_S, 0.0)
