"""Which reference line every vehicle follows, from what it did so far (METHOD section 1.1).

Candidates are the lane paths near a vehicle, drawn out through every connection. Each is scored by
open-end dynamic time warping of the motion so far against it. A line is a curve without a fork
that is driven forwards, so the warping path is the projection carried forward from frame to frame,
and the warping cost is a mean of the costs at the feet, kept up to date with one projection per
candidate and frame. It is the front that is projected: it shows first where a vehicle turns. Frames
weigh by the distance driven in them, the last metre most: a vehicle that waits gives no evidence of
where it will turn.

Scores are negative log likelihoods: of the motion, measured by how well the vehicle keeps to its
best line; of the blinker; and of the connection, from the habits of the traffic seen so far. Lines
through the same next connection are one choice, and the probability of a line is that of its
course through its next junction. Hysteresis does the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hatn_sim.datatypes import (
    BoolArray,
    FloatArray,
    IntArray,
    Kind,
    Lines,
    Route,
    Scene,
    Tracks,
)
from hatn_sim.geometry import wrap_angle
from hatn_sim.habits import Habits, fresh_habits, learn, share_nats, silent_nats
from hatn_sim.road import AHEAD_M, LINE_STEP_M, NEAR_M, NEAR_RAD, Road
from hatn_sim.tracks import rows_before

MAX_CANDIDATES: Final = 24
WARP_FRAMES: Final = 31
"""New candidates are held against the last three seconds, now included."""
HEADING_COST_M: Final = 2.0
"""Cost of a heading error: lateral offset + 2 m (1 - cos error)."""
RECENT_M: Final = 0.5
"""Evidence fades by 1/e over this distance driven."""
FIRST_M: Final = 0.01
"""Weight of the first frame of a vehicle: all there is of one that never moved."""
SHARP_M: Final = 0.005
BLUNT_M: Final = 0.3
STEADY_M: Final = 10.0
"""An extra cost makes a line e times less likely if it is as large as what the vehicle's best lines
have cost over the last metres (fading by 1/e over the latter distance), between these bounds."""
SWITCH_NATS: Final = 0.4
"""Another line must be better by this much ..."""
SWITCH_FRAMES: Final = 3
"""... for this many frames ..."""
SURE_NATS: Final = 1.5
"""... or by this much at once."""
EQUAL_NATS: Final = 1e-3
"""Lines this near to each other tie, whatever the last digits say."""
IDLE_BLINKER_NATS: Final = 4.0
"""To signal and drive straight on (a change of lanes, a forgotten blinker) ..."""
WRONG_BLINKER_NATS: Final = 5.0
"""... or to turn the other way."""
BLINKER_REACH_M: Final = (60.0, 100.0)
"""A blinker tells all of a connection nearer than this, and nothing of one further away than that.
"""
SILENT_REACH_M: Final = (20.0, 60.0)
"""The same of one that is not set."""
OFF_M: Final = 1.7
"""Half a lane off: another lane may be the nearer one by now (a change of lanes)."""
REST_FRAMES: Final = 5
"""After a search for candidates near a vehicle that is off its lines."""
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
    weight_m: FloatArray  # [N] of the frames in `cost_m`
    spread_m: FloatArray  # [N] what the best line costs: how far the vehicle keeps from lines
    chosen: IntArray  # [N] candidate, -1: none
    doubted: IntArray  # [N] frames for which another candidate has been better
    renewed: IntArray  # [N] number of the lane on which the candidates were last drawn, -1: none
    rest: IntArray  # [N] frames until the next search for candidates near the vehicle
    inside: IntArray  # [N] number of the connection under the front, -1: none
    habits: Habits | None  # None: nobody seen yet


def empty_lines() -> LineState:
    return _blank((), None)


def _blank(ids: tuple[str, ...], habits: Habits | None) -> LineState:
    count = len(ids)
    shape = (count, MAX_CANDIDATES)
    return LineState(
        ids=ids,
        line=np.full(shape, -1, dtype=np.int64),
        s_m=np.zeros(shape),
        cost_m=np.zeros(shape),
        now_m=np.zeros(shape),
        weight_m=np.zeros(count),
        spread_m=np.full(count, np.nan),
        chosen=np.full(count, -1, dtype=np.int64),
        doubted=np.zeros(count, dtype=np.int64),
        renewed=np.full(count, -1, dtype=np.int64),
        rest=np.zeros(count, dtype=np.int64),
        inside=np.full(count, -1, dtype=np.int64),
        habits=habits,
    )


def follow_lines(
    state: LineState,
    road: Road,
    tracks: Tracks,
    scene: Scene,
    routes: tuple[Route | None, ...] | None = None,
) -> tuple[LineState, Lines]:
    """One frame on: the line of every vehicle. With `routes`, that of its route, not inferred."""
    moved = _advance(state, road, tracks, scene)
    if routes is not None:
        moved = _take_routes(moved, road, scene, routes)
        probability = np.where(moved.line[:, 0] >= 0, 1.0, 0.0)
        return moved, _lines(moved, road, scene, probability)
    habits = state.habits or fresh_habits(road)
    moved = _spread(_renew(moved, road, tracks, scene, habits), tracks)
    score, connection = _score(moved, road, scene, habits)
    moved = _choose(moved, score)
    moved = _learn(moved, road, scene, habits)
    return moved, _lines(moved, road, scene, _probability(moved, score, connection))


def _advance(state: LineState, road: Road, tracks: Tracks, scene: Scene) -> LineState:
    """Carry every candidate's foot point forward to the newest frame and add its cost."""
    rows = rows_before(state.ids, tracks.ids)
    if state.ids == tracks.ids:
        moved = replace(state, line=state.line.copy())
    else:
        moved = _blank(tracks.ids, state.habits)
        known = rows >= 0
        before = rows[known]
        for name in _PER_VEHICLE:
            getattr(moved, name)[known] = getattr(state, name)[before]
    step_m = np.linalg.norm(tracks.xy_m[:, -1] - tracks.xy_m[:, -2], axis=1)
    faded_m = moved.weight_m * np.exp(-step_m / RECENT_M)
    weight_m = faded_m + step_m
    vehicle, slot = np.nonzero(moved.line >= 0)
    if not len(vehicle):
        return replace(moved, weight_m=weight_m)
    s_m, cost_m, now_m = moved.s_m.copy(), moved.cost_m.copy(), moved.now_m.copy()
    at = moved.line[vehicle, slot]
    front_xy = _front_xy_m(scene.xy_m, scene.yaw_rad, scene.size_m[:, 0])
    s, d = road.track(at, front_xy[vehicle], s_m[vehicle, slot] + step_m[vehicle])
    s = np.maximum(s, s_m[vehicle, slot] - 0.5)  # time warping never runs backwards
    now, turned = _foot_cost_m(road, at, scene.yaw_rad[vehicle], scene.size_m[vehicle, 0], s, d)
    s_m[vehicle, slot], now_m[vehicle, slot] = s, now
    total = cost_m[vehicle, slot] * faded_m[vehicle] + now * step_m[vehicle]
    cost_m[vehicle, slot] = total / np.maximum(weight_m[vehicle], 1e-9)
    off = (np.abs(d) > NEAR_M) | (np.abs(turned) > NEAR_RAD)
    moved.line[vehicle[off], slot[off]] = -1
    return replace(moved, s_m=s_m, cost_m=cost_m, now_m=now_m, weight_m=weight_m)


_PER_VEHICLE: Final = (
    "line",
    "s_m",
    "cost_m",
    "now_m",
    "weight_m",
    "spread_m",
    "chosen",
    "doubted",
    "renewed",
    "rest",
    "inside",
)


def _front_xy_m(xy_m: FloatArray, yaw_rad: FloatArray, length_m: FloatArray) -> FloatArray:
    """Middle of the front [N, 2] of boxes [N]."""
    heading = np.stack((np.cos(yaw_rad), np.sin(yaw_rad)), axis=1)
    return xy_m + 0.5 * length_m[:, None] * heading


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


def _take_routes(
    state: LineState, road: Road, scene: Scene, routes: tuple[Route | None, ...]
) -> LineState:
    """Route mode: the only candidate is the line of the simulator's route."""
    line = np.full_like(state.line, -1)
    line[:, 0] = [-1 if route is None else road.line(route) for route in routes]
    s_m = state.s_m.copy()
    new = np.flatnonzero((line[:, 0] >= 0) & (line[:, 0] != state.line[:, 0]))
    if len(new):
        length_m = float(road.count[line[new, 0]].max()) * LINE_STEP_M
        s_m[new, 0], _ = road.search(line[new, 0], scene.xy_m[new], np.zeros(len(new)), length_m)
        s_m[new, 0] += 0.5 * scene.size_m[new, 0]
    chosen = np.where(line[:, 0] >= 0, 0, -1)
    return replace(state, line=line, s_m=s_m, chosen=chosen)


def _renew(state: LineState, road: Road, tracks: Tracks, scene: Scene, habits: Habits) -> LineState:
    """Draw candidates for newcomers, for vehicles off their lines and for lines that run out."""
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
    for i in np.flatnonzero(astray | short).tolist():
        kind = Kind(int(scene.kind[i]))
        if astray[i]:
            near = road.lanes_near(scene.xy_m[i], float(scene.yaw_rad[i]), kind)
            prefixes = [road.prefix_to(name, kind) for name in near]
        else:
            s_now = float(state.s_m[i, best[i]]) - 0.5 * float(scene.size_m[i, 0])
            lane = road.lane_number(int(own[i]), s_now)
            if road.lines[own[i]].closed_end or lane == state.renewed[i]:
                continue  # there is no more of the road, or no more than was drawn on this lane
            fields["renewed"][i] = lane
            prefixes = [_before_junction(road, road.trim(road.lines[own[i]].route, s_now))]
        found = list(dict.fromkeys(k for p in prefixes for k in road.branches(p, kind)))
        fields["line"][i] = -1
        fields["chosen"][i] = -1
        if not found:
            continue
        kept, s, cost, now, weight_m = _warp(
            road, tracks, i, float(scene.size_m[i, 0]), np.array(found, dtype=np.int64)
        )
        nearest = np.sort(np.argsort(cost, kind="stable")[:MAX_CANDIDATES])
        usual = np.argsort(_unusual_nats(road, habits, kept[nearest]), kind="stable")
        order = nearest[usual]
        count = len(order)
        fields["line"][i, :count], fields["s_m"][i, :count] = kept[order], s[order]
        fields["cost_m"][i, :count], fields["now_m"][i, :count] = cost[order], now[order]
        fields["weight_m"][i] = weight_m
        if short[i]:
            fields["chosen"][i] = _same_course(road, int(own[i]), kept[order])
    return replace(state, **fields)


def _spread(state: LineState, tracks: Tracks) -> LineState:
    """How far vehicles keep from their best lines, with the newest frame."""
    now_m = np.where(state.line >= 0, state.now_m, np.inf).min(axis=1, initial=BLUNT_M)
    step_m = np.linalg.norm(tracks.xy_m[:, -1] - tracks.xy_m[:, -2], axis=1)
    kept = np.exp(-step_m / STEADY_M)
    spread_m = np.where(
        np.isnan(state.spread_m), now_m, kept * state.spread_m + (1.0 - kept) * now_m
    )
    return replace(state, spread_m=spread_m)


def _before_junction(road: Road, route: Route) -> Route:
    """A route cut back to before the junction that it ends in, so that every way is still open."""
    end = len(route)
    while end > 1 and road.lanes[route[end - 1]].is_connection:
        end -= 1
    return route[:end]


def _unusual_nats(road: Road, habits: Habits, line: IntArray) -> FloatArray:
    """-log likelihood [Q] of all the connections of lines [Q]."""
    nats = share_nats(habits, road.fork_lane[line])
    known = np.isfinite(road.fork_s_m[line])
    return np.round(np.where(known, nats, 0.0).sum(axis=1), 6)


def _same_course(road: Road, own: int, candidates: IntArray) -> int:
    """The renewed candidate that runs on along the old choice, -1 if there is none."""
    old = road.lines[own].route
    for slot, index in enumerate(candidates.tolist()):
        route = road.lines[index].route
        tail = old[old.index(route[0]) :] if route[0] in old else ()
        if tail and route[: len(tail)] == tail[: len(route)]:
            return slot
    return -1


def _warp(
    road: Road, tracks: Tracks, vehicle: int, length_m: float, candidates: IntArray
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, float]:
    """Candidates near the vehicle now, by one warping of its last frames.

    Returns the candidates [C], s [C], the mean cost [C], the cost now [C] and the weight of the
    mean.
    """
    yaw = tracks.yaw_rad[vehicle, -WARP_FRAMES:]
    lengths_m = np.full(WARP_FRAMES, length_m)
    xy = _front_xy_m(tracks.xy_m[vehicle, -WARP_FRAMES:], yaw, lengths_m)
    valid = tracks.valid[vehicle, -WARP_FRAMES:]
    many = len(candidates)
    reach_m = float(road.count[candidates].max()) * LINE_STEP_M
    s_now, d_now = road.search(candidates, np.repeat(xy[-1:], many, 0), np.zeros(many), reach_m)
    near = np.abs(d_now) <= NEAR_M
    candidates, s_now = candidates[near], s_now[near]
    step_m = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    behind_m = np.concatenate((np.cumsum(step_m[::-1])[::-1], [0.0]))
    line = np.repeat(candidates, WARP_FRAMES)
    all_xy, all_yaw = np.tile(xy, (len(candidates), 1)), np.tile(yaw, len(candidates))
    s, d = road.project(line, all_xy, (s_now[:, None] - behind_m).ravel(), 4.0)
    cost, _ = _foot_cost_m(road, line, all_yaw, np.tile(lengths_m, len(candidates)), s, d)
    cost = cost.reshape(-1, WARP_FRAMES)
    weight = np.concatenate(([0.0], step_m))
    weight[np.argmax(valid)] = FIRST_M
    weight = np.where(valid, weight * np.exp(-behind_m / RECENT_M), 0.0)
    total_m = float(weight.sum())
    return candidates, s_now, cost @ weight / total_m, cost[:, -1], total_m


def _score(
    state: LineState, road: Road, scene: Scene, habits: Habits
) -> tuple[FloatArray, IntArray]:
    """-log likelihood [N, A], inf where there is no candidate; and each one's next connection.

    Where there is no connection ahead, the number stands for the line itself.
    """
    score = np.full(state.line.shape, np.inf)
    connection = np.full(state.line.shape, -1, dtype=np.int64)
    vehicle, slot = np.nonzero(state.line >= 0)
    if not len(vehicle):
        return score, connection
    line = state.line[vehicle, slot]
    front_m = state.s_m[vehicle, slot]
    first = (road.fork_end_s_m[line] <= front_m[:, None]).sum(axis=1)
    first = np.minimum(first, road.fork_s_m.shape[1] - 1)
    away_m = road.fork_s_m[line, first] - front_m
    ahead = np.isfinite(away_m)
    turn, lane = road.fork_turn[line, first], road.fork_lane[line, first]

    nats = state.cost_m[vehicle, slot] / np.maximum(state.spread_m, SHARP_M)[vehicle]
    blinker = scene.blinker[vehicle]
    against = np.where(turn == 0, IDLE_BLINKER_NATS, WRONG_BLINKER_NATS)
    against = np.where((blinker != 0) & (turn != blinker), against, 0.0)
    silent = np.where((blinker == 0) & (turn != 0), silent_nats(habits), 0.0)
    nats += against * _nearness(away_m, BLINKER_REACH_M) + silent * _nearness(
        away_m, SILENT_REACH_M
    )
    nats += np.where(ahead, share_nats(habits, lane), 0.0)
    score[vehicle, slot] = nats
    connection[vehicle, slot] = np.where(ahead, lane, -2 - line)
    return score, connection


def _nearness(away_m: FloatArray, reach_m: tuple[float, float]) -> FloatArray:
    """1 up to the first distance, falling to 0 at the second."""
    return np.clip((reach_m[1] - away_m) / (reach_m[1] - reach_m[0]), 0.0, 1.0)


def _choose(state: LineState, score: FloatArray) -> LineState:
    """The best candidate, with hysteresis. Among equals it is the first, the most usual one."""
    rows = np.arange(len(state.ids))
    least = np.min(score, axis=1, initial=np.inf)
    best = (score <= least[:, None] + EQUAL_NATS).argmax(axis=1)
    some = np.isfinite(score[rows, best])
    own = np.maximum(state.chosen, 0)
    lost = (state.chosen < 0) | ~np.isfinite(score[rows, own])
    gain = np.zeros(len(rows))
    both = some & ~lost
    gain[both] = score[rows, own][both] - score[rows, best][both]
    doubted = np.where(gain > SWITCH_NATS, state.doubted + 1, 0)
    switch = lost | (doubted >= SWITCH_FRAMES) | (gain > SURE_NATS)
    chosen = np.where(some, np.where(switch, best, state.chosen), -1)
    return replace(state, chosen=chosen, doubted=np.where(switch, 0, doubted))


def _probability(state: LineState, score: FloatArray, connection: IntArray) -> FloatArray:
    """Softmax [N] over the next connections of the candidates: that of the chosen one's."""
    rows, own = np.arange(len(state.ids)), np.maximum(state.chosen, 0)
    some = state.chosen >= 0
    low = np.where(some, np.min(score, axis=1, initial=np.inf), 0.0)
    weight = np.where(np.isfinite(score), np.exp(low[:, None] - score), 0.0)
    same = (connection[:, :, None] == connection[:, None, :]) & (weight[:, None, :] > 0)
    weight /= np.maximum(same.sum(axis=2), 1)
    mine = (weight * same[rows, own]).sum(axis=1)
    return np.where(some, mine / np.maximum(weight.sum(axis=1), 1e-12), 0.0)


def _learn(state: LineState, road: Road, scene: Scene, habits: Habits) -> LineState:
    """Note the connections that vehicles come to the end of, and who signals on them."""
    rows = np.arange(len(state.ids))
    own = np.maximum(state.chosen, 0)
    on = np.flatnonzero(state.chosen >= 0)
    line = state.line[rows, own][on]
    inside = np.full(len(rows), -1, dtype=np.int64)
    if not len(on):
        return replace(state, inside=inside, habits=habits)
    front_m = state.s_m[rows, own][on, None]
    past = road.fork_end_s_m[line] <= front_m
    under = ~past & (road.fork_s_m[line] <= front_m)
    fork, is_in = under.argmax(axis=1), under.any(axis=1)
    lane = road.fork_lane[line]
    inside[on] = np.where(is_in, lane[np.arange(len(on)), fork], -1)
    left: BoolArray = ((lane == state.inside[on, None]) & past).any(axis=1)
    turn = np.where(is_in, road.fork_turn[line, fork], 0)
    habits = learn(habits, state.inside[on][left], turn[turn != 0], scene.blinker[on][turn != 0])
    return replace(state, inside=inside, habits=habits)


def _lines(state: LineState, road: Road, scene: Scene, probability: FloatArray) -> Lines:
    rows = np.arange(len(state.ids))
    own = np.maximum(state.chosen, 0)
    line = np.where(state.chosen >= 0, state.line[rows, own], -1)
    on: BoolArray = line >= 0
    s = state.s_m[rows, own] - 0.5 * scene.size_m[:, 0]
    d, phi = np.zeros(len(rows)), np.zeros(len(rows))
    if on.any():
        s_on, d_on = road.track(line[on], scene.xy_m[on], s[on])
        s[on], d[on] = s_on, d_on
        phi[on] = wrap_angle(scene.yaw_rad[on] - road.line_yaw_rad(line[on], s_on))
    return Lines(line=line, s_m=s, d_m=d, phi_rad=phi, probability=np.where(on, probability, 0.0))
