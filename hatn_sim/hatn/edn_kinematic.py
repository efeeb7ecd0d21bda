"""What the kinematic decoder reads of a vehicle's motion, and the limits of what it may say.

It says, at every step, how the acceleration and the curvature change; see METHOD section 3, "Beyond
the paper". Lengths in metres, and in metres a frame where they are increments.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import torch
from torch import Tensor

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES
from hatn_sim.hatn.kinematics import (
    Present,
    gap_ahead_m,
    largest_curvature_per_m,
    path_along,
)

MAX_JERK_MPS3: Final = 30.0
ACCELERATION_MPS2: Final = (-9.0, 6.0)
MAX_SWERVE_PER_M: Final = 0.03
"""By how much one step may change the curvature against the path's."""
MAX_SLOPE: Final = 0.5
AHEAD_STEPS: Final = 5
"""How many steps ahead of now the goals are read besides."""
START_LIMITS: Final = (0.03, 3.0, 0.1, 0.05)
"""How far the present increment (m), acceleration, course and curvature may be corrected."""
GAP_AT_S: Final = (0.5, 1.0, 1.5, 2.0, 3.0)
"""The network is told how far beside the present arc the line runs, after the way of these times
and a metre more for each second."""
GAP_M: Final = 6.0
"""At most so far."""
BLEND_M: Final = 4.0
BLEND_S: Final = 1.0
"""The path is the line's after this and the way of this time, unless the network knows better."""
HISTORY_SIZE: Final = 14 + len(GAP_AT_S)
STATE_SIZE: Final = 6


def history_inputs(history: Tensor, line: Tensor, now: Present) -> Tensor:
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
        now.curving_per_m.unsqueeze(-1).expand_as(s) / 0.05,
        *(gap.unsqueeze(-1).expand_as(s) / 2.0 for gap in _gaps_m(line, now).unbind(-1)),
    )
    return torch.stack(columns, -1)


def _gaps_m(line: Tensor, now: Present) -> Tensor:
    """How far the line [B, P, 2] runs to the left of the present arc [B, len(GAP_AT_S)]."""
    arc = path_along(line, now.course_rad, _curvature(now, 1.0), _usual_blend_m(now))
    after_s = now.increment_m.new_tensor(GAP_AT_S)
    ahead_m = now.increment_m.unsqueeze(-1) / DT_S * after_s + after_s
    return gap_ahead_m(arc, ahead_m).clamp(-GAP_M, GAP_M)


def _curvature(now: Present, trend: float | Tensor) -> Tensor:
    """How the path goes on [B], with so much of how its curvature has changed."""
    onward = now.curvature_per_m + trend * now.curving_per_m
    most = largest_curvature_per_m(now.increment_m)
    return onward.clamp(-most, most)


def _usual_blend_m(now: Present) -> Tensor:
    return BLEND_M + BLEND_S / DT_S * now.increment_m


def corrected(now: Present, correction: Tensor) -> tuple[Present, Tensor]:
    """The present motion as the network holds it to be, and `Path.blend_m` [B].

    `correction` [B, len(START_LIMITS) + 2] is what it says of them.
    """
    curvature = _curvature(now, 2.0 * correction[:, 5].sigmoid())
    known = (now.increment_m, now.acceleration_mps2, now.course_rad, curvature)
    limits = correction.new_tensor(START_LIMITS)
    increment, acceleration, course, curvature = (
        torch.stack(known, -1) + limits * correction[:, :4].tanh()
    ).unbind(-1)
    blend_m = _usual_blend_m(now) * correction[:, 4].clamp(-2, 2).exp()
    begun = replace(
        now,
        increment_m=increment.clamp(min=0.0),
        acceleration_mps2=acceleration,
        course_rad=course,
        curvature_per_m=curvature,
    )
    return begun, blend_m


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
