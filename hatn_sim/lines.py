"""Which reference line every vehicle follows, from what it did so far (METHOD section 1.1).

Of the candidates (`candidates.py`: lane paths near the vehicle, with the cost of warping its motion
onto them) the most likely one is chosen.

Scores are negative log likelihoods: of the motion, measured by how well the vehicle keeps to its
best line; of the blinker; and of the connection, from the habits of the traffic seen so far. Lines
through the same next connection are one choice, and the probability of a line is that of its
course through its next junction. Hysteresis does the rest.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from hatn_sim.candidates import WARP_FRAMES as WARP_FRAMES
from hatn_sim.candidates import LineState, advance, blank, renew
from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Lines, Route, Scene, Tracks
from hatn_sim.geometry import wrap_angle
from hatn_sim.habits import Habits, fresh_habits, learn, share_nats, silent_nats
from hatn_sim.road import LINE_STEP_M, Road

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


def empty_lines() -> LineState:
    """Nobody seen yet."""
    return blank((), None)


def follow_lines(
    state: LineState,
    road: Road,
    tracks: Tracks,
    scene: Scene,
    routes: tuple[Route | None, ...] | None = None,
) -> tuple[LineState, Lines]:
    """One frame on: the line of every vehicle. With `routes`, that of its route, not inferred."""
    moved = advance(state, road, tracks, scene)
    if routes is not None:
        moved = _take_routes(moved, road, scene, routes)
        probability = np.where(moved.line[:, 0] >= 0, 1.0, 0.0)
        return moved, _lines(moved, road, scene, probability)
    habits = state.habits or fresh_habits(road)
    moved = _spread(renew(moved, road, tracks, scene, habits), tracks)
    score, connection = _score(moved, road, scene, habits)
    moved = _choose(moved, score)
    moved = _learn(moved, road, scene, habits)
    return moved, _lines(moved, road, scene, _probability(moved, score, connection))


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


def _spread(state: LineState, tracks: Tracks) -> LineState:
    """How far vehicles keep from their best lines, with the newest frame."""
    now_m = np.where(state.line >= 0, state.now_m, np.inf).min(axis=1, initial=BLUNT_M)
    step_m = np.linalg.norm(tracks.xy_m[:, -1] - tracks.xy_m[:, -2], axis=1)
    kept = np.exp(-step_m / STEADY_M)
    spread_m = np.where(
        np.isnan(state.spread_m), now_m, kept * state.spread_m + (1.0 - kept) * now_m
    )
    return replace(state, spread_m=spread_m)


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
    nats += against * _nearness(away_m, BLINKER_REACH_M)
    nats += silent * _nearness(away_m, SILENT_REACH_M)
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
