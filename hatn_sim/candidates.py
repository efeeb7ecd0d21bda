"""The lines that a vehicle may be on, and how well its motion so far fits each (METHOD 1.1).

Candidates are the lane paths near a vehicle, drawn out through every connection. Each is scored by
open-end dynamic time warping of the motion so far against it. A line is a curve without a fork
that is driven forwards, so the warping path is the projection carried forward from frame to frame,
and the warping cost is a mean of the costs at the feet, kept up to date with one projection per
candidate and frame. It is the front that is projected: it shows first where a vehicle turns. Frames
weigh by the distance driven in them, the last metre most: a vehicle that waits gives no evidence of
where it will turn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, IntArray, Kind, Route, Scene, Tracks
from hatn_sim.geometry import wrap_angle
from hatn_sim.habits import Habits, share_nats
from hatn_sim.lane_graph import AHEAD_M, NEAR_M, NEAR_RAD
from hatn_sim.road import LINE_STEP_M, Road
from hatn_sim.tracks import rows_before
from hatn_sim.worlds import world_of

MAX_CANDIDATES: Final = 24
WARP_FRAMES: Final = 31
"""New candidates are held against the last three seconds, now included."""
HEADING_COST_M: Final = 2.0
"""Cost of a heading error: lateral offset + 2 m (1 - cos error)."""
RECENT_M: Final = 0.5
"""Evidence fades by 1/e over this distance driven."""
FIRST_M: Final = 0.01
"""Weight of the first frame of a vehicle: all there is of one that never moved."""
BEND_M: Final = 1.5
"""The curvature of the way driven is a mean over about this distance."""
OFF_M: Final = 1.7
"""Half a lane off: another lane may be the nearer one by now (a change of lanes)."""
REST_FRAMES: Final = 5
"""After a search for candidates near a vehicle that is off its lines."""
DECIDED_M: Final = 30.0
"""This far into a junction no other way through it is thought of when candidates are drawn."""
RENEW_AHEAD_M: Final = 0.6 * AHEAD_M
"""Candidates are drawn anew when less than this is left ahead."""


@dataclass(frozen=True, eq=False)
class LineState:
    """Memory of the choice of lines; A candidates a vehicle, padded with -1."""

    ids: tuple[str, ...]  # [N]
    line: IntArray  # [N, A]
    s_m: FloatArray  # [N, A] of the front
    cost_m: FloatArray  # [N, A] warping cost: the mean over the recent way
    now_m: FloatArray  # [N, A] cost at the newest foot
    d_m: FloatArray  # [N, A] lateral offset of the front now, left positive
    turned_rad: FloatArray  # [N, A] heading minus tangent now
    weight_m: FloatArray  # [N] of the frames in `cost_m`
    bend_per_m: FloatArray  # [N] curvature of the recent way, left positive
    spread_m: FloatArray  # [N] what the best line costs: how far the vehicle keeps from lines
    chosen: IntArray  # [N] candidate, -1: none
    doubted: IntArray  # [N] frames for which another candidate has been better
    renewed: IntArray  # [N] number of the lane on which the candidates were last drawn, -1: none
    rest: IntArray  # [N] frames until the next search for candidates near the vehicle
    inside: IntArray  # [N] number of the connection under the front, -1: none
    habits: Habits | None  # None: nobody seen yet


_PER_VEHICLE: Final = (
    "line",
    "s_m",
    "cost_m",
    "now_m",
    "d_m",
    "turned_rad",
    "weight_m",
    "bend_per_m",
    "spread_m",
    "chosen",
    "doubted",
    "renewed",
    "rest",
    "inside",
)
"""Fields of `LineState` with a row for each vehicle."""


def blank(ids: tuple[str, ...], habits: Habits | None) -> LineState:
    """The state of vehicles [N] of which nothing is known yet."""
    count = len(ids)
    shape = (count, MAX_CANDIDATES)
    return LineState(
        ids=ids,
        line=np.full(shape, -1, dtype=np.int64),
        s_m=np.zeros(shape),
        cost_m=np.zeros(shape),
        now_m=np.zeros(shape),
        d_m=np.zeros(shape),
        turned_rad=np.zeros(shape),
        weight_m=np.zeros(count),
        bend_per_m=np.zeros(count),
        spread_m=np.full(count, np.nan),
        chosen=np.full(count, -1, dtype=np.int64),
        doubted=np.zeros(count, dtype=np.int64),
        renewed=np.full(count, -1, dtype=np.int64),
        rest=np.zeros(count, dtype=np.int64),
        inside=np.full(count, -1, dtype=np.int64),
        habits=habits,
    )


def advance(state: LineState, road: Road, tracks: Tracks, scene: Scene) -> LineState:
    """Carry every candidate's foot point forward to the newest frame and add its cost."""
    if state.ids == tracks.ids:
        moved = replace(state, line=state.line.copy())
    else:
        moved = blank(tracks.ids, state.habits)
        rows = rows_before(state.ids, tracks.ids)
        known = rows >= 0
        for name in _PER_VEHICLE:
            getattr(moved, name)[known] = getattr(state, name)[rows[known]]
    step_m = np.linalg.norm(tracks.xy_m[:, -1] - tracks.xy_m[:, -2], axis=1)
    faded_m = moved.weight_m * np.exp(-step_m / RECENT_M)
    weight_m = faded_m + step_m
    bend_per_m = _bend_per_m(moved.bend_per_m, tracks, step_m)
    vehicle, slot = np.nonzero(moved.line >= 0)
    if not len(vehicle):
        return replace(moved, weight_m=weight_m, bend_per_m=bend_per_m)
    s_m, cost_m, now_m = moved.s_m.copy(), moved.cost_m.copy(), moved.now_m.copy()
    d_m, turned_rad = moved.d_m.copy(), moved.turned_rad.copy()
    at = moved.line[vehicle, slot]
    front_xy = _front_xy_m(scene.xy_m, scene.yaw_rad, scene.size_m[:, 0])
    s, d = road.track(at, front_xy[vehicle], s_m[vehicle, slot] + step_m[vehicle])
    s = np.maximum(s, s_m[vehicle, slot] - 0.5)  # time warping never runs backwards
    now, turned = _foot_cost_m(road, at, scene.yaw_rad[vehicle], scene.size_m[vehicle, 0], s, d)
    s_m[vehicle, slot], now_m[vehicle, slot] = s, now
    d_m[vehicle, slot], turned_rad[vehicle, slot] = d, turned
    total = cost_m[vehicle, slot] * faded_m[vehicle] + now * step_m[vehicle]
    cost_m[vehicle, slot] = total / np.maximum(weight_m[vehicle], 1e-9)
    off = (np.abs(d) > NEAR_M) | (np.abs(turned) > NEAR_RAD)
    moved.line[vehicle[off], slot[off]] = -1
    return replace(
        moved,
        s_m=s_m,
        cost_m=cost_m,
        now_m=now_m,
        d_m=d_m,
        turned_rad=turned_rad,
        weight_m=weight_m,
        bend_per_m=bend_per_m,
    )


def _bend_per_m(before_per_m: FloatArray, tracks: Tracks, step_m: FloatArray) -> FloatArray:
    """The curvature [N] of the way driven, fading by 1/e over `BEND_M`: waiting changes nothing."""
    turned = wrap_angle(tracks.yaw_rad[:, -1] - tracks.yaw_rad[:, -2])
    kept = np.exp(-step_m / BEND_M)
    share = np.where(step_m > 1e-3, (1.0 - kept) / np.maximum(step_m, 1e-3), 0.0)
    return kept * before_per_m + share * turned


def _front_xy_m(xy_m: FloatArray, yaw_rad: FloatArray, length_m: FloatArray) -> FloatArray:
    """Middle of the front [..., 2] of boxes [...]."""
    heading = np.stack((np.cos(yaw_rad), np.sin(yaw_rad)), axis=-1)
    return xy_m + 0.5 * length_m[..., None] * heading


def _foot_cost_m(
    road: Road,
    line: IntArray,
    yaw_rad: FloatArray,
    length_m: FloatArray,
    s_m: FloatArray,
    d_m: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Cost [Q] of poses whose fronts have their feet at s, d; and their heading to the line [Q]."""
    turned = wrap_angle(yaw_rad - road.line_yaw_rad(line, s_m - 0.5 * length_m))
    return np.abs(d_m) + HEADING_COST_M * (1.0 - np.cos(turned)), turned


def renew(
    state: LineState, road: Road, tracks: Tracks, scene: Scene, habits: Sequence[Habits]
) -> LineState:
    """Draw candidates for newcomers, for vehicles off their lines and for lines that run out.

    `habits` are those of every world.
    """
    vehicle = np.arange(len(state.ids))
    best = np.maximum(state.chosen, 0)
    own = np.where(state.chosen >= 0, state.line[vehicle, best], -1)
    on_line = own >= 0
    drivable = scene.kind != Kind.PEDESTRIAN
    # A line just lost is looked for at once; what was off its lines already has time.
    due = (state.rest <= 0) | ((state.chosen >= 0) & ~on_line)
    astray = drivable & due & (~on_line | (state.now_m[vehicle, best] > OFF_M))
    short = np.zeros(len(vehicle), dtype=np.bool_)
    if on_line.any():
        safe = np.maximum(own, 0)
        left_m = (road.count[safe] - 1) * LINE_STEP_M - state.s_m[vehicle, best]
        short = drivable & on_line & ~astray & (left_m < RENEW_AHEAD_M)
    state = replace(state, rest=np.where(astray, REST_FRAMES, state.rest - 1))
    if not (astray | short).any():
        return state
    fields = {name: getattr(state, name).copy() for name in _PER_VEHICLE}
    lines_of: dict[int, list[int]] = {}
    for i in np.flatnonzero(astray | short).tolist():
        kind = Kind(int(scene.kind[i]))
        if astray[i]:
            near = road.lane_graph.near(scene.xy_m[i], float(scene.yaw_rad[i]), kind)
            prefixes = [road.lane_graph.prefix_to(name, kind) for name in near]
        else:
            s_now = float(state.s_m[i, best[i]]) - 0.5 * float(scene.size_m[i, 0])
            lane = road.lane_number(int(own[i]), s_now)
            if road.lines[own[i]].closed_end or lane == state.renewed[i]:
                continue  # there is no more of the road, or no more than was drawn on this lane
            fields["renewed"][i] = lane
            prefixes = [_undecided(road, int(own[i]), s_now)]
        lines_of[i] = list(dict.fromkeys(k for p in prefixes for k in road.branches(p, kind)))
        fields["line"][i] = -1
        fields["chosen"][i] = -1
    world = world_of(scene)
    for i, warped in _warped(road, tracks, scene, lines_of):
        cost, kept = warped.cost_m, warped.line
        nearest = np.sort(np.argsort(cost, kind="stable")[:MAX_CANDIDATES])
        order = nearest[_by_habit(road, habits[world[i]], kept[nearest])]
        count = len(order)
        for name in ("line", "s_m", "cost_m", "now_m", "d_m", "turned_rad"):
            fields[name][i, :count] = getattr(warped, name)[order]
        fields["weight_m"][i] = warped.weight_m
        if short[i]:
            fields["chosen"][i] = _same_course(road, int(own[i]), kept[order])
    return replace(state, **fields)


def _undecided(road: Road, line: int, s_m: float) -> Route:
    """The lanes of a line up to an arc length, without the junction that a vehicle is just in.

    So every way through it is still open.
    """
    route, start_s_m = road.trim(line, s_m), road.lines[line].lane_start_s_m
    now = int(np.searchsorted(start_s_m, s_m, side="right")) - 1
    end = len(route)
    while (
        end > 1
        and road.lanes[route[end - 1]].is_connection
        and s_m - float(start_s_m[now]) < DECIDED_M
    ):
        end, now = end - 1, now - 1
    return route[:end]


def _by_habit(road: Road, habits: Habits, line: IntArray) -> IntArray:
    """Lines [Q] in the order in which drivers would take them, fork by fork.

    At each fork the more usual connection comes first, and of equally usual ones the straight one:
    who leaves a roundabout at some exit passes all the exits before it.
    """
    known = np.isfinite(road.fork_s_m[line])
    nats = np.round(np.where(known, share_nats(habits, road.fork_lane[line]), 0.0), 6)
    turns = known & (road.fork_turn[line] != 0)
    keys = np.stack((turns.astype(np.float64), nats), axis=2)[:, ::-1]  # the last key counts first
    return np.lexsort(keys.reshape(len(line), 2 * known.shape[1]).T)


def _same_course(road: Road, own: int, candidates: IntArray) -> int:
    """The renewed candidate that runs on along the old choice, -1 if there is none."""
    old = road.lines[own].route
    for slot, index in enumerate(candidates.tolist()):
        route = road.lines[index].route
        tail = old[old.index(route[0]) :] if route[0] in old else ()
        if tail and route[: len(tail)] == tail[: len(route)]:
            return slot
    return -1


@dataclass(frozen=True, eq=False)
class _Warped:
    """What `LineState` holds of the candidates [C] of one vehicle."""

    line: IntArray
    s_m: FloatArray
    cost_m: FloatArray
    now_m: FloatArray
    d_m: FloatArray
    turned_rad: FloatArray
    weight_m: float


def _warped(
    road: Road, tracks: Tracks, scene: Scene, lines_of: Mapping[int, Sequence[int]]
) -> list[tuple[int, _Warped]]:
    """Of each vehicle's lines those near it now, by one warping of its last frames; all at once."""
    sizes = [len(found) for found in lines_of.values()]
    if not sum(sizes):
        return []
    line = np.array([k for found in lines_of.values() for k in found], dtype=np.int64)
    who = np.array([i for i, found in lines_of.items() if found], dtype=np.int64)
    of = np.repeat(np.arange(len(who)), [size for size in sizes if size])  # [C], into `who`
    frames = np.s_[who, -WARP_FRAMES:]
    yaw, valid = tracks.yaw_rad[frames], tracks.valid[frames]
    length_m = scene.size_m[who, 0]
    xy = _front_xy_m(tracks.xy_m[frames], yaw, length_m[:, None])
    reach_m = float(road.count[line].max()) * LINE_STEP_M
    s_now, d_now = road.search(line, xy[of, -1], np.zeros(len(line)), reach_m)
    near = np.abs(d_now) <= NEAR_M
    line, of, s_now = line[near], of[near], s_now[near]
    step_m = np.linalg.norm(np.diff(xy, axis=1), axis=2)
    behind_m = np.zeros(yaw.shape)
    behind_m[:, :-1] = np.cumsum(step_m[:, ::-1], axis=1)[:, ::-1]
    each = np.repeat(line, WARP_FRAMES)
    guess_m = (s_now[:, None] - behind_m[of]).ravel()
    s, d = road.project(each, xy[of].reshape(-1, 2), guess_m, 4.0)
    lengths_m = np.repeat(length_m[of], WARP_FRAMES)
    cost, turned = _foot_cost_m(road, each, yaw[of].ravel(), lengths_m, s, d)
    cost, turned, d = (a.reshape(len(line), WARP_FRAMES) for a in (cost, turned, d))
    weight = np.concatenate((np.zeros((len(who), 1)), step_m), axis=1)
    weight[np.arange(len(who)), valid.argmax(axis=1)] = FIRST_M
    weight = np.where(valid, weight * np.exp(-behind_m / RECENT_M), 0.0)
    total_m = weight.sum(axis=1)
    ends = np.searchsorted(of, np.arange(len(who) + 1))
    found: list[tuple[int, _Warped]] = []
    for k, i in enumerate(who.tolist()):
        own = slice(ends[k], ends[k + 1])
        warped = _Warped(
            line=line[own],
            s_m=s_now[own],
            cost_m=cost[own] @ weight[k] / total_m[k],
            now_m=cost[own, -1],
            d_m=d[own, -1],
            turned_rad=turned[own, -1],
            weight_m=float(total_m[k]),
        )
        found.append((i, warped))
    return found
