"""Polylines as arrays: arc length, Frenet coordinates, contacts. Pure functions, no state."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hatn_sim.datatypes import FloatArray, IntArray


def wrap_angle(angle_rad: FloatArray) -> FloatArray:
    """Angles wrapped to [-pi, pi)."""
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi


def arc_length_m(xy_m: FloatArray) -> FloatArray:
    """Arc length [P] of a polyline [P, 2] at its vertices, beginning with 0."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(xy_m, axis=0), axis=1))))


def resample(xy_m: FloatArray, step_m: float) -> FloatArray:
    """A polyline [P, 2] at equal steps of arc length; the last step is drawn out to be whole."""
    s_m = arc_length_m(xy_m)
    keep = np.concatenate(([True], np.diff(s_m) > 1e-9))
    s_m, xy_m = s_m[keep], xy_m[keep]
    count = max(2, math.ceil(s_m[-1] / step_m - 1e-9) + 1)
    at_m = np.arange(count) * step_m
    out = np.stack([np.interp(at_m, s_m, xy_m[:, axis]) for axis in (0, 1)], axis=1)
    if at_m[-1] > s_m[-1] and len(s_m) > 1:
        direction = (xy_m[-1] - xy_m[-2]) / (s_m[-1] - s_m[-2])
        out[-1] = xy_m[-1] + direction * (at_m[-1] - s_m[-1])
    return out


def cut_polyline(xy_m: FloatArray, from_m: float, to_m: float) -> FloatArray:
    """The part of a polyline [P, 2] between two arc lengths."""
    s_m = arc_length_m(xy_m)
    inside = (s_m > from_m) & (s_m < to_m)
    ends = [[np.interp(at, s_m, xy_m[:, axis]) for axis in (0, 1)] for at in (from_m, to_m)]
    return np.concatenate((ends[:1], xy_m[inside], ends[1:]))


def tangent_rad(xy_m: FloatArray) -> FloatArray:
    """Unwrapped direction [P] of a polyline [P, 2] at its vertices, by central differences."""
    step = np.empty_like(xy_m)
    step[1:-1] = xy_m[2:] - xy_m[:-2]
    step[0], step[-1] = xy_m[1] - xy_m[0], xy_m[-1] - xy_m[-2]
    return np.unwrap(np.arctan2(step[:, 1], step[:, 0]))


def nearest_vertex(
    vertices_xy_m: FloatArray, base: IntArray, xy_m: FloatArray, index: IntArray
) -> tuple[IntArray, FloatArray]:
    """The nearest of the vertices `index` [Q, W], counted from `base` [Q], to points `xy_m` [Q, 2].

    `vertices_xy_m` [V, 2] holds many lines one after the other. Returns the index [Q] and its
    squared distance [Q] in m2.
    """
    at = vertices_xy_m[base[:, None] + index]
    dx = at[..., 0] - xy_m[:, None, 0]
    dy = at[..., 1] - xy_m[:, None, 1]
    squared = dx * dx + dy * dy
    best = squared.argmin(axis=1)
    rows = np.arange(len(base))
    return index[rows, best], squared[rows, best]


def project_at(
    vertices_xy_m: FloatArray,
    base: IntArray,
    count: IntArray,
    step_m: float,
    xy_m: FloatArray,
    vertex: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """Arc length s [Q] and left-positive offset d [Q] of points near the vertex [Q] of their line.

    The line of a point is the `count` [Q] vertices of `vertices_xy_m` [V, 2] from `base` [Q] on.
    The foot point lies on one of the two segments that meet at the vertex. Before the first and
    behind the last vertex of a line, the end segments are drawn out straight.
    """
    last = count - 2
    best_s: FloatArray = np.zeros(len(base))
    best_d, best_square = best_s, best_s
    for which, shift in enumerate((-1, 0)):
        segment = np.minimum(np.maximum(vertex + shift, 0), last)
        start = vertices_xy_m.take(base + segment, axis=0)
        along = vertices_xy_m.take(base + segment + 1, axis=0) - start
        offset = xy_m - start
        # By columns: a sum over two is slow in an array of many rows.
        (along_x, along_y), (offset_x, offset_y) = along.T, offset.T
        length2 = np.maximum(along_x * along_x + along_y * along_y, 1e-12)
        t = (offset_x * along_x + offset_y * along_y) / length2
        t = np.where((segment > 0) & (t < 0), 0.0, t)
        t = np.where((segment < last) & (t > 1), 1.0, t)
        away_x, away_y = offset_x - t * along_x, offset_y - t * along_y
        square = away_x * away_x + away_y * away_y
        side = along_x * offset_y - along_y * offset_x
        s: FloatArray = (segment.astype(np.float64) + t) * step_m
        d: FloatArray = np.sqrt(square) * np.where(side < 0, -1.0, 1.0)
        if which == 0:
            best_s, best_d, best_square = s, d, square
        else:
            better = square < best_square
            best_s, best_d = np.where(better, s, best_s), np.where(better, d, best_d)
    return best_s, best_d


def window(
    count: IntArray, low_s_m: FloatArray, vertices: int, step_m: float, stride: int
) -> IntArray:
    """Vertex indices [Q, vertices] of lines with `count` [Q] vertices from `low_s_m` [Q] on.

    They are `stride` apart and never beyond the ends.
    """
    first = np.floor(low_s_m / step_m).astype(np.int64)
    index = first[:, None] + stride * np.arange(vertices)
    return np.clip(index, 0, count[:, None] - 1)


def interpolate(
    values: NDArray[np.float64], base: IntArray, count: IntArray, position: FloatArray
) -> FloatArray:
    """Linear interpolation of per-vertex `values` [V(, D)] at fractional indices [Q, ...].

    Row q counts from `base` [Q] and stays within its `count` [Q] vertices.
    """
    shape = base.shape + (1,) * (position.ndim - base.ndim)
    base, last = base.reshape(shape), count.reshape(shape) - 2
    below = np.minimum(np.maximum(np.floor(position).astype(np.int64), 0), last)
    part = np.minimum(np.maximum(position - below, 0.0), 1.0)
    at = base + below
    low, high = values.take(at, axis=0), values.take(at + 1, axis=0)
    part = part.reshape(part.shape + (1,) * (low.ndim - part.ndim))
    return low + part * (high - low)


def smooth_curvature_per_m(yaw_rad: FloatArray, step_m: float) -> FloatArray:
    """Change of direction [P] of a polyline, left positive, averaged over nine vertices.

    Lanes come as polylines with corners. `yaw_rad` [P] is unwrapped, a vertex every `step_m`.
    """
    raw = np.gradient(yaw_rad, step_m)
    kernel = np.full(9, 1.0 / 9.0)
    padded = np.concatenate((np.full(4, raw[0]), raw, np.full(4, raw[-1])))
    return np.convolve(padded, kernel, mode="valid")
