"""How fast the ego may be: what no driver decides, so that a policy need not learn it.

Limits, bends, stop lines, closed signals, the leader ahead, and whoever crosses or merges and can
no longer stop, each as a speed not to be exceeded some way on. When to go, and whom to let go of
those who could still wait, is left to the policy.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.assist.suggest import AT_LINE_M
from hatn_sim.datatypes import DT_S, FloatArray
from hatn_sim.envs.action import FASTER_MPS2, SLOWER_MPS2
from hatn_sim.envs.features import ON_ROAD, OWN, ROAD_AT_M, SLOT
from hatn_sim.envs.observation import Observation
from hatn_sim.graph import FREE_M
from hatn_sim.speed_profile import LATERAL_MPS2

LEVELS_MPS2: Final = (-6.0, -3.0, -1.5, 0.0, 0.7, 1.4, 2.0)
"""What a policy chooses from, as far as it is allowed."""
BRAKING_MPS2: Final = 2.5
"""What is ahead is to be met by braking no harder than this."""
REACTION_S: Final = 0.5
"""The time of one decision."""
HOLDS_FRAMES: Final = round(REACTION_S / DT_S)
HEADWAY_S: Final = 1.0
FALLS_BACK_S: Final = 1.0
STANDSTILL_M: Final = 2.0
"""From the leader's rear bumper."""
BEFORE_LINE_M: Final = 0.7
"""Where front bumpers stop."""
NEAR_SIDE_M: Final = 1.5
"""Before a crossing's point: half the width of who crosses, and some room."""
MOVING_MPS: Final = 0.5
"""Slower ones can stop."""
AHEAD_S: Final = 1.5
"""Who is at a conflict so much sooner than the other is not in the way."""
SAME_M: Final = 1.0
"""So near to each other, the end of the ego's own slot and the line ahead are one place."""
AT_CONFLICT_M: Final = 0.1
STANDING_MPS: Final = 0.3

_OWN: Final = {one.name: k for k, one in enumerate(OWN + ON_ROAD)}
_SLOT: Final = {one.name: k for k, one in enumerate(SLOT)}
_SPEED, _LENGTH = _OWN["speed"], _OWN["length"]
_ON_LINE: Final = len(OWN)
_GATE: Final = _OWN["centre to a stop line, give-way line or closed signal, 50: none"]
_RED: Final = _OWN["a closed signal is before it"]
_LIMIT: Final = _OWN[f"speed limit at {ROAD_AT_M[0]:g} m"]
_BEND: Final = _OWN[f"curvature at {ROAD_AT_M[0]:g} m, left positive"]
_EGO_M: Final = _SLOT["way of the ego to the conflict"]
_OTHER_M: Final = _SLOT["way of the rear vehicle to the conflict"]
_OTHER_MPS: Final = _SLOT["v_r, speed of the rear boundary"]
_MERGES: Final = _SLOT["the conflict is a merge"]
_EGO_S: Final = _SLOT["earliest time of the ego at the conflict"]
_OTHER_S: Final = _SLOT["earliest time of the rear vehicle there"]
_FRONT_MPS: Final = _SLOT["v_f, speed of the front boundary"]
_FRONT_M: Final = _SLOT["d_f, way from the front boundary to the conflict"]
_SLOT_M: Final = _SLOT["l, length of the slot"]


def has_stood(before: bool, observation: Observation) -> bool:
    """Whether the ego has stood at the stop line ahead; `before`: a decision earlier."""
    is_near = _line_m(observation) < AT_LINE_M
    return is_near and (before or float(observation["ego"][_SPEED]) < STANDING_MPS)


def lawful_mps2(observation: Observation, stood: bool) -> float:
    """The highest acceleration that is allowed until the next decision.

    Where it is not known what road the ego is on, it keeps its speed at most.
    """
    own = observation["ego"]
    if not own[_ON_LINE]:
        return 0.0
    return (allowed_mps(observation, stood) - float(own[_SPEED])) / REACTION_S


def level_mps2(level: int, lawful: float) -> float:
    """What comes of a level where no more than `lawful` is allowed."""
    return float(np.clip(min(LEVELS_MPS2[level], lawful), SLOWER_MPS2, FASTER_MPS2))


def allowed_mps(observation: Observation, stood: bool) -> float:
    """The speed that an ego on a known road may have when it decides next."""
    own = observation["ego"].astype(np.float64)
    count = len(ROAD_AT_M)
    bend = np.abs(own[_BEND : _BEND + count])
    road = np.minimum(own[_LIMIT : _LIMIT + count], np.sqrt(LATERAL_MPS2 / np.maximum(bend, 1e-4)))
    away_m, there_mps = [*ROAD_AT_M[1:]], road[1:].tolist()
    reaction_s = [REACTION_S] * (count - 1)
    if own[_RED] or (_is_stop_line(observation) and not stood):
        away_m.append(_line_m(observation) - BEFORE_LINE_M)
        there_mps.append(0.0)
        reaction_s.append(REACTION_S)
    has_leader, gap_m, leader_mps = own[_RED + 1 : _RED + 4].tolist()
    if has_leader:
        away_m.append(gap_m - STANDSTILL_M)
        there_mps.append(leader_mps)
        reaction_s.append(HEADWAY_S)
    for away, there in _committed(observation):
        away_m.append(away)
        there_mps.append(there)
        reaction_s.append(REACTION_S)
    ahead = _safe_mps(np.array(away_m), np.array(there_mps), np.array(reaction_s))
    return min(float(road[0]), float(ahead.min()))


def _committed(observation: Observation) -> list[tuple[float, float]]:
    """How far on to be how fast, for all at conflicts ahead who can no longer stop before them.

    Who merges ahead of the ego is followed; for others it waits, if its nose is not there yet: at
    the line, for who stands beyond it is in the way of whom it lets go. Who has a line ahead lets
    everybody go, too, who is almost there.
    """
    there = observation["slot_mask"][1:] > 0.0
    slots = observation["slots"][1:][there].astype(np.float64)
    ego_m, other_m, other_mps = slots[:, _EGO_M], slots[:, _OTHER_M], slots[:, _OTHER_MPS]
    merges = slots[:, _MERGES] > 0.0
    half_m, line_m = 0.5 * float(observation["ego"][_LENGTH]), _line_m(observation)
    nose_m = ego_m - half_m - np.where(merges, 0.0, NEAR_SIDE_M)
    # At the line it leaves more room, so as not to stop again with its nose in the other's way.
    notice_s = REACTION_S if np.isinf(line_m) else REACTION_S + HEADWAY_S
    stops_m = other_mps**2 / (2.0 * BRAKING_MPS2) + other_mps * notice_s
    bound = (other_mps > MOVING_MPS) & (stops_m > other_m - half_m)
    almost_m = 2.0 * half_m if np.isfinite(line_m) else half_m
    bound |= other_m < np.minimum(almost_m, ego_m)
    follows = bound & merges & (other_m < ego_m)
    first = slots[:, _OTHER_S] < slots[:, _EGO_S] + AHEAD_S
    waits = bound & ~follows & first & (nose_m > 0.0)
    wait_m = np.minimum(nose_m, line_m) - BEFORE_LINE_M
    gap_m = np.where(follows, ego_m - other_m - 2.0 * half_m - STANDSTILL_M, wait_m)
    speed_mps = np.where(follows, np.maximum(other_mps, 0.0), 0.0)
    counts = follows | waits
    return list(zip(gap_m[counts].tolist(), speed_mps[counts].tolist(), strict=True))


def _line_m(observation: Observation) -> float:
    """From the front bumper to the line ahead; infinite where there is none."""
    own = observation["ego"]
    gate_m = float(own[_GATE])
    return gate_m - 0.5 * float(own[_LENGTH]) if 0.0 < gate_m < FREE_M else np.inf


def _is_stop_line(observation: Observation) -> bool:
    """A line that ends the ego's own slot is one to stop at; at others one gives way.

    What ends it at a give-way line is the conflict behind it, which may be as near.
    """
    slot = observation["slots"][0]
    is_end = abs(float(slot[_SLOT_M]) - _line_m(observation)) < SAME_M
    is_conflict = float(slot[_FRONT_M]) < AT_CONFLICT_M
    return is_end and not is_conflict and float(slot[_FRONT_MPS]) == 0.0


def _safe_mps(away_m: FloatArray, there_mps: FloatArray, reaction_s: FloatArray) -> FloatArray:
    """From which speeds one is down to `there_mps`, `away_m` on (Krauss 1998).

    Who is nearer than it should be already falls back within `FALLS_BACK_S`.
    """
    slack = BRAKING_MPS2 * reaction_s
    square = slack**2 + there_mps**2 + 2.0 * BRAKING_MPS2 * np.maximum(away_m, 0.0)
    return np.maximum(np.sqrt(square) - slack + np.minimum(away_m, 0.0) / FALLS_BACK_S, 0.0)
