"""What drivers were seen to do here so far: which connections they take, and whether they signal.

A prior for the choice of lines, learned from the past of the same traffic without any label. It
begins with even shares, but for turning around, which is rare everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Lane
from hatn_sim.road import Road

RARE: Final = 0.05
"""A turnaround counts as this many vehicles before anybody was seen, any other connection as 1."""
TURNAROUND_RAD: Final = math.radians(150.0)
FLOOR: Final = 0.02
"""No share is taken to be smaller, however many vehicles did otherwise."""
SIGNALLED: Final = 3.0
TURNED: Final = 4.0
"""Before anybody was seen: three of four drivers who turn signal it."""


@dataclass(frozen=True, eq=False)
class Habits:
    """Counts by number of lane, [lanes] each, and of frames of turning vehicles."""

    taken: FloatArray  # vehicles seen on a connection
    entered: FloatArray  # vehicles seen to leave a lane into any connection
    source: IntArray  # the lane before a connection, itself where there is none
    signalled: float
    turned: float


def fresh_habits(road: Road) -> Habits:
    """Nobody seen yet. Worked out once for a road."""
    if "habits" not in road.shared:
        number = {name: row for row, name in enumerate(road.lanes)}
        source = np.arange(len(number))
        taken, entered = np.zeros(len(number)), np.zeros(len(number))
        taken[[lane.is_connection for lane in road.lanes.values()]] = 1.0
        for lane in road.lanes.values():
            for name in lane.successors:
                if name in number and road.lanes[name].is_connection:
                    source[number[name]] = number[_last_choice(road, lane.id)]
                    taken[number[name]] = RARE if _turns_around(road, lane.id, name) else 1.0
        np.add.at(entered, source, taken)
        entered = np.maximum(entered, RARE)  # of a lane without connections nobody will ask
        road.shared["habits"] = Habits(taken, entered, source, SIGNALLED, TURNED)
    habits: Habits = road.shared["habits"]
    return habits


def _last_choice(road: Road, lane_id: str) -> str:
    """The lane behind the last junction or merge before a lane: from there on ways may have parted.

    Who keeps to the left long before a junction has chosen already, and counts all the same.
    """
    seen = {lane_id}
    while not road.lanes[lane_id].is_connection:
        before = road.lane_graph.predecessors[lane_id]
        if len(before) != 1 or before[0] in seen or road.lanes[before[0]].is_connection:
            break
        lane_id = before[0]
        seen.add(lane_id)
    return lane_id


def _turns_around(road: Road, lane_id: str, connection: str) -> bool:
    """Whether a connection leads back against the direction of the lane before it."""
    lanes = road.lanes
    if not lanes[connection].turn:
        return False
    name, seen = connection, {lane_id}
    while lanes[name].is_connection and name not in seen:
        seen.add(name)
        name = next((one for one in lanes[name].successors if one in lanes), name)
    before, after = _steps_m(lanes[lane_id]), _steps_m(lanes[name])
    if not before or not after:
        return False  # a lane of no length has no direction
    (dx, dy), (ex, ey) = before[-1], after[0]
    return abs(math.atan2(dx * ey - dy * ex, dx * ex + dy * ey)) > TURNAROUND_RAD


def _steps_m(lane: Lane) -> list[list[float]]:
    """From point to point of a lane, without those of no length."""
    step_m = np.diff(lane.xy_m, axis=0)
    return step_m[(step_m != 0.0).any(axis=1)].tolist()


def habits_joined(every: Sequence[Habits]) -> Habits:
    """Those of several worlds on one road, for `share_nats` alone: the lanes one after another."""
    source, count = every[0].source, len(every[0].source)
    return Habits(
        taken=np.concatenate([one.taken for one in every]),
        entered=np.concatenate([one.entered for one in every]),
        source=np.concatenate([source + k * count for k in range(len(every))]),
        signalled=math.nan,
        turned=math.nan,
    )


def share_nats(habits: Habits, connection: IntArray) -> FloatArray:
    """-log of the share of vehicles [...] that take a connection [...] from the lane before it."""
    share = habits.taken[connection] / habits.entered[habits.source[connection]]
    return -np.log(np.maximum(share, FLOOR))


def silent_nats(habits: Habits) -> float:
    """-log of the share of turning vehicles that do not signal."""
    return -math.log(max(1.0 - habits.signalled / habits.turned, FLOOR))


def learn(habits: Habits, left: IntArray, turns: IntArray, blinker: IntArray) -> Habits:
    """The habits after a frame.

    `left` [K] are the connections that vehicles have come to the end of; `turns` [R] the turns of
    the connections that vehicles are on, where they are turns, and `blinker` [R] their blinkers.
    """
    signals: BoolArray = turns == blinker
    learned = replace(
        habits,
        signalled=habits.signalled + float(signals.sum()),
        turned=habits.turned + float(len(turns)),
    )
    if not len(left):
        return learned
    taken, entered = habits.taken.copy(), habits.entered.copy()
    np.add.at(taken, left, 1.0)
    np.add.at(entered, habits.source[left], 1.0)
    return replace(learned, taken=taken, entered=entered)
