"""Our conflicts held against SUMO's own (`vehicle.getJunctionFoes`), one moment at a time.

The unit is a meeting: two vehicles and a junction that both have within `REACH_M` ahead of their
front bumpers, or are in. A meeting is SUMO's if its list holds the two against each other there,
and ours if their reference lines have a conflict there. Lines come from the simulator's routes, so
that the geometry is tested and not the guess of where somebody goes.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.conflicts import OPPOSITE_RAD
from hatn_sim.datatypes import BoolArray, ConflictType, FloatArray, IntArray
from hatn_sim.geometry import wrap_angle
from hatn_sim.road import LINE_STEP_M, MAX_CONFLICTS, Road
from hatn_sim.score.oracle_lanes import NOWHERE, JunctionLanes, junction_spans
from hatn_sim.simulators.sumo_messages import JunctionFoes

REACH_M: Final = 60.0
ASK_M: Final = 200.0
"""How far SUMO is asked to look: to a junction `REACH_M` ahead, and through it."""
NEAR_JUNCTION_M: Final = 10.0
"""A conflict belongs to the nearest junction of both lines, at most this far from its lanes."""
AREA_MERGE_M: Final = 2.5
"""SUMO's area of a merge begins where centre lines are this near, or half the lanes' widths."""


class Outcome(IntEnum):
    """What became of a meeting."""

    BOTH = 0
    ONLY_SUMO = 1
    ONLY_SUMO_OTHER_LANE = 2
    ONLY_OURS = 3
    ONLY_OURS_NO_JUNCTION = 4
    NEITHER = 5
    SAME_LANE_BEFORE = 6
    NO_ROUTE = 7
    PASSED = 8
    OUTDATED = 9
    UNANNOUNCED = 10
    CUT_SHORT = 11
    RIGHT_OF_WAY_ONLY = 12
    HEAD_ON = 13


@dataclass(frozen=True, eq=False)
class Moment:
    """Where N vehicles are on the lines of their routes, and SUMO's answer."""

    xy_m: FloatArray  # [N, 2]
    line: IntArray  # [N] -1: on no line
    front_s_m: FloatArray  # [N] front bumper, along the line
    foes: JunctionFoes


@dataclass(frozen=True, eq=False)
class Compared:
    """M meetings and D distances, each of one vehicle to one conflict."""

    vehicle: IntArray  # [M, 2]
    way: IntArray  # [M, 2] first lanes of the ways through the junction, -1: at no junction
    outcome: IntArray  # [M] Outcome
    distance_vehicle: IntArray  # [D]
    place_error_m: FloatArray  # [D] ours minus SUMO's, to the same place of the area
    entry_error_m: FloatArray  # [D] ours minus SUMO's, to the area's begin, each by its own width
    waiting_places: int  # SUMO's distances to a place to wait before the area, left out of D


@dataclass(frozen=True, eq=False)
class _Meetings:
    key: IntArray  # [M] sorted
    vehicle: IntArray  # [M, 2] the smaller index first
    junction: IntArray  # [M]
    way: IntArray  # [M, 2]


@dataclass(frozen=True, eq=False)
class _Listed:
    """SUMO's list, K rows of it that are of a meeting."""

    meeting: IntArray  # [K]
    side: IntArray  # [K] which of the meeting's vehicles was asked
    lane: IntArray  # [K, 2] the asked one's, its foe's
    enter_m: FloatArray  # [K] of the asked one: a foe's distance is of the step before
    leave_m: FloatArray  # [K]
    ahead: BoolArray  # [K] neither has left the area
    current: BoolArray  # [K] both are still on the ways that the list names


@dataclass(frozen=True, eq=False)
class _Ours:
    table: FloatArray  # [M, Q, 7] see Road.conflict_table
    here: BoolArray  # [M, Q] the conflict belongs to the meeting's junction
    ahead: BoolArray  # [M, Q] neither front bumper is beyond it
    head_on: BoolArray  # [M, Q] they run against each other there
    stray: IntArray  # [R, 2] pairs with a conflict ahead at none of their junctions
    stray_outcome: IntArray  # [R] Outcome


class Oracle:
    """Compares moment after moment; keeps what it works out of lines."""

    def __init__(self, road: Road, lanes: JunctionLanes) -> None:
        self._road = road
        self._lanes = lanes
        self._spans: dict[tuple[str, ...], dict[int, tuple[float, float]]] = {}
        self._begins: dict[tuple[int, int, int, float], float] = {}

    def compare(self, moment: Moment) -> Compared:
        """What SUMO and we say of one moment."""
        lanes, foes = self._lanes, moment.foes
        meetings = _meetings(lanes, foes, len(moment.line))
        listed = _listed(lanes, foes, meetings, len(moment.line))
        same_lane = lanes.source[meetings.way[:, 0]] == lanes.source[meetings.way[:, 1]]
        no_route = (moment.line[meetings.vehicle] < 0).any(axis=1)
        ours = self._ours(moment, meetings, ~same_lane & ~no_route)
        outcome = self._outcome(moment, meetings, listed, ours)
        outcome[no_route & (outcome == Outcome.ONLY_SUMO)] = Outcome.NO_ROUTE
        outcome[same_lane] = Outcome.SAME_LANE_BEFORE
        asked, place_m, entry_m, waiting = self._distances(
            moment, meetings, listed, ours, outcome == Outcome.BOTH
        )
        return Compared(
            vehicle=np.concatenate((meetings.vehicle, ours.stray)),
            way=np.concatenate((meetings.way, np.full(ours.stray.shape, -1))),
            outcome=np.concatenate((outcome, ours.stray_outcome)),
            distance_vehicle=asked,
            place_error_m=place_m,
            entry_error_m=entry_m,
            waiting_places=waiting,
        )

    def _outcome(
        self, moment: Moment, meetings: _Meetings, listed: _Listed, ours: _Ours
    ) -> IntArray:
        """Outcome [M] of meetings whose vehicles have routes and come from different lanes."""
        lanes, count = self._lanes, len(meetings.key)
        in_sumo = _any_of(listed.meeting[listed.current], count)
        sumo_ahead = _any_of(listed.meeting[listed.current & listed.ahead], count)
        in_ours: BoolArray = ours.here.any(axis=1)
        ours_ahead: BoolArray = (ours.here & ours.ahead).any(axis=1)
        outcome = np.full(count, int(Outcome.NEITHER))
        outcome[_any_of(listed.meeting, count)] = Outcome.OUTDATED
        outcome[in_sumo | in_ours] = Outcome.PASSED
        outcome[sumo_ahead & in_ours] = Outcome.BOTH
        missed = np.flatnonzero(sumo_ahead & ~in_ours)
        outcome[missed] = [self._only_sumo(moment, meetings, row) for row in missed.tolist()]
        alone = ours_ahead & ~in_sumo
        outcome[alone] = Outcome.ONLY_OURS
        outcome[alone & ~(ours.here & ours.ahead & ~ours.head_on).any(axis=1)] = Outcome.HEAD_ON
        outcome[alone & lanes.cross_right_of_way(meetings.way)] = Outcome.RIGHT_OF_WAY_ONLY
        foes, listable = lanes.are_foes(meetings.way), _listable(lanes, meetings)
        owed = (listable & _announced(lanes, moment.foes, meetings)[:, ::-1]).any(axis=1)
        outcome[alone & foes & ~owed] = Outcome.UNANNOUNCED
        outcome[alone & foes & ~listable.any(axis=1)] = Outcome.CUT_SHORT
        return outcome

    def _only_sumo(self, moment: Moment, meetings: _Meetings, row: int) -> Outcome:
        junction = int(meetings.junction[row])
        for vehicle, way in zip(meetings.vehicle[row], meetings.way[row], strict=True):
            line = int(moment.line[vehicle])
            if line >= 0 and not self._drives(line, int(way), junction):
                return Outcome.ONLY_SUMO_OTHER_LANE
        return Outcome.ONLY_SUMO

    def _drives(self, line: int, way: int, junction: int) -> bool:
        rows = [self._lanes.row[name] for name in self._road.lines[line].route]
        return any(self._lanes.way[k] == way for k in rows if self._lanes.junction[k] == junction)

    def _ours(self, moment: Moment, meetings: _Meetings, eligible: BoolArray) -> _Ours:
        """Our conflicts of all pairs nearby, each given to the junction that it belongs to."""
        count = len(moment.line)
        near = KDTree(moment.xy_m).query_pairs(3.0 * REACH_M, output_type="ndarray")
        near.sort(axis=1)
        own_pair = meetings.vehicle[:, 0] * count + meetings.vehicle[:, 1]
        pair = np.unique(np.concatenate((own_pair, near[:, 0] * count + near[:, 1])))
        one, other = np.divmod(pair, max(count, 1))
        on = (moment.line[one] >= 0) & (moment.line[other] >= 0)
        table = np.full((len(pair), MAX_CONFLICTS, 7), np.inf)
        table[on] = self._road.conflict_table(moment.line[one[on]], moment.line[other[on]])
        entry, leave = table[:, :, [0, 3]], table[:, :, [2, 5]]
        merge = table[:, :, 6:7] == ConflictType.MERGE
        end = np.where(merge, entry, leave)  # what lies behind the begin of a merge is no place
        front = np.stack((moment.front_s_m[one], moment.front_s_m[other]), axis=1)[:, None, :]
        there = np.isfinite(entry).all(axis=2)
        ahead = there & (end >= front).all(axis=2)
        row = np.searchsorted(pair, own_pair)
        gap_m = np.where(there[row], self._gap_m(moment, meetings, entry[row], end[row]), np.inf)
        gap_m[~eligible] = np.inf
        nearest_m = np.full(there.shape, np.inf)
        np.minimum.at(nearest_m, row, gap_m)
        here = (gap_m <= NEAR_JUNCTION_M) & (gap_m <= nearest_m[row])
        # Nearer than the reach by what a conflict may lie before its junction.
        close = (entry - front <= REACH_M - NEAR_JUNCTION_M).all(axis=2)
        close &= there & (entry > front).all(axis=2)
        unclaimed = close & ~(nearest_m <= NEAR_JUNCTION_M)
        stray = unclaimed.any(axis=1)
        head_on = self._run_against(moment.line[one], moment.line[other], table)
        against = (~unclaimed | head_on).all(axis=1)
        return _Ours(
            table=table[row],
            here=here,
            ahead=ahead[row],
            head_on=head_on[row],
            stray=np.stack((one, other), axis=1)[stray],
            stray_outcome=np.where(against, Outcome.HEAD_ON, Outcome.ONLY_OURS_NO_JUNCTION)[stray],
        )

    def _run_against(self, one: IntArray, other: IntArray, table: FloatArray) -> BoolArray:
        """Whether lines [P] have opposite directions at their conflicts [P, Q, 7]."""
        pair, which = np.nonzero(np.isfinite(table[:, :, 0]))
        at = table[pair, which]
        turned = self._road.line_yaw_rad(one[pair], at[:, 1])
        turned -= self._road.line_yaw_rad(other[pair], at[:, 4])
        against = np.zeros(table.shape[:2], dtype=np.bool_)
        against[pair, which] = np.abs(wrap_angle(turned)) > OPPOSITE_RAD
        return against

    def _gap_m(
        self, moment: Moment, meetings: _Meetings, entry: FloatArray, end: FloatArray
    ) -> FloatArray:
        """How far conflicts [M, Q, 2] are from their meeting's junction [M, Q], on either line."""
        spans = np.array(
            [
                [self._span(int(moment.line[vehicle]), junction) for vehicle in pair]
                for pair, junction in zip(
                    meetings.vehicle.tolist(), meetings.junction.tolist(), strict=True
                )
            ],
            dtype=np.float64,
        ).reshape(-1, 1, 2, 2)
        with np.errstate(invalid="ignore"):
            gap = np.maximum(np.maximum(spans[..., 0] - end, entry - spans[..., 1]), 0.0)
        return np.where(np.isnan(gap), np.inf, gap).max(axis=2)

    def _span(self, line: int, junction: int) -> tuple[float, float]:
        if line < 0:
            return NOWHERE
        reference = self._road.lines[line]
        spans = self._spans.get(reference.route)
        if spans is None:
            spans = self._spans[reference.route] = junction_spans(self._lanes, reference)
        return spans.get(junction, NOWHERE)

    def _distances(
        self,
        moment: Moment,
        meetings: _Meetings,
        listed: _Listed,
        ours: _Ours,
        found: BoolArray,
    ) -> tuple[IntArray, FloatArray, FloatArray, int]:
        """Vehicles [D], errors of place and entry [D], and how many waiting places were left out.

        Where SUMO's area is a crossing, the place is its middle and our point; where it is a merge,
        the place is where the lines come as near as SUMO's rule wants. Behind a place to wait
        inside the junction, SUMO gives the distance to that.
        """
        lanes = self._lanes
        asked: list[int] = []
        place_m: list[float] = []
        entry_m: list[float] = []
        waiting = 0
        for k in np.flatnonzero(listed.current & listed.ahead & found[listed.meeting]).tolist():
            meeting, side = int(listed.meeting[k]), int(listed.side[k])
            own, foe = listed.lane[k].tolist()
            merge = lanes.target[own] >= 0 and lanes.target[own] == lanes.target[foe]
            if not merge and lanes.way[own] != own:
                waiting += 1
                continue
            vehicle = int(meetings.vehicle[meeting, side])
            pair = meetings.vehicle[meeting, [side, 1 - side]]
            front = float(moment.front_s_m[vehicle])
            enter, middle = float(listed.enter_m[k]), float(listed.enter_m[k] + listed.leave_m[k])
            places: list[float] = []
            entries: list[float] = []
            for row in ours.table[meeting, ours.here[meeting]]:
                mine = row[3 * side : 3 * side + 3]
                other = row[3 * (1 - side) : 3 * (1 - side) + 3]
                if merge:
                    begin = self._begin_m(moment.line[pair], (own, foe), mine[0], other[0])
                    places.append(begin - front - enter)
                else:
                    places.append(float(mine[1]) - front - 0.5 * middle)
                entries.append(float(mine[0]) - front - enter)
            asked.append(vehicle)
            place_m.append(min(places, key=abs))
            entry_m.append(min(entries, key=abs))
        return np.array(asked, dtype=np.int64), np.array(place_m), np.array(entry_m), waiting

    def _begin_m(
        self, line: IntArray, lane: tuple[int, int], own_s_m: float, other_s_m: float
    ) -> float:
        """Where on the first of two lines SUMO's rule lets the area of their merge begin."""
        one, other = int(line[0]), int(line[1])
        key = (one, other, lane[0], own_s_m)
        if key not in self._begins:
            lanes = self._lanes.lanes
            half_m = 0.5 * (lanes[lane[0]].width_m + lanes[lane[1]].width_m)
            reference = self._road.lines[one]
            inside = reference.route.index(lanes[lane[0]].id)
            self._begins[key] = max(
                merge_begin_m(
                    reference.xy_m,
                    self._road.lines[other].xy_m,
                    own_s_m,
                    other_s_m,
                    min(AREA_MERGE_M, half_m),
                ),
                float(reference.lane_start_s_m[inside]),
            )
        return self._begins[key]


def merge_begin_m(
    one_xy_m: FloatArray, other_xy_m: FloatArray, one_s_m: float, other_s_m: float, width_m: float
) -> float:
    """The arc length from which on a line [P, 2] is within `width_m` of another it merges into.

    Both have a vertex every `LINE_STEP_M`; they are near each other at `one_s_m`, `other_s_m`.
    """
    around = [
        xy[max(int((s_m - 25.0) / LINE_STEP_M), 0) : int((s_m + 25.0) / LINE_STEP_M)]
        for xy, s_m in ((one_xy_m, one_s_m), (other_xy_m, other_s_m))
    ]
    start, end = around[1][:-1], around[1][1:]
    along = end - start
    offset = around[0][:, None, :] - start[None]
    t = np.clip((offset * along).sum(axis=2) / (along * along).sum(axis=1), 0.0, 1.0)
    apart_m = np.linalg.norm(offset - t[:, :, None] * along, axis=2).min(axis=1)
    together = int(apart_m.argmin())
    wide = np.flatnonzero(apart_m[: together + 1] >= width_m)
    first = max(int((one_s_m - 25.0) / LINE_STEP_M), 0)
    if not len(wide):
        return first * LINE_STEP_M
    last = int(wide[-1])
    part = (apart_m[last] - width_m) / max(apart_m[last] - apart_m[last + 1], 1e-9)
    return (first + last + float(part)) * LINE_STEP_M


def _meetings(lanes: JunctionLanes, foes: JunctionFoes, count: int) -> _Meetings:
    """Every two vehicles that have the same junction ahead, or are in it."""
    near = (foes.approach_m <= REACH_M) & (foes.approach_lane >= 0)
    vehicle, lane = foes.approach_vehicle[near], foes.approach_lane[near]
    junction = lanes.junction[lane]
    # Who comes through a junction twice counts with the first time: they are in order of distance.
    _, first = np.unique(vehicle * len(lanes.lanes) + junction, return_index=True)
    vehicle, way, junction = vehicle[first], lanes.way[lane[first]], junction[first]
    order = np.lexsort((vehicle, junction))
    vehicle, way, junction = vehicle[order], way[order], junction[order]
    starts = np.flatnonzero(np.concatenate(([True], junction[1:] != junction[:-1])))
    groups = np.split(np.arange(len(vehicle)), starts[1:]) if len(vehicle) else []
    corners = [np.triu_indices(len(group), 1) for group in groups]
    one = _joined([group[a] for group, (a, _) in zip(groups, corners, strict=True)])
    other = _joined([group[b] for group, (_, b) in zip(groups, corners, strict=True)])
    key = _key(lanes, count, vehicle[one], vehicle[other], junction[one])
    order = np.argsort(key)
    one, other = one[order], other[order]
    return _Meetings(
        key=key[order],
        vehicle=np.stack((vehicle[one], vehicle[other]), axis=1),
        junction=junction[one],
        way=np.stack((way[one], way[other]), axis=1),
    )


def _listed(lanes: JunctionLanes, foes: JunctionFoes, meetings: _Meetings, count: int) -> _Listed:
    """The rows of SUMO's list that are of a meeting."""
    low, high = foes.vehicle.min(axis=1), foes.vehicle.max(axis=1)
    known = (foes.lane >= 0).all(axis=1)
    junction = np.where(known, lanes.junction[foes.lane[:, 0]], -1)
    key = _key(lanes, count, low, high, junction)
    at = np.minimum(np.searchsorted(meetings.key, key), max(len(meetings.key) - 1, 0))
    of_meeting = known & np.isin(key, meetings.key)
    rows = np.flatnonzero(of_meeting)
    meeting, lane = at[rows], foes.lane[rows]
    side = (foes.vehicle[rows, 0] > foes.vehicle[rows, 1]).astype(np.int64)
    way = np.take_along_axis(meetings.way[meeting], np.stack((side, 1 - side), axis=1), axis=1)
    return _Listed(
        meeting=meeting,
        side=side,
        lane=lane,
        enter_m=foes.enter_m[rows, 0],
        leave_m=foes.leave_m[rows, 0],
        ahead=(foes.leave_m[rows] > 0.0).all(axis=1),
        current=(lanes.way[lane] == way).all(axis=1),
    )


def _listable(lanes: JunctionLanes, meetings: _Meetings) -> BoolArray:
    """Whether SUMO's list of a meeting's first, second vehicle can hold the other one [M, 2]."""
    way = meetings.way
    return np.stack((lanes.can_list(way), lanes.can_list(way[:, ::-1])), axis=1)


def _announced(lanes: JunctionLanes, foes: JunctionFoes, meetings: _Meetings) -> BoolArray:
    """Whether each vehicle of a meeting is a foe of anybody at that junction [M, 2]."""
    known = foes.lane[:, 1] >= 0
    size = len(lanes.lanes)
    seen = foes.vehicle[known, 1] * size + lanes.junction[foes.lane[known, 1]]
    return np.isin(meetings.vehicle * size + meetings.junction[:, None], seen)


def _any_of(meeting: IntArray, count: int) -> BoolArray:
    """Which of `count` meetings are among those given."""
    return np.bincount(meeting, minlength=count) > 0


def _key(
    lanes: JunctionLanes, count: int, one: IntArray, other: IntArray, junction: IntArray
) -> IntArray:
    return (one * count + other) * len(lanes.lanes) + junction


def _joined(parts: list[IntArray]) -> IntArray:
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)
