"""A vehicle's motion as a path and a progress along it, for many vehicles at once; torch.

The path begins where the vehicle is, in the direction and with the curvature it drives now, and
bends into the parallel of its reference line. The progress begins with the present increment of
path. So a prediction starts from the exact present motion, whatever the map says, and cannot move
sideways without moving on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from hatn_sim.datatypes import DT_S
from hatn_sim.hatn.inputs import HISTORY

X: Final = HISTORY.index("x_m in the vehicle's frame of now")
Y: Final = HISTORY.index("y_m in the vehicle's frame of now")
YAW: Final = HISTORY.index("yaw_rad since now")
SPEED: Final = HISTORY.index("speed_mps")
MAX_CURVATURE_PER_M: Final = 0.25
SLOW_M: Final = 0.05
"""Increments shorter than this in 0.1 s tell no direction."""


@dataclass(frozen=True, eq=False)
class Present:
    """How B vehicles move now, from their last positions; metres per frame, radians, 1/m."""

    increment_m: Tensor  # [B] of path in the last frame
    acceleration_mps2: Tensor  # [B]
    course_rad: Tensor  # [B] direction of motion now, in the vehicle's frame
    curvature_per_m: Tensor  # [B] of the path driven


def present_motion(history: Tensor) -> Present:
    """The motion now of `history` [B, T, len(HISTORY)].

    Increments of position rather than speeds: what a source calls speed may hold for the whole last
    step (SUMO) or for its end (a differentiated track); the next position follows the last ones.
    """
    step = history[:, 1:, (X, Y)] - history[:, :-1, (X, Y)]
    yaw = history[..., YAW]
    last = step[:, -1]
    length = last.norm(dim=-1)
    forward = torch.where(last[:, 0] < 0.0, -length, length)
    sure = torch.sigmoid((length - SLOW_M) / (0.2 * SLOW_M))
    half_back = torch.atan2(last[:, 1], last[:, 0].clamp(min=1e-3)) * sure
    driven = step[:, -3:].norm(dim=-1).sum(-1)
    curvature = (yaw[:, -1] - yaw[:, -4]) / driven.clamp(min=0.5)
    curvature = curvature.clamp(-MAX_CURVATURE_PER_M, MAX_CURVATURE_PER_M)
    speed = history[..., SPEED]
    return Present(
        increment_m=forward.clamp(min=0.0),
        acceleration_mps2=(speed[:, -1] - speed[:, -3]) / (2.0 * DT_S),
        course_rad=half_back + 0.5 * curvature * forward,
        curvature_per_m=curvature,
    )


@dataclass(frozen=True, eq=False)
class Path:
    """Paths of B vehicles from now on, in their frames."""

    course_rad: Tensor  # [B] at the beginning
    curvature_per_m: Tensor  # [B] at the beginning
    blend_m: Tensor  # [B] after this length the path is the parallel of the line
    at_m: Tensor  # [B, P] arc length of the parallel's vertices
    gap_m: Tensor  # [B, P, 2] from the arc that goes on as now to the parallel
    normal: Tensor  # [B, P, 2] of the parallel, to the left


def path_along(line: Tensor, course_rad: Tensor, curvature_per_m: Tensor, blend_m: Tensor) -> Path:
    """The path that leaves in the present direction and bends into `line` [B, P, 2]."""
    step = line[:, 1:] - line[:, :-1]
    length = step.norm(dim=-1).clamp(min=1e-4)
    at_m = torch.cat((torch.zeros_like(length[:, :1]), length.cumsum(-1)), -1)
    tangent = step / length.unsqueeze(-1)
    tangent = torch.cat((tangent, tangent[:, -1:]), 1)
    normal = torch.stack((-tangent[..., 1], tangent[..., 0]), -1)
    gap_m = line - _arc(course_rad, curvature_per_m, blend_m, at_m)
    return Path(course_rad, curvature_per_m, blend_m, at_m, gap_m, normal)


def _arc(course_rad: Tensor, curvature_per_m: Tensor, turning_m: Tensor, at_m: Tensor) -> Tensor:
    """Positions [B, Q, 2] after `at_m` [B, Q]: arcs from the origin, straight on when turned."""
    turned_m = torch.minimum(at_m, turning_m.unsqueeze(-1))
    turn = curvature_per_m.unsqueeze(-1) * turned_m
    chord = turned_m * torch.sinc(0.5 * turn / torch.pi)
    course = course_rad.unsqueeze(-1)
    way, end = course + 0.5 * turn, course + turn
    beyond = at_m - turned_m
    return torch.stack(
        (chord * way.cos() + beyond * end.cos(), chord * way.sin() + beyond * end.sin()), -1
    )


def positions(path: Path, progress_m: Tensor, offset_m: Tensor) -> Tensor:
    """Where vehicles are [B, F, 2] after `progress_m` [B, F] and `offset_m` [B, F] to the left."""
    last = path.at_m.shape[1] - 2
    below = torch.searchsorted(path.at_m, progress_m.detach().contiguous(), right=True) - 1
    below = below.clamp(0, last)
    low_m = path.at_m.gather(1, below)
    part = (progress_m - low_m) / (path.at_m.gather(1, below + 1) - low_m)
    # Farther than the line was sampled: straight on.
    part = part.unsqueeze(-1)
    pair = below.unsqueeze(-1).expand(-1, -1, 2)
    gap_low, gap_high = path.gap_m.gather(1, pair), path.gap_m.gather(1, pair + 1)
    gap = gap_low + part * (gap_high - gap_low)
    n_low, n_high = path.normal.gather(1, pair), path.normal.gather(1, pair + 1)
    normal = n_low + part.clamp(0.0, 1.0) * (n_high - n_low)
    u = (progress_m / path.blend_m.unsqueeze(-1)).clamp(0.0, 1.0)
    weight = u * u * u * (u * (6.0 * u - 15.0) + 10.0)
    arc = _arc(path.course_rad, path.curvature_per_m, path.blend_m, progress_m)
    return arc + weight.unsqueeze(-1) * gap + offset_m.unsqueeze(-1) * normal
