"""What may come of a moment: how early others may be where they meet the ego, and what the ego
has to keep to if it takes one of its slots.

Letters as in `datatypes`, and R pairs of an ego and one of its slots, G knots of a profile.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.assist.areas import areas_m
from hatn_sim.assist.pairs import CROSS, MERGE, Pairs, at_conflicts
from hatn_sim.assist.profile import (
    COMFORT_ACCELERATION_MPS2,
    COMFORT_BRAKING_MPS2,
    EASE_S,
    FAR_S,
    KNOT_AT_S,
    LEADER,
    ROAD_REACH_M,
    ROAD_STEP_M,
    SLOWING_MPS2,
    Approach,
    Profiles,
)
from hatn_sim.assist.risk import arrival_s, travelled_m
from hatn_sim.datatypes import (
    DT_S,
    HORIZON_FRAMES,
    BoolArray,
    FloatArray,
    IntArray,
    Prediction,
    Scene,
    SemanticGraphs,
)
from hatn_sim.graph import AHEAD_AT_M, CONTEXT, gates_ahead
from hatn_sim.road import Road
from hatn_sim.speed_profile import LATERAL_MPS2

PLAUSIBLE_WEIGHT: Final = 0.1
"""Components of a goal distribution with less weight are not reckoned with."""
PLAUSIBLE_STD: Final = 1.28
"""One in ten of a component goes farther than this many of its standard deviations."""
LEAVE_MARGIN_S: Final = 0.5
"""An area opens so long after whoever was let go has left it."""
NOSE_M: Final = 0.5
"""Whose front bumper is farther than this in an area is in the way there."""
_ACCELERATION: Final = CONTEXT.index("acceleration_mps2 of the rear vehicle")


@dataclass(frozen=True, eq=False)
class Outlook:
    """A moment, as far as slots are chosen by it; [E, M] are 0 where a graph has no such node."""

    scene: Scene
    graphs: SemanticGraphs
    travelled_m: FloatArray  # [N, F] on the most probable predicted path
    slowest_m: FloatArray  # [N, F] the least that they may plausibly travel
    stop_m: FloatArray  # [N] to a stop line, whoever is before it; inf: none
    closed_m: FloatArray  # [N] to a closed signal, likewise
    room_m: FloatArray  # [E, M] from the ego's front bumper to the area
    clear_m: FloatArray  # [E, M] the ego's way until its rear bumper is out of the area
    other_room_m: FloatArray  # [E, M] from the other's front bumper to the area
    ego_enter_s: FloatArray  # [E, M] as predicted
    enter_s: FloatArray  # [E, M] of the other, as predicted
    leave_s: FloatArray  # [E, M]
    soonest_s: FloatArray  # [E, M] the earliest that the other may plausibly enter
    taken_m: FloatArray  # [E] from the ego's front bumper to an area somebody is in; inf: none
    taken_s: FloatArray  # [E] when it is left
    taken_by: IntArray  # [E] by whom; -1: nobody


def look_ahead(
    road: Road, scene: Scene, prediction: Prediction, pairs: Pairs | None = None
) -> Outlook:
    """The outlook of a moment; needs `prediction.graphs` and `prediction.lines`.

    `pairs` are those of the moment, if they are known already.
    """
    graphs, lines = prediction.graphs, prediction.lines
    assert graphs is not None and lines is not None
    travelled = travelled_m(scene, prediction)
    fastest, slowest = plausible_travel_m(prediction, travelled)
    e, m = np.nonzero(graphs.node_mask & (np.arange(graphs.rear.shape[1]) > 0))
    index = np.stack((graphs.ego[e], graphs.rear[e, m]), axis=1)
    to_point = np.stack((graphs.ego_to_conflict_m[e, m], graphs.rear_to_conflict_m[e, m]), axis=1)
    point_s = lines.s_m[index] + to_point
    kind = graphs.conflict_type[e, m]
    before, beyond = areas_m(road, scene, index, lines.line[index], point_s, kind)
    room, clear = to_point - before, to_point + beyond
    # The ego's and the other's way into the area, and the other's way out of it; and the other's
    # way in once more, with the path that it may plausibly take.
    ways = np.concatenate((travelled, fastest))
    vehicle = np.stack((index[:, 0], index[:, 1], index[:, 1], index[:, 1] + len(travelled)))
    way_m = np.stack((room[:, 0], room[:, 1], clear[:, 1], room[:, 1]))
    ego_enter, enter, leave, soonest = arrival_s(ways, vehicle, way_m)

    def by_node(of_pair: FloatArray) -> FloatArray:
        whole = np.zeros(graphs.rear.shape)
        whole[e, m] = of_pair
        return whole

    gates = gates_ahead(road, scene, lines)
    taken_m, taken_s, taken_by = _taken(
        pairs or at_conflicts(road, scene, lines), graphs, travelled
    )
    return Outlook(
        scene=scene,
        graphs=graphs,
        travelled_m=travelled,
        slowest_m=slowest,
        stop_m=gates.stop_m,
        closed_m=gates.closed_m,
        room_m=by_node(room[:, 0]),
        clear_m=by_node(clear[:, 0]),
        other_room_m=by_node(room[:, 1]),
        ego_enter_s=by_node(ego_enter),
        enter_s=by_node(enter),
        leave_s=by_node(leave),
        soonest_s=by_node(soonest),
        taken_m=taken_m,
        taken_s=taken_s,
        taken_by=taken_by,
    )


def _taken(
    pairs: Pairs, graphs: SemanticGraphs, travelled_m: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """The nearest area [E] ahead of each ego that somebody who crosses is in, until when, and who.

    Graphs let go of a conflict 2 m behind the other's centre: its rear may be in the area yet.
    """
    count = len(graphs.ids)
    nearest, until, who = np.full(count, np.inf), np.zeros(count), np.full(count, -1)
    inside = (pairs.type == CROSS)[:, None] & (pairs.room_m[:, ::-1] <= 0.0)
    inside &= pairs.room_m > -0.5 * pairs.length_m
    q, mine = np.nonzero(inside)
    if len(q):
        room_m, its = pairs.room_m[q, mine], 1 - mine
        leave_s = arrival_s(travelled_m, pairs.index[q, its], pairs.clear_m[q, its])
        order = np.lexsort((leave_s, -room_m))  # the nearest is written last
        ego = pairs.index[q, mine][order]
        nearest[ego], until[ego] = room_m[order], leave_s[order] + LEAVE_MARGIN_S
        who[ego] = pairs.index[q, its][order]
    return nearest[graphs.ego], until[graphs.ego], who[graphs.ego]


def plausible_travel_m(
    prediction: Prediction, travelled_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far vehicles may plausibly get, at most and at least [N, F].

    The predicted path length, and from some time on more or less of it, as of one who decides then
    to accelerate or to brake: so that it ends at the farthest or nearest plausible goal.
    """
    weight, mean, std = (
        prediction.goal_weight,
        prediction.goal_mean_m,
        prediction.goal_std_m,
    )
    if weight is None or mean is None or std is None:
        return travelled_m, travelled_m
    end_m, counts, reach = travelled_m[:, -1], weight >= PLAUSIBLE_WEIGHT, PLAUSIBLE_STD * std
    far = np.where(counts, mean + reach, 0.0).max(axis=1)
    near = np.maximum(np.where(counts, mean - reach, np.inf).min(axis=1), 0.0)
    more = _deciding_m(np.maximum(far - end_m, 0.0), COMFORT_ACCELERATION_MPS2)
    less = _deciding_m(np.maximum(end_m - near, 0.0), COMFORT_BRAKING_MPS2)
    slowest = np.maximum.accumulate(np.maximum(travelled_m - less, 0.0), axis=1)
    return travelled_m + more, slowest


def _deciding_m(difference_m: FloatArray, acceleration_mps2: float) -> FloatArray:
    """What it adds to the way [N, F] to accelerate so late that it comes to `difference_m` [N]."""
    horizon_s = HORIZON_FRAMES * DT_S
    changing_s = np.minimum(np.sqrt(2.0 * difference_m / acceleration_mps2), horizon_s)
    since_s = DT_S * np.arange(1, HORIZON_FRAMES + 1) - (horizon_s - changing_s[:, None])
    share = np.maximum(since_s, 0.0) / np.maximum(changing_s, DT_S)[:, None]
    return np.asarray(difference_m[:, None] * share**2)


def approaches(
    outlook: Outlook,
    row: IntArray,
    slot: IntArray,
    named: IntArray,
    has_stopped: BoolArray,
    start_s: float = 0.0,
) -> tuple[Approach, FloatArray, IntArray]:
    """What egos of graphs [R] have to keep to in order to take slots [R].

    On a yield, the vehicles of nodes `named` [R] go first, and whoever would be met then.
    Also when the area opens for them [R]: the last of those let go has left; 0 on a pass. And who
    is ahead at the knots [R, G], as vehicles; -1: nobody.
    `has_stopped` [R] is of the stop line ahead: they have done so, and may go on. Until `start_s`
    they drive as predicted.
    """
    graphs, scene = outlook.graphs, outlook.scene
    ego = graphs.ego[row]
    first, area_s = _let_go(outlook, row, slot, named)
    others = graphs.node_mask[row] & (np.arange(graphs.rear.shape[1]) > 0)
    further = others & ~graphs.focus_mask[row]
    # At later conflicts the order is the predicted one.
    first |= further & (outlook.enter_s[row] < outlook.ego_enter_s[row])
    # Whoever stops in somebody's way is no help to anybody.
    first &= ~in_the_way(outlook, row)
    # Who has begun to merge is kept apart from those ahead by following them.
    merging = graphs.conflict_type[row] == MERGE
    closed = first & ~(merging & (outlook.room_m[row] <= 0.0))
    opens = outlook.leave_s[row] + LEAVE_MARGIN_S
    leader_m, leader_mps, leader = _leaders(outlook, row, first, start_s + KNOT_AT_S)
    to_line = np.minimum(np.where(has_stopped, np.inf, outlook.stop_m[ego]), outlook.closed_m[ego])
    speed, start_m = scene.speed_mps[ego], np.zeros(len(row))
    acceleration = graphs.context[row, 0, _ACCELERATION]
    if start_s > 0.0:
        lately_s = np.array([max(start_s - EASE_S, 0.0), start_s])
        travel, then = travel_at(outlook.travelled_m[ego], lately_s)
        speed, start_m = then[:, 1], travel[:, 1]
        acceleration = (then[:, 1] - then[:, 0]) / max(lately_s[1] - lately_s[0], DT_S)
    return (
        Approach(
            start_s=start_s,
            start_m=start_m,
            speed_mps=speed,
            acceleration_mps2=acceleration,
            allowed_mps=_allowed_mps(graphs.context[row, 0]),
            leader_m=leader_m,
            leader_mps=leader_mps,
            stop_m=to_line,
            area_m=np.column_stack(
                (np.where(closed, outlook.room_m[row], np.inf), outlook.taken_m[row])
            ),
            open_s=np.column_stack((np.where(closed, opens, 0.0), outlook.taken_s[row])),
        ),
        area_s,
        leader,
    )


def in_the_way(outlook: Outlook, row: IntArray) -> BoolArray:
    """Of nodes [R, M]: the ego's nose is in the area, and the other is not, or merges behind it."""
    graphs = outlook.graphs
    others = graphs.node_mask[row] & (np.arange(graphs.rear.shape[1]) > 0)
    behind = graphs.rear_to_conflict_m[row] > graphs.ego_to_conflict_m[row]
    behind &= graphs.conflict_type[row] == MERGE
    alone = behind | (outlook.other_room_m[row] > 0.0)
    return others & (outlook.room_m[row] < -NOSE_M) & alone


def _let_go(
    outlook: Outlook, row: IntArray, slot: IntArray, named: IntArray
) -> tuple[BoolArray, FloatArray]:
    """Who of the focus group goes before the ego [R, M], and when the last of them has left [R].

    On a yield: whoever is named, and everybody whom the ego would meet if it went then. On a pass:
    nobody.
    """
    graphs = outlook.graphs
    group = graphs.focus_mask[row] & (np.arange(graphs.rear.shape[1]) > 0)
    enter = np.where(group, outlook.enter_s[row], np.inf)
    leave = outlook.leave_s[row] + LEAVE_MARGIN_S
    yields = slot == 0
    first = group & yields[:, None] & (np.arange(group.shape[1]) == named[:, None])
    room = np.maximum(outlook.room_m[row], 0.0)
    within = np.maximum(outlook.clear_m[row] - room, 0.0)
    speed = outlook.scene.speed_mps[graphs.ego[row]][:, None]
    area_s = np.zeros(len(row))
    for _ in range(graphs.rear.shape[1] - 1):
        area_s = np.where(first, leave, 0.0).max(axis=1)
        arrives = area_s[:, None]
        # Having braked evenly so as to arrive then.
        enters_mps = np.maximum(2.0 * room / np.maximum(arrives, DT_S) - speed, 0.0)
        enters_mps = np.minimum(enters_mps, speed)
        root = np.sqrt(enters_mps**2 + 2.0 * COMFORT_ACCELERATION_MPS2 * within)
        out_s = arrives + (root - enters_mps) / COMFORT_ACCELERATION_MPS2
        more = group & yields[:, None] & ~first & (enter < np.minimum(out_s, FAR_S))
        if not more.any():
            break
        first |= more
    return first, area_s


def _leaders(
    outlook: Outlook, row: IntArray, first: BoolArray, time_s: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Rear bumper [R, G], from the ego's front bumper, speed [R, G] of the nearest ahead, and who
    that is [R, G].

    That is its leader, or whoever of those `first` [R, M] merges before it: from now on where the
    ego has begun to merge behind them, else from when they enter the area. Until they are past its
    near end, they count as there: so that the ego comes no faster than it can follow.
    """
    graphs, scene = outlook.graphs, outlook.scene
    ego, leader = graphs.ego[row], graphs.leader[row]
    # The ego is to manage if they slow down, beyond the horizon or, as far as is plausible, before.
    slow_m, slow_mps = travel_at(outlook.slowest_m, time_s, SLOWING_MPS2)
    there = (leader >= 0)[:, None]
    ahead = np.where(there, graphs.leader_gap_m[row][:, None] + slow_m[leader], np.inf)
    ahead_mps = np.where(there, slow_mps[leader], 0.0)
    who = np.repeat(leader[:, None], len(time_s), axis=1)
    r, m = np.nonzero(first & (graphs.conflict_type[row] == MERGE))
    if not len(r):
        return ahead, ahead_mps, who
    travel, speed = travel_at(outlook.travelled_m, time_s, SLOWING_MPS2)
    other = graphs.rear[row[r], m]
    half_m = 0.5 * (scene.size_m[ego[r], 0] + scene.size_m[other, 0])
    before_m = graphs.ego_to_conflict_m[row[r], m] - graphs.rear_to_conflict_m[row[r], m] - half_m
    room_m, enter_s = outlook.room_m[row[r], m], outlook.enter_s[row[r], m]
    begun = (room_m <= 0.0)[:, None]
    near_end_m = np.where(begun, -np.inf, room_m[:, None] + LEADER.short_m)
    place_m = np.maximum(before_m[:, None] + travel[other], near_end_m)
    counts = begun | (time_s >= enter_s[:, None])
    place_m = np.where(counts, place_m, np.inf)
    # Of the nodes of each row, which follow each other, the first that is nearest.
    rows, begins, of_row = np.unique(r, return_index=True, return_inverse=True)
    nearest_m = np.minimum.reduceat(place_m, begins)
    is_nearest = place_m == nearest_m[of_row]
    node = np.where(is_nearest, np.arange(len(r))[:, None], len(r))
    nearest = np.minimum.reduceat(node, begins)
    nearest_mps = speed[other[nearest], np.arange(len(time_s))]
    nearer = nearest_m < ahead[rows]
    ahead[rows] = np.where(nearer, nearest_m, ahead[rows])
    ahead_mps[rows] = np.where(nearer, nearest_mps, ahead_mps[rows])
    who[rows] = np.where(nearer, other[nearest], who[rows])
    return ahead, ahead_mps, who


def travel_at(
    travelled_m: FloatArray, time_s: FloatArray, slowing_mps2: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Path length [N, G] and speed [N, G] at times [G], from frames [N, F].

    Beyond them at the last speed, or slowing down evenly from it.
    """
    path = np.concatenate((np.zeros((len(travelled_m), 1)), travelled_m), axis=1)
    frame = time_s / DT_S
    low = np.minimum((frame + 1e-9).astype(np.int64), HORIZON_FRAMES - 1)
    before_m = path[:, low]
    step_m = path[:, low + 1] - before_m
    way, speed = before_m + (frame - low) * step_m, step_m / DT_S
    if slowing_mps2:
        beyond_s = np.maximum(time_s - DT_S * HORIZON_FRAMES, 0.0)
        lost_mps = np.minimum(slowing_mps2 * beyond_s, speed)
        # Whoever has come to a stand has driven v^2 / 2b, not v t - b t^2 / 2.
        driving_s = lost_mps / slowing_mps2
        way = way - speed * (beyond_s - driving_s) - 0.5 * slowing_mps2 * driving_s**2
        speed = speed - lost_mps
    return way, speed


def pass_margins_s(
    outlook: Outlook, row: IntArray, profiles: Profiles
) -> tuple[FloatArray, FloatArray]:
    """By how much egos [R] are out of every area of their focus group before others enter them:
    at the earliest plausible entries, and at the predicted ones.

    Where lines merge, the ego has also to be far enough ahead for the other to brake in comfort.
    """
    graphs = outlook.graphs
    group = graphs.focus_mask[row] & (np.arange(graphs.rear.shape[1]) > 0)
    clear_s = profiles.arrival_s(np.where(group, outlook.clear_m[row], 0.0))
    other_mps = outlook.scene.speed_mps[np.maximum(graphs.rear[row], 0)]
    knot = np.minimum(np.searchsorted(KNOT_AT_S, clear_s, side="right") - 1, len(KNOT_AT_S) - 1)
    own_mps = np.take_along_axis(profiles.speed_mps, knot, axis=1)
    faster = np.maximum(other_mps - own_mps, 0.0)
    brakes_s = faster**2 / (2.0 * COMFORT_BRAKING_MPS2 * np.maximum(other_mps, 1.0))
    merging = graphs.conflict_type[row] == MERGE
    needed_s = clear_s + np.where(merging, brakes_s, 0.0)

    def margin(enter_s: FloatArray) -> FloatArray:
        by_node = np.where(group, enter_s[row] - needed_s, np.inf)
        return np.asarray(by_node.min(axis=1, initial=np.inf))

    return margin(outlook.soonest_s), margin(outlook.enter_s)


_POINTS: Final = round(ROAD_REACH_M / ROAD_STEP_M) + 1
_AT_M: Final = ROAD_STEP_M * np.arange(_POINTS)
_BETWEEN: Final = np.array(
    [np.interp(_AT_M, AHEAD_AT_M, unit) for unit in np.eye(len(AHEAD_AT_M))]
)  # [AHEAD_AT_M, P]


def _allowed_mps(context: FloatArray) -> FloatArray:
    """Speed [R, P] that limits and bends allow, ahead of vehicles with contexts [R, ...]."""
    points = len(AHEAD_AT_M)
    limit, bend = context[:, :points], np.abs(context[:, points : 2 * points])
    square = np.minimum(limit**2, LATERAL_MPS2 / np.maximum(bend, 1e-4))
    square = square @ _BETWEEN
    fall = 2.0 * SLOWING_MPS2 * _AT_M
    return np.sqrt(np.minimum.accumulate((square + fall)[:, ::-1], axis=1)[:, ::-1] - fall)
