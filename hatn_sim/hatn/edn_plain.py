"""What the plain decoder reads and says: the paper's coordinates, features and representations.

Outputs are a position, with `speed_out` two speeds, with `yaw_out` an angle: [.., O]. In Frenet
coordinates (s, d), (v_s, v_d), phi; in Cartesian ones (x, y), (v_x, v_y), yaw of the map. `aligned`
positions count from the vehicle's present one.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

from hatn_sim.hatn.edn_settings import EdnSettings
from hatn_sim.hatn.inputs import LINE_AT_M

ALIGNED_SCALE_M: Final = 10.0
MAP_SCALE_M: Final = 50.0
"""Positions that are not aligned lie anywhere on a map."""
SPEED_SCALE_MPS: Final = 10.0
_SEEN: Final = 5


def output_size(settings: EdnSettings) -> int:
    return 2 + 2 * settings.speed_out + settings.yaw_out


def history_size(settings: EdnSettings) -> int:
    return 2 + 2 * settings.speed_in + settings.yaw_in + 1


def _motion(settings: EdnSettings, history: Tensor, at: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Positions [B, T, 2], speeds [B, T, 2] and angles [B, T, 1] in the wanted coordinates."""
    if settings.coordinates == "frenet":
        s, d, v_s, v_d, phi = history[..., :5].unbind(-1)
        if settings.aligned:
            d = d - d[:, -1:]
        else:
            s = s + at[:, 3:4]
        return torch.stack((s, d), -1), torch.stack((v_s, v_d), -1), phi.unsqueeze(-1)
    x, y, yaw, speed = history[..., 6:10].unbind(-1)
    yaw_now = at[:, 2:3]
    cos, sin = yaw_now.cos(), yaw_now.sin()
    xy = torch.stack((x * cos - y * sin, x * sin + y * cos), -1)
    if not settings.aligned:
        xy = xy + at[:, None, :2]
    yaw = yaw + yaw_now
    return xy, torch.stack((speed * yaw.cos(), speed * yaw.sin()), -1), yaw.unsqueeze(-1)


def _position_scale(settings: EdnSettings) -> float:
    return ALIGNED_SCALE_M if settings.aligned else MAP_SCALE_M


def history_inputs(settings: EdnSettings, history: Tensor, at: Tensor, goal_m: Tensor) -> Tensor:
    """What the encoder reads [B, T, history_size]."""
    position, speed, yaw = _motion(settings, history, at)
    if settings.goal == "transform":
        # The goal is a distance along the way: along x of the vehicle's frame where there is none.
        along = _forward(settings, at) * goal_m[:, None, -1:]
        position = position - position[:, -1:] - along
    columns = [position / _position_scale(settings)]
    if settings.speed_in:
        columns.append(speed / SPEED_SCALE_MPS)
    if settings.yaw_in:
        columns.append(yaw)
    return torch.cat((*columns, history[..., _SEEN : _SEEN + 1]), -1)


def _forward(settings: EdnSettings, at: Tensor) -> Tensor:
    """The direction of the way [B, 1, 2] in the wanted coordinates."""
    if settings.coordinates == "frenet":
        return torch.stack((torch.ones_like(at[:, :1]), torch.zeros_like(at[:, :1])), -1)
    return torch.stack((at[:, 2:3].cos(), at[:, 2:3].sin()), -1)


def history_outputs(settings: EdnSettings, history: Tensor, at: Tensor) -> Tensor:
    """The history [B, T, O] in the terms of the outputs."""
    position, speed, yaw = _motion(settings, history, at)
    columns = [position]
    if settings.speed_out:
        columns.append(speed)
    if settings.yaw_out:
        columns.append(yaw)
    return torch.cat(columns, -1)


def first_input(settings: EdnSettings, said: Tensor) -> Tensor:
    """What the decoder reads first [B, O]: the present, or the last increment observed."""
    return taught(settings, said[:, -1], said[:, -2])


def taught(settings: EdnSettings, now: Tensor, before: Tensor) -> Tensor:
    """Outputs [B, O] as the decoder would have emitted them."""
    if not settings.incremental:
        return now
    return torch.cat((now[:, :2] - before[:, :2], now[:, 2:]), -1)


def _scales(settings: EdnSettings, like: Tensor) -> Tensor:
    position = 1.0 if settings.incremental else _position_scale(settings)
    scales = [position, position] + [SPEED_SCALE_MPS] * (2 * settings.speed_out)
    return like.new_tensor(scales + [1.0] * settings.yaw_out)


def scaled(settings: EdnSettings, outputs: Tensor) -> Tensor:
    return outputs / _scales(settings, outputs)


def unscaled(settings: EdnSettings, emitted: Tensor) -> Tensor:
    return emitted * _scales(settings, emitted)


def travelled(settings: EdnSettings, position: Tensor, start: Tensor) -> Tensor:
    """How far [B, 1] a position is from the first, along the line or as the crow flies."""
    away = position - start
    if settings.coordinates == "frenet":
        return away[:, :1]
    return (away * away).sum(-1, keepdim=True).add(1e-9).sqrt()


def targets(
    settings: EdnSettings, at: Tensor, future: Tensor, future_xy: Tensor, motion: Tensor
) -> Tensor:
    """The truth [B, F, O] in the terms of the outputs.

    Args:
        settings: of the network.
        at: [B, 5] now, see `inputs.VehicleInputs`.
        future: [B, F, 2] s and d since now.
        future_xy: [B, F, 2] in the vehicle's frame of now.
        motion: [B, F, 3] speed, yaw since now, heading against the line (phi).
    """
    speed, yaw, phi = motion.unbind(-1)
    if settings.coordinates == "frenet":
        s, d = future.unbind(-1)
        if not settings.aligned:
            s, d = s + at[:, 3:4], d + at[:, 4:5]
        columns = [s, d]
        angle = phi
    else:
        cos, sin = at[:, 2:3].cos(), at[:, 2:3].sin()
        x, y = future_xy.unbind(-1)
        x, y = x * cos - y * sin, x * sin + y * cos
        if not settings.aligned:
            x, y = x + at[:, :1], y + at[:, 1:2]
        columns = [x, y]
        angle = yaw + at[:, 2:3]
    if settings.speed_out:
        columns += [speed * angle.cos(), speed * angle.sin()]
    if settings.yaw_out:
        columns.append(angle)
    return torch.stack(columns, -1)


def to_vehicle_frame(settings: EdnSettings, line: Tensor, at: Tensor, native: Tensor) -> Tensor:
    """Positions [B, F, 2] in the vehicle's frame of what the decoder said [B, F, O]."""
    position = native[..., :2]
    if settings.coordinates == "cartesian":
        if not settings.aligned:
            position = position - at[:, None, :2]
        cos, sin = at[:, 2:3].cos(), at[:, 2:3].sin()
        x, y = position.unbind(-1)
        return torch.stack((x * cos + y * sin, y * cos - x * sin), -1)
    s, d = position.unbind(-1)
    if not settings.aligned:
        s, d = s - at[:, 3:4], d - at[:, 4:5]
    return _along(line, s, d)


def _along(line: Tensor, s: Tensor, d: Tensor) -> Tensor:
    """Positions [B, F, 2] at s, d since now [B, F] on `line` [B, P, 2]; straight on at ends."""
    vertex_m = line.new_tensor(LINE_AT_M)
    below = (torch.searchsorted(vertex_m, s.detach().contiguous(), right=True) - 1).clamp(
        0, len(vertex_m) - 2
    )
    part = ((s - vertex_m[below]) / (vertex_m[below + 1] - vertex_m[below])).unsqueeze(-1)
    pair = below.unsqueeze(-1).expand(-1, -1, 2)
    low, high = line.gather(1, pair), line.gather(1, pair + 1)
    along = high - low
    tangent = along / along.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    normal = torch.stack((-tangent[..., 1], tangent[..., 0]), -1)
    return low + part * along + d.unsqueeze(-1) * normal
