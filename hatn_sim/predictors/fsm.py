"""IDM that also follows whoever comes first where the lines meet: FSM-D and FSM-T of the paper.

Section "Comparison with other methods" of Wang et al. (arXiv 2202.05140), after the finite state
machine of Zhang et al. (2017): of the vehicles on other lines that are nearer to their conflict
with the ego than the ego, by distance (D) or by time at constant speed (T), the one least far ahead
is projected onto the ego's line and followed like a leader.

Both are here at their best: nobody follows a vehicle that stands, nor one that has a stop line, a
give-way line or a closed signal ahead, without having one as well.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, ConflictType, FloatArray
from hatn_sim.graph import Active, active_conflicts, next_gates
from hatn_sim.perception import Perception
from hatn_sim.predictors.along_lines import LineFollower
from hatn_sim.predictors.car_following import Meetings, roll_out
from hatn_sim.predictors.present import Present
from hatn_sim.road import Road

SLOWEST_MPS: Final = 0.1
"""Times to a conflict are taken at this speed at least."""
STANDING_MPS: Final = 0.5


class CloserBy(Enum):
    """What decides who is closer to a conflict."""

    DISTANCE = "fsm_d"
    TIME = "fsm_t"


def finite_state_machine(closer_by: CloserBy) -> LineFollower:
    """Follows the leader, or the closest vehicle that will be first at a conflict."""

    def travel(road: Road, seen: Perception, now: Present) -> FloatArray:
        return roll_out(road, seen, now, find_meetings(road, seen, now, closer_by))

    return LineFollower(closer_by.value, travel)


def find_meetings(road: Road, seen: Perception, now: Present, closer_by: CloserBy) -> Meetings:
    """Whom every vehicle follows of those on other lines, if anybody."""
    met = active_conflicts(road, seen, np.flatnonzero(seen.lines.line >= 0))
    merges = met.type == ConflictType.MERGE
    speed = np.maximum(now.speed_mps, SLOWEST_MPS)
    if closer_by is CloserBy.DISTANCE:
        scale = np.ones(len(met.ego))
        lead = met.ego_m - met.other_m
    else:
        scale = speed[met.ego] / speed[met.other]
        lead = met.ego_m / speed[met.ego] - met.other_m / speed[met.other]
    comes = (met.other_m > 0.0) | merges
    comes &= (now.speed_mps[met.other] > STANDING_MPS) & ~_gives_way(road, seen, met)
    rows = np.flatnonzero((met.ego_m > 0.0) & (lead > 0.0) & comes)
    rows = rows[np.lexsort((met.rank[rows], lead[rows], met.ego[rows]))]
    rows = rows[np.diff(met.ego[rows], prepend=-1) > 0]  # the closest for each
    return Meetings(
        follower=met.ego[rows],
        leader=met.other[rows],
        follower_to_m=met.ego_m[rows],
        leader_to_m=met.other_m[rows],
        scale=scale[rows],
        merges=merges[rows],
    )


def _gives_way(road: Road, seen: Perception, met: Active) -> BoolArray:
    """Whether the other [I] has a gate ahead before the conflict, and the ego has none."""
    gates = next_gates(road, seen)
    to_gate_m = np.minimum(np.minimum(gates.stop_m, gates.give_way_m), gates.closed_m)
    to_gate_m = to_gate_m + 0.5 * seen.scene.size_m[:, 0]
    return (to_gate_m[met.other] <= met.other_m) & (to_gate_m[met.ego] > met.ego_m)
