"""Lanes between two bounds: which way they run, their centre line, and bounds for a centre line."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray
from hatn_sim.geometry import arc_length_m

STEP_M: Final = 1.0
"""Bounds are paired at least this densely."""
MIN_STEP_M: Final = 0.05
"""Vertices of a centre line are at least this far apart."""
SAME_PART: Final = 0.35
"""Points of two bounds are opposite each other only if their shares of the length differ less."""
MAX_MITRE: Final = 3.0
"""An outer corner lies at most this many half widths from the centre line's."""


def orientation(left_xy_m: FloatArray, right_xy_m: FloatArray) -> tuple[bool, bool]:
    """Whether the left and the right bound [P, 2] run against the lane between them.

    Bounds may be drawn in either direction. The lane runs so that its left bound is on its left;
    the ends of the bounds that are nearer to each other belong together.
    """
    flip_right = _end_distance(left_xy_m, right_xy_m) > _end_distance(left_xy_m, right_xy_m[::-1])
    right_side = _side_of(left_xy_m, right_xy_m) - _side_of(right_xy_m, left_xy_m) * (
        -1.0 if flip_right else 1.0
    )
    flip_left = right_side > 0
    return flip_left, flip_right != flip_left


def centre_line(left_xy_m: FloatArray, right_xy_m: FloatArray) -> tuple[FloatArray, float]:
    """The centre line [P, 2] between two bounds that run the same way, and the median width.

    Every vertex of a bound is paired with the nearest point of the other; the middles of the pairs
    are the line. For bounds parallel to a line, mitred corners included, this gives that line.
    """
    left, right = _densified(left_xy_m), _densified(right_xy_m)
    left_part, right_part = _parts(left), _parts(right)
    pairs = np.concatenate(
        [
            [[0.0, 0.0], [1.0, 1.0]],
            np.stack([left_part, _nearest_part(left, left_part, right, right_part)], axis=1),
            np.stack([_nearest_part(right, right_part, left, left_part), right_part], axis=1),
        ]
    )
    pairs = pairs[np.argsort(pairs.sum(axis=1), kind="stable")]
    pairs = np.maximum.accumulate(pairs, axis=0)
    on_left, on_right = _at(left, left_part, pairs[:, 0]), _at(right, right_part, pairs[:, 1])
    width_m = float(np.median(np.linalg.norm(on_left - on_right, axis=1)))
    return thinned((on_left + on_right) / 2.0), width_m


def thinned(xy_m: FloatArray) -> FloatArray:
    """A polyline [P, 2] without vertices that lie on the one before; its ends stay."""
    s_m = arc_length_m(xy_m)
    keep = [0]
    for vertex in range(1, len(s_m) - 1):
        if min(s_m[vertex] - s_m[keep[-1]], s_m[-1] - s_m[vertex]) >= MIN_STEP_M:
            keep.append(vertex)
    return xy_m[[*keep, len(s_m) - 1]]


def offset_line(xy_m: FloatArray, offset_m: float) -> FloatArray:
    """The polyline [P, 2] moved sideways, left positive, its corners mitred."""
    step = np.diff(xy_m, axis=0)
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1)
    normal /= np.linalg.norm(step, axis=1)[:, None]
    before, after = np.vstack([normal[:1], normal]), np.vstack([normal, normal[-1:]])
    both = before + after
    square = (both**2).sum(axis=1)[:, None] / 2.0
    mitre = both / np.maximum(square, 2.0 / MAX_MITRE**2)
    return xy_m + offset_m * mitre


def crossings(
    one_xy_m: FloatArray, other_xy_m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where two polylines [P, 2], [R, 2] cross: arc lengths [k] on each, sine of the angle [k].

    The sine is positive where the other comes from the right.
    """
    p, r = one_xy_m[:-1, None], np.diff(one_xy_m, axis=0)[:, None]
    q, s = other_xy_m[None, :-1], np.diff(other_xy_m, axis=0)[None]
    across = r[..., 0] * s[..., 1] - r[..., 1] * s[..., 0]
    away = q - p
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (away[..., 0] * s[..., 1] - away[..., 1] * s[..., 0]) / across
        u = (away[..., 0] * r[..., 1] - away[..., 1] * r[..., 0]) / across
        sine = across / (np.linalg.norm(r, axis=2) * np.linalg.norm(s, axis=2))
    found: BoolArray = (t >= 0) & (t <= 1) & (u >= 0) & (u <= 1)
    i, j = np.nonzero(found)
    one_s, other_s = arc_length_m(one_xy_m), arc_length_m(other_xy_m)
    return (
        one_s[i] + t[i, j] * np.diff(one_s)[i],
        other_s[j] + u[i, j] * np.diff(other_s)[j],
        sine[i, j],
    )


def split(xy_m: FloatArray, s_m: float) -> tuple[FloatArray, FloatArray]:
    """The parts of a polyline [P, 2] before and after an arc length inside it."""
    at_m = arc_length_m(xy_m)
    point = np.array([[np.interp(s_m, at_m, xy_m[:, axis]) for axis in (0, 1)]])
    before, after = at_m < s_m - MIN_STEP_M, at_m > s_m + MIN_STEP_M
    return np.vstack([xy_m[before], point]), np.vstack([point, xy_m[after]])


def _end_distance(one: FloatArray, other: FloatArray) -> float:
    return math.dist(one[0], other[0]) + math.dist(one[-1], other[-1])


def _side_of(line: FloatArray, points: FloatArray) -> float:
    """Mean offset of a polyline from another, left positive."""
    dense = _densified(points)
    start, along = line[:-1], np.diff(line, axis=0)
    away, square = _to_segments(dense, start, along)
    nearest = square.argmin(axis=1)
    rows = np.arange(len(dense))
    along, away, square = along[nearest], away[rows, nearest], square[rows, nearest]
    side = np.sign(along[:, 0] * away[:, 1] - along[:, 1] * away[:, 0])
    return float(np.mean(side * np.sqrt(square)))


def _to_segments(
    points: FloatArray, start: FloatArray, along: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """From the nearest point of each segment [S] to points [Q]: vector [Q, S, 2], its square."""
    t = _foot(points, start, along)
    away = points[:, None] - start - t[..., None] * along
    return away, (away**2).sum(axis=2)


def _foot(points: FloatArray, start: FloatArray, along: FloatArray) -> FloatArray:
    length2 = np.maximum((along**2).sum(axis=1), 1e-12)
    t = ((points[:, None] - start) * along).sum(axis=2) / length2
    return np.clip(t, 0.0, 1.0)


def _densified(xy_m: FloatArray) -> FloatArray:
    """The polyline with its vertices, and more of them, so that none are over `STEP_M` apart."""
    s_m = arc_length_m(xy_m)
    more = np.linspace(0.0, s_m[-1], max(2, math.ceil(s_m[-1] / STEP_M) + 1))
    at_m = np.unique(np.concatenate([s_m, more]))
    at_m = at_m[np.concatenate([[True], np.diff(at_m) > 1e-9])]
    return np.stack([np.interp(at_m, s_m, xy_m[:, axis]) for axis in (0, 1)], axis=1)


def _parts(xy_m: FloatArray) -> FloatArray:
    """Share of the length [P] at every vertex."""
    s_m = arc_length_m(xy_m)
    return s_m / s_m[-1]


def _at(xy_m: FloatArray, part: FloatArray, wanted: FloatArray) -> FloatArray:
    return np.stack([np.interp(wanted, part, xy_m[:, axis]) for axis in (0, 1)], axis=1)


def _nearest_part(
    points: FloatArray, point_part: FloatArray, line: FloatArray, line_part: FloatArray
) -> FloatArray:
    """Share of the line's length where it is nearest to each point, among those opposite it."""
    start, along = line[:-1], np.diff(line, axis=0)
    _, square = _to_segments(points, start, along)
    middle = (line_part[:-1] + line_part[1:]) / 2.0
    far = np.abs(middle - point_part[:, None]) > SAME_PART + np.diff(line_part).max()
    nearest = np.where(far, np.inf, square).argmin(axis=1)
    t = _foot(points, start, along)[np.arange(len(points)), nearest]
    return line_part[nearest] + t * (line_part[nearest + 1] - line_part[nearest])
