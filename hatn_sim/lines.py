"""Which reference line every vehicle follows, from what it did so far (METHOD section 1.1).

Candidates are the lane paths near a vehicle, drawn out through every connection. Each is scored by
open-end dynamic time warping of the last three seconds of motion against it. A line is a curve
without a fork that is driven forwards, so the warping path is the projection carried forward from
frame to frame, and the warping cost is the sum of the costs at the feet: it is kept up to date with
one projection per candidate and frame. Frames weigh by the distance driven in them, the last metres
most: a vehicle that waits gives no evidence of where it will turn. Blinkers and hysteresis do the
rest.
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
from hatn_sim.road import AHEAD_M, LINE_STEP_M, NEAR_M, NEAR_RAD, Road
from hatn_sim.tracks import rows_before

MAX_CANDIDATES: Final = 24
WARP_FRAMES: Final = 31
"""Three seconds, now included."""
HEADING_COST_M: Final = 2.0
"""Cost of a heading error: lateral offset + 2 m (1 - cos error)."""
RECENT_M: Final = 4.0
"""Evidence fades by 1/e over this distance driven."""
STANDING_M: Final = 0.01
"""Weight of a frame in which the vehicle does not move."""
SWITCH_COST_M: Final = 0.05
"""Another line must be better by this much ..."""
SWITCH_FRAMES: Final = 3
"""... for this many frames."""
LOST_COST_M: Final = 1.0
"""A line worse than another by this much now is left at once."""
TEMPERATURE_M: Final = 0.15
BLINKER_COST_M: Final = 1.5
"""Against a blinker that is set."""
SILENT_COST_M: Final = 0.4
"""To turn without a blinker, close to the junction."""
BLINKER_REACH_M: Final = 60.0
SILENT_REACH_M: Final = 20.0
FORK_TIE_M: Final = 0.02
"""Lines that tie: prefer the one that leaves the common course last."""
RENEW_AHEAD_M: Final = 0.6 * AHEAD_M
"""Candidates are drawn anew when less than this is left ahead."""


@dataclass(frozen=True, eq=False)
class LineState:
    """Memory of the choice of lines; A candidates a vehicle, padded with -1."""

    ids: tuple[str, ...]  # [N]
    line: IntArray  # [N, A]
    s_m: FloatArray  # [N, A]
    cost_m: FloatArray  # [N, A, WARP_FRAMES] cost at the foot, nan before the vehicle was seen
    chosen: IntArray  # [N] candidate, -1: none
    doubted: IntArray  # [N] frames for which another candidate has been better
    renewed: IntArray  # [N] number of the lane on which the candidates were last drawn, -1: none


def empty_lines() -> LineState:
    return LineState(
        ids=(),
        line=np.zeros((0, MAX_CANDIDATES), dtype=np.int64),
        s_m=np.zeros((0, MAX_CANDIDATES)),
        cost_m=np.zeros((0, MAX_CANDIDATES, WARP_FRAMES)),
        chosen=np.zeros(0, dtype=np.int64),
        doubted=np.zeros(0, dtype=np.int64),
        renewed=np.zeros(0, dtype=np.int64),
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
        moved = _take_routes(moved, road, tracks, routes)
        probability = np.where(moved.line[:, 0] >= 0, 1.0, 0.0)[:, None]
        return moved, _lines(moved, road, scene, probability)
    moved = _renew(moved, road, tracks, scene)
    score = _score(moved, road, tracks, scene)
    moved = _choose(moved, score)
    return moved, _lines(moved, road, scene, _probabilities(moved, score))


def _advance(state: LineState, road: Road, tracks: Tracks, scene: Scene) -> LineState:
    """Carry every candidate's foot point forward to the newest frame and note its cost."""
    rows = rows_before(state.ids, tracks.ids)
    known, source = rows >= 0, np.maximum(rows, 0)
    count = len(rows)
    line = np.full((count, MAX_CANDIDATES), -1, dtype=np.int64)
    s_m = np.zeros((count, MAX_CANDIDATES))
    cost = np.full((count, MAX_CANDIDATES, WARP_FRAMES), np.nan)
    chosen = np.full(count, -1, dtype=np.int64)
    doubted = np.zeros(count, dtype=np.int64)
    renewed = np.full(count, -1, dtype=np.int64)
    if known.any():
        before = source[known]
        line[known], s_m[known] = state.line[before], state.s_m[before]
        cost[known, :, :-1] = state.cost_m[before, :, 1:]
        chosen[known], doubted[known] = state.chosen[before], state.doubted[before]
        renewed[known] = state.renewed[before]
    vehicle, slot = np.nonzero(line >= 0)
    if len(vehicle):
        step_m = np.linalg.norm(tracks.xy_m[:, -1] - tracks.xy_m[:, -2], axis=1)[vehicle]
        at = line[vehicle, slot]
        xy = tracks.xy_m[vehicle, -1]
        s, d = road.track(at, xy, s_m[vehicle, slot] + step_m)
        s = np.maximum(s, s_m[vehicle, slot] - 0.5)  # time warping never runs backwards
        s_m[vehicle, slot] = s
        yaw = tracks.yaw_rad[vehicle, -1]
        turned = yaw - road.line_yaw_rad(at, s)
        length_m = scene.size_m[vehicle, 0]
        cost[vehicle, slot, -1] = _foot_cost_m(road, at, xy, yaw, length_m, s, d)
        off = (np.abs(d) > NEAR_M) | (np.abs(wrap_angle(turned)) > NEAR_RAD)
        line[vehicle[off], slot[off]] = -1
    return LineState(tracks.ids, line, s_m, cost, chosen, doubted, renewed)


def _foot_cost_m(
    road: Road,
    line: IntArray,
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    length_m: FloatArray,
    s_m: FloatArray,
    d_m: FloatArray,
) -> FloatArray:
    """Cost [Q] of poses whose feet are at s, d: mean offset of centre and front, and the heading.

    The front of a vehicle shows first where it turns.
    """
    heading = np.stack((np.cos(yaw_rad), np.sin(yaw_rad)), axis=1)
    front_xy = xy_m + 0.5 * length_m[:, None] * heading
    _, front_d = road.track(line, front_xy, s_m + 0.5 * length_m)
    turned = yaw_rad - road.line_yaw_rad(line, s_m)
    offset = 0.5 * (np.abs(d_m) + np.abs(front_d))
    return offset + HEADING_COST_M * (1.0 - np.cos(turned))


def _take_routes(
    state: LineState, road: Road, tracks: Tracks, routes: tuple[Route | None, ...]
) -> LineState:
    """Route mode: the only candidate is the line of the simulator's route."""
    line = np.full_like(state.line, -1)
    line[:, 0] = [-1 if route is None else road.line(route) for route in routes]
    s_m = state.s_m.copy()
    new = np.flatnonzero((line[:, 0] >= 0) & (line[:, 0] != state.line[:, 0]))
    if len(new):
        length_m = float(road.count[line[new, 0]].max()) * LINE_STEP_M
        s_m[new, 0], _ = road.search(
            line[new, 0], tracks.xy_m[new, -1], np.zeros(len(new)), length_m
        )
    chosen = np.where(line[:, 0] >= 0, 0, -1)
    return replace(state, line=line, s_m=s_m, chosen=chosen)


def _renew(state: LineState, road: Road, tracks: Tracks, scene: Scene) -> LineState:
    """Draw candidates for newcomers, for vehicles off their lines and for lines that run out."""
    alive = (state.line >= 0).any(axis=1)
    has_choice = state.chosen >= 0
    vehicle = np.arange(len(state.ids))
    best = np.maximum(state.chosen, 0)
    own = np.where(has_choice, state.line[vehicle, best], -1)
    on_line = own >= 0
    safe = np.maximum(own, 0)
    off_m = np.where(on_line, state.cost_m[vehicle, best, -1], np.inf)
    drivable = scene.kind != Kind.PEDESTRIAN
    # Half a lane off: another lane may be the nearer one by now (a lane change).
    astray = drivable & (~alive | ~on_line | (off_m > 1.7))
    if len(road.count):
        left_m = (road.count[safe] - 1) * LINE_STEP_M - state.s_m[vehicle, best]
        short = drivable & on_line & (left_m < RENEW_AHEAD_M)
    else:
        short = np.zeros(len(vehicle), dtype=np.bool_)
    if not (astray | short).any():
        return state
    line, s_m, cost = state.line.copy(), state.s_m.copy(), state.cost_m.copy()
    chosen, renewed = state.chosen.copy(), state.renewed.copy()
    for i in np.flatnonzero(astray | short).tolist():
        kind = Kind(int(scene.kind[i]))
        if not astray[i]:
            lane = road.lane_number(int(own[i]), float(state.s_m[i, best[i]]))
            if road.lines[own[i]].closed_end or lane == state.renewed[i]:
                continue  # there is no more of the road, or no more than was drawn on this lane
            renewed[i] = lane
        if astray[i]:
            prefixes = [
                road.prefix_to(name, kind)
                for name in road.lanes_near(scene.xy_m[i], float(scene.yaw_rad[i]), kind)
            ]
        else:
            prefixes = [road.trim(int(own[i]), float(state.s_m[i, best[i]]))]
        found = list(dict.fromkeys(k for p in prefixes for k in road.branches(p, kind)))
        if not found:
            line[i], chosen[i] = -1, -1
            continue
        length_m = float(scene.size_m[i, 0])
        kept, new_s, new_cost = _warp(road, tracks, i, length_m, np.array(found, dtype=np.int64))
        order = np.argsort(np.nanmean(new_cost, axis=1), kind="stable")[:MAX_CANDIDATES]
        kept, new_s, new_cost = kept[order], new_s[order], new_cost[order]
        line[i], s_m[i], cost[i] = -1, 0.0, np.nan
        line[i, : len(kept)] = kept
        s_m[i, : len(kept)], cost[i, : len(kept)] = new_s, new_cost
        chosen[i] = _same_course(road, state, i, kept) if short[i] and not astray[i] else -1
    return replace(state, line=line, s_m=s_m, cost_m=cost, chosen=chosen, renewed=renewed)


def _same_course(road: Road, state: LineState, vehicle: int, candidates: IntArray) -> int:
    """The renewed candidate that runs on along the old choice, -1 if there is none."""
    old = road.lines[int(state.line[vehicle, state.chosen[vehicle]])].route
    for slot, index in enumerate(candidates.tolist()):
        route = road.lines[index].route
        shared = [lane for lane in old if lane in route]
        tail = old[old.index(route[0]) :] if route[0] in old else ()
        if shared and tail and route[: len(tail)] == tail[: len(route)]:
            return slot
    return -1


def _warp(
    road: Road, tracks: Tracks, vehicle: int, length_m: float, candidates: IntArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Candidates near the vehicle now, with s and the cost of the last frames, by one warping."""
    xy = tracks.xy_m[vehicle, -WARP_FRAMES:]
    yaw = tracks.yaw_rad[vehicle, -WARP_FRAMES:]
    valid = tracks.valid[vehicle, -WARP_FRAMES:]
    many = len(candidates)
    reach_m = float(road.count[candidates].max()) * LINE_STEP_M
    s_now, d_now = road.search(candidates, np.repeat(xy[-1:], many, 0), np.zeros(many), reach_m)
    near = np.abs(d_now) <= NEAR_M
    candidates, s_now = candidates[near], s_now[near]
    steps = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    behind_m = np.concatenate((np.cumsum(steps[::-1])[::-1], [0.0]))
    guess = (s_now[:, None] - behind_m).ravel()
    line = np.repeat(candidates, WARP_FRAMES)
    all_xy, all_yaw = np.tile(xy, (len(candidates), 1)), np.tile(yaw, len(candidates))
    s, d = road.project(line, all_xy, guess, 4.0)
    cost = _foot_cost_m(road, line, all_xy, all_yaw, np.full(len(line), length_m), s, d)
    cost = np.where(np.tile(valid, len(candidates)), cost, np.nan)
    return candidates, s_now, cost.reshape(len(candidates), WARP_FRAMES)


def _score(state: LineState, road: Road, tracks: Tracks, scene: Scene) -> FloatArray:
    """Warping cost [N, A] in metres plus the priors; inf where there is no candidate."""
    score = np.full(state.line.shape, np.inf)
    vehicle, slot = np.nonzero(state.line >= 0)
    if not len(vehicle):
        return score
    cost = state.cost_m[vehicle, slot]
    seen = np.isfinite(cost)
    weight = np.where(seen, _evidence(tracks)[vehicle], 0.0)
    mean = (np.where(seen, cost, 0.0) * weight).sum(axis=1) / weight.sum(axis=1)
    line = state.line[vehicle, slot]
    s = state.s_m[vehicle, slot] + 0.5 * scene.size_m[vehicle, 0]  # drivers signal from the front
    to_fork = road.fork_s_m[line] - s[:, None]  # [Q, forks]
    ahead = road.fork_end_s_m[line] > s[:, None]
    first = np.argmax(ahead, axis=1)
    rows = np.arange(len(line))
    distance = np.where(ahead.any(axis=1), to_fork[rows, first], np.inf)
    turn = road.fork_turn[line, first]
    blinker = scene.blinker[vehicle]
    against = (blinker != 0) & (turn != blinker) & (distance < BLINKER_REACH_M)
    silent = (blinker == 0) & (turn != 0) & (distance > 0) & (distance < SILENT_REACH_M)
    turns = (road.fork_turn[line] != 0) & ahead & (to_fork < AHEAD_M)
    tie = np.where(turns, 1.0 - np.maximum(to_fork, 0.0) / AHEAD_M, 0.0).sum(axis=1)
    score[vehicle, slot] = (
        mean + BLINKER_COST_M * against + SILENT_COST_M * silent + FORK_TIE_M * tie
    )
    return score


def _evidence(tracks: Tracks) -> FloatArray:
    """Weight [N, WARP_FRAMES] of each frame: distance driven in it, fading with that since."""
    xy = tracks.xy_m[:, -WARP_FRAMES - 1 :]
    step_m = np.linalg.norm(np.diff(xy, axis=1), axis=2)
    since_m = np.cumsum(step_m[:, ::-1], axis=1)[:, ::-1] - step_m
    return (step_m + STANDING_M) * np.exp(-since_m / RECENT_M)


def _choose(state: LineState, score: FloatArray) -> LineState:
    """The best candidate, with hysteresis."""
    rows = np.arange(len(state.ids))
    best = score.argmin(axis=1) if score.size else np.zeros(0, dtype=np.int64)
    some = np.isfinite(score[rows, best])
    own = np.maximum(state.chosen, 0)
    lost = (state.chosen < 0) | ~np.isfinite(score[rows, own])
    gain = np.where(lost | ~some, 0.0, score[rows, own] - np.where(some, score[rows, best], 0.0))
    now = np.nan_to_num(state.cost_m[rows, own, -1] - state.cost_m[rows, best, -1])
    doubted = np.where((gain > SWITCH_COST_M) & ~lost, state.doubted + 1, 0)
    switch = lost | (doubted >= SWITCH_FRAMES) | ((now > LOST_COST_M) & (gain > 0))
    chosen = np.where(some, np.where(switch, best, state.chosen), -1)
    doubted = np.where(switch, 0, doubted)
    return replace(state, chosen=chosen, doubted=doubted)


def _probabilities(state: LineState, score: FloatArray) -> FloatArray:
    """Softmax [N, A] of the scores."""
    some = np.isfinite(score)
    low = np.where(some.any(axis=1), np.min(np.where(some, score, np.inf), axis=1), 0.0)
    weight = np.where(some, np.exp(-(np.where(some, score, 0.0) - low[:, None]) / TEMPERATURE_M), 0)
    return weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)


def _lines(state: LineState, road: Road, scene: Scene, probability: FloatArray) -> Lines:
    rows = np.arange(len(state.ids))
    own = np.maximum(state.chosen, 0)
    line = np.where(state.chosen >= 0, state.line[rows, own], -1)
    on: BoolArray = line >= 0
    s, d, phi = state.s_m[rows, own], np.zeros(len(rows)), np.zeros(len(rows))
    chance = np.zeros(len(rows))
    if on.any():
        s_on, d_on = road.track(line[on], scene.xy_m[on], s[on])
        s[on], d[on] = s_on, d_on
        phi[on] = wrap_angle(scene.yaw_rad[on] - road.line_yaw_rad(line[on], s_on))
        chance[on] = probability[rows, np.minimum(own, probability.shape[1] - 1)][on]
    return Lines(line=line, s_m=s, d_m=d, phi_rad=phi, probability=chance)
