"""What the networks read, cut from perception and graphs: arrays in, float32 arrays out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hatn_sim.datatypes import HISTORY_FRAMES, IntArray
from hatn_sim.geometry import wrap_angle
from hatn_sim.perception import Perception
from hatn_sim.road import Road

Float32Array = NDArray[np.float32]

HISTORY: Final = (
    "s_m since now along the own line",
    "d_m",
    "speed_mps along the line",
    "speed_mps across the line",
    "phi_rad",
    "seen",
    "x_m in the vehicle's frame of now",
    "y_m in the vehicle's frame of now",
    "yaw_rad since now",
    "speed_mps",
)
"""The last axis of `VehicleInputs.history`. A vehicle's frame: its centre, x along its heading."""
LINE_AT_M: Final = np.concatenate(
    (np.arange(0.0, 10.0, 0.5), np.arange(10.0, 40.0, 1.0), np.arange(40.0, 121.0, 4.0))
)
"""Where the line ahead is sampled: finely where the next seconds are driven."""


@dataclass(frozen=True, eq=False)
class VehicleInputs:
    """What the EDN reads of B vehicles that are on a line; float32."""

    history: Float32Array  # [B, T, len(HISTORY)]
    line: Float32Array  # [B, P, 2] parallel to the own line through now, in the vehicle's frame
    at: Float32Array  # [B, 5] now: x_m and y_m in the map, yaw_rad; s_m and d_m on the own line


def vehicle_inputs(road: Road, seen: Perception, vehicle: IntArray) -> VehicleInputs:
    """The inputs of vehicles [B], every one of them on a line."""
    own, scene, lines = seen.own, seen.scene, seen.lines
    tracks = seen.tracks
    xy_now, yaw_now = scene.xy_m[vehicle], scene.yaw_rad[vehicle]
    s, s_now = own.s_m[vehicle], lines.s_m[vehicle]
    xy = to_vehicle_frame(tracks.xy_m[vehicle, -HISTORY_FRAMES:], xy_now, yaw_now)
    columns = (
        s - s[:, -1:],
        own.d_m[vehicle],
        own.speed_mps[vehicle],
        own.lateral_mps[vehicle],
        own.phi_rad[vehicle],
        tracks.valid[vehicle, -HISTORY_FRAMES:].astype(np.float64),
        xy[..., 0],
        xy[..., 1],
        wrap_angle(tracks.yaw_rad[vehicle, -HISTORY_FRAMES:] - yaw_now[:, None]),
        tracks.speed_mps[vehicle, -HISTORY_FRAMES:],
    )
    # Where the line is a polyline, Frenet and back is not exact: begin at now exactly.
    ahead_m = s_now[:, None] + LINE_AT_M
    sideways_m = np.repeat(lines.d_m[vehicle, None], len(LINE_AT_M), axis=1)
    line_xy = road.locate(lines.line[vehicle], ahead_m, sideways_m)
    line_xy = to_vehicle_frame(line_xy, line_xy[:, 0], yaw_now)
    at = np.column_stack((xy_now, yaw_now, s_now, lines.d_m[vehicle]))
    return VehicleInputs(
        history=np.stack(columns, axis=-1).astype(np.float32),
        line=line_xy.astype(np.float32),
        at=at.astype(np.float32),
    )


def to_vehicle_frame(
    xy_m: NDArray[np.float64], origin_m: NDArray[np.float64], yaw_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Map positions [B, ..., 2] as seen from vehicles at `origin_m` [B, 2], heading `yaw_rad`."""
    shape = (len(yaw_rad),) + (1,) * (xy_m.ndim - 2)
    away = xy_m - origin_m.reshape((*shape, 2))
    cos, sin = np.cos(yaw_rad).reshape(shape), np.sin(yaw_rad).reshape(shape)
    x, y = away[..., 0], away[..., 1]
    return np.stack((x * cos + y * sin, y * cos - x * sin), axis=-1)


def to_map_frame(
    xy_m: NDArray[np.float64], origin_m: NDArray[np.float64], yaw_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The inverse of `to_vehicle_frame`."""
    shape = (len(yaw_rad),) + (1,) * (xy_m.ndim - 2)
    cos, sin = np.cos(yaw_rad).reshape(shape), np.sin(yaw_rad).reshape(shape)
    x, y = xy_m[..., 0], xy_m[..., 1]
    turned = np.stack((x * cos - y * sin, x * sin + y * cos), axis=-1)
    return turned + origin_m.reshape((*shape, 2))
