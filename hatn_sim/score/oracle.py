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

from hatn_sim.conflict_table import PairConflicts
from hatn_sim.conflicts import OPPOSITE_RAD
from hatn_sim.datatypes import BoolArray, ConflictType, FloatArray, IntArray
from hatn_sim.geometry import wrap_angle
from hatn_sim.road import Road
from hatn_sim.score.oracle_distances import DistanceErrors, Distances
from hatn_sim.score.oracle_lanes import NOWHERE, JunctionLanes, junction_spans
from hatn_sim.score.oracle_meetings import (
    REACH_M,
    Listed,
    Meetings,
    announced,
    listable,
    meetings_of,
    rows_of,
)
from hatn_sim.simulators.sumo_messages import JunctionFoes

ASK_M: Final = 200.0
"""How far SUMO is asked to look: to a junction `REACH_M` ahead, and through it."""
NEAR_JUNCTION_M: Final = 10.0
"""A conflict belongs to the nearest junction of both lines, at most this far from its lanes."""


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
    NO_LOGIC = 14
    NO_LIST = 15


@dataclass(frozen=True, eq=False)
class Moment:
    """Where N vehicles are on the lines of their routes, and SUMO's answer."""

    xy_m: FloatArray  # [N, 2]
    line: IntArray  # [N] -1: on no line
    front_s_m: FloatArray  # [N] front bumper, along the line
    foes: JunctionFoes


@dataclass(frozen=True, eq=False)
class Compared:
    """M meetings, and the distances of those that both have."""

    vehicle: IntArray  # [M, 2]
    way: IntArray  # [M, 2] first lanes of the ways through the junction, -1: at no junction
    outcome: IntArray  # [M] Outcome
    distances: DistanceErrors


@dataclass(frozen=True, eq=False)
class _Ours:
    table: FloatArray  # [M, Q, 7] entry, point, exit on either line, ConflictType; padded with inf
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
        self._distances = Distances(road, lanes)

    def compare(self, moment: Moment) -> Compared:
        """What SUMO and we say of one moment."""
        lanes, foes = self._lanes, moment.foes
        meetings = meetings_of(lanes, foes, len(moment.line))
        listed = rows_of(lanes, foes, meetings, len(moment.line))
        same_lane = lanes.source[meetings.way[:, 0]] == lanes.source[meetings.way[:, 1]]
        no_route = (moment.line[meetings.vehicle] < 0).any(axis=1)
        ours = self._ours(moment, meetings, ~same_lane & ~no_route)
        outcome = self._outcome(moment, meetings, listed, ours)
        outcome[no_route & (outcome == Outcome.ONLY_SUMO)] = Outcome.NO_ROUTE
        mute = lanes.mute[meetings.way[:, 0]] & (outcome == Outcome.ONLY_OURS)
        outcome[mute] = Outcome.NO_LOGIC
        outcome[same_lane] = Outcome.SAME_LANE_BEFORE
        distances = self._distances.errors(
            moment.line,
            moment.front_s_m,
            meetings,
            listed,
            (ours.table, ours.here),
            outcome == Outcome.BOTH,
        )
        return Compared(
            vehicle=np.concatenate((meetings.vehicle, ours.stray)),
            way=np.concatenate((meetings.way, np.full(ours.stray.shape, -1))),
            outcome=np.concatenate((outcome, ours.stray_outcome)),
            distances=distances,
        )

    def _outcome(self, moment: Moment, meetings: Meetings, listed: Listed, ours: _Ours) -> IntArray:
        """Outcome [M] of meetings whose vehicles have routes and come from different lanes."""
        lanes, count = self._lanes, len(meetings.key)
        in_sumo = _any_of(listed.meeting[listed.current], count)
        sumo_ahead = _any_of(listed.meeting[listed.current & listed.ahead], count)
        in_ours = np.asarray(ours.here.any(axis=1))
        ours_ahead = np.asarray((ours.here & ours.ahead).any(axis=1))
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
        foes, can = lanes.are_foes(meetings.way), listable(lanes, meetings)
        owed = can & announced(lanes, moment.foes, meetings)[:, ::-1]
        lists = np.isin(meetings.vehicle, moment.foes.vehicle[:, 0])
        outcome[alone & foes & ~(owed & lists).any(axis=1)] = Outcome.NO_LIST
        outcome[alone & foes & ~owed.any(axis=1)] = Outcome.UNANNOUNCED
        outcome[alone & foes & ~can.any(axis=1)] = Outcome.CUT_SHORT
        return outcome

    def _only_sumo(self, moment: Moment, meetings: Meetings, row: int) -> Outcome:
        junction = int(meetings.junction[row])
        for vehicle, way in zip(meetings.vehicle[row], meetings.way[row], strict=True):
            line = int(moment.line[vehicle])
            if line >= 0 and not self._drives(line, int(way), junction):
                return Outcome.ONLY_SUMO_OTHER_LANE
        return Outcome.ONLY_SUMO

    def _drives(self, line: int, way: int, junction: int) -> bool:
        rows = [self._lanes.row[name] for name in self._road.lines[line].route]
        return any(self._lanes.way[k] == way for k in rows if self._lanes.junction[k] == junction)

    def _ours(self, moment: Moment, meetings: Meetings, eligible: BoolArray) -> _Ours:
        """Our conflicts of all pairs nearby, each given to the junction that it belongs to."""
        count = len(moment.line)
        near = KDTree(moment.xy_m).query_pairs(2.0 * REACH_M, output_type="ndarray")
        near.sort(axis=1)
        own_pair = meetings.vehicle[:, 0] * count + meetings.vehicle[:, 1]
        pair = np.unique(np.concatenate((own_pair, near[:, 0] * count + near[:, 1])))
        one, other = np.divmod(pair, max(count, 1))
        on = (moment.line[one] >= 0) & (moment.line[other] >= 0)
        found = self._road.conflict_table.of_pairs(moment.line[one[on]], moment.line[other[on]])
        table = _padded(found, np.flatnonzero(on), len(pair))
        entry, leave = table[:, :, [0, 3]], table[:, :, [2, 5]]
        merge = table[:, :, 6:7] == ConflictType.MERGE
        end = np.where(merge, entry, leave)  # what lies behind the begin of a merge is no place
        front = np.stack((moment.front_s_m[one], moment.front_s_m[other]), axis=1)[:, None, :]
        there = np.asarray(np.isfinite(entry).all(axis=2))
        ahead = np.asarray(there & (end >= front).all(axis=2))
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
        stray = np.asarray(unclaimed.any(axis=1))
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
        self, moment: Moment, meetings: Meetings, entry: FloatArray, end: FloatArray
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


def _any_of(meeting: IntArray, count: int) -> BoolArray:
    """Which of `count` meetings are among those given."""
    return np.bincount(meeting, minlength=count) > 0


def _padded(found: PairConflicts, row: IntArray, rows: int) -> FloatArray:
    """Conflicts [rows, Q, 7] of pairs, pair k in row[k], each along its first line."""
    order = np.lexsort((found.point_s_m[:, 0], found.pair))
    pair = found.pair[order]
    begins = np.flatnonzero(np.diff(pair, prepend=-1))
    nth = np.arange(len(pair)) - np.repeat(begins, np.diff(begins, append=len(pair)))
    table = np.full((rows, int(nth.max(initial=0)) + 1, 7), np.inf)
    sides = (found.entry_s_m, found.point_s_m, found.exit_s_m)
    columns = [side[:, k] for k in (0, 1) for side in sides]
    table[row[pair], nth] = np.column_stack((*columns, found.type))[order]
    return table
