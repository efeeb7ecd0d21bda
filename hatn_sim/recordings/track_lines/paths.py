"""A driven track -> its path: points a metre apart, without time, standing and jitter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import solveh_banded

from hatn_sim.datatypes import FloatArray, Kind
from hatn_sim.geometry import arc_length_m, resample, tangent_rad
from hatn_sim.recordings.lanelet2.rules import MOTOR

STEP_M: Final = 1.0
"""From point to point of every path."""
THIN_M: Final = 0.5
"""Positions nearer to the one before are jitter or standing."""
SHORTEST_M: Final = 20.0
"""Who drove less tells nothing of a line."""
TRACK_SMOOTH_M: Final = 6.0
REVERSED: Final = 0.1
"""Share of the way driven backwards from which on a vehicle was parking, not passing."""
_SCALE_M: Final = 3.0
"""In the space of poses, a radian counts as much as this distance."""


@dataclass(frozen=True, eq=False)
class DrivenTrack:
    """Where a road user was, frame by frame, from its first to its last."""

    recording: str
    name: str
    kind: Kind
    xy_m: FloatArray  # [T, 2]
    yaw_rad: FloatArray  # [T]


@dataclass(frozen=True, eq=False)
class Path:
    """Points `STEP_M` apart. `vehicles` drove it: 1 for a track, 0 for a path of the map.

    The name, of a track or of one of those that made a mean, settles the order of equal paths.
    """

    xy_m: FloatArray  # [P, 2]
    yaw_rad: FloatArray  # [P] unwrapped
    vehicles: int = 1
    name: str = ""

    @property
    def length_m(self) -> float:
        return (len(self.xy_m) - 1) * STEP_M


def path_through(xy_m: FloatArray, vehicles: int = 1, name: str = "") -> Path:
    """The path along a polyline [P, 2]."""
    xy_m = resample(xy_m, STEP_M)
    return Path(xy_m, tangent_rad(xy_m), vehicles, name)


def driven_path(track: DrivenTrack) -> Path | None:
    """The path of a motor vehicle that drove on; None for anybody else."""
    if track.kind not in MOTOR:
        return None
    kept = _thinned(track.xy_m)
    xy_m = track.xy_m[kept]
    if len(kept) < 2 or arc_length_m(xy_m)[-1] < SHORTEST_M:
        return None
    step = np.diff(xy_m, axis=0)
    yaw = track.yaw_rad[kept[:-1]]
    ahead = step[:, 0] * np.cos(yaw) + step[:, 1] * np.sin(yaw)
    if (ahead < 0.0).mean() > REVERSED:
        return None
    name = f"{track.recording}:{track.name}"
    return path_through(smoothed(resample(xy_m, STEP_M), TRACK_SMOOTH_M), name=name)


def _thinned(xy_m: FloatArray) -> list[int]:
    """Indices of positions at least `THIN_M` apart, the first included."""
    kept, (x, y) = [0], xy_m[0].tolist()
    for k, (next_x, next_y) in enumerate(xy_m.tolist()):
        if (next_x - x) ** 2 + (next_y - y) ** 2 >= THIN_M**2:
            kept.append(k)
            x, y = next_x, next_y
    return kept


def smoothed(xy_m: FloatArray, wavelength_m: float) -> FloatArray:
    """Points [P, 2] a step apart without ripples much shorter than a wavelength.

    The Whittaker smoother with third differences (Eilers, A perfect smoother, 2003): it halves
    ripples of the wavelength and leaves parabolas as they are, so that bends do not shrink.
    """
    count = len(xy_m)
    if count < 8:
        return xy_m
    weight = (2.0 * np.sin(np.pi * STEP_M / wavelength_m)) ** -6
    third = (-1.0, 3.0, -3.0, 1.0)
    bands = np.zeros((4, count))
    for shift in range(4):
        for k in range(4 - shift):
            from_k = k + shift
            bands[3 - shift, from_k : from_k + count - 3] += weight * third[k] * third[from_k]
    bands[3] += 1.0
    return np.asarray(solveh_banded(bands, xy_m), dtype=np.float64)


def poses(xy_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """[N, 4] Poses as points of a space in which near means near in place and heading."""
    heading = np.column_stack((np.cos(yaw_rad), np.sin(yaw_rad)))
    return np.concatenate((xy_m, _SCALE_M * heading), axis=1)
