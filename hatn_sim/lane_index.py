"""Which lanes are near a pose. Built for a whole net at once, without a loop over its lanes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import FloatArray
from hatn_sim.geometry import wrap_angle

_PIECE_M: Final = 10.0
"""Lanes are cut into pieces no longer than this, each found by its middle."""


class LaneIndex:
    """Pieces of polylines [P, 2] in a tree; they are numbered as they were given."""

    def __init__(self, lines_xy_m: Sequence[FloatArray]) -> None:
        points = np.concatenate((np.zeros((0, 2)), *lines_xy_m))
        owner = np.repeat(np.arange(len(lines_xy_m)), np.array([len(xy) for xy in lines_xy_m], int))
        first = np.flatnonzero(owner[1:] == owner[:-1])
        start, along = points[first], points[first + 1] - points[first]
        length_m = np.linalg.norm(along, axis=1)
        some = length_m > 1e-9
        start, along, length_m, owner = start[some], along[some], length_m[some], owner[first[some]]
        pieces = np.ceil(length_m / _PIECE_M).astype(np.int64)
        segment = np.repeat(np.arange(len(pieces)), pieces)
        nth = np.arange(len(segment)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        self._along = (along / pieces[:, None])[segment]
        self._start = start[segment] + nth[:, None] * self._along
        self._yaw_rad = np.arctan2(along[:, 1], along[:, 0])[segment]
        self._owner = owner[segment]
        self._tree = KDTree(self._start + 0.5 * self._along)

    def near(
        self, xy_m: FloatArray, yaw_rad: float, within_m: float, turned_rad: float
    ) -> list[int]:
        """The polylines within a distance of a point and a turn of a heading, nearest first."""
        found = np.array(self._tree.query_ball_point(xy_m, within_m + 0.5 * _PIECE_M), np.int64)
        if not len(found):
            return []
        along, offset = self._along[found], xy_m - self._start[found]
        t = (offset * along).sum(axis=1) / (along * along).sum(axis=1)
        away_m = np.linalg.norm(offset - np.clip(t, 0.0, 1.0)[:, None] * along, axis=1)
        turned = np.abs(wrap_angle(self._yaw_rad[found] - yaw_rad))
        fits = np.flatnonzero((away_m <= within_m) & (turned <= turned_rad))
        order = fits[np.argsort(away_m[fits], kind="stable")]
        return list(dict.fromkeys(self._owner[found[order]].tolist()))
