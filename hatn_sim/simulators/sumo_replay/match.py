"""Which lanes of a net a recorded vehicle drove: its track matched onto the lane graph. Pure.

A hidden-Markov map matching (Newson and Krumm, 2009): a lane explains a point the better the
nearer it is and the more it points the same way, and one lane follows another where the net lets a
vehicle drive on for about the distance that it was recorded to move.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Kind, Lane, Route
from hatn_sim.geometry import arc_length_m, resample, tangent_rad, wrap_angle
from hatn_sim.simulators.sumo_lanes import edge_of, is_connection

SAMPLE_M: Final = 1.0
NEIGHBOURS: Final = 64
"""Samples of lanes looked at around a point, at most."""
REACH_M: Final = 6.0
REACH_RAD: Final = np.deg2rad(75.0)
CANDIDATES: Final = 6
BESIDE_M: Final = 1.0
"""How far beyond a lane's edge a vehicle still counts as on it."""
SPACING_M: Final = 2.5
"""Points of a track nearer to each other than this say nothing more."""
LOOK_AHEAD_M: Final = 80.0
"""How far one point may lie beyond the end of the lane of the point before."""
DISTANCE_SCALE_M: Final = 1.5
HEADING_SCALE_RAD: Final = 0.4
STEP_SCALE_M: Final = 3.0
BACKWARD_M: Final = 3.0
CHANGE_COST: Final = 4.0
BREAK_COST: Final = 200.0


@dataclass(frozen=True, eq=False)
class Match:
    """The lanes that a recorded vehicle drove.

    `lanes` are in driving order, those between two points included; after a change of lanes the
    lane beside follows. `breaks` are the places in `lanes` (index of the later lane) where the
    net does not lead from one to the next.
    """

    first_frame: int
    last_frame: int
    lanes: Route
    frame: IntArray  # [n] of the points matched
    at: IntArray  # [n] place of each point in `lanes`
    breaks: tuple[int, ...]

    def lanes_at(self, frame: int) -> Route:
        """The lanes that the vehicle may be on at a frame.

        Those between the matched points around the frame, and one before and after: a bumper where
        two lanes meet is on either.
        """
        after = int(np.searchsorted(self.frame, frame))
        low = int(self.at[max(after - 1, 0)])
        high = int(self.at[min(after, len(self.at) - 1)])
        return self.lanes[max(low - 1, 0) : high + 2]


class LaneMatcher:
    """The lanes of a net, ready to have tracks matched onto them."""

    def __init__(self, lanes: Sequence[Lane]) -> None:
        self._lanes = list(lanes)
        self._number = {lane.id: index for index, lane in enumerate(lanes)}
        number = self._number
        self._successors = [[number[name] for name in lane.successors] for lane in lanes]
        self._predecessors: list[list[int]] = [[] for _ in lanes]
        for index, following in enumerate(self._successors):
            for successor in following:
                self._predecessors[successor].append(index)
        self._length_m = [float(arc_length_m(lane.xy_m)[-1]) for lane in lanes]
        self._edge = [edge_of(lane.id) for lane in lanes]
        points = [resample(lane.xy_m, SAMPLE_M) for lane in lanes]
        counts = [len(part) for part in points]
        self._owner = np.repeat(np.arange(len(lanes)), counts)
        self._s_m = np.concatenate([np.arange(count) * SAMPLE_M for count in counts])
        self._yaw_rad = np.concatenate([tangent_rad(part) for part in points])
        self._half_width_m = np.array([0.5 * lane.width_m for lane in lanes])
        self._tree = KDTree(np.concatenate(points))
        self._ahead: dict[int, dict[int, tuple[float, tuple[int, ...]]]] = {}

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """Lowest x and y, highest x and y of the centre lines."""
        low, high = self._tree.mins, self._tree.maxes
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def distance_m(self, xy_m: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Of points [N, 2]: metres to the nearest centre line [N], and whether on a lane [N]."""
        away_m, sample = self._tree.query(xy_m)
        on_lane = away_m <= self._half_width_m[self._owner[sample]] + BESIDE_M
        return np.asarray(away_m), np.asarray(on_lane)

    def match(
        self, frame: IntArray, xy_m: FloatArray, yaw_rad: FloatArray, kind: Kind
    ) -> Match | None:
        """The lanes of a track [n], [n, 2], [n] of front bumpers; None if it is near no lane."""
        keep = _spaced(xy_m)
        candidates = self._candidates(xy_m[keep], yaw_rad[keep], kind)
        used = np.array([row for row, found in zip(keep, candidates, strict=True) if found])
        if not len(used):
            return None
        chosen = self._viterbi([found for found in candidates if found], xy_m[used])
        path, at, breaks = [chosen[0]], [0], list[int]()
        for before, now in pairwise(chosen):
            if now != before:
                between = self._between(before, now)
                path += [*between, now] if between is not None else [now]
                if between is None:
                    breaks.append(len(path) - 1)
            at.append(len(path) - 1)
        return Match(
            first_frame=int(frame[0]),
            last_frame=int(frame[-1]),
            lanes=tuple(self._lanes[index].id for index in path),
            frame=frame[used],
            at=np.array(at),
            breaks=tuple(breaks),
        )

    def edges_from(self, match: Match, frame: int) -> Route | None:
        """The edges to drive from a frame on, the present one first; None where no way leads.

        Where the recorded lanes do not follow one another the shortest way between them is taken.
        """
        number = self._number
        after = int(np.searchsorted(match.frame, frame, side="right"))
        start = int(match.at[max(after - 1, 0)])
        path = [number[match.lanes[start]]]
        for place in range(start + 1, len(match.lanes)):
            lane = number[match.lanes[place]]
            if place in match.breaks:
                detour = self._shortest(path[-1], lane)
                if detour is None:
                    return None
                path += detour
            path.append(lane)
        # SUMO's routes begin and end on normal edges.
        while is_connection(self._edge[path[0]]):
            if not self._predecessors[path[0]]:
                return None
            path.insert(0, self._predecessors[path[0]][0])
        while is_connection(self._edge[path[-1]]):
            if not self._successors[path[-1]]:
                return None
            path.append(self._successors[path[-1]][0])
        edges = [self._edge[index] for index in path if not is_connection(self._edge[index])]
        return tuple(e for place, e in enumerate(edges) if place == 0 or e != edges[place - 1])

    def _candidates(
        self, xy_m: FloatArray, yaw_rad: FloatArray, kind: Kind
    ) -> list[list[tuple[int, float, float]]]:
        """For each point the likeliest (lane, arc length, cost), a lane once."""
        neighbours = min(NEIGHBOURS, len(self._owner))
        away_m, sample = self._tree.query(xy_m, k=neighbours, distance_upper_bound=REACH_M)
        away_m, sample = away_m.reshape(len(xy_m), -1), sample.reshape(len(xy_m), -1)
        near = np.isfinite(away_m)
        sample = np.where(near, sample, 0)
        turned = np.abs(wrap_angle(self._yaw_rad[sample] - yaw_rad[:, None]))
        cost = (np.where(near, away_m, 0.0) / DISTANCE_SCALE_M) ** 2
        cost = cost + (turned / HEADING_SCALE_RAD) ** 2
        cost = np.where(near & (turned <= REACH_RAD), cost, np.inf)
        found: list[list[tuple[int, float, float]]] = []
        for row, order in enumerate(np.argsort(cost, axis=1, kind="stable")):
            best: dict[int, tuple[int, float, float]] = {}
            for column in order:
                if len(best) == CANDIDATES or not np.isfinite(cost[row, column]):
                    break
                lane = int(self._owner[sample[row, column]])
                if lane not in best and kind in self._lanes[lane].kinds:
                    s_m = float(self._s_m[sample[row, column]])
                    best[lane] = (lane, s_m, float(cost[row, column]))
            found.append(list(best.values()))
        return found

    def _viterbi(
        self, candidates: list[list[tuple[int, float, float]]], xy_m: FloatArray
    ) -> list[int]:
        """The likeliest sequence of lanes, one for each point."""
        moved_m = np.linalg.norm(np.diff(xy_m, axis=0), axis=1)
        costs = [cost for _, _, cost in candidates[0]]
        back: list[list[int]] = []
        for step_m, (before, now) in zip(moved_m, pairwise(candidates), strict=True):
            rows: list[int] = []
            totals: list[float] = []
            for lane, s_m, cost in now:
                options = [
                    total + self._step_cost(source, source_s_m, lane, s_m, float(step_m))
                    for total, (source, source_s_m, _) in zip(costs, before, strict=True)
                ]
                best = min(range(len(options)), key=options.__getitem__)
                rows.append(best)
                totals.append(options[best] + cost)
            costs = totals
            back.append(rows)
        row = min(range(len(costs)), key=costs.__getitem__)
        chosen = [candidates[-1][row][0]]
        for rows, found in zip(reversed(back), reversed(candidates[:-1]), strict=True):
            row = rows[row]
            chosen.append(found[row][0])
        return chosen[::-1]

    def _step_cost(
        self, source: int, source_s_m: float, lane: int, s_m: float, moved_m: float
    ) -> float:
        cost, driven_m = 0.0, s_m - source_s_m
        if lane != source:
            ahead = self._reachable(source).get(lane)
            if ahead is not None:
                driven_m = self._length_m[source] - source_s_m + ahead[0] + s_m
            elif self._beside(source, lane):
                cost = CHANGE_COST
            else:
                return BREAK_COST
        if driven_m < -BACKWARD_M:
            return BREAK_COST
        return min(cost + ((driven_m - moved_m) / STEP_SCALE_M) ** 2, BREAK_COST)

    def _between(self, source: int, lane: int) -> tuple[int, ...] | None:
        """The lanes passed on the way from one to the other; None if there is no way nearby."""
        ahead = self._reachable(source).get(lane)
        if ahead is not None:
            return ahead[1]
        return () if self._beside(source, lane) else None

    def _beside(self, source: int, lane: int) -> bool:
        return self._edge[source] == self._edge[lane] and not is_connection(self._edge[lane])

    def _reachable(self, source: int) -> dict[int, tuple[float, tuple[int, ...]]]:
        """Lane -> metres from the end of `source` to its beginning, and the lanes between."""
        if source not in self._ahead:
            self._ahead[source] = self._spread(source, LOOK_AHEAD_M)
        return self._ahead[source]

    def _shortest(self, source: int, lane: int) -> list[int] | None:
        """The lanes of the shortest way from the end of one lane to the beginning of another."""
        for start in (source, *(i for i, e in enumerate(self._edge) if e == self._edge[source])):
            found = self._spread(start, np.inf).get(lane)
            if found is not None:
                return list(found[1])
        return None

    def _spread(self, source: int, limit_m: float) -> dict[int, tuple[float, tuple[int, ...]]]:
        found: dict[int, tuple[float, tuple[int, ...]]] = {}
        queue: list[tuple[float, int, tuple[int, ...]]] = [
            (0.0, successor, ()) for successor in self._successors[source]
        ]
        while queue:
            away_m, lane, between = heapq.heappop(queue)
            if lane in found or away_m > limit_m:
                continue
            found[lane] = (away_m, between)
            for successor in self._successors[lane]:
                further = (away_m + self._length_m[lane], successor, (*between, lane))
                heapq.heappush(queue, further)
        return found


def _spaced(xy_m: FloatArray) -> list[int]:
    """The rows of a track [n, 2] that are `SPACING_M` apart, its first and last included."""
    kept = [0]
    for row in range(1, len(xy_m)):
        if np.hypot(*(xy_m[row] - xy_m[kept[-1]])) >= SPACING_M:
            kept.append(row)
    if kept[-1] != len(xy_m) - 1:
        kept.append(len(xy_m) - 1)
    return kept
