"""Which reference line every vehicle follows, from what it did so far (METHOD section 1.1).

Of the candidates (`candidates.py`: lane paths near the vehicle, with the cost of warping its motion
onto them) the most likely one is chosen.

Scores are negative log likelihoods: of the motion, measured by how well the vehicle keeps to its
best line; of the blinker; and of the connection, from the habits of the traffic seen so far. Lines
through the same next connection are one choice, and the probability of a line is that of its
course through its next junction. Hysteresis does the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from hatn_sim.candidates import WARP_FRAMES as WARP_FRAMES
from hatn_sim.candidates import LineState, advance, blank, renew
from hatn_sim.datatypes import BoolArray, FloatArray, Lines, Route, Scene, Tracks
from hatn_sim.geometry import wrap_angle
from hatn_sim.habits import Habits, fresh_habits, learn
from hatn_sim.line_choice import HAND_MADE_CHOICE, LineChoice, shipped_line_choice
from hatn_sim.line_features import BLUNT_M, Evidence, collect_evidence, line_features
from hatn_sim.road import LINE_STEP_M, Road
from hatn_sim.worlds import Worlds, ids_joined, joined, part, world_of

STEADY_M: Final = 10.0
"""How far a vehicle keeps from its best lines fades by 1/e over this distance."""
SWITCH_NATS: Final = 0.4
"""Another line must be better by this much ..."""
SWITCH_FRAMES: Final = 3
"""... for this many frames ..."""
SURE_NATS: Final = 1.5
"""... or by this much at once."""
EQUAL_NATS: Final = 1e-3
"""Lines this near to each other tie, whatever the last digits say."""


def empty_lines() -> LineState:
    """Nobody seen yet."""
    return blank((), None)


def follow_lines(
    state: LineState,
    road: Road,
    tracks: Tracks,
    scene: Scene,
    routes: tuple[Route | None, ...] | None = None,
    choice: LineChoice | None = None,
) -> tuple[LineState, Lines]:
    """One frame on: the line of every vehicle. With `routes`, that of its route, not inferred.

    Candidates are scored by `choice`; None: the one that ships.
    """
    choice = choice or shipped_line_choice()
    moved, lines, (habits,) = _follow(state, [state.habits], road, tracks, scene, routes, choice)
    return replace(moved, habits=habits), lines


def follow_all(
    states: Sequence[LineState],
    road: Road,
    tracks: Tracks,
    scene: Worlds,
    routes: tuple[Route | None, ...] | None,
    choice: LineChoice,
) -> tuple[list[LineState], Lines]:
    """What `follow_lines` gives of each of several worlds on one road, the lines one after another.

    `tracks`, `scene` and `routes` are those of all.
    """
    ids = ids_joined([state.ids for state in states])
    state = joined(LineState, states, ids=ids, habits=None)
    known = [one.habits for one in states]
    moved, lines, habits = _follow(state, known, road, tracks, scene, routes, choice)
    road.touch(moved.line)
    after = [
        part(moved, rows, ids=one.ids, habits=own)
        for one, rows, own in zip(scene.scenes, scene.rows, habits, strict=True)
    ]
    return after, lines


def _follow(
    state: LineState,
    known: Sequence[Habits | None],
    road: Road,
    tracks: Tracks,
    scene: Scene,
    routes: tuple[Route | None, ...] | None,
    choice: LineChoice,
) -> tuple[LineState, Lines, Sequence[Habits | None]]:
    """One frame on in worlds with habits of their own."""
    moved = advance(state, road, tracks, scene)
    if routes is not None:
        moved = _take_routes(moved, road, scene, routes)
        probability = np.where(moved.line[:, 0] >= 0, 1.0, 0.0)
        return moved, _lines(moved, road, scene, probability), known
    habits = [own or fresh_habits(road) for own in known]
    moved = _spread(renew(moved, road, tracks, scene, habits), tracks)
    evidence = collect_evidence(moved, road, scene, habits)
    score = _score(evidence, moved, road, tracks, scene, choice)
    moved, habits = _learn(_choose(moved, score), road, scene, habits)
    return moved, _lines(moved, road, scene, _probability(moved, score, evidence)), habits


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
    evidence: Evidence,
    state: LineState,
    road: Road,
    tracks: Tracks,
    scene: Scene,
    choice: LineChoice,
) -> FloatArray:
    """-log likelihood [N, A], inf where there is no candidate."""
    score = np.full(state.line.shape, np.inf)
    if len(evidence.vehicle):
        at = evidence.vehicle, evidence.slot
        if choice is HAND_MADE_CHOICE:
            score[at] = evidence.nats.sum(axis=1)
        else:
            nats = choice.nats(line_features(evidence, state, road, tracks, scene))
            score[at] = nats[evidence.alike]
    return score


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


def _probability(state: LineState, score: FloatArray, evidence: Evidence) -> FloatArray:
    """Softmax [N] over the next connections of the candidates: that of the chosen one's."""
    count, vehicle, slot = len(state.ids), evidence.vehicle, evidence.slot
    if not len(vehicle):
        return np.zeros(count)
    least = np.min(score, axis=1, initial=np.inf)
    weight = np.exp(least[vehicle] - score[vehicle, slot] + evidence.log_share)
    connection = np.full(score.shape, -1, dtype=np.int64)
    connection[vehicle, slot] = evidence.connection
    own = connection[np.arange(count), np.maximum(state.chosen, 0)]
    mine = np.bincount(vehicle, weight * (evidence.connection == own[vehicle]), count)
    total = np.bincount(vehicle, weight, count)
    return np.where(state.chosen >= 0, mine / np.maximum(total, 1e-12), 0.0)


def _learn(
    state: LineState, road: Road, scene: Scene, habits: Sequence[Habits]
) -> tuple[LineState, list[Habits]]:
    """Note the connections that vehicles come to the end of, and who signals on them."""
    rows = np.arange(len(state.ids))
    own = np.maximum(state.chosen, 0)
    on = np.flatnonzero(state.chosen >= 0)
    line = state.line[rows, own][on]
    inside = np.full(len(rows), -1, dtype=np.int64)
    if not len(on):
        return replace(state, inside=inside), list(habits)
    front_m = state.s_m[rows, own][on, None]
    past = road.fork_end_s_m[line] <= front_m
    under = ~past & (road.fork_s_m[line] <= front_m)
    fork, is_in = under.argmax(axis=1), under.any(axis=1)
    lane = road.fork_lane[line]
    inside[on] = np.where(is_in, lane[np.arange(len(on)), fork], -1)
    left: BoolArray = ((lane == state.inside[on, None]) & past).any(axis=1)
    turn = np.where(is_in, road.fork_turn[line, fork], 0)
    turns = turn != 0
    gone, turning, blinker = state.inside[on][left], turn[turns], scene.blinker[on][turns]
    if len(habits) == 1:
        return replace(state, inside=inside), [learn(habits[0], gone, turning, blinker)]
    world = world_of(scene)[on]
    of_gone, of_turning = world[left], world[turns]
    learned = [
        learn(own, gone[of_gone == k], turning[mine := of_turning == k], blinker[mine])
        for k, own in enumerate(habits)
    ]
    return replace(state, inside=inside), learned


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
