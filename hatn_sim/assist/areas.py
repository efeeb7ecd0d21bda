"""Areas of conflict where lines bend: how far before and beyond the point they reach.

The closed form of `pairs.area_m` is of straight lines. Where lines bend, as all turns do, a body is
a chord of its way and comes into the other's strip earlier, or leaves it later. At a crossing it is
driven along its line past the strip, which is taken to be the arc that the other's line is there.

Letters: Q pairs of vehicles, R of their ends, X samples of a way.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.assist.pairs import LEAST_ANGLE_RAD, area_m
from hatn_sim.datatypes import ConflictType, FloatArray, IntArray, Scene
from hatn_sim.geometry import wrap_angle
from hatn_sim.road import Road

_WAY_M: Final[FloatArray] = np.arange(0.0, 16.1, 2.0)
"""Of the nose before the point, and of the tail beyond it; between them it is interpolated."""
_BEND_M: Final = 5.0
"""The other's line is an arc of so much to either side of the point."""


def areas_m(
    road: Road, scene: Scene, index: IntArray, line: IntArray, point_s_m: FloatArray, kind: IntArray
) -> tuple[FloatArray, FloatArray]:
    """How far areas of conflict [Q, 2] reach before the point and beyond it, for centres.

    `index` and `line` [Q, 2] are the vehicles and their lines, `point_s_m` [Q, 2] the conflict on
    either, `kind` [Q] its type.
    """
    before, beyond = np.empty(index.shape), np.empty(index.shape)
    crosses = kind == ConflictType.CROSS
    q = np.flatnonzero(crosses)
    if len(q):
        half_length = 0.5 * scene.size_m[index[q], 0]
        nose, tail = swept_areas_m(road, scene, index[q], line[q], point_s_m[q])
        before[q], beyond[q] = half_length + nose, half_length + tail
    q = np.flatnonzero(~crosses)
    if len(q):
        half, _ = area_m(road, scene, index[q], line[q], point_s_m[q], kind[q])
        near, far = _cut_m(road, scene, index[q], line[q], point_s_m[q])
        before[q], beyond[q] = half + near, half + far
    return before, beyond


def swept_areas_m(
    road: Road, scene: Scene, index: IntArray, line: IntArray, point_s_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far before the point [Q, 2] noses come into the other's strip, and how far beyond it
    [Q, 2] tails leave it.

    `index` and `line` [Q, 2] are the vehicles and their lines, which cross at `point_s_m` [Q, 2].
    At most the last of `_WAY_M`.
    """
    # Both ways round, and both ends: [4 Q], noses first.
    both = np.arange(4) % 2
    own, other = np.concatenate(index.T[both]), np.concatenate(index.T[1 - both])
    own_line, other_line = np.concatenate(line.T[both]), np.concatenate(line.T[1 - both])
    own_s, other_s = np.concatenate(point_s_m.T[both]), np.concatenate(point_s_m.T[1 - both])
    strips = _strips(road, other_line, other_s, scene.size_m[other])
    sign = np.repeat([-1.0, -1.0, 1.0, 1.0], len(index))
    reach_m = _reach_m(road, strips, own_line, own_s, sign, scene.size_m[own]).reshape(4, -1)
    return reach_m[:2].T, reach_m[2:].T


class _Strips:
    """Arcs with origins [R, 2], headings, curvatures and widths [R] to their left and right."""

    def __init__(
        self, xy_m: FloatArray, yaw_rad: FloatArray, per_m: FloatArray, size_m: FloatArray
    ) -> None:
        self.xy_m, self.per_m = xy_m, per_m
        self.along = np.stack((np.cos(yaw_rad), np.sin(yaw_rad)), axis=-1)
        length, width = size_m.T
        # A chord of length l is up to r - sqrt(r^2 - l^2 / 4) inside of its arc of radius 1 / k.
        square = 0.25 * length**2
        inside = square * per_m / (1.0 + np.sqrt(np.maximum(1.0 - square * per_m**2, 0.0)))
        self.left_m = 0.5 * width + np.maximum(inside, 0.0)
        self.right_m = 0.5 * width + np.maximum(-inside, 0.0)

    def beside_m(self, xy_m: FloatArray) -> FloatArray:
        """How far points [R, X, 2] are to the left of the arcs [R, X]."""
        away = xy_m - self.xy_m[:, None]
        c, s = self.along[:, None, 0], self.along[:, None, 1]
        ahead, left = away[..., 0] * c + away[..., 1] * s, away[..., 1] * c - away[..., 0] * s
        bend = self.per_m[:, None]
        # d (1 - k d / 2) = y - k (x^2 + y^2) / 2 for points d from an arc through the origin.
        half = left - 0.5 * bend * (ahead**2 + left**2)
        return 2.0 * half / (1.0 + np.sqrt(np.maximum(1.0 - 2.0 * bend * half, 0.0)))


def _strips(road: Road, line: IntArray, s_m: FloatArray, size_m: FloatArray) -> _Strips:
    at = s_m[:, None] + _BEND_M * np.array([-1.0, 0.0, 1.0])
    yaw = road.line_yaw_rad(line, at)
    per_m = wrap_angle(yaw[:, 2] - yaw[:, 0]) / (2.0 * _BEND_M)
    return _Strips(road.locate(line, s_m, np.zeros(len(s_m))), yaw[:, 1], per_m, size_m)


def _reach_m(
    road: Road,
    strips: _Strips,
    line: IntArray,
    point_s_m: FloatArray,
    sign: FloatArray,
    size_m: FloatArray,
) -> FloatArray:
    """How far before (-1) or beyond (1) the point [R] noses or tails are at the strips' sides."""
    end_s = point_s_m[:, None] + sign[:, None] * _WAY_M
    end = road.locate(line, end_s, np.zeros(end_s.shape))
    # The body is as its line is in the middle of it.
    yaw = road.line_yaw_rad(line, end_s + (0.5 * sign * size_m[:, 0])[:, None])
    half_width = 0.5 * size_m[:, 1, None, None]
    aside = half_width * np.stack((-np.sin(yaw), np.cos(yaw)), axis=-1)
    one, two = strips.beside_m(end + aside), strips.beside_m(end - aside)
    outside = np.maximum(
        np.minimum(one, two) - strips.left_m[:, None],
        -strips.right_m[:, None] - np.maximum(one, two),
    )
    # The end is at the point itself, inside; seen from there the first sample that is outside.
    out = outside > 0.0
    out[:, -1] = True
    after = np.maximum(out.argmax(axis=1), 1)
    row = np.arange(len(line))
    inner, outer = outside[row, after - 1], outside[row, after]
    part = np.clip(-inner / np.maximum(outer - inner, 1e-9), 0.0, 1.0)
    return _WAY_M[after - 1] + part * (_WAY_M[after] - _WAY_M[after - 1])


def _cut_m(
    road: Road, scene: Scene, index: IntArray, line: IntArray, point_s_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How much longer areas [Q, 2] are, at their near and at their far end, as the other turns.

    A body of length l is a chord of its way: in a bend it is up to l^2 k / 8 inside of the line,
    where k is the curvature. Areas are those of straight strips: that the strip bends takes about
    as much again, from whoever comes from that side.
    """
    length = scene.size_m[index, 0]
    yaw = road.line_yaw_rad(line, point_s_m[..., None] + length[..., None] * _ALONG)
    turned = wrap_angle(yaw[..., 2:] - yaw[..., :-2])  # each while one length is driven
    sharpest = np.abs(turned).argmax(axis=-1)[..., None]
    inside = 0.25 * length * np.take_along_axis(turned, sharpest, axis=-1)[..., 0]  # left positive
    apart = wrap_angle(yaw[:, 1, 2] - yaw[:, 0, 2])
    slant = np.maximum(np.abs(np.sin(apart)), np.sin(LEAST_ANGLE_RAD))
    # The first comes from the left of the second where it heads to the right of it.
    from_left = np.stack((np.sign(apart), -np.sign(apart)), axis=1)
    towards = inside[:, ::-1] * from_left / slant[:, None]
    return np.maximum(towards, 0.0), np.maximum(-towards, 0.0)


_ALONG: Final = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
