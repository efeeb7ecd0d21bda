"""How far a vehicle would get in three seconds if it did one plain thing, whatever the place.

A goal is then mostly a choice among these, which means the same on every road, and little of a
distance learnt by heart.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

from hatn_sim.graph import CONTEXT, FREE_M
from hatn_sim.hatn.travel import HORIZON_S, braking_m

_REAR_M, _REAR_MPS, _LENGTH_M = 3, 4, 6  # d_r, v_r, l among the features
_FREE: Final = CONTEXT.index("free_travel_m of the rear vehicle in 3 s")
_GAP: Final = CONTEXT.index("distance_m of the rear vehicle to its leader, up to FREE_M")
_LEADER_MPS: Final = CONTEXT.index("speed_mps of the leader of the rear vehicle")
_LEADER: Final = CONTEXT.index("leader there")
_ACCELERATION: Final = CONTEXT.index("acceleration_mps2 of the rear vehicle")
_GATE: Final = next(index for index, name in enumerate(CONTEXT) if name.startswith("gate_m"))
ANCHORS_OF_FEATURES: Final = 3
ANCHORS: Final = ANCHORS_OF_FEATURES + 4


def anchors_of_features_m(now: Tensor) -> Tensor:
    """Distances [..., 3] of rear vehicles with features [..., 7] now.

    At today's speed; braking for the front boundary; braking for the conflict.
    """
    speed = now[..., _REAR_MPS]
    front_m = now[..., _LENGTH_M].clamp(max=FREE_M)
    at_front, at_conflict = braking_m(front_m, speed), braking_m(now[..., _REAR_M], speed)
    return torch.stack((HORIZON_S * speed, at_front, at_conflict), -1)


def anchors_of_context_m(now: Tensor, context: Tensor) -> Tensor:
    """Distances [..., 4] of rear vehicles with features [..., 7] now and `graph.CONTEXT` [..., C].

    At today's acceleration; with nobody in the way; behind the leader; braking for the gate.
    """
    free = context[..., _FREE]
    onward = HORIZON_S * now[..., _REAR_MPS] + 0.5 * HORIZON_S**2 * context[..., _ACCELERATION]
    behind = context[..., _GAP] + HORIZON_S * context[..., _LEADER_MPS]
    behind = torch.where(context[..., _LEADER] > 0.5, torch.minimum(behind, free), free)
    at_gate = torch.minimum(braking_m(context[..., _GATE], now[..., _REAR_MPS]), free)
    return torch.stack((onward.clamp(min=0.0), free, behind, at_gate), -1)
