"""Which vehicles meet at a junction, and which rows of SUMO's list are of their meetings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray
from hatn_sim.score.oracle_lanes import JunctionLanes
from hatn_sim.simulators.sumo_messages import JunctionFoes

REACH_M: Final = 60.0
"""A junction this far ahead of both front bumpers, or nearer, is one they meet at."""


@dataclass(frozen=True, eq=False)
class Meetings:
    """M times two vehicles and a junction that both have ahead, or are in."""

    key: IntArray  # [M] sorted
    vehicle: IntArray  # [M, 2] the smaller index first
    junction: IntArray  # [M]
    way: IntArray  # [M, 2]


@dataclass(frozen=True, eq=False)
class Listed:
    """SUMO's list, K rows of it that are of a meeting."""

    meeting: IntArray  # [K]
    side: IntArray  # [K] which of the meeting's vehicles was asked
    lane: IntArray  # [K, 2] the asked one's, its foe's
    enter_m: FloatArray  # [K] of the asked one: a foe's distance is of the step before
    leave_m: FloatArray  # [K]
    ahead: BoolArray  # [K] neither has left the area
    current: BoolArray  # [K] both are still on the ways that the list names


def meetings_of(lanes: JunctionLanes, foes: JunctionFoes, count: int) -> Meetings:
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
    return Meetings(
        key=key[order],
        vehicle=np.stack((vehicle[one], vehicle[other]), axis=1),
        junction=junction[one],
        way=np.stack((way[one], way[other]), axis=1),
    )


def rows_of(lanes: JunctionLanes, foes: JunctionFoes, meetings: Meetings, count: int) -> Listed:
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
    return Listed(
        meeting=meeting,
        side=side,
        lane=lane,
        enter_m=foes.enter_m[rows, 0],
        leave_m=foes.leave_m[rows, 0],
        ahead=np.asarray((foes.leave_m[rows] > 0.0).all(axis=1)),
        current=np.asarray((lanes.way[lane] == way).all(axis=1)),
    )


def listable(lanes: JunctionLanes, meetings: Meetings) -> BoolArray:
    """Whether SUMO's list of a meeting's first, second vehicle can hold the other one [M, 2]."""
    way = meetings.way
    return np.stack((lanes.can_list(way), lanes.can_list(way[:, ::-1])), axis=1)


def announced(lanes: JunctionLanes, foes: JunctionFoes, meetings: Meetings) -> BoolArray:
    """Whether each vehicle of a meeting is a foe of anybody at that junction [M, 2]."""
    known = foes.lane[:, 1] >= 0
    size = len(lanes.lanes)
    seen = foes.vehicle[known, 1] * size + lanes.junction[foes.lane[known, 1]]
    return np.isin(meetings.vehicle * size + meetings.junction[:, None], seen)


def _key(
    lanes: JunctionLanes, count: int, one: IntArray, other: IntArray, junction: IntArray
) -> IntArray:
    return (one * count + other) * len(lanes.lanes) + junction


def _joined(parts: list[IntArray]) -> IntArray:
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)
