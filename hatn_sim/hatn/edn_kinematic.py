"""What the kinematic decoder reads of a vehicle's motion, and the limits of what it may say.

It says, at every step, how the acceleration and the curvature change; see METHOD section 3, "Beyond
the paper". Lengths in metres, and in metres a frame where they are increments.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES
from hatn_sim.hatn.kinematics import Present

MAX_JERK_MPS3: Final = 30.0
ACCELERATION_MPS2: Final = (-9.0, 6.0)
MAX_SWERVE_PER_M: Final = 0.03
"""By how much one step may change the curvature against the path's."""
MAX_SLOPE: Final = 0.5
AHEAD_STEPS: Final = 5
"""How many steps ahead of now the goals are read besides."""
START_LIMITS: Final = (0.03, 3.0, 0.1, 0.05)
"""How far the present increment (m), acceleration, course and curvature may be corrected."""
BLEND_M: Final = 4.0
BLEND_S: Final = 1.0
"""The path is the line's after this and the way of this time, unless the network knows better."""
HISTORY_SIZE: Final = 13
STATE_SIZE: Final = 6


def history_inputs(history: Tensor, now: Present) -> Tensor:
    """Motion along the line and in the vehicle's own frame, fine differences enlarged.

    [B, T, HISTORY_SIZE]; the increments of the first frame repeat those of the second.
    """
    s, d, v_s, v_d, phi, seen, x, y, yaw, speed = history.unbind(-1)
    dx, dy = x.diff(dim=1), y.diff(dim=1)
    dx, dy = torch.cat((dx[:, :1], dx), 1), torch.cat((dy[:, :1], dy), 1)
    length = (dx * dx + dy * dy + 1e-12).sqrt()
    speed_now = speed[:, -1:]
    acceleration = now.acceleration_mps2.unsqueeze(-1).expand_as(s)
    columns = (
        s / 10.0,
        d,
        v_s / 10.0,
        v_d,
        phi / 0.5,
        seen,
        (length - now.increment_m.unsqueeze(-1)) / 0.1,
        dy / 0.1,
        yaw / 0.2,
        (speed - speed_now) / 2.0,
        (length / DT_S - speed) / 0.5,
        acceleration / 2.0,
        now.curvature_per_m.unsqueeze(-1).expand_as(s) / 0.1,
    )
    return torch.stack(columns, -1)


def corrected(now: Present, correction: Tensor) -> tuple[Present, Tensor]:
    """The present motion as the network holds it to be, and `Path.blend_m` [B].

    `correction` [B, len(START_LIMITS) + 1] is what it says of them.
    """
    known = (now.increment_m, now.acceleration_mps2, now.course_rad, now.curvature_per_m)
    limits = correction.new_tensor(START_LIMITS)
    increment, acceleration, course, curvature = (
        torch.stack(known, -1) + limits * correction[:, :4].tanh()
    ).unbind(-1)
    blend_m = (BLEND_M + BLEND_S / DT_S * now.increment_m) * correction[:, 4].clamp(-2, 2).exp()
    return Present(increment.clamp(min=0.0), acceleration, course, curvature), blend_m


def state_inputs(
    increment: Tensor,
    acceleration: Tensor,
    slope: Tensor,
    offset: Tensor,
    progress: Tensor,
    wanted_m: Tensor,
    ahead_m: Tensor,
) -> Tensor:
    """What the decoder reads of its own motion [B, STATE_SIZE]; all that it takes is [B].

    `wanted_m`: how far the goals would have it by this step, `ahead_m`: and `AHEAD_STEPS` later.
    """
    columns = (
        increment,
        acceleration / 4.0,
        offset,
        slope * 4.0,
        wanted_m - progress,
        (ahead_m - progress) / 4.0,
    )
    return torch.stack(columns, -1)


def by_step(goal_m: Tensor, steps: int) -> Tensor:
    """Distance wanted at every step [B, HORIZON_FRAMES or fewer]: straight between the goals."""
    count = goal_m.shape[1]
    knots = torch.cat((torch.zeros_like(goal_m[:, :1]), goal_m), 1)
    every = HORIZON_FRAMES // count
    part = torch.arange(1, every + 1, device=goal_m.device, dtype=goal_m.dtype) / every
    between = knots[:, :-1, None] + (knots[:, 1:, None] - knots[:, :-1, None]) * part
    return between.flatten(1)[:, : steps + AHEAD_STEPS]
