"""The outlines of vehicles as oriented boxes: where their corners are, and how near two come.

Arrays only: boxes of any shape [...] are compared element by element, after broadcasting.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray

_SIGNS: Final = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


@dataclass(frozen=True, eq=False)
class Boxes:
    """Oriented boxes of any shape [...]."""

    xy_m: FloatArray  # [..., 2] centres
    yaw_rad: FloatArray  # [...]
    size_m: FloatArray  # [..., 2] length, width

    def __getitem__(self, index: Any) -> Boxes:
        """Some of them; the index is of the axes [...]."""
        return Boxes(self.xy_m[index], self.yaw_rad[index], self.size_m[index])

    @property
    def radius_m(self) -> FloatArray:
        """[...] from the centre to a corner."""
        return 0.5 * np.hypot(self.size_m[..., 0], self.size_m[..., 1])

    def corners_m(self) -> FloatArray:
        """[..., 4, 2] front left, rear left, rear right, front right."""
        cos, sin = np.cos(self.yaw_rad)[..., None], np.sin(self.yaw_rad)[..., None]
        along = 0.5 * self.size_m[..., None, 0] * _SIGNS[:, 0]
        aside = 0.5 * self.size_m[..., None, 1] * _SIGNS[:, 1]
        offset = np.stack((along * cos - aside * sin, along * sin + aside * cos), axis=-1)
        return np.asarray(self.xy_m[..., None, :] + offset)


def separation_m(one: Boxes, other: Boxes) -> FloatArray:
    """How far two boxes are apart along the best of their four axes [...], m.

    Negative exactly where they overlap, by how far they would have to be moved to part; elsewhere
    a lower bound of the gap (separating axes: Gottschalk, Lin and Manocha 1996, section 4).
    """
    away = other.xy_m - one.xy_m
    turn = other.yaw_rad - one.yaw_rad
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    best = None
    for mine, its in ((one, other), (other, one)):
        c, s = np.cos(mine.yaw_rad), np.sin(mine.yaw_rad)
        half, far = 0.5 * mine.size_m, 0.5 * its.size_m
        ahead = np.abs(away[..., 0] * c + away[..., 1] * s)
        aside = np.abs(away[..., 1] * c - away[..., 0] * s)
        along = ahead - half[..., 0] - (far[..., 0] * cos + far[..., 1] * sin)
        across = aside - half[..., 1] - (far[..., 0] * sin + far[..., 1] * cos)
        here = np.maximum(along, across)
        best = here if best is None else np.maximum(best, here)
    return np.asarray(best, dtype=np.float64)


def overlap(one: Boxes, other: Boxes) -> BoolArray:
    """Whether the insides of two boxes meet [...]; boxes that only touch do not."""
    return np.asarray(separation_m(one, other) < 0.0)


def gap_m(one: Boxes, other: Boxes) -> FloatArray:
    """The distance between two outlines [...], m; 0 where they overlap."""
    # Of two convex outlines that are apart, one has a corner that is nearest to the other.
    nearest = np.minimum(_corners_away_m(one, other), _corners_away_m(other, one))
    return np.where(overlap(one, other), 0.0, nearest)


def _corners_away_m(one: Boxes, other: Boxes) -> FloatArray:
    """The distance of the nearest corner of one box to the other box [...]."""
    away = one.corners_m() - other.xy_m[..., None, :]
    c, s = np.cos(other.yaw_rad)[..., None], np.sin(other.yaw_rad)[..., None]
    half = 0.5 * other.size_m[..., None, :]
    ahead = np.abs(away[..., 0] * c + away[..., 1] * s) - half[..., 0]
    aside = np.abs(away[..., 1] * c - away[..., 0] * s) - half[..., 1]
    out = np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0))
    return np.asarray(out.min(axis=-1))
