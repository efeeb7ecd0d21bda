"""Paths of many vehicles -> the mean path of each way through the site.

A path lies along another one if it stays within `BESIDE_M` of it. Taken longest first, each path
gathers those that lie along it. Where the vehicles that drove all of it are enough, they make a
cluster; whoever lies along its mean, from wherever to wherever, tells nothing new. Who is at fault
(a U-turn, a parking vehicle) finds no others and draws nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray
from hatn_sim.geometry import wrap_angle
from hatn_sim.recordings.track_lines.paths import STEP_M, Path, path_through, poses, smoothed

FEWEST: Final = 2
"""Vehicles that draw a line: a single one's way may be an oddity."""
BESIDE_M: Final = 1.5
TURNED_RAD: Final = np.deg2rad(40.0)
BEYOND_M: Final = 15.0
"""A path may begin so much before the one it lies along, and end so much behind it."""
ALONG_SHARE: Final = 0.95
WHOLE_SHARE: Final = 0.8
"""Who drove this much of a way, drove it all: views begin and end now here, now there."""
SUPPORT: Final = 0.3
"""A way is as long as this share of its vehicles is seen on it."""
FADE_M: Final = 10.0
"""A vehicle's say in the mean grows over the first metres it is seen, and fades over the last."""
MEAN_SMOOTH_M: Final = 12.0
ROUNDS: Final = 2
_EXACT_M: Final = 1e-6


@dataclass(frozen=True, eq=False)
class _Stock:
    """All paths, their points one after the other."""

    paths: Sequence[Path]
    xy_m: FloatArray  # [V, 2]
    yaw_rad: FloatArray  # [V]
    start: IntArray  # [N + 1]

    def points(self, some: IntArray) -> tuple[IntArray, IntArray]:
        """The points of some paths [K]: indices of all, and for each the place in `some`."""
        count = self.start[some + 1] - self.start[some]
        which = np.repeat(np.arange(len(some)), count)
        within = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        return self.start[some][which] + within, which


@dataclass(frozen=True, eq=False)
class _Feet:
    """Where the points of some paths are on another one."""

    which: IntArray  # [Q] the path, rising
    s_m: FloatArray  # [Q]
    d_m: FloatArray  # [Q] left positive
    along: BoolArray  # [K] the path lies along the other one
    span_m: FloatArray  # [K, 2] first and last place
    rms_m: FloatArray  # [K]


def mean_paths(paths: Sequence[Path]) -> list[Path]:
    """The mean paths of the ways that were driven, those of most vehicles first.

    The order of the paths is without effect.
    """
    if len(paths) < FEWEST:
        return []
    stock = _stock(sorted(paths, key=_longest_first))
    found = _ways(stock)
    for _ in range(ROUNDS):
        found = _reassigned(stock, found)
    return sorted(found, key=lambda path: (-path.vehicles, *_longest_first(path)))


def _longest_first(path: Path) -> tuple[int, str]:
    """A key that is the same however the world is turned."""
    return -len(path.xy_m), path.name


def _stock(paths: Sequence[Path]) -> _Stock:
    start = np.cumsum([0, *(len(path.xy_m) for path in paths)])
    xy_m = np.concatenate([path.xy_m for path in paths])
    return _Stock(paths, xy_m, np.concatenate([path.yaw_rad for path in paths]), start)


def _ways(stock: _Stock) -> list[Path]:
    """Mean paths, longest first, until no path is left that finds others like it."""
    free = np.ones(len(stock.paths), dtype=np.bool_)
    found: list[Path] = []
    for number, seed in enumerate(stock.paths):
        if not free[number]:
            continue
        free[number] = False
        mean = _mean(seed, *_along(stock, seed, np.concatenate(([number], np.flatnonzero(free)))))
        if mean is not None:
            rest = np.flatnonzero(free)
            some, feet = _along(stock, mean, rest)
            free[some[feet.along]] = False
            found.append(mean)
    return found


def _reassigned(stock: _Stock, ways: Sequence[Path]) -> list[Path]:
    """The means of the vehicles that drove all of a way, each counted for the way it fits best."""
    count = len(stock.paths)
    best_m, best = np.full(count, np.inf), np.full(count, -1, dtype=np.int64)
    on_way = [_along(stock, way, np.arange(count)) for way in ways]
    for number, (way, (some, feet)) in enumerate(zip(ways, on_way, strict=True)):
        whole = feet.along & (_seen_m(way, feet) >= WHOLE_SHARE * way.length_m)
        better = whole & (feet.rms_m < best_m[some])
        best_m[some[better]], best[some[better]] = feet.rms_m[better], number
    means: list[Path] = []
    for number, (way, (some, feet)) in enumerate(zip(ways, on_way, strict=True)):
        mean = _mean(way, some, feet, best[some] == number)
        if mean is not None:
            means.append(mean)
    return means


def _along(stock: _Stock, path: Path, some: IntArray) -> tuple[IntArray, _Feet]:
    """Those of some paths that may lie along a path, by three of their points, and their feet."""
    tree = KDTree(poses(path.xy_m, path.yaw_rad))
    first, last = stock.start[some], stock.start[some + 1] - 1
    three = np.concatenate((first, (first + last) // 2, last))
    _, _, fits = _project(path, tree, stock.xy_m[three], stock.yaw_rad[three])
    some = some[fits.reshape(3, -1).all(axis=0)]
    at, which = stock.points(some)
    s_m, d_m, fits = _project(path, tree, stock.xy_m[at], stock.yaw_rad[at])
    count = np.maximum(np.bincount(which, minlength=len(some)), 1)
    share = np.bincount(which, weights=fits, minlength=len(some)) / count
    square = np.bincount(which, weights=d_m * d_m, minlength=len(some)) / count
    span_m = np.column_stack((np.full(len(some), np.inf), np.full(len(some), -np.inf)))
    np.minimum.at(span_m[:, 0], which, s_m)
    np.maximum.at(span_m[:, 1], which, s_m)
    return some, _Feet(which, s_m, d_m, share >= ALONG_SHARE, span_m, np.sqrt(square))


def _project(
    path: Path, tree: KDTree, xy_m: FloatArray, yaw_rad: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Arc length and offset [Q] of poses [Q] on a path, and whether they lie along it there."""
    _, near = tree.query(poses(xy_m, yaw_rad))
    near = np.asarray(near, dtype=np.int64)
    last = len(path.xy_m) - 1
    away, yaw = xy_m - path.xy_m[near], path.yaw_rad[near]
    ahead_m = away[:, 0] * np.cos(yaw) + away[:, 1] * np.sin(yaw)
    d_m = away[:, 1] * np.cos(yaw) - away[:, 0] * np.sin(yaw)
    before, behind = (near == 0) & (ahead_m < 0.0), (near == last) & (ahead_m > 0.0)
    reach_m = np.where(before | behind, BEYOND_M, 2.0 * STEP_M)
    fits = (np.abs(d_m) <= BESIDE_M) & (np.abs(ahead_m) <= reach_m)
    fits &= np.abs(wrap_angle(yaw_rad - yaw)) <= TURNED_RAD
    return near * STEP_M + ahead_m, d_m, fits


def _seen_m(path: Path, feet: _Feet) -> FloatArray:
    """How much of a path each of the others [K] saw."""
    inside = np.clip(feet.span_m, 0.0, path.length_m)
    return np.maximum(inside[:, 1] - inside[:, 0], 0.0)


def _mean(path: Path, some: IntArray, feet: _Feet, among: BoolArray | None = None) -> Path | None:
    """The mean of those of some paths that drove all of a way; None where they are too few.

    How long the way is, most of those that lie along the path say, or those `among` [K] them.
    """
    chosen = feet.along if among is None else feet.along & among
    stations = np.arange(len(path.xy_m)) * STEP_M
    low, high = feet.span_m[:, 0] - _EXACT_M, feet.span_m[:, 1] + _EXACT_M
    seen = (low[:, None] <= stations) & (stations <= high[:, None]) & chosen[:, None]
    if among is None:
        count = seen.sum(axis=0)
        extent = stations[count >= max(FEWEST, SUPPORT * count.max(initial=0))]
        if not len(extent):
            return None
        span_m = np.minimum(high, extent[-1]) - np.maximum(low, extent[0])
        chosen = chosen & (span_m >= WHOLE_SHARE * (extent[-1] - extent[0]))
        seen &= chosen[:, None]
    members = np.flatnonzero(chosen)
    if len(members) < FEWEST:
        return None
    count = seen.sum(axis=0)
    enough = np.flatnonzero(count >= max(FEWEST, SUPPORT * len(members)))
    if not len(enough):
        return None
    extent = slice(int(enough[0]), int(enough[-1]) + 1)
    stations = stations[extent]
    total, weight = np.zeros(len(stations)), np.full(len(stations), 1e-9)
    bounds = np.searchsorted(feet.which, np.arange(len(some) + 1))
    for k in members.tolist():
        own = slice(bounds[k], bounds[k + 1])
        order = np.argsort(feet.s_m[own], kind="stable")
        d_m = np.interp(stations, feet.s_m[own][order], feet.d_m[own][order])
        inside_m = np.minimum(stations - low[k], high[k] - stations)
        share = np.clip(inside_m / FADE_M, 0.0, 1.0) + 1e-3 * (inside_m >= 0.0)
        total, weight = total + share * d_m, weight + share
    yaw = path.yaw_rad[extent]
    left = np.column_stack((-np.sin(yaw), np.cos(yaw)))
    xy_m = path.xy_m[extent] + (total / weight)[:, None] * left
    return path_through(smoothed(xy_m, MEAN_SMOOTH_M), len(members), path.name)
