"""Lanes inside junctions, as SUMO's answers name them: rows of the list of lanes, -1 for none.

A way through a junction is one connection; it may be split where vehicles wait for oncoming
traffic. It goes by the row of its first lane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Lane, ReferenceLine
from hatn_sim.road import LINE_STEP_M
from hatn_sim.simulators.sumo_lanes import junction_of
from hatn_sim.simulators.sumo_messages import LaneFoes

NOWHERE: Final = (np.nan, np.nan)


@dataclass(frozen=True, eq=False)
class JunctionLanes:
    """What the comparison needs to know of L lanes, row by row."""

    lanes: Sequence[Lane]
    row: dict[str, int]
    junction: IntArray  # [L] its number, -1 outside junctions
    way: IntArray  # [L] first lane of the way through the junction
    source: IntArray  # [L] the lane before the junction
    target: IntArray  # [L] what follows the lane, -1 where that is inside too
    foes: IntArray  # keys of two ways, sorted
    shown: IntArray  # keys of a way and a foe of it that SUMO's list comes to, sorted
    mute: BoolArray  # [L] in a junction without logic
    approach_foes: IntArray  # keys of a way and the lane before its foe's way, sorted

    def are_foes(self, way: IntArray) -> BoolArray:
        """Whether SUMO's junction holds lanes of two ways [M, 2] against each other."""
        return np.isin(self._key(way[:, 0], way[:, 1]), self.foes)

    def can_list(self, way: IntArray) -> BoolArray:
        """Whether SUMO's list of vehicles on a way can hold those on another; ways [M, 2].

        SUMO 1.28 goes through the foe lanes of a lane in the order of its table and passes over all
        that follow the first one whose centre line does not cross (observed, not documented).
        """
        return np.isin(self._key(way[:, 0], way[:, 1]), self.shown)

    def cross_right_of_way(self, way: IntArray) -> BoolArray:
        """Whether each of two ways [M, 2] has the other's approach among its foes."""
        there = self._key(way[:, 0], self.source[way[:, 1]])
        back = self._key(way[:, 1], self.source[way[:, 0]])
        return np.isin(there, self.approach_foes) & np.isin(back, self.approach_foes)

    def _key(self, one: IntArray, other: IntArray) -> IntArray:
        return one * len(self.lanes) + other


def read_junctions(lanes: Sequence[Lane], foes: LaneFoes) -> JunctionLanes:
    """The ways through the junctions of a net, and their foes."""
    row = {lane.id: number for number, lane in enumerate(lanes)}
    count = len(lanes)
    inside = np.array([lane.is_connection for lane in lanes], dtype=np.bool_)
    following = np.array([_first(lane.successors, row) for lane in lanes], dtype=np.int64)
    before = np.full(count, -1, dtype=np.int64)
    for number in range(count):  # inside a junction a lane has one lane before it
        for successor in lanes[number].successors:
            after = row.get(successor, -1)
            if after >= 0 and inside[after]:
                before[after] = number
    way = np.arange(count)
    source = before.copy()
    for _ in range(count):
        within = inside & (source >= 0)
        within[within] = inside[source[within]]
        if not within.any():
            break
        way[within] = source[within]
        source[within] = before[source[within]]
    names: dict[str, int] = {}
    junction = np.array(
        [
            names.setdefault(junction_of(lane.id), len(names)) if lane.is_connection else -1
            for lane in lanes
        ],
        dtype=np.int64,
    )
    leads_on = inside & (following >= 0)
    target = np.where(leads_on & ~inside[following], following, -1)
    pairs = way[foes.inside]
    keys = np.concatenate((pairs[:, 0] * count + pairs[:, 1], pairs[:, 1] * count + pairs[:, 0]))
    shown = pairs[_before_first_miss(foes.inside, lanes, source, target)]
    return JunctionLanes(
        lanes=lanes,
        row=row,
        junction=junction,
        way=way,
        source=source,
        target=target,
        foes=np.unique(keys),
        mute=np.isin(np.arange(count), foes.mute),
        shown=np.unique(shown[:, 0] * count + shown[:, 1]),
        approach_foes=_approach_keys(foes.approaching, way, source, target, inside),
    )


def junction_spans(lanes: JunctionLanes, line: ReferenceLine) -> dict[int, tuple[float, float]]:
    """Junction -> begin and end on a line, in metres of arc length."""
    start_s_m = line.lane_start_s_m
    end_s_m = np.append(start_s_m[1:], (len(line.xy_m) - 1) * LINE_STEP_M)
    spans: dict[int, tuple[float, float]] = {}
    for name, start, end in zip(line.route, start_s_m.tolist(), end_s_m.tolist(), strict=True):
        number = int(lanes.junction[lanes.row[name]])
        if number >= 0:
            spans[number] = (spans.get(number, (start, end))[0], end)
    return spans


def _first(successors: Sequence[str], row: dict[str, int]) -> int:
    return next((row[name] for name in successors if name in row), -1)


def _before_first_miss(
    inside: IntArray, lanes: Sequence[Lane], source: IntArray, target: IntArray
) -> BoolArray:
    """Rows of (lane, foe), in the order of SUMO's table, before the first foe that is not met."""
    kept = np.ones(len(inside), dtype=np.bool_)
    missed: set[int] = set()
    for number, (lane, foe) in enumerate(inside.tolist()):
        if lane not in missed:
            joined = source[lane] == source[foe] or target[lane] == target[foe] >= 0
            if joined or _cross(lanes[lane].xy_m, lanes[foe].xy_m):
                continue
            missed.add(lane)
        kept[number] = False
    return kept


def _cross(one_xy_m: FloatArray, other_xy_m: FloatArray) -> bool:
    """Whether two polylines [P, 2] have a point in common, their ends included."""
    a, b = one_xy_m[:-1, None], one_xy_m[1:, None]
    c, d = other_xy_m[None, :-1], other_xy_m[None, 1:]
    sides = _side(a, b, c) * _side(a, b, d), _side(c, d, a) * _side(c, d, b)
    return bool(((sides[0] <= 0.0) & (sides[1] <= 0.0)).any())


def _side(start: FloatArray, end: FloatArray, point: FloatArray) -> FloatArray:
    """Positive where a point is left of the way from start to end, zero on it; [..., 2] each."""
    along, off = end - start, point - start
    return np.asarray(along[..., 0] * off[..., 1] - along[..., 1] * off[..., 0])


def _approach_keys(
    approaching: IntArray, way: IntArray, source: IntArray, target: IntArray, inside: BoolArray
) -> IntArray:
    """Keys of (way, lane before its foe's way) for rows of (lane, lane reached, foe's lane)."""
    last = np.flatnonzero(inside & (target >= 0))
    way_of = {
        (s, t): w
        for s, t, w in zip(
            source[last].tolist(), target[last].tolist(), way[last].tolist(), strict=True
        )
    }
    keys = [
        way_of[lane, reached] * len(way) + foe
        for lane, reached, foe in approaching.tolist()
        if (lane, reached) in way_of
    ]
    return np.unique(np.array(keys, dtype=np.int64))
