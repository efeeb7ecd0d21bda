"""The way to a goal: distances after 0.5, 1 ... 3 s that begin with today's speed and end there."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

from hatn_sim.speed_profile import ACCELERATION_MPS2

PROFILE_S: Final = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
"""When the distances of a profile are travelled; the last is the goal's."""
HORIZON_S: Final = 3.0
MIN_SHARE: Final = 0.05
"""Of a uniform step in every step of the base, so that what stands may also go."""


def constant_acceleration_steps(goal_m: Tensor, speed_mps: Tensor) -> Tensor:
    """The shares [..., P] of a goal [...] in each half second, at one acceleration; they sum to 1.

    From `speed_mps` [...] on. Who would stop before the three seconds are over brakes evenly to
    stand at the goal, and then stays.
    """
    t = goal_m.new_tensor(PROFILE_S)
    speed, goal = speed_mps.clamp(min=0.0).unsqueeze(-1), goal_m.clamp(min=1e-3).unsqueeze(-1)
    stop_s = (2.0 * goal / speed.clamp(min=1e-3)).clamp(max=HORIZON_S)
    braking = goal * (1.0 - (1.0 - t / stop_s).clamp(min=0.0) ** 2)
    even = speed * t + (goal - HORIZON_S * speed) * (t / HORIZON_S) ** 2
    travelled = torch.where(goal < 0.5 * HORIZON_S * speed, braking, even)
    step = torch.diff(travelled, dim=-1, prepend=torch.zeros_like(goal)) / goal
    return (1.0 - MIN_SHARE) * step + MIN_SHARE / len(PROFILE_S)


def profile_m(goal_m: Tensor, speed_mps: Tensor, change: Tensor) -> Tensor:
    """Distances [..., P] after `PROFILE_S`: never falling, the last is the goal [...].

    `change` [..., P] multiplies the steps of one acceleration, as a logarithm; 0 changes nothing.
    """
    base = constant_acceleration_steps(goal_m.detach(), speed_mps)
    share = (base.log() + change).softmax(-1)
    return goal_m.unsqueeze(-1) * share.cumsum(-1)


def braking_m(distance_m: Tensor, speed_mps: Tensor) -> Tensor:
    """How far one gets in three seconds by braking evenly to stand after a distance [...]."""
    distance, speed = distance_m.clamp(min=1e-3), speed_mps.clamp(min=0.0)
    moving = speed * HORIZON_S - (speed * HORIZON_S) ** 2 / (4.0 * distance)
    return torch.where(distance < 0.5 * HORIZON_S * speed, distance, moving).clamp(min=0.0)


def earliest_s(distance_m: Tensor, speed_mps: Tensor) -> Tensor:
    """Time to a place at `ACCELERATION_MPS2` from now on; 0 behind it."""
    speed = speed_mps.clamp(min=0.0)
    ahead = distance_m.clamp(min=0.0)
    root = (speed**2 + 2.0 * ACCELERATION_MPS2 * ahead).clamp(min=1e-9).sqrt()
    return (root - speed).clamp(min=0.0) / ACCELERATION_MPS2
