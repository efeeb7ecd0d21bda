"""Other places, from the samples of one: the same manoeuvres at another scale, under other limits.

A junction drawn `k` times as large and driven `k` times as fast takes the same time. Limits that
nobody keeps teach the networks to look at how a vehicle drives, not only at what it may.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import torch
from torch import Tensor

from hatn_sim.graph import AHEAD_AT_M, CONTEXT
from hatn_sim.hatn.edn import VehicleBatch
from hatn_sim.hatn.inputs import HISTORY
from hatn_sim.hatn.sgn import GraphBatch
from hatn_sim.speed_profile import (
    ACCELERATION_MPS2,
    BRAKING_MPS2,
    FREE_STEP_S,
    FREE_STEPS,
    LATERAL_MPS2,
)

SCALE_STD: Final = 0.25
"""Of the logarithm of the scale."""
SCALE_RANGE: Final = (0.6, 2.0)
LIMIT_RANGE: Final = (0.8, 2.0)
"""Factors on the speed limits."""
SHARE: Final = 0.5
"""Of the samples are changed, by scale and by limit each."""

_POINTS: Final = len(AHEAD_AT_M)
_LENGTHS: Final = (0, 3, 6)  # of x: d_f, d_r, l
_SPEEDS: Final = (1, 4)  # of x: v_f, v_r
_ANGLES: Final = (2, 5)  # of x: phi_f, phi_r


def _entry(start: str) -> int:
    return next(index for index, name in enumerate(CONTEXT) if name.startswith(start))


_FREE: Final = _entry("free_travel_m")
_GROWING: Final = (
    *range(_POINTS),
    _FREE,
    _entry("acceleration"),
    _entry("distance_m"),
    _entry("speed_mps of the leader"),
    _entry("gate_m"),
)
_HISTORY_LENGTHS: Final = tuple(
    index
    for index, name in enumerate(HISTORY)
    if name.startswith(("s_m", "d_m", "speed", "x_", "y_m"))
)
_HISTORY_SIDES: Final = tuple(
    index
    for index, name in enumerate(HISTORY)
    if name.startswith(("d_m", "speed_mps across", "phi", "y_m", "yaw"))
)
_HEADING: Final = HISTORY.index("phi_rad")
_YAW: Final = HISTORY.index("yaw_rad since now")
_OFFSET: Final = HISTORY.index("d_m")
_PLACE: Final = tuple(index for index, name in enumerate(HISTORY) if name.startswith(("x_", "y_m")))
_VELOCITY: Final = (
    HISTORY.index("speed_mps along the line"),
    HISTORY.index("speed_mps across the line"),
)
_LATERAL: Final = _entry("lateral_m")
_CURVATURE: Final = slice(_POINTS, 2 * _POINTS)


def random_scale(samples: int) -> Tensor:
    """A scale [S] for each sample; 1 for those left as they are."""
    scale = torch.exp(SCALE_STD * torch.randn(samples)).clamp(*SCALE_RANGE)
    return torch.where(torch.rand(samples) < SHARE, scale, torch.ones(samples))


def scale_graphs(batch: GraphBatch, scale: Tensor) -> GraphBatch:
    """Graphs [E, ...] of places `scale` [E] times as large, driven in the same time."""
    x, context = batch.x.clone(), batch.context.clone()
    by = scale[:, None, None, None]
    x[..., _LENGTHS + _SPEEDS] = x[..., _LENGTHS + _SPEEDS] * by
    context[..., _GROWING] = context[..., _GROWING] * scale[:, None, None]
    context[..., _CURVATURE] = context[..., _CURVATURE] / scale[:, None, None]
    return replace(batch, x=x, context=context)


def change_limits(batch: GraphBatch) -> GraphBatch:
    """The same traffic under other speed limits, one factor for each graph."""
    egos = len(batch.x)
    low, high = LIMIT_RANGE
    factor = low * (high / low) ** torch.rand(egos)
    factor = torch.where(torch.rand(egos) < SHARE, factor, torch.ones(egos))
    context = batch.context.clone()
    context[..., :_POINTS] = context[..., :_POINTS] * factor[:, None, None]
    changed = (factor != 1.0)[:, None] & batch.node_mask
    free = free_travel_m(
        context[..., :_POINTS], context[..., _CURVATURE], batch.x[:, :, -1, _SPEEDS[1]]
    )
    context[..., _FREE] = torch.where(changed, free, context[..., _FREE])
    return replace(batch, context=context)


def free_travel_m(limit_mps: Tensor, curvature_per_m: Tensor, speed_mps: Tensor) -> Tensor:
    """`speed_profile.free_travel_m` from the samples of the road ahead [..., P] in graphs."""
    at_m = torch.tensor(AHEAD_AT_M)
    square = torch.minimum(limit_mps**2, LATERAL_MPS2 / curvature_per_m.abs().clamp(min=1e-4))
    fall = 2.0 * BRAKING_MPS2 * at_m
    reachable = (square + fall).flip(-1).cummin(-1).values.flip(-1) - fall
    allowed = reachable.clamp(min=0.0).sqrt()
    s = torch.zeros_like(speed_mps)
    speed = speed_mps
    for _ in range(FREE_STEPS):
        ahead = s + speed * FREE_STEP_S
        column = torch.searchsorted(at_m, ahead, right=True).sub(1).clamp(0, _POINTS - 1)
        limit = allowed.gather(-1, column.unsqueeze(-1)).squeeze(-1)
        wanted = torch.minimum(limit, speed + ACCELERATION_MPS2 * FREE_STEP_S)
        after = torch.maximum(wanted, speed - 2.0 * BRAKING_MPS2 * FREE_STEP_S).clamp(min=0.0)
        s = s + 0.5 * (speed + after) * FREE_STEP_S
        speed = after
    return s


def mirror_graphs(batch: GraphBatch, mirrored: Tensor) -> GraphBatch:
    """Left for right where `mirrored` [E]."""
    x, context = batch.x.clone(), batch.context.clone()
    sign = 1.0 - 2.0 * mirrored.to(x.dtype)
    x[..., _ANGLES] = x[..., _ANGLES] * sign[:, None, None, None]
    context[..., _CURVATURE] = context[..., _CURVATURE] * sign[:, None, None]
    context[..., _LATERAL] = context[..., _LATERAL] * sign[:, None]
    return replace(batch, x=x, context=context)


def scale_vehicles(
    batch: VehicleBatch, future_xy: Tensor, goal_m: Tensor, scale: Tensor
) -> tuple[VehicleBatch, Tensor, Tensor]:
    """Vehicles [B], their futures [B, F, 2] and goals [B, G] at a scale [B] of their own."""
    by = scale[:, None, None]
    history = batch.history.clone()
    history[..., _HISTORY_LENGTHS] = history[..., _HISTORY_LENGTHS] * by
    batch = replace(batch, history=history, line=batch.line * by)
    return batch, future_xy * by, goal_m * scale[:, None]


def mirror_vehicles(
    batch: VehicleBatch, future_xy: Tensor, mirrored: Tensor
) -> tuple[VehicleBatch, Tensor]:
    """Those of the vehicles [B] that `mirrored` [B] names with left and right exchanged."""
    sign = torch.where(mirrored, -1.0, 1.0)
    history = batch.history.clone()
    history[..., _HISTORY_SIDES] = history[..., _HISTORY_SIDES] * sign[:, None, None]
    flip = torch.stack((torch.ones_like(sign), sign), -1)[:, None]
    return replace(batch, history=history, line=batch.line * flip), future_xy * flip


def turn_vehicles(
    batch: VehicleBatch, future_xy: Tensor, turn_rad: Tensor
) -> tuple[VehicleBatch, Tensor]:
    """Vehicles [B] that head by `turn_rad` [B] to the left of where they did, and drive alike."""
    history = batch.history.clone()
    history[..., _HEADING] = history[..., _HEADING] + turn_rad[:, None]
    # Speeds along and across the line are those that heading and speed tell of.
    history[..., _VELOCITY] = _turned(history[..., _VELOCITY], turn_rad)
    history[..., _PLACE] = _turned(history[..., _PLACE], -turn_rad)
    line = _turned(batch.line, -turn_rad)
    return replace(batch, history=history, line=line), _turned(future_xy, -turn_rad)


def _turned(xy: Tensor, by_rad: Tensor) -> Tensor:
    cos, sin = by_rad.cos()[:, None], by_rad.sin()[:, None]
    x, y = xy.unbind(-1)
    return torch.stack((x * cos - y * sin, x * sin + y * cos), -1)


def shift_vehicles(batch: VehicleBatch, left_m: Tensor) -> VehicleBatch:
    """Vehicles [B] that drive alike beside a line that lies `left_m` [B] farther to the right."""
    history = batch.history.clone()
    history[..., _OFFSET] = history[..., _OFFSET] + left_m[:, None]
    return replace(batch, history=history)


def shake_vehicles(batch: VehicleBatch, std_rad: Tensor) -> VehicleBatch:
    """Vehicles [B] whose headings were measured with errors of `std_rad` [B] until now."""
    history = batch.history.clone()
    error = std_rad[:, None] * torch.randn(history.shape[:2])
    error[:, -1] = 0.0  # headings count from that of now
    history[..., _YAW] = history[..., _YAW] + error
    return replace(batch, history=history)
