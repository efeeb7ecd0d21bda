"""Lanes -> reference lines -> conflicts. Built on demand: a road costs what its vehicles touch."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from hatn_sim.conflict_table import ConflictTable
from hatn_sim.conflicts import CONFLICT_WIDTH_M, find_conflicts
from hatn_sim.datatypes import (
    BoolArray,
    Conflict,
    ConflictType,
    FloatArray,
    Gate,
    IntArray,
    Kind,
    Lane,
    ReferenceLine,
    Route,
)
from hatn_sim.geometry import (
    cut_polyline,
    interpolate,
    nearest_vertex,
    project_at,
    resample,
    smooth_curvature_per_m,
    tangent_rad,
    window,
)
from hatn_sim.lane_graph import AHEAD_M, BEHIND_M, LaneGraph, length_m

LINE_STEP_M: Final = 0.5
SPARE_M: Final = 100.0
"""Lines are cut where more than this is to spare; uncut they serve vehicles on all their lanes."""
MAX_FORKS: Final = 24
NEAR_JUNCTION_M: Final = 10.0
"""Lines that cross have a junction at most this far away, both of them."""
COARSE: Final = 8
"""Vertices apart for a first look along a line."""
_WHOLE: Final = -1
"""In place of a lane's position in a route: the line is not cut to what is near that lane."""


class Road:
    """The lane graph of a place, and the reference lines and conflicts drawn from it so far.

    Lines are drawn as vehicles need them. Whoever runs for long lets go of those not touched for a
    while with `release`; their numbers are given to new lines then. Vertices of all lines lie one
    after the other; those of `lines[i]` are the `count[i]` from `offset[i]` on:

    | array | shape | content |
    |---|---|---|
    | `offset`, `count` | [L] | where a line's vertices are |
    | `xy_m` | [V, 2] | centre line, a vertex every `LINE_STEP_M` |
    | `yaw_rad` | [V] | direction, unwrapped along the line |
    | `speed_limit_mps` | [V] | of the lane at the vertex |
    | `curvature_per_m` | [V] | signed, left positive |
    | `gate_s_m`, `gate_type`, `gate_signal` | [L, G] | ends of lanes with a stop or give-way line |
    | `fork_s_m`, `fork_end_s_m`, `fork_turn` | [L, G] | connections through junctions |
    | `fork_lane` | [L, G] | numbers of their lanes, in the order of `lanes` |
    """

    def __init__(self, lanes: Iterable[Lane]) -> None:
        self.lane_graph = LaneGraph(lanes)
        self.lines: list[ReferenceLine] = []
        self._line_of: dict[tuple[Route, int], int] = {}
        self._branches: dict[tuple[Route, Kind], tuple[int, ...]] = {}
        self.xy_m: FloatArray = np.zeros((0, 2))
        self.yaw_rad: FloatArray = np.zeros(0)
        self.speed_limit_mps: FloatArray = np.zeros(0)
        self.curvature_per_m: FloatArray = np.zeros(0)
        self._vertices = 0  # in use
        self.offset: IntArray = np.zeros(0, dtype=np.int64)
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

    @property
    def lanes(self) -> dict[str, Lane]:
        """The lanes by name."""
        return self.lane_graph.lanes

    # -- lines --------------------------------------------------------------------------------

    def line(self, route: Route) -> int:
        """The index of the reference line along all of the lanes of `route`."""
        return self._line(route, _WHOLE)

    def branches(self, prefix: Route, kind: Kind) -> tuple[int, ...]:
        """Lines that begin with `prefix` and go on through every connection for `AHEAD_M`.

        Where lanes are long they are drawn from `BEHIND_M` before the last lane of the prefix to
        `AHEAD_M` behind it only.
        """
        key = (prefix, kind)
        if key not in self._branches:
            here = len(prefix) - 1
            need_m = BEHIND_M + length_m(self.lanes[prefix[-1]]) + AHEAD_M + SPARE_M
            routes = self.lane_graph.routes_from(prefix, kind)
            whole_m = [sum(length_m(self.lanes[name]) for name in route) for route in routes]
            self._branches[key] = tuple(
                self._line(route, _WHOLE if whole < need_m else here)
                for route, whole in zip(routes, whole_m, strict=True)
            )
        return self._branches[key]

    def _line(self, route: Route, here: int) -> int:
        index = self._line_of.get((route, here))
        if index is None:
            index = self._add_line(route, here)
            self._line_of[route, here] = index
        return index

    def trim(self, line: int, s_m: float) -> Route:
        """The lanes of a line from `BEHIND_M` before the arc length `s_m` to the lane at it."""
        start = self.lines[line].lane_start_s_m
        now = int(np.searchsorted(start, s_m, side="right")) - 1
        first = int(np.searchsorted(start, max(s_m - BEHIND_M, 0.0), side="right")) - 1
        return self.lines[line].route[max(first, 0) : max(now, 0) + 1]

    def stretch(self, line: int, s_m: float) -> Route:
        """The lanes of a line from `BEHIND_M` before an arc length to `AHEAD_M` behind it."""
        start = self.lines[line].lane_start_s_m
        first, last = np.searchsorted(start, [max(s_m - BEHIND_M, 0.0), s_m + AHEAD_M], "right")
        return self.lines[line].route[max(int(first) - 1, 0) : int(last)]

    def lane_number(self, line: int, s_m: float) -> int:
        """A number for the lane of a line at an arc length, the same for every line over it."""
        start = self.lines[line].lane_start_s_m
        position = max(int(np.searchsorted(start, s_m, side="right")) - 1, 0)
        return self.lane_graph.numbers[self.lines[line].route[position]]

    def _add_line(self, route: Route, here: int) -> int:
        lanes = [self.lanes[name] for name in route]
        lengths = np.array([length_m(lane) for lane in lanes])
        ends = np.cumsum(lengths)
        xy_m = np.concatenate([lane.xy_m for lane in lanes])
        cut_m = (0.0, float(ends[-1]))
        if here != _WHOLE:
            before_m, behind_m = ends[here] - lengths[here] - BEHIND_M, ends[here] + AHEAD_M
            cut_m = (max(0.0, float(before_m)), min(float(behind_m), cut_m[1]))
            xy_m = cut_polyline(xy_m, *cut_m)
        start_s_m = ends - lengths - cut_m[0]
        closed_end = not lanes[-1].successors and cut_m[1] == ends[-1]
        xy_m = resample(xy_m, LINE_STEP_M)
        index = self._free.pop() if self._free else len(self.lines)
        line = ReferenceLine(index, route, xy_m, start_s_m, closed_end)
        if index == len(self.lines):
            self.lines.append(line)
        else:
            self.lines[index] = line
        count = len(xy_m)
        self._grow(index + 1, self._vertices + count)
        self.offset[index], self.count[index] = self._vertices, count
        self._touched[index] = self._clock
        own = slice(self._vertices, self._vertices + count)
        self._vertices += count
        yaw_rad = tangent_rad(xy_m)
        at_m = np.arange(count) * LINE_STEP_M
        lane_at = np.clip(np.searchsorted(start_s_m, at_m, side="right") - 1, 0, len(lanes) - 1)
        self.xy_m[own], self.yaw_rad[own] = xy_m, yaw_rad
        self.speed_limit_mps[own] = np.array([lane.speed_limit_mps for lane in lanes])[lane_at]
        self.curvature_per_m[own] = smooth_curvature_per_m(yaw_rad, LINE_STEP_M)
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
                self.fork_lane[index, fork] = self.lane_graph.numbers[lane.id]
                fork += 1

    def _grow(self, lines: int, vertices: int) -> None:
        if vertices > len(self.yaw_rad):
            self._resize(_PER_VERTEX, max(8192, int(1.5 * vertices)))
        if lines > len(self.count):
            self._resize(_PER_LINE, max(32, 2 * lines))

    def _resize(self, names: Iterable[str], rows: int) -> None:
        for name in names:
            old = getattr(self, name)
            new = np.empty((rows, *old.shape[1:]), dtype=old.dtype)
            new[: len(old)] = old
            setattr(self, name, new)

    def touch(self, line: IntArray) -> None:
        """Time goes on by a frame, in which the lines [...] are in use; -1 stands for none."""
        self._clock += 1
        if len(self._touched):
            self._touched[line[line >= 0]] = self._clock

    def release(self, idle_frames: int, keep: int = 0) -> None:
        """Let go of the lines not touched for so many frames, if there are more than `keep` lines.

        Nobody may hold on to these: their numbers will mean other lines.
        """
        if len(self._line_of) <= keep:
            return
        old = self._touched[: len(self.lines)] < self._clock - idle_frames
        old[self._free] = False
        gone = np.flatnonzero(old)
        if not len(gone):
            return
        dropped = set(gone.tolist())
        self._line_of = {key: i for key, i in self._line_of.items() if i not in dropped}
        self._free += sorted(dropped, reverse=True)
        self._branches = {
            key: lines for key, lines in self._branches.items() if dropped.isdisjoint(lines)
        }
        self.conflict_table.drop(gone)
        self._close_gaps()

    def _close_gaps(self) -> None:
        kept = np.array(sorted(self._line_of.values()), dtype=np.int64)
        count = self.count[kept]
        start = np.cumsum(count) - count
        self._vertices = int(count.sum())
        old = np.repeat(self.offset[kept] - start, count) + np.arange(self._vertices)
        for name in _PER_VERTEX:
            values = getattr(self, name)
            values[: self._vertices] = values[old]
        self.offset[kept] = start

    # -- coordinates --------------------------------------------------------------------------

    def project(
        self, line: IntArray, xy_m: FloatArray, guess_s_m: FloatArray, reach_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """Frenet s, d [Q] of points [Q, 2] on lines [Q], searched within `reach_m` of a guess."""
        base, count = self.offset[line], self.count[line]
        vertices = int(2 * reach_m / LINE_STEP_M) + 2
        index = window(count, guess_s_m - reach_m, vertices, LINE_STEP_M, 1)
        vertex, _ = nearest_vertex(self.xy_m, base, xy_m, index)
        return project_at(self.xy_m, base, count, LINE_STEP_M, xy_m, vertex)

    def track(
        self, line: IntArray, xy_m: FloatArray, guess_s_m: FloatArray, steps: int = 1
    ) -> tuple[FloatArray, FloatArray]:
        """Frenet s, d [Q] of points [Q, 2] whose feet are known to within about a metre.

        One Newton step along the tangent at the guess finds the segment: half the work of
        `project`, for points carried on from frame to frame.
        """
        base, count = self.offset[line], self.count[line]
        last = count - 1
        vertex = np.rint(guess_s_m / LINE_STEP_M).astype(np.int64)
        vertex = np.minimum(np.maximum(vertex, 0), last)
        for _ in range(steps):
            away = xy_m - self.xy_m.take(base + vertex, axis=0)
            yaw = self.yaw_rad.take(base + vertex)
            ahead_m = away[:, 0] * np.cos(yaw) + away[:, 1] * np.sin(yaw)
            vertex = vertex + np.rint(ahead_m / LINE_STEP_M).astype(np.int64)
            vertex = np.minimum(np.maximum(vertex, 0), last)
        return project_at(self.xy_m, base, count, LINE_STEP_M, xy_m, vertex)

    def search(
        self, line: IntArray, xy_m: FloatArray, low_s_m: FloatArray, reach_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """Frenet s, d [Q] of points anywhere between `low_s_m` and `reach_m` further on."""
        coarse_s_m, _ = self.coarse_distance_m(line, xy_m, low_s_m, reach_m)
        return self.project(line, xy_m, coarse_s_m, 0.75 * COARSE * LINE_STEP_M)

    def coarse_distance_m(
        self, line: IntArray, xy_m: FloatArray, low_s_m: FloatArray, reach_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """s [Q] and distance [Q] of the nearest of the vertices 4 m apart: a cheap first look."""
        vertices = int(reach_m / (LINE_STEP_M * COARSE)) + 2
        index = window(self.count[line], low_s_m, vertices, LINE_STEP_M, COARSE)
        vertex, square = nearest_vertex(self.xy_m, self.offset[line], xy_m, index)
        return vertex.astype(np.float64) * LINE_STEP_M, np.sqrt(square)

    def line_yaw_rad(self, line: IntArray, s_m: FloatArray) -> FloatArray:
        """Direction of lines [Q] at arc lengths [Q, ...]."""
        return interpolate(self.yaw_rad, self.offset[line], self.count[line], s_m / LINE_STEP_M)

    def locate(self, line: IntArray, s_m: FloatArray, d_m: FloatArray) -> FloatArray:
        """Map positions [Q, ..., 2] of Frenet coordinates [Q, ...]; drawn out straight at ends."""
        position = s_m / LINE_STEP_M
        last = self.count[line] - 1.0
        last = last.reshape(last.shape + (1,) * (position.ndim - last.ndim))
        beyond_m = (np.maximum(position - last, 0.0) + np.minimum(position, 0.0)) * LINE_STEP_M
        at = np.clip(position, 0.0, last)
        yaw = interpolate(self.yaw_rad, self.offset[line], self.count[line], at)
        xy = interpolate(self.xy_m, self.offset[line], self.count[line], at)
        cos, sin = np.cos(yaw), np.sin(yaw)
        dx = beyond_m * cos - d_m * sin
        dy = beyond_m * sin + d_m * cos
        return xy + np.stack((dx, dy), axis=-1)

    # -- conflicts ----------------------------------------------------------------------------

    def conflicts(self, first: int, second: int) -> tuple[Conflict, ...]:
        """The conflicts of two lines in order along the first, s on (first, second).

        Where the road knows junctions, lines that touch outside of them pass over each other, and
        so do lines that cross where only one of them has a junction: a bridge.
        """
        one, other = (
            slice(self.offset[k], self.offset[k] + self.count[k]) for k in (first, second)
        )
        found = find_conflicts(
            self.xy_m[one], self.yaw_rad[one], self.xy_m[other], self.yaw_rad[other], LINE_STEP_M
        )
        if not self.lane_graph.knows_junctions:
            return found
        return tuple(
            conflict
            for conflict in found
            if any(self._at_junction((first, second), conflict, 0.0))
            and (
                conflict.type is ConflictType.MERGE
                or all(self._at_junction((first, second), conflict, NEAR_JUNCTION_M))
            )
        )

    def find_all_conflicts(self, most_lines: int) -> None:
        """Find out at once who meets whom, where no more lines than so many were drawn."""
        lines = np.array(sorted(self._line_of.values()), dtype=np.int64)
        if len(lines) <= most_lines:
            first, second = np.triu_indices(len(lines), 1)
            self.conflict_table.of_pairs(lines[first], lines[second])

    def _at_junction(
        self, lines: tuple[int, int], conflict: Conflict, within_m: float
    ) -> tuple[bool, bool]:
        """Whether a conflict of two lines is in a junction, or as near to one, on either line."""
        one, other = (
            self._touches_junction(line, entry - within_m, leave + within_m)
            for line, entry, leave in zip(lines, conflict.entry_s_m, conflict.exit_s_m, strict=True)
        )
        return one, other

    def _touches_junction(self, line: int, from_s_m: float, to_s_m: float) -> bool:
        """Whether a connection is part of a line between two arc lengths."""
        start = self.lines[line].lane_start_s_m
        first = max(int(np.searchsorted(start, from_s_m, side="right")) - 1, 0)
        last = int(np.searchsorted(start, to_s_m, side="right"))
        return any(self.lanes[name].is_connection for name in self.lines[line].route[first:last])

    def _may_meet(self, first: IntArray, second: IntArray) -> BoolArray:
        """Whether lines [Q] and [Q] come near enough for a conflict, by every COARSE-th vertex."""
        apart_m = CONFLICT_WIDTH_M + 1.5 * COARSE * LINE_STEP_M + 0.1
        near = np.zeros(len(first), dtype=np.bool_)
        for some in np.array_split(np.arange(len(first)), len(first) // 64 + 1):
            one, other = self._coarse(first[some]), self._coarse(second[some])
            away = one[:, :, None] - other[:, None]
            near[some] = (np.einsum("qijk,qijk->qij", away, away) < apart_m**2).any(axis=(1, 2))
        return near

    def _coarse(self, line: IntArray) -> FloatArray:
        """Every COARSE-th vertex [Q, W, 2] of lines [Q]; shorter ones repeat their last."""
        count = self.count[line]
        index = np.arange(0, int(count.max(initial=1)) + COARSE, COARSE)
        return self.xy_m[self.offset[line][:, None] + np.minimum(index, count[:, None] - 1)]


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
_PER_LINE: Final = ("offset", "count", "_touched", *_NO_GATES)
_PER_VERTEX: Final = ("xy_m", "yaw_rad", "speed_limit_mps", "curvature_per_m")
