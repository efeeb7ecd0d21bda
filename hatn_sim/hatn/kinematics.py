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
SEEN: Final = HISTORY.index("seen")
SPEED: Final = HISTORY.index("speed_mps")
MAX_CURVATURE_PER_M: Final = 0.25
MAX_LATERAL_MPS2: Final = 15.0
"""Nothing on wheels turns harder: what a heading says beyond is noise."""
SLOW_M: Final = 0.05
"""Increments shorter than this in 0.1 s tell no direction."""
SHORT_M: Final = 0.35
"""On a way shorter than this the heading tells no curvature."""


@dataclass(frozen=True, eq=False)
class Present:
    """How B vehicles move now, from their last positions; metres per frame, radians, 1/m."""

    increment_m: Tensor  # [B] of path in the last frame
    acceleration_mps2: Tensor  # [B]
    course_rad: Tensor  # [B] direction of motion now, in the vehicle's frame
    curvature_per_m: Tensor  # [B] of the path driven in the last 0.4 s
    curving_per_m: Tensor  # [B] of its second half, less that of the first


def present_motion(history: Tensor) -> Present:
    """The motion now of `history` [B, T, len(HISTORY)].

    Increments of position rather than speeds: what a source calls speed may hold for the whole last
    step (SUMO) or for its end (a differentiated track); the next position follows the last ones.
    Who has only just come into view has a speed alone. Who reverses stands for what comes next, on
    the way that its nose points along.
    """
    step = history[:, 1:, (X, Y)] - history[:, :-1, (X, Y)]
    yaw = history[..., YAW]
    last = step[:, -1]
    length = last.norm(dim=-1)
    forward = torch.where(last[:, 0] < 0.0, -length, length)
    forward = torch.where(history[:, -2, SEEN] > 0.5, forward, history[:, -1, SPEED] * DT_S)
    sure = torch.sigmoid((length - SLOW_M) / (0.2 * SLOW_M))
    ahead = torch.where(last[:, 0] < -SLOW_M, -1.0, 1.0)
    half_back = torch.atan2(ahead * last[:, 1], (ahead * last[:, 0]).clamp(min=1e-3)) * sure
    driven = step.norm(dim=-1)
    late = ahead * (yaw[:, -1] - yaw[:, -3]) / driven[:, -2:].sum(-1).clamp(min=SHORT_M)
    early = ahead * (yaw[:, -3] - yaw[:, -5]) / driven[:, -4:-2].sum(-1).clamp(min=SHORT_M)
    most = largest_curvature_per_m(length)
    late, early = late.clamp(-most, most), early.clamp(-most, most)
    curvature = 0.5 * (late + early)
    speed = history[..., SPEED]
    return Present(
        increment_m=forward.clamp(min=0.0),
        acceleration_mps2=(speed[:, -1] - speed[:, -3]) / (2.0 * DT_S),
        course_rad=half_back + 0.5 * late * forward,
        curvature_per_m=curvature,
        curving_per_m=late - early,
    )


def largest_curvature_per_m(increment_m: Tensor) -> Tensor:
    """Of the path of vehicles [B] that drive `increment_m` in a frame."""
    square = (increment_m / DT_S).square().clamp(min=1e-3)
    return (MAX_LATERAL_MPS2 / square).clamp(max=MAX_CURVATURE_PER_M)


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


def gap_ahead_m(path: Path, at_m: Tensor) -> Tensor:
    """How far to the left of the arc the parallel runs [B, Q] after `at_m` [B, Q]."""
    pair, part = _between(path, at_m)
    gap = _blend(path.gap_m, pair, part)
    return (gap * _blend(path.normal, pair, part.clamp(0.0, 1.0))).sum(-1)


def _between(path: Path, at_m: Tensor) -> tuple[Tensor, Tensor]:
    """The vertex [B, Q, 2] before, and the part [B, Q, 1] of the way to the next one."""
    last = path.at_m.shape[1] - 2
    below = torch.searchsorted(path.at_m, at_m.detach().contiguous(), right=True) - 1
    below = below.clamp(0, last)
    low_m = path.at_m.gather(1, below)
    part = (at_m - low_m) / (path.at_m.gather(1, below + 1) - low_m)
    return below.unsqueeze(-1).expand(-1, -1, 2), part.unsqueeze(-1)


def _blend(values: Tensor, pair: Tensor, part: Tensor) -> Tensor:
    low, high = values.gather(1, pair), values.gather(1, pair + 1)
    return low + part * (high - low)


def positions(path: Path, progress_m: Tensor, offset_m: Tensor) -> Tensor:
    """Where vehicles are [B, F, 2] after `progress_m` [B, F] and `offset_m` [B, F] to the left."""
    pair, part = _between(path, progress_m)
    # Farther than the line was sampled: straight on.
    gap = _blend(path.gap_m, pair, part)
    normal = _blend(path.normal, pair, part.clamp(0.0, 1.0))
    u = (progress_m / path.blend_m.unsqueeze(-1)).clamp(0.0, 1.0)
    weight = u * u * u * (u * (6.0 * u - 15.0) + 10.0)
    arc = _arc(path.course_rad, path.curvature_per_m, path.blend_m, progress_m)
    return arc + weight.unsqueeze(-1) * gap + offset_m.unsqueeze(-1) * normal
