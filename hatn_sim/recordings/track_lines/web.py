"""Paths -> a web: where paths run together they are one strand, before they part and once merged.

Points a metre apart, each with those it leads to. A path is laid over the web that is there: it
follows strands as long as it stays near them and in their direction, and is drawn beside them where
it does not; there it is bent towards the points at which it parts and joins, without a kink. What
is laid first stays, so the paths of most vehicles come first.
"""

from __future__ import annotations

import math
from collections.abc import Container
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray
from hatn_sim.geometry import tangent_rad, wrap_angle
from hatn_sim.recordings.track_lines.paths import STEP_M, Path, poses

TOGETHER_M: Final = 10.0
"""Paths that are near each other for less than this only cross or touch ..."""
TOUCHING_M: Final = 1.0
"""... unless one of them begins or ends there: then this is enough."""
APART_M: Final = 10.0
"""A path needs this much room to change over from one strand to another."""
BEND_M: Final = 15.0
"""A path that parts from a strand is on its own course after this."""
END_M: Final = 25.0
"""Over this much at its ends a path may be beside a strand that leads in or out the same way."""
FADE_M: Final = 40.0
"""What it was moved by there fades over this much."""
BESIDE_STEPS: Final = 1.5
"""Points of a web and of a path that belong together are at most so many steps apart along it."""


@dataclass(frozen=True)
class Near:
    """How near a path is to a strand that it follows.

    One that comes back to a strand follows it all the time if it strayed no further than `stray`
    times as far: so there are no two ways from one place of a strand to the next.
    """

    within_m: float
    turned_rad: float
    stray: float = 1.0


SAME_END: Final = Near(1.2, math.radians(5.0))
"""Ends of paths this near to a strand are of the same lane: lanes are further apart."""


@dataclass(frozen=True)
class _Run:
    """A path follows a strand: points of the web, and the place of each on the path, rising."""

    points: list[int]
    places: list[int]


class Web:
    """Points [V], the numbers of those that follow each, `ahead`, and of those before, `behind`."""

    def __init__(self) -> None:
        self.xy_m: FloatArray = np.zeros((0, 2))
        self.yaw_rad: FloatArray = np.zeros(0)
        self.ahead: list[list[int]] = []
        self.behind: list[list[int]] = []

    def lay(self, path: Path, near: Near) -> None:
        """Lay a path over what is there."""
        path = self._aligned(path)
        before: int | None = None
        at = 0
        for run in self._with_room(self._runs(path, near)):
            self._draw(path, at, run.places[0], before, run.points[0])
            before, at = run.points[-1], run.places[-1] + 1
        self._draw(path, at, len(path.xy_m), before, None)

    def split(self, first: int, second: int, xy_m: FloatArray) -> int:
        """Put a point [2] between two that follow each other; its number."""
        self.ahead[first].remove(second)
        self.behind[second].remove(first)
        (number,) = self._add(xy_m[None], self.yaw_rad[[first]])
        self._link(first, number)
        self._link(number, second)
        return number

    def strands(self, cuts: Container[int] = ()) -> list[list[int]]:
        """The points from fork to fork, merge or end, and from cut to cut, in order of numbers."""
        count = len(self.ahead)
        ends = [
            k
            for k in range(count)
            if k in cuts or len(self.ahead[k]) != 1 or len(self.behind[k]) != 1
        ]
        is_end, seen = [False] * count, [False] * count
        for k in ends:
            is_end[k] = True
        found: list[list[int]] = []
        for start in [*ends, *range(count)]:
            if seen[start]:
                continue
            is_end[start] = seen[start] = True  # of a circle without a fork any point is an end
            for following in self.ahead[start]:
                strand = [start, following]
                while not is_end[strand[-1]]:
                    seen[strand[-1]] = True
                    strand.append(self.ahead[strand[-1]][0])
                found.append(strand)
        return found

    def _add(self, xy_m: FloatArray, yaw_rad: FloatArray) -> list[int]:
        first = len(self.ahead)
        self.xy_m = np.concatenate((self.xy_m, xy_m))
        self.yaw_rad = np.concatenate((self.yaw_rad, yaw_rad))
        self.ahead += [[] for _ in range(len(xy_m))]
        self.behind += [[] for _ in range(len(xy_m))]
        return list(range(first, first + len(xy_m)))

    def _link(self, first: int, second: int) -> None:
        if second not in self.ahead[first]:
            self.ahead[first].append(second)
            self.behind[second].append(first)

    def _draw(self, path: Path, first: int, end: int, parts: int | None, joins: int | None) -> None:
        """Draw the points of a path from place `first` to before `end`.

        `parts` and `joins` are the points of the web that it comes from and leads to, if any.
        """
        if end <= first:
            if parts is not None and joins is not None:
                self._link(parts, joins)
            return
        xy_m = path.xy_m[first:end]
        start = None if parts is None else self._pull(path, first - 1, parts)
        stop = None if joins is None else self._pull(path, end, joins)
        xy_m = xy_m + _bend_m(len(xy_m), start, stop)
        before = [] if parts is None else [parts]
        after = [] if joins is None else [joins]
        whole = np.concatenate((self.xy_m[before], xy_m, self.xy_m[after]))
        yaw_rad = tangent_rad(whole) if len(whole) > 1 else path.yaw_rad[first:end]
        drawn = self._add(xy_m, yaw_rad[len(before) : len(before) + len(xy_m)])
        for one, other in pairwise([*before, *drawn, *after]):
            self._link(one, other)

    def _pull(self, path: Path, place: int, point: int) -> FloatArray:
        """[2, 2] From a place on a path to a point of the web, and what that changes a step on."""
        own, other = path.yaw_rad[place], self.yaw_rad[point]
        turn = STEP_M * np.array([np.cos(other) - np.cos(own), np.sin(other) - np.sin(own)])
        return np.array([self.xy_m[point] - path.xy_m[place], turn])

    def _aligned(self, path: Path) -> Path:
        """A path whose ends are moved onto strands that they are beside.

        Who comes from the same way in keeps to the same place in it: that the means of some are a
        little apart is chance.
        """
        if not self.ahead or not path.vehicles:
            return path
        start = self._beside_start(path)
        back = Path(path.xy_m[::-1], path.yaw_rad[::-1], path.vehicles)
        stop = self._beside_start(back)
        left = np.column_stack((-np.sin(path.yaw_rad), np.cos(path.yaw_rad)))
        left_m = start + stop[::-1]
        xy_m = path.xy_m + left_m[:, None] * left
        return Path(xy_m, tangent_rad(xy_m), path.vehicles, path.name)

    def _beside_start(self, path: Path) -> FloatArray:
        """How far left [P] of the first points of a path a strand is, fading along the path."""
        count = min(int(END_M / STEP_M), len(path.xy_m) // 2)
        first = Path(path.xy_m[:count], path.yaw_rad[:count])
        nearest = self._nearest(first)
        beside = np.flatnonzero(self._fits(first, nearest, SAME_END))
        if not len(beside):
            return np.zeros(len(path.xy_m))
        place = int(beside[0])
        yaw, away = path.yaw_rad[place], self.xy_m[nearest[place]] - path.xy_m[place]
        left_m = away[1] * np.cos(yaw) - away[0] * np.sin(yaw)
        fade = min(FADE_M / STEP_M, len(path.xy_m) / 2.0)
        rest = 1.0 - np.clip((np.arange(len(path.xy_m)) - place) / fade, 0.0, 1.0)
        return left_m * rest * rest * (3.0 - 2.0 * rest)

    def _nearest(self, path: Path) -> IntArray:
        """The points [P] of the web nearest to those of a path in place and direction."""
        tree = KDTree(poses(self.xy_m, self.yaw_rad))
        _, found = tree.query(poses(path.xy_m, path.yaw_rad))
        return np.asarray(found, dtype=np.int64)

    def _runs(self, path: Path, near: Near) -> list[_Run]:
        """Where a path follows strands, in order along it."""
        if not self.ahead:
            return []
        nearest = self._nearest(path)
        fits = self._fits(path, nearest, near)
        runs: list[_Run] = []
        place, last = 0, len(path.xy_m) - 1
        while place <= last:
            if fits[place]:
                run = self._follow(path, place, int(nearest[place]), near)
                length_m = (run.places[-1] - place) * STEP_M
                touches = place == 0 or run.places[-1] >= last - 1
                if length_m >= (TOUCHING_M if touches else TOGETHER_M):
                    runs.append(run)
                    place = run.places[-1]
            place += 1
        return runs

    def _fits(self, path: Path, points: IntArray, near: Near) -> BoolArray:
        """Whether points [P] of the web are near the places [P] of a path."""
        away, yaw = self.xy_m[points] - path.xy_m, path.yaw_rad
        ahead_m = away[:, 0] * np.cos(yaw) + away[:, 1] * np.sin(yaw)
        left_m = away[:, 1] * np.cos(yaw) - away[:, 0] * np.sin(yaw)
        turned = np.abs(wrap_angle(self.yaw_rad[points] - yaw))
        beside = (np.abs(ahead_m) <= BESIDE_STEPS * STEP_M) & (np.abs(left_m) <= near.within_m)
        return beside & (turned <= near.turned_rad)

    def _follow(self, path: Path, place: int, point: int, near: Near) -> _Run:
        """The longest run along a path from a place on it and a point of the web near to it."""
        run = self._stray(path, place, point, near)
        while run.points and not self._is_near(path, run.places[-1], run.points[-1], near):
            run.points.pop()
            run.places.pop()
        return run

    def _stray(self, path: Path, place: int, point: int, near: Near) -> _Run:
        """The run that is near the path furthest along it, and how it strays at its end."""
        far = Near(near.stray * near.within_m, near.stray * near.turned_rad)
        run = _Run([point], [place])
        while True:
            options = [
                (following, at)
                for following in self.ahead[run.points[-1]]
                if self._is_near(
                    path, at := self._place_of(path, run.places[-1], following), following, far
                )
            ]
            if len(options) != 1:
                break
            run.points.append(options[0][0])
            run.places.append(options[0][1])
        if options:
            ways = [self._follow(path, at, following, near) for following, at in options]
            best = max(
                ways, key=lambda way: (max(way.places, default=-1), -self._apart_m(path, way))
            )
            run.points.extend(best.points)
            run.places.extend(best.places)
        return run

    def _place_of(self, path: Path, place: int, point: int) -> int:
        """The nearest place on a path to a point of the web, from one on."""
        x, y = self.xy_m[point].tolist()
        window = path.xy_m[place : place + 3].tolist()
        away = [(px - x) ** 2 + (py - y) ** 2 for px, py in window]
        return place + away.index(min(away))

    def _is_near(self, path: Path, place: int, point: int, near: Near) -> bool:
        """Whether a point of the web is near a place on a path."""
        (x, y), (px, py) = self.xy_m[point].tolist(), path.xy_m[place].tolist()
        yaw = float(path.yaw_rad[place])
        cos, sin = math.cos(yaw), math.sin(yaw)
        ahead_m, left_m = (x - px) * cos + (y - py) * sin, (y - py) * cos - (x - px) * sin
        turned = math.remainder(float(self.yaw_rad[point]) - yaw, math.tau)
        beside = abs(ahead_m) <= BESIDE_STEPS * STEP_M and abs(left_m) <= near.within_m
        return beside and abs(turned) <= near.turned_rad

    def _apart_m(self, path: Path, run: _Run) -> float:
        """Mean distance of a run from the path."""
        if not run.points:
            return math.inf
        away = self.xy_m[run.points] - path.xy_m[run.places]
        return round(float(np.hypot(away[:, 0], away[:, 1]).mean()), 6)

    def _with_room(self, runs: list[_Run]) -> list[_Run]:
        """The runs, shortened where a path would have to jump from one strand to the next.

        What ends where another strand begins is joined to it as it is.
        """
        kept: list[_Run] = []
        for run in runs:
            while kept and run.points:
                before = kept[-1]
                lacking = APART_M / STEP_M - (run.places[0] - before.places[-1] - 1)
                ends = not self.ahead[before.points[-1]] and not self.behind[run.points[0]]
                if lacking <= 0 or ends:
                    break
                half = math.ceil(lacking / 2)
                run = _between(run, run.places[0] + half, run.places[-1])
                kept[-1] = _between(before, before.places[0], before.places[-1] - half)
                if not kept[-1].points:
                    kept.pop()
            if run.points:
                kept.append(run)
        return kept


def _between(run: _Run, first: int, last: int) -> _Run:
    """The part of a run between two places."""
    inside = [k for k, place in enumerate(run.places) if first <= place <= last]
    return _Run([run.points[k] for k in inside], [run.places[k] for k in inside])


def _bend_m(count: int, start: FloatArray | None, stop: FloatArray | None) -> FloatArray:
    """Shifts [count, 2] that carry points from one pull over to another, or fade one out.

    A pull [2, 2] is the shift at a step before the first point, or behind the last, and its change
    by a step there. Cubic (Hermite), so that neither place nor direction jumps.
    """
    steps = np.arange(1.0, count + 1.0)
    whole = count + 1.0
    if start is not None and stop is not None and whole <= 2.0 * BEND_M / STEP_M:
        return _hermite(steps / whole, start, stop, whole)
    bend = min(BEND_M / STEP_M, whole)
    rest = np.zeros((2, 2))
    shift_m = np.zeros((count, 2))
    if start is not None:
        shift_m += _hermite(np.minimum(steps / bend, 1.0), start, rest, bend)
    if stop is not None:
        shift_m += _hermite(np.maximum(1.0 - (whole - steps) / bend, 0.0), rest, stop, bend)
    return shift_m


def _hermite(part: FloatArray, start: FloatArray, stop: FloatArray, steps: float) -> FloatArray:
    """[N, 2] at parts [N] in 0 ... 1 of a way of so many steps, from [2, 2] value and slope."""
    u = part[:, None]
    return (
        (2 * u**3 - 3 * u**2 + 1) * start[0]
        + (u**3 - 2 * u**2 + u) * steps * start[1]
        + (3 * u**2 - 2 * u**3) * stop[0]
        + (u**3 - u**2) * steps * stop[1]
    )
