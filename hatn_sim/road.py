"""Lanes -> reference lines -> conflicts. Built on demand: a road costs what its vehicles touch."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any, Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.conflict_table import ConflictTable
from hatn_sim.conflicts import CONFLICT_WIDTH_M, find_conflicts
from hatn_sim.datatypes import (
    BoolArray,
    Conflict,
    FloatArray,
    Gate,
    IntArray,
    Kind,
    Lane,
    ReferenceLine,
    Route,
)
from hatn_sim.geometry import (
    interpolate,
    nearest_vertex,
    project_at,
    resample,
    tangent_rad,
    window,
    wrap_angle,
)

LINE_STEP_M: Final = 0.5
AHEAD_M: Final = 150.0
"""How far candidate lines are drawn out beyond the lane they start from."""
BEHIND_M: Final = 60.0
"""How much of a line is kept behind a vehicle: more than three seconds of history."""
MAX_BRANCHES: Final = 16
MAX_FORKS: Final = 24
NEAR_M: Final = 3.5
NEAR_RAD: Final = np.deg2rad(60.0)
COARSE: Final = 8
"""Vertices apart for a first look along a line."""


class Road:
    """The lane graph of a place, and the reference lines and conflicts drawn from it so far.

    Lines are drawn as vehicles need them. Whoever runs for long lets go of those not touched for a
    while with `release`; their numbers are given to new lines then. Per-line arrays are padded to
    the longest line; row i belongs to `lines[i]`:

    | array | shape | content |
    |---|---|---|
    | `xy_m` | [L, P, 2] | centre line, a vertex every `LINE_STEP_M` |
    | `yaw_rad` | [L, P] | unwrapped direction |
    | `speed_limit_mps` | [L, P] | of the lane at the vertex |
    | `curvature_per_m` | [L, P] | signed, left positive |
    | `count` | [L] | vertices |
    | `gate_s_m`, `gate_type`, `gate_signal` | [L, G] | ends of lanes with a stop or give-way line |
    | `fork_s_m`, `fork_end_s_m`, `fork_turn` | [L, G] | connections through junctions |
    | `fork_lane` | [L, G] | numbers of their lanes, in the order of `lanes` |
    """

    def __init__(self, lanes: Iterable[Lane]) -> None:
        self.lanes: dict[str, Lane] = {lane.id: lane for lane in lanes}
        self.lines: list[ReferenceLine] = []
        self._line_of_route: dict[Route, int] = {}
        self._branches: dict[tuple[Route, Kind], tuple[int, ...]] = {}
        self.xy_m: FloatArray = np.zeros((0, 2, 2))
        self.yaw_rad: FloatArray = np.zeros((0, 2))
        self.speed_limit_mps: FloatArray = np.zeros((0, 2))
        self.curvature_per_m: FloatArray = np.zeros((0, 2))
        self.count: IntArray = np.zeros(0, dtype=np.int64)
        self.gate_s_m: FloatArray = np.zeros((0, MAX_FORKS))
        self.gate_type: IntArray = np.zeros((0, MAX_FORKS), dtype=np.int64)
        self.gate_signal: IntArray = np.zeros((0, MAX_FORKS), dtype=np.int64)
        self.fork_s_m: FloatArray = np.zeros((0, MAX_FORKS))
        self.fork_end_s_m: FloatArray = np.zeros((0, MAX_FORKS))
        self.fork_turn: IntArray = np.zeros((0, MAX_FORKS), dtype=np.int64)
        self.fork_lane: IntArray = np.zeros((0, MAX_FORKS), dtype=np.int64)
        self.conflict_table = ConflictTable(self.conflicts, self._may_meet)
        self._clock = 0
        self._touched: IntArray = np.zeros(0, dtype=np.int64)  # [L] when a line was last in use
        self._free: list[int] = []  # numbers of lines that were released
        self.shared: dict[str, Any] = {}  # what perception keeps for all predictors of this road

    # -- lanes --------------------------------------------------------------------------------

    @cached_property
    def _lane_numbers(self) -> dict[str, int]:
        return {name: number for number, name in enumerate(self.lanes)}

    @cached_property
    def _predecessors(self) -> dict[str, list[str]]:
        before: dict[str, list[str]] = {name: [] for name in self.lanes}
        for lane in self.lanes.values():
            for successor in lane.successors:
                if successor in before:
                    before[successor].append(lane.id)
        return before

    @cached_property
    def _lane_samples(self) -> tuple[KDTree, IntArray, FloatArray, tuple[str, ...]]:
        """Points every 2 m of every lane, the lane of each and the lane's direction there."""
        names = tuple(self.lanes)
        points = [resample(self.lanes[name].xy_m, 2.0) for name in names]
        owner = np.repeat(np.arange(len(names)), [len(p) for p in points])
        yaw = np.concatenate([tangent_rad(p) for p in points])
        return KDTree(np.concatenate(points)), owner, yaw, names

    def lanes_near(self, xy_m: FloatArray, yaw_rad: float, kind: Kind) -> list[str]:
        """Lanes within `NEAR_M` and `NEAR_RAD` of a pose that a `kind` may use, nearest first."""
        tree, owner, yaw, names = self._lane_samples
        distance, found = tree.query(xy_m, k=min(64, len(owner)), distance_upper_bound=NEAR_M + 1.0)
        out: list[str] = []
        for away_m, sample in zip(np.atleast_1d(distance), np.atleast_1d(found), strict=True):
            if not np.isfinite(away_m):
                break
            lane = self.lanes[names[owner[sample]]]
            turned = abs(float(wrap_angle(np.asarray(yaw[sample] - yaw_rad))))
            if lane.id not in out and turned <= NEAR_RAD and kind in lane.kinds:
                out.append(lane.id)
        return out

    # -- lines --------------------------------------------------------------------------------

    def line(self, route: Route) -> int:
        """The index of the reference line along the lanes of `route`."""
        index = self._line_of_route.get(route)
        if index is None:
            index = self._add_line(route)
            self._line_of_route[route] = index
        return index

    def branches(self, prefix: Route, kind: Kind) -> tuple[int, ...]:
        """Lines that begin with `prefix` and go on through every connection for `AHEAD_M`."""
        key = (prefix, kind)
        if key not in self._branches:
            self._branches[key] = tuple(self.line(route) for route in self._extend(prefix, kind))
        return self._branches[key]

    def prefix_to(self, lane_id: str, kind: Kind) -> Route:
        """Lanes that lead to `lane_id`, the straightest first, for `BEHIND_M`, and itself."""
        route, length_m = [lane_id], 0.0
        while length_m < BEHIND_M:
            before = [
                name
                for name in self._predecessors[route[0]]
                if kind in self.lanes[name].kinds and name not in route
            ]
            if not before:
                break
            best = min(before, key=lambda name: (abs(self.lanes[name].turn), name))
            route.insert(0, best)
            length_m += _length_m(self.lanes[best])
        return tuple(route)

    def trim(self, route: Route, s_m: float) -> Route:
        """The part of `route` from `BEHIND_M` before the arc length `s_m` to the lane at it."""
        line = self.lines[self.line(route)]
        start = line.lane_start_s_m
        now = int(np.searchsorted(start, s_m, side="right")) - 1
        first = int(np.searchsorted(start, max(s_m - BEHIND_M, 0.0), side="right")) - 1
        return route[max(first, 0) : max(now, 0) + 1]

    def lane_number(self, line: int, s_m: float) -> int:
        """A number for the lane of a line at an arc length, the same for every line over it."""
        start = self.lines[line].lane_start_s_m
        position = max(int(np.searchsorted(start, s_m, side="right")) - 1, 0)
        return self._lane_numbers[self.lines[line].route[position]]

    def _extend(self, prefix: Route, kind: Kind) -> list[Route]:
        open_routes: list[tuple[float, Route]] = [(0.0, prefix)]
        done: list[Route] = []
        while open_routes:
            length_m, route = open_routes.pop(0)
            ahead = [
                name
                for name in self.lanes[route[-1]].successors
                if name in self.lanes and kind in self.lanes[name].kinds and name not in route
            ]
            full = len(done) + len(open_routes) + len(ahead) > MAX_BRANCHES
            if not ahead or length_m >= AHEAD_M or full:
                done.append(route)
                continue
            open_routes += [
                (length_m + _length_m(self.lanes[name]), (*route, name)) for name in ahead
            ]
            open_routes.sort()
        return done

    def _add_line(self, route: Route) -> int:
        lanes = [self.lanes[name] for name in route]
        lengths = np.array([_length_m(lane) for lane in lanes])
        start_s_m = np.concatenate(([0.0], np.cumsum(lengths)[:-1]))
        xy_m = resample(np.concatenate([lane.xy_m for lane in lanes]), LINE_STEP_M)
        index = self._free.pop() if self._free else len(self.lines)
        closed_end = not lanes[-1].successors
        line = ReferenceLine(index, route, xy_m, start_s_m, closed_end)
        if index == len(self.lines):
            self.lines.append(line)
        else:
            self.lines[index] = line
        self._grow(index + 1, len(xy_m))
        self._touched[index] = self._clock
        count = len(xy_m)
        yaw_rad = tangent_rad(xy_m)
        at_m = np.arange(count) * LINE_STEP_M
        lane_at = np.clip(np.searchsorted(start_s_m, at_m, side="right") - 1, 0, len(lanes) - 1)
        self.count[index] = count
        self.xy_m[index, :count] = xy_m
        self.xy_m[index, count:] = xy_m[-1]
        self.yaw_rad[index, :count] = yaw_rad
        self.yaw_rad[index, count:] = yaw_rad[-1]
        limits = np.array([lane.speed_limit_mps for lane in lanes])[lane_at]
        self.speed_limit_mps[index, :count] = limits
        self.speed_limit_mps[index, count:] = limits[-1]
        self.curvature_per_m[index, :count] = _smooth_curvature(yaw_rad)
        self.curvature_per_m[index, count:] = 0.0
        self._add_gates(index, lanes, start_s_m, lengths)
        return index

    def _add_gates(
        self, index: int, lanes: Sequence[Lane], start_s_m: FloatArray, lengths: FloatArray
    ) -> None:
        for name, empty in _NO_GATES.items():
            getattr(self, name)[index] = empty
        gate = fork = 0
        for position, lane in enumerate(lanes):
            end_s_m = start_s_m[position] + lengths[position]
            following = lanes[position + 1].id if position + 1 < len(lanes) else None
            if lane.gate is not Gate.NONE and gate < MAX_FORKS:
                signals = lane.signals or {}
                self.gate_s_m[index, gate] = end_s_m
                self.gate_type[index, gate] = lane.gate
                self.gate_signal[index, gate] = signals.get(following or "", -1)
                gate += 1
            if lane.is_connection and fork < MAX_FORKS:
                self.fork_s_m[index, fork] = start_s_m[position]
                self.fork_end_s_m[index, fork] = end_s_m
                self.fork_turn[index, fork] = lane.turn
                self.fork_lane[index, fork] = self._lane_numbers[lane.id]
                fork += 1

    def _grow(self, lines: int, vertices: int) -> None:
        rows, columns = self.yaw_rad.shape
        if lines <= rows and vertices <= columns:
            return
        rows = max(rows, 32) if lines <= rows else max(32, 2 * lines)
        columns = max(columns, int(1.25 * vertices) if vertices > columns else columns)
        for name in ("xy_m", "yaw_rad", "speed_limit_mps", "curvature_per_m"):
            old = getattr(self, name)
            new = np.zeros((rows, columns, *old.shape[2:]))
            new[: old.shape[0], : old.shape[1]] = old
            new[: old.shape[0], old.shape[1] :] = old[:, -1:] if name != "curvature_per_m" else 0.0
            setattr(self, name, new)
        for name, empty in _NO_GATES.items():
            old = getattr(self, name)
            new = np.full((rows, MAX_FORKS), empty, dtype=old.dtype)
            new[: old.shape[0]] = old
            setattr(self, name, new)
        self.count = np.concatenate((self.count, np.full(rows - len(self.count), 2)))
        self._touched = np.concatenate((self._touched, np.zeros(rows - len(self._touched), int)))

    def touch(self, line: IntArray) -> None:
        """Time goes on by a frame, in which the lines [...] are in use; -1 stands for none."""
        self._clock += 1
        if len(self._touched):
            self._touched[line[line >= 0]] = self._clock

    def release(self, idle_frames: int) -> None:
        """Let go of the lines that were not touched for so many frames.

        Nobody may hold on to these: their numbers will mean other lines.
        """
        old = self._touched[: len(self.lines)] < self._clock - idle_frames
        old[self._free] = False
        gone = np.flatnonzero(old)
        if not len(gone):
            return
        dropped = set(gone.tolist())
        for index in dropped:
            del self._line_of_route[self.lines[index].route]
        self._free += sorted(dropped, reverse=True)
        self._branches = {
            key: lines for key, lines in self._branches.items() if dropped.isdisjoint(lines)
        }
        self.conflict_table.drop(gone)

    # -- coordinates --------------------------------------------------------------------------

    def project(
        self, line: IntArray, xy_m: FloatArray, guess_s_m: FloatArray, reach_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """Frenet s, d [Q] of points [Q, 2] on lines [Q], searched within `reach_m` of a guess."""
        vertices = int(2 * reach_m / LINE_STEP_M) + 2
        index = window(self.count, line, guess_s_m - reach_m, vertices, LINE_STEP_M, 1)
        vertex, _ = nearest_vertex(self.xy_m, line, xy_m, index)
        return project_at(self.xy_m, self.count, LINE_STEP_M, line, xy_m, vertex)

    def track(
        self, line: IntArray, xy_m: FloatArray, guess_s_m: FloatArray, steps: int = 1
    ) -> tuple[FloatArray, FloatArray]:
        """Frenet s, d [Q] of points [Q, 2] whose feet are known to within about a metre.

        One Newton step along the tangent at the guess finds the segment: half the work of
        `project`, for points carried on from frame to frame.
        """
        last = self.count[line] - 1
        vertex = np.clip(np.rint(guess_s_m / LINE_STEP_M).astype(np.int64), 0, last)
        for _ in range(steps):
            away = xy_m - self.xy_m[line, vertex]
            yaw = self.yaw_rad[line, vertex]
            ahead_m = away[:, 0] * np.cos(yaw) + away[:, 1] * np.sin(yaw)
            vertex = np.clip(vertex + np.rint(ahead_m / LINE_STEP_M).astype(np.int64), 0, last)
        return project_at(self.xy_m, self.count, LINE_STEP_M, line, xy_m, vertex)

    def search(
        self, line: IntArray, xy_m: FloatArray, low_s_m: FloatArray, reach_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """Frenet s, d [Q] of points anywhere between `low_s_m` and `reach_m` further on."""
        vertices = int(reach_m / (LINE_STEP_M * COARSE)) + 2
        index = window(self.count, line, low_s_m, vertices, LINE_STEP_M, COARSE)
        coarse, _ = nearest_vertex(self.xy_m, line, xy_m, index)
        coarse_s_m = coarse.astype(np.float64) * LINE_STEP_M
        return self.project(line, xy_m, coarse_s_m, 0.75 * COARSE * LINE_STEP_M)

    def coarse_distance_m(
        self, line: IntArray, xy_m: FloatArray, low_s_m: FloatArray, reach_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """s [Q] and distance [Q] of the nearest of the vertices 4 m apart: a cheap first look."""
        vertices = int(reach_m / (LINE_STEP_M * COARSE)) + 2
        index = window(self.count, line, low_s_m, vertices, LINE_STEP_M, COARSE)
        vertex, square = nearest_vertex(self.xy_m, line, xy_m, index)
        return vertex.astype(np.float64) * LINE_STEP_M, np.sqrt(square)

    def line_yaw_rad(self, line: IntArray, s_m: FloatArray) -> FloatArray:
        """Direction of lines [Q] at arc lengths [Q, ...]."""
        return interpolate(self.yaw_rad, line, s_m / LINE_STEP_M)

    def locate(self, line: IntArray, s_m: FloatArray, d_m: FloatArray) -> FloatArray:
        """Map positions [Q, ..., 2] of Frenet coordinates [Q, ...]; drawn out straight at ends."""
        position = s_m / LINE_STEP_M
        last = self.count[line] - 1.0
        last = last.reshape(last.shape + (1,) * (position.ndim - last.ndim))
        beyond_m = (np.maximum(position - last, 0.0) + np.minimum(position, 0.0)) * LINE_STEP_M
        at = np.clip(position, 0.0, last)
        yaw = interpolate(self.yaw_rad, line, at)
        xy = interpolate(self.xy_m, line, at)
        cos, sin = np.cos(yaw), np.sin(yaw)
        dx = beyond_m * cos - d_m * sin
        dy = beyond_m * sin + d_m * cos
        return xy + np.stack((dx, dy), axis=-1)

    # -- conflicts ----------------------------------------------------------------------------

    def conflicts(self, first: int, second: int) -> tuple[Conflict, ...]:
        """The conflicts of two lines in order along the first, s on (first, second)."""
        return find_conflicts(
            self.xy_m[first, : self.count[first]],
            self.yaw_rad[first, : self.count[first]],
            self.xy_m[second, : self.count[second]],
            self.yaw_rad[second, : self.count[second]],
            LINE_STEP_M,
        )

    def _may_meet(self, first: IntArray, second: IntArray) -> BoolArray:
        """Whether lines [Q] and [Q] come near enough for a conflict, by every COARSE-th vertex."""
        apart_m = CONFLICT_WIDTH_M + 1.5 * COARSE * LINE_STEP_M + 0.1
        near = np.zeros(len(first), dtype=np.bool_)
        for some in np.array_split(np.arange(len(first)), len(first) // 64 + 1):
            one = self.xy_m[first[some], ::COARSE].astype(np.float32)
            other = self.xy_m[second[some], ::COARSE].astype(np.float32)
            away = one[:, :, None] - other[:, None]
            near[some] = (np.einsum("qijk,qijk->qij", away, away) < apart_m**2).any(axis=(1, 2))
        return near


_NO_GATES: Final = {
    "gate_s_m": np.inf,
    "gate_type": 0,
    "gate_signal": -1,
    "fork_s_m": np.inf,
    "fork_end_s_m": np.inf,
    "fork_turn": 0,
    "fork_lane": 0,
}
"""Per-line arrays [L, MAX_FORKS], and what they hold where there is nothing."""


def _length_m(lane: Lane) -> float:
    return float(np.linalg.norm(np.diff(lane.xy_m, axis=0), axis=1).sum())


def _smooth_curvature(yaw_rad: FloatArray) -> FloatArray:
    """Change of direction per metre, averaged over 4 m: lanes come as polylines with corners."""
    raw = np.gradient(yaw_rad, LINE_STEP_M)
    kernel = np.full(9, 1.0 / 9.0)
    padded = np.concatenate((np.full(4, raw[0]), raw, np.full(4, raw[-1])))
    return np.convolve(padded, kernel, mode="valid")
