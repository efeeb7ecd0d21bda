"""Perception -> semantic graphs of all egos at once (METHOD section 1, the paper's section 4.1).

Boundaries are bumpers: the front of a DIA is the rear bumper of the vehicle ahead, its rear is the
front bumper of the vehicle behind, so that its length is the gap a driver sees, whatever the
lengths of the vehicles. Distances to a conflict count positive upstream.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import (
    HISTORY_FRAMES,
    MAX_NODES,
    BoolArray,
    FloatArray,
    Front,
    Gate,
    IntArray,
    Lines,
    Scene,
    SemanticGraphs,
)
from hatn_sim.perception import Motion, Perception, motion_along
from hatn_sim.road import LINE_STEP_M, Road
from hatn_sim.speed_profile import ACCELERATION_MPS2, allowed_speed_mps, free_travel_m
from hatn_sim.worlds import is_closed, near_pairs

INTERACTION_M: Final = 60.0
"""Conflicts nearer than this to both vehicles are active."""
PASSED_M: Final = 2.0
"""A conflict stays active until this far behind."""
GROUP_M: Final = 4.0
"""Conflicts this near to the focus, along the ego's line, form its group."""
FREE_M: Final = 50.0
"""Where there is no conflict, boundaries are measured to a point this far ahead."""
AHEAD_AT_M: Final = (0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0, 35.0, 40.0, 50.0)
"""Where the line ahead of a node's rear vehicle is sampled."""

CONTEXT: Final = (
    *(f"speed_limit_mps at {at:g} m" for at in AHEAD_AT_M),
    *(f"curvature_per_m at {at:g} m" for at in AHEAD_AT_M),
    "free_travel_m of the rear vehicle in 3 s",
    "waited_s of the rear vehicle",
    "waited_s of the ego",
    "length_m of the rear vehicle",
    "gate ahead of the rear vehicle before the conflict",
    "gate ahead of the ego before the conflict",
    "conflict is a merge",
    "node is of the focus group",
    "acceleration_mps2 of the rear vehicle",
    "lateral_m of the rear vehicle",
    "distance_m of the rear vehicle to its leader, up to FREE_M",
    "speed_mps of the leader of the rear vehicle",
    "leader there",
    "earliest_s of the rear vehicle at the conflict, up to FAR_S",
    "earliest_s of the ego at the node's conflict, up to FAR_S",
    "front is a vehicle of the focus group",
    "gate_m of the rear vehicle: stop line, give-way line or closed signal, up to FREE_M",
)
"""The last axis of `SemanticGraphs.context`: what holds now, beyond the paper's seven features."""
CONTEXT_SIZE: Final = len(CONTEXT)
_COLUMN: Final = {name: column for column, name in enumerate(CONTEXT)}
ROAD_CONTEXT: Final = 2 * len(AHEAD_AT_M) + 1
"""The first entries are of the road ahead, the others of the interaction."""
FAR_S: Final = 10.0


def build_graphs(road: Road, seen: Perception) -> SemanticGraphs:
    """Semantic graphs of every vehicle that has a reference line."""
    ego = np.flatnonzero(seen.lines.line >= 0)
    nodes = _interacting(road, seen, ego)
    rear, ego_m, rear_m, focus, kind, node_mask, conflict_s = nodes
    has_conflict: BoolArray = np.asarray(node_mask[:, 1:].any(axis=1))
    gates = next_gates(road, seen)
    front, front_type, front_s = _fronts(seen, gates, rear, rear_m, node_mask, has_conflict)
    x, history = _features(road, seen, rear, rear_m, front, front_s, node_mask)
    to_conflict_m = (ego_m, rear_m)
    context = _context(road, seen, gates, ego, rear, front, to_conflict_m, focus, kind, node_mask)
    point_xy = road.locate(
        np.repeat(seen.lines.line[ego], MAX_NODES), conflict_s.ravel(), np.zeros(conflict_s.size)
    ).reshape(*conflict_s.shape, 2)
    return SemanticGraphs(
        ids=seen.scene.ids,
        ego=ego,
        rear=rear,
        front=front,
        front_type=front_type,
        x=x,
        context=context,
        node_mask=node_mask,
        focus_mask=focus,
        history_mask=history,
        has_conflict=has_conflict,
        ego_at_red=gates.closed_m[ego] + 0.5 * seen.scene.size_m[ego, 0] <= ego_m[:, 0],
        ego_to_conflict_m=ego_m,
        rear_to_conflict_m=rear_m,
        conflict_xy_m=np.where(node_mask[:, :, None], point_xy, 0.0),
        conflict_type=kind,
        leader=seen.leader[ego],
        leader_gap_m=_leader_gap_m(seen)[ego],
    )


def _leader_gap_m(seen: Perception) -> FloatArray:
    """From the front bumper of every vehicle [N] to its leader's rear bumper; 0: no leader."""
    half_m = 0.5 * seen.scene.size_m[:, 0]
    behind_m = seen.leader_s_m - half_m[np.maximum(seen.leader, 0)]
    return np.where(seen.leader >= 0, behind_m - seen.lines.s_m - half_m, 0.0)


def _interacting(
    road: Road, seen: Perception, ego: IntArray
) -> tuple[IntArray, FloatArray, FloatArray, BoolArray, IntArray, BoolArray, FloatArray]:
    """The nodes [E, M] of every ego: vehicle, distances of both to the conflict, focus, type, mask.

    Node 0 carries the ego's own nearest conflict (the focus), or a point `FREE_M` ahead.
    """
    scene, s = seen.scene, seen.lines.s_m
    shape = (len(ego), MAX_NODES)
    rear = np.full(shape, -1, dtype=np.int64)
    ego_m, rear_m, conflict_s = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    focus, mask = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
    kind = np.zeros(shape, dtype=np.int64)
    rear[:, 0], mask[:, 0], focus[:, 0] = ego, True, True
    ego_m[:, 0] = rear_m[:, 0] = FREE_M
    row_of = np.full(len(scene.ids), -1, dtype=np.int64)
    row_of[ego] = np.arange(len(ego))
    met = active_conflicts(road, seen, ego)
    if len(met.ego):
        one, other = row_of[met.ego], met.other
        order = np.lexsort((met.rank, np.maximum(met.ego_m, met.other_m), one))
        one, other = one[order], other[order]
        begins = np.concatenate(([True], one[1:] != one[:-1]))
        nth = np.arange(len(one)) - np.maximum.accumulate(np.where(begins, np.arange(len(one)), 0))
        keep = nth < MAX_NODES - 1
        e, m, chosen = one[keep], nth[keep] + 1, order[keep]
        rear[e, m], mask[e, m] = other[keep], True
        ego_m[e, m], rear_m[e, m] = met.ego_m[chosen], met.other_m[chosen]
        kind[e, m] = met.type[chosen]
        to_conflict_m = np.where(mask[:, 1:], ego_m[:, 1:], np.inf)
        nearest = to_conflict_m.min(axis=1)
        focus[:, 1:] = mask[:, 1:] & (ego_m[:, 1:] - nearest[:, None] <= GROUP_M)
        has = np.isfinite(nearest)
        ego_m[has, 0] = rear_m[has, 0] = nearest[has]
        kind[has, 0] = kind[has, to_conflict_m.argmin(axis=1)[has] + 1]
    conflict_s[:] = s[ego][:, None] + ego_m
    return rear, ego_m, rear_m, focus, kind, mask, conflict_s


@dataclass(frozen=True, eq=False)
class Active:
    """Who meets whom, one row for each ego and other vehicle: the first conflict of the two."""

    ego: IntArray  # [I] vehicle
    other: IntArray  # [I] vehicle
    ego_m: FloatArray  # [I] of the ego to the conflict, along its line
    other_m: FloatArray  # [I]
    type: IntArray  # [I] ConflictType
    rank: IntArray  # [I] of the other's id


def active_conflicts(road: Road, seen: Perception, ego: IntArray) -> Active:
    """Conflicts within reach of both vehicles: for each pair the first along the ego's line."""
    line, s, ids = seen.lines.line, seen.lines.s_m, seen.scene.ids
    near = near_pairs(seen.scene, ego, 2 * INTERACTION_M)
    met = road.conflict_table.of_pairs(line[near[:, 0]], line[near[:, 1]])
    pair = near[met.pair]
    to_m = met.point_s_m - s[pair]
    within = (to_m > -PASSED_M) & (to_m <= INTERACTION_M)
    active = within[:, 0] & within[:, 1]
    pair, to_m, kind = pair[active], to_m[active], met.type[active]
    ego_of = np.concatenate((pair[:, 0], pair[:, 1]))
    other = np.concatenate((pair[:, 1], pair[:, 0]))
    ego_m = np.concatenate((to_m[:, 0], to_m[:, 1]))
    other_m = np.concatenate((to_m[:, 1], to_m[:, 0]))
    kind = np.concatenate((kind, kind))
    key = ego_of * len(ids) + other
    order = np.lexsort((ego_m, key))
    both = key[order]
    first = order[np.concatenate(([True], both[1:] != both[:-1]))] if len(order) else order
    other = other[first]
    rank = np.argsort(np.argsort(np.array(ids)))[other] if len(other) else other
    return Active(ego_of[first], other, ego_m[first], other_m[first], kind[first], rank)


@dataclass(frozen=True, eq=False)
class Gates:
    """Distance [N] of every front bumper to what it meets first of its kind; inf: nothing."""

    stop_m: FloatArray  # stop line
    give_way_m: FloatArray  # give-way line
    closed_m: FloatArray  # closed signal


def next_gates(road: Road, seen: Perception) -> Gates:
    """The gates ahead of every vehicle on its line."""
    return gates_ahead(road, seen.scene, seen.lines)


def gates_ahead(road: Road, scene: Scene, lines: Lines) -> Gates:
    """The gates ahead of every vehicle of a scene on lines given."""
    line = np.maximum(lines.line, 0)
    if not len(road.count):
        nothing = np.full(len(line), np.inf)
        return Gates(nothing, nothing, nothing)
    front = lines.s_m + 0.5 * scene.size_m[:, 0]
    to_gate = road.gate_s_m[line] - front[:, None]
    # A vehicle that stands with its bumper a little over the line is still behind it.
    ahead = (to_gate > -0.5) & (lines.line >= 0)[:, None]
    kind, signal = road.gate_type[line], road.gate_signal[line]

    def nearest_m(counts: BoolArray) -> FloatArray:
        return np.where(ahead & counts, to_gate, np.inf).min(axis=1)

    return Gates(
        stop_m=nearest_m(kind == Gate.STOP_LINE),
        give_way_m=nearest_m(kind == Gate.GIVE_WAY_LINE),
        closed_m=nearest_m((kind == Gate.SIGNAL) & is_closed(scene, signal)),
    )


def _fronts(
    seen: Perception,
    gates: Gates,
    rear: IntArray,
    rear_m: FloatArray,
    node_mask: BoolArray,
    has_conflict: BoolArray,
) -> tuple[IntArray, IntArray, FloatArray]:
    """Front boundary of every node: vehicle or -1, Front, arc length on the rear's line [E, M]."""
    at = np.maximum(rear, 0)
    s = seen.lines.s_m[at]
    conflict_s = s + rear_m
    half_m = 0.5 * seen.scene.size_m[at, 0]
    leader = seen.leader[at]
    leader_s = np.where(leader >= 0, seen.leader_s_m[at], np.inf)
    lead_half = np.where(leader >= 0, 0.5 * seen.scene.size_m[np.maximum(leader, 0), 0], 0.0)
    vehicle_s = np.where(leader_s <= conflict_s, leader_s - lead_half, np.inf)
    stop_s = s + half_m + np.minimum(gates.stop_m, gates.closed_m)[at]
    stop_s = np.where(stop_s <= conflict_s, stop_s, np.inf)
    front_s = np.minimum(np.minimum(vehicle_s, stop_s), conflict_s)
    free = ~has_conflict[:, None] & (np.arange(rear.shape[1]) == 0)
    kind = np.where(free, Front.FREE, Front.CONFLICT)
    kind = np.where(stop_s <= front_s, Front.STOP, kind)
    kind = np.where(vehicle_s <= front_s, Front.VEHICLE, kind)
    front = np.where((kind == Front.VEHICLE) & node_mask, leader, -1)
    return front, kind, front_s


def _features(
    road: Road,
    seen: Perception,
    rear: IntArray,
    rear_m: FloatArray,
    front: IntArray,
    front_s: FloatArray,
    node_mask: BoolArray,
) -> tuple[FloatArray, BoolArray]:
    """The paper's seven features over the history [E, M, T, 7], and where both ends were seen."""
    ahead, own = _leader_motion(road, seen), seen.own
    half_m = 0.5 * seen.scene.size_m[:, 0]
    valid = seen.tracks.valid[:, -HISTORY_FRAMES:]
    e, m = np.nonzero(node_mask)
    at, before = rear[e, m], np.maximum(front[e, m], 0)
    is_vehicle = (front[e, m] >= 0)[:, None]
    conflict_s = (seen.lines.s_m[at] + rear_m[e, m])[:, None]
    moving_front = conflict_s - (ahead.s_m[at] - half_m[before][:, None])
    of_node = np.empty((len(at), HISTORY_FRAMES, 7))
    of_node[..., 0] = np.where(is_vehicle, moving_front, conflict_s - front_s[e, m][:, None])
    of_node[..., 1] = np.where(is_vehicle, ahead.speed_mps[at], 0.0)
    of_node[..., 2] = np.where(is_vehicle, ahead.phi_rad[at], 0.0)
    of_node[..., 3] = conflict_s - (own.s_m[at] + half_m[at][:, None])
    of_node[..., 4] = own.speed_mps[at]
    of_node[..., 5] = own.phi_rad[at]
    of_node[..., 6] = of_node[..., 3] - of_node[..., 0]
    x = np.zeros((*rear.shape, HISTORY_FRAMES, 7))
    x[e, m] = of_node
    history = np.zeros((*rear.shape, HISTORY_FRAMES), dtype=np.bool_)
    history[e, m] = valid[at] & (~is_vehicle | valid[before])
    return x, history


def _leader_motion(road: Road, seen: Perception) -> Motion:
    """The history of every vehicle's leader on the follower's line [N, T]."""
    there = seen.leader >= 0
    line = np.where(there, seen.lines.line, -1)
    s_now = np.where(there, seen.leader_s_m, 0.0)
    # A leader may have come in from another lane, where it drove a longer or shorter way.
    return motion_along(road, seen.tracks, line, s_now, np.maximum(seen.leader, 0), steps=2)


def _context(
    road: Road,
    seen: Perception,
    gates: Gates,
    ego: IntArray,
    rear: IntArray,
    front: IntArray,
    to_conflict_m: tuple[FloatArray, FloatArray],
    focus: BoolArray,
    kind: IntArray,
    node_mask: BoolArray,
) -> FloatArray:
    """What holds now [E, M, CONTEXT_SIZE], see `CONTEXT`."""
    e, m = np.nonzero(node_mask)
    at, mine = rear[e, m], ego[e]
    ego_m, rear_m = to_conflict_m[0][e, m], to_conflict_m[1][e, m]
    vehicle, speed = _vehicle_context(road, seen, gates), seen.own.speed_mps[:, -1]
    of_node = np.empty((len(at), CONTEXT_SIZE))

    def put(name: str, values: FloatArray | IntArray | BoolArray) -> None:
        of_node[:, _COLUMN[name]] = values

    of_node[:, :ROAD_CONTEXT] = vehicle.road[at]
    put("waited_s of the rear vehicle", seen.waited_s[at])
    put("waited_s of the ego", seen.waited_s[mine])
    put("length_m of the rear vehicle", seen.scene.size_m[at, 0])
    put("gate ahead of the rear vehicle before the conflict", vehicle.to_gate_m[at] <= rear_m)
    put("gate ahead of the ego before the conflict", vehicle.to_gate_m[mine] <= ego_m)
    put("conflict is a merge", kind[e, m])
    put("node is of the focus group", focus[e, m])
    put("acceleration_mps2 of the rear vehicle", vehicle.acceleration_mps2[at])
    put("lateral_m of the rear vehicle", seen.lines.d_m[at])
    put("distance_m of the rear vehicle to its leader, up to FREE_M", vehicle.gap_m[at])
    put("speed_mps of the leader of the rear vehicle", vehicle.leader_mps[at])
    put("leader there", seen.leader[at] >= 0)
    rear_s, ego_s = _earliest_s(rear_m, speed[at]), _earliest_s(ego_m, speed[mine])
    put("earliest_s of the rear vehicle at the conflict, up to FAR_S", rear_s)
    put("earliest_s of the ego at the node's conflict, up to FAR_S", ego_s)
    put("front is a vehicle of the focus group", _queued(rear, front, focus)[e, m])
    gate = "gate_m of the rear vehicle: stop line, give-way line or closed signal, up to FREE_M"
    put(gate, np.clip(vehicle.to_gate_m[at], 0.0, FREE_M))
    context = np.zeros((*rear.shape, CONTEXT_SIZE))
    context[e, m] = of_node
    return context


@dataclass(frozen=True, eq=False)
class _VehicleContext:
    """What the context says of each vehicle, whatever node it is in."""

    road: FloatArray  # [N, ROAD_CONTEXT]
    to_gate_m: FloatArray  # [N] from the centre
    acceleration_mps2: FloatArray  # [N]
    gap_m: FloatArray  # [N] to the leader
    leader_mps: FloatArray  # [N]


def _vehicle_context(road: Road, seen: Perception, gates: Gates) -> _VehicleContext:
    scene, lines = seen.scene, seen.lines
    safe = np.maximum(lines.line, 0)
    profile = np.zeros((len(scene.ids), ROAD_CONTEXT))
    if len(road.count):
        index = ((lines.s_m[:, None] + np.array(AHEAD_AT_M)) / LINE_STEP_M).astype(np.int64)
        index = np.clip(index, 0, road.count[safe][:, None] - 1)
        index += road.offset[safe][:, None]
        profile[:, : len(AHEAD_AT_M)] = road.speed_limit_mps[index]
        profile[:, len(AHEAD_AT_M) : -1] = road.curvature_per_m[index]
        allowed = allowed_speed_mps(road, safe, lines.s_m)
        profile[:, -1] = free_travel_m(allowed, seen.own.speed_mps[:, -1])
    half_m = 0.5 * scene.size_m[:, 0]
    has_leader, lead = seen.leader >= 0, np.maximum(seen.leader, 0)
    gap = np.where(has_leader, _leader_gap_m(seen), FREE_M)
    gates_m = np.minimum(np.minimum(gates.stop_m, gates.give_way_m), gates.closed_m)
    return _VehicleContext(
        road=profile,
        to_gate_m=gates_m + half_m,
        acceleration_mps2=(seen.own.speed_mps[:, -1] - seen.own.speed_mps[:, -3]) / 0.2,
        gap_m=np.clip(gap, 0.0, FREE_M),
        leader_mps=np.where(has_leader, scene.speed_mps[lead], 0.0),
    )


def _earliest_s(distance_m: FloatArray, speed_mps: FloatArray) -> FloatArray:
    """Time to a place at `ACCELERATION_MPS2` from now on, 0 behind it, at most `FAR_S`.

    Unlike distance over speed it is finite and smooth for a vehicle that stands.
    """
    speed = np.maximum(speed_mps, 0.0)
    root = np.sqrt(speed**2 + 2.0 * ACCELERATION_MPS2 * np.maximum(distance_m, 0.0))
    return np.minimum((root - speed) / ACCELERATION_MPS2, FAR_S)


def _queued(rear: IntArray, front: IntArray, focus: BoolArray) -> BoolArray:
    """Nodes [E, M] behind a vehicle that heads for the same focus: they cannot be next there."""
    others = np.where(focus, rear, -2)[:, None, :]
    same = front[:, :, None] == others
    same[:, :, 0] = False  # the ego is no obstacle to those behind it on another line
    return np.asarray(same.any(axis=2))
