"""What a driver who is warned had better do: brake for the other, or not stop in his way.

He brakes where that is comfortable; else he goes on if he is out before the other comes; else he
brakes as hard as it takes. Who is in the place already, or would get there first and cannot stay
out by braking as hard as a car can, goes on. All is reckoned from when he has reacted; until then
he drives as predicted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.assist.alert import Warned
from hatn_sim.assist.moment import Moment
from hatn_sim.assist.outlook import LEAVE_MARGIN_S, NOSE_M, approaches, look_ahead, travel_at
from hatn_sim.assist.pairs import FOLLOW, MERGE, Pairs
from hatn_sim.assist.profile import (
    COMFORT_ACCELERATION_MPS2,
    COMFORT_BRAKING_MPS2,
    HARD_BRAKING_MPS2,
    LEADER,
    SHORT_M,
    SLOWING_MPS2,
)
from hatn_sim.assist.risk import (
    STANDING_MPS,
    Times,
    required_deceleration_mps2,
    times_predicted,
    travelled_m,
)
from hatn_sim.assist.signs import acceleration_mps2, kept_travel_m
from hatn_sim.assist.words import names
from hatn_sim.datatypes import BoolArray, FloatArray, IntArray

BRAKE, CLEAR = "brake", "clear"
REACTION_S: Final = 1.0
"""A driver who is warned acts after so long (METHOD section 7)."""
HOLDS_S: Final = 6.0
"""Nobody is told to wait longer than a second of reaction and five of the manoeuvre."""
EDGE_M: Final = 0.1
"""Who stands this near to a place stays out of it."""
OUT_BEFORE_S: Final = 0.5
"""Who goes on is to be out so long before the other comes in."""
_IS_SECOND: Final = np.array([False, True])


@dataclass(frozen=True, eq=False)
class Evasions:
    """What either of pairs [P, 2] had better do, if it is warned and the other is not."""

    brakes: BoolArray
    needed_mps2: FloatArray  # evenly, after reacting; infinite where braking does not help
    room_m: FloatArray  # from the front bumper now to where it has to stay out of
    open_s: FloatArray  # from now until the other has left


def evasions(moment: Moment, pairs: Pairs) -> Evasions:
    """Of some pairs of the moment."""
    way_m = travelled_m(moment.scene, moment.prediction)
    own, its = _times(moment, pairs, way_m)
    follows = (pairs.type == FOLLOW)[:, None]
    is_follower = follows & _IS_SECOND
    room_m = np.where(follows, _room_behind_m(pairs, way_m), pairs.room_m)
    # Who is nearer than that already stays where he is.
    room_m = room_m - np.clip(room_m - EDGE_M, 0.0, 0.5 * SHORT_M)
    # Who merges behind another has to keep a distance.
    margin_s = np.where(pairs.type == MERGE, LEADER.time_s, LEAVE_MARGIN_S)[:, None]
    open_s = np.where(follows, HOLDS_S, np.minimum(its.leave_s + margin_s, HOLDS_S))
    gone_m, then_mps = (of[pairs.index, 0] for of in travel_at(way_m, np.array([REACTION_S])))
    left_m, left_s = room_m + NOSE_M - gone_m, open_s - REACTION_S
    needed = required_deceleration_mps2(left_m, then_mps, left_s)
    needed = np.where((left_m > 0.0) | is_follower, needed, np.inf)
    needed[left_s <= 0.0] = 0.0
    clear_m = np.maximum(pairs.clear_m - gone_m, 0.0)
    fastest_mps = np.sqrt(then_mps**2 + 2.0 * COMFORT_ACCELERATION_MPS2 * clear_m)
    out_s = REACTION_S + (fastest_mps - then_mps) / COMFORT_ACCELERATION_MPS2
    # Who merges before a faster one has to leave it time to brake in comfort (`pass_margins_s`).
    other_mps = moment.scene.speed_mps[pairs.index[:, ::-1]]
    slowing_s = np.maximum(other_mps - fastest_mps, 0.0) ** 2 / (2.0 * COMFORT_BRAKING_MPS2)
    slowing_s *= (pairs.type == MERGE)[:, None] / np.maximum(other_mps, 1.0)
    is_out = ~follows & (out_s + OUT_BEFORE_S + slowing_s <= its.enter_s)
    # Who comes second has nothing to clear, nor has a follower; a leader's braking helps nobody.
    can = (needed <= HARD_BRAKING_MPS2) | ((its.enter_s < own.enter_s) & (pairs.room_m > 0.0))
    can = np.where(follows, is_follower, can)
    brakes = (needed <= COMFORT_BRAKING_MPS2) | (~is_out & can)
    return Evasions(brakes, needed, room_m, open_s)


def _times(moment: Moment, pairs: Pairs, way_m: FloatArray) -> tuple[Times, Times]:
    """When either is where they meet, and when the other is [P, 2]: as predicted or, if it is to
    wait, as if it went on as now."""
    kept_m = kept_travel_m(moment.scene.speed_mps, acceleration_mps2(moment))
    # Of two futures, [2, P, 2].
    ways = times_predicted(pairs, np.stack((way_m, kept_m), axis=1))
    comes = ways.enter_s[0] < HOLDS_S
    enter_s, leave_s = (np.where(comes, *times) for times in (ways.enter_s, ways.leave_s))
    return Times(enter_s, leave_s), Times(enter_s[:, ::-1], leave_s[:, ::-1])


def _room_behind_m(pairs: Pairs, way_m: FloatArray) -> FloatArray:
    """To where the first, whom the second follows, will be, if it slows down; none for itself."""
    far_m, _ = travel_at(way_m, np.array([HOLDS_S]), SLOWING_MPS2)
    behind_m = pairs.room_m[:, 1] + far_m[pairs.index[:, 0], 0]
    return np.stack((np.full(len(behind_m), -np.inf), behind_m), axis=1)


def warn(moment: Moment, first: int, second: int, either: bool) -> Warned:
    """Whom of two to warn of the other, and what it had better do.

    `first`, or `second` too where `either` is, if it needs less braking to give way: where both are
    warned, it is up to him.
    """
    rows = _rows(moment.pairs, first, second)
    if not len(rows):
        return Warned(first, second)
    pairs = moment.pairs.of(rows)
    found = evasions(moment, pairs)
    # Of two who meet and follow each other: what asks for more.
    side = (pairs.index[:, 1] == first).astype(np.int64)
    each = np.arange(len(rows))
    of_first, of_second = found.needed_mps2[each, side], found.needed_mps2[each, 1 - side]
    if either and of_second.max() < of_first.max():
        first, second, side, of_first = second, first, 1 - side, of_second
    place = int(of_first.argmax()), int(side[of_first.argmax()])
    (who,) = names(moment.scene, np.array([first]), np.array([second]))
    if not found.brakes[place]:
        return Warned(first, second, CLEAR, text=f"Go on, do not stop in the way of {who}")
    open_s = max(float(found.open_s[place]), _all_gone_s(moment, first, second))
    hard = " hard" if found.needed_mps2[place] > COMFORT_BRAKING_MPS2 else ""
    stands = moment.scene.speed_mps[first] < STANDING_MPS
    does = "Wait" if stands else f"Brake{hard}"
    follows = pairs.type[place[0]] == FOLLOW
    return Warned(
        first,
        second,
        BRAKE,
        room_m=float(found.room_m[place]),
        open_s=min(open_s, HOLDS_S),
        text=f"{does}: " + (f"keep behind {who}" if follows else f"let {who} go first"),
    )


def _rows(pairs: Pairs, one: int, other: int) -> IntArray:
    both = (pairs.index == (one, other)).all(axis=1) | (pairs.index == (other, one)).all(axis=1)
    return np.flatnonzero(both)


def _all_gone_s(moment: Moment, ego: int, other: int) -> float:
    """When the other and whoever else the ego would meet if it went then have left; 0: unknown."""
    graphs = moment.prediction.graphs
    assert graphs is not None
    row = np.flatnonzero(graphs.ego == ego)
    if not len(row):
        return 0.0
    node = np.flatnonzero(graphs.focus_mask[row[0]] & (graphs.rear[row[0]] == other))
    if not len(node):
        return 0.0
    outlook = look_ahead(moment.road, moment.scene, moment.prediction, moment.pairs)
    stopped = np.zeros(1, dtype=np.bool_)
    _, open_s, _ = approaches(outlook, row, np.zeros(1, dtype=np.int64), node, stopped)
    return float(open_s[0])
