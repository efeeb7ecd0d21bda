"""What tells the candidates of a vehicle apart, one row for each: observed, history only.

Nothing here has a left or a right of its own: a mirrored world with mirrored traffic has the same
features, and so has a turned or shifted one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.candidates import LineState
from hatn_sim.datatypes import DT_S, FloatArray, IntArray, Scene, Tracks
from hatn_sim.geometry import interpolate, wrap_angle
from hatn_sim.habits import Habits, habits_joined, share_nats, silent_nats
from hatn_sim.road import LINE_STEP_M, Road
from hatn_sim.speed_profile import LATERAL_MPS2
from hatn_sim.worlds import world_of

SHARP_M: Final = 0.005
BLUNT_M: Final = 0.3
"""An extra cost makes a line e times less likely if it is as large as what the vehicle's best lines
have cost over the last metres, between these bounds."""
IDLE_BLINKER_NATS: Final = 4.0
"""To signal and drive straight on (a change of lanes, a forgotten blinker) ..."""
WRONG_BLINKER_NATS: Final = 5.0
"""... or to turn the other way."""
BLINKER_REACH_M: Final = (60.0, 100.0)
"""A blinker tells all of a connection nearer than this, and nothing of one further away than that.
"""
SILENT_REACH_M: Final = (20.0, 60.0)
"""The same of one that is not set."""
LOOK_S: Final = (0.7, 1.5)
LOOK_M: Final = ((2.0, 10.0), (5.0, 20.0))
"""Lines are compared with the way driven on as now for these times, within these distances."""
BEND_PER_M: Final = 0.3
"""Nobody drives a tighter bend."""
BEND_RAD: Final = 0.2
"""A bend ahead of this angle is one."""
BEHIND_M: Final = 8.0
"""How far back the line is looked at: who leaves a bend is still off to its inside."""
NEAR_FORK_M: Final = 15.0
"""The nearness of a connection falls by 1/e over this distance."""
PASSED_M: Final = 2.0
"""This far inside a connection it is passed for sure."""
PROFILE_M: Final = (4.0, 10.0, 18.0, 28.0)
"""Where the curvature ahead is looked up."""
RECENT_FRAMES: Final = 6
"""Acceleration is that of half a second."""
HAND_MADE: Final = ("motion", "blinker", "silence", "habit")
"""The first features are -log likelihoods; their sum is the choice made by hand."""
ALIKE_M: Final = 1e-6
"""Warping costs that differ by less are the same."""
FEATURES: Final = (
    *HAND_MADE,
    "extra_cost",  # warping cost; extra: beyond the least of the vehicle's candidates
    "extra_offset",  # lateral offset now
    "extra_turned",  # heading to the line now
    "extra_near_heading",  # to the line a little ahead, were the way driven on as now
    "extra_far_heading",
    "extra_near_offset",
    "extra_far_offset",
    "inside",  # offset to the side on which the line leaves the others
    "lean",  # heading to that side
    "steer",  # curvature of the way driven to that side
    "behind",  # the bend behind, to that side
    "apart",  # how far the line turns away from the others
    "extra_bend",  # how much more it bends
    "braking",  # that the bends ahead ask for
    "extra_braking",
    "pace",  # speed to what the line allows
    "extra_pace",
    "slowing",
    "speed",
    "standing",
    "fork_near",
    "fork_passed",
    "spread",
    "signalled",  # how usual a blinker is here
    "next_habit",  # the same for the connection after the next
    "next_blinker",
)


@dataclass(frozen=True, eq=False)
class Evidence:
    """The candidates in view, by vehicle; Q pairs of a vehicle and a candidate."""

    vehicle: IntArray  # [Q]
    slot: IntArray  # [Q] which of its candidates
    connection: IntArray  # [Q] the next connection; where there is none, a number for the line
    log_share: FloatArray  # [Q] of a line among those through its next connection, see `_shares`
    nats: FloatArray  # [Q, 4] see HAND_MADE
    away_m: FloatArray  # [Q, 2] to the next connection and the one after it
    next_nats: FloatArray  # [Q, 2] what habit and blinker say of the one after the next
    silent_nats: float | FloatArray  # of a driver who turns; [N] where worlds differ
    first: IntArray  # [G] of the candidates that differ by nothing near enough to tell
    alike: IntArray  # [Q] which of these a candidate is like


def collect_evidence(
    state: LineState, road: Road, scene: Scene, habits: Habits | Sequence[Habits]
) -> Evidence:
    """The -log likelihoods of every candidate by motion, blinker and habit.

    `habits` may be those of every world.
    """
    vehicle, slot = np.nonzero(state.line >= 0)
    line, front_m = state.line[vehicle, slot], state.s_m[vehicle, slot]
    passed = (road.fork_end_s_m[line] <= front_m[:, None]).sum(axis=1)
    blinker = scene.blinker[vehicle]
    first: IntArray | int = 0  # of the lanes of a vehicle's world
    if isinstance(habits, Habits) or len(habits) == 1:
        habits = habits if isinstance(habits, Habits) else habits[0]
        of_driver = silence = silent_nats(habits)
    else:
        world = world_of(scene)
        first = len(habits[0].source) * world[vehicle]
        of_driver = np.array([silent_nats(own) for own in habits])[world]
        silence, habits = of_driver[vehicle], habits_joined(habits)

    def at(order: int) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray]:
        """Of a connection ahead: metres to it, its number, and the nats of what is observed."""
        fork = np.minimum(passed + order, road.fork_s_m.shape[1] - 1)
        away_m = road.fork_s_m[line, fork] - front_m
        known = np.isfinite(away_m)
        turn, lane = road.fork_turn[line, fork], road.fork_lane[line, fork]
        against = np.where(turn == 0, IDLE_BLINKER_NATS, WRONG_BLINKER_NATS)
        against = np.where((blinker != 0) & (turn != blinker), against, 0.0)
        silent = np.where((blinker == 0) & (turn != 0), silence, 0.0)
        return (
            away_m,
            np.where(known, lane, -2 - line),
            against * _nearness(away_m, BLINKER_REACH_M),
            silent * _nearness(away_m, SILENT_REACH_M),
            np.where(known, share_nats(habits, first + lane), 0.0),
        )

    away_m, connection, against, silent, habit = at(0)
    next_away_m, following, next_against, next_silent, next_habit = at(1)
    following = np.where(np.isfinite(next_away_m), following, -1)
    fit = np.rint(state.cost_m[vehicle, slot] / ALIKE_M).astype(np.int64)
    ways, log_share, first, alike = _group(vehicle, connection, following, fit)
    motion = state.cost_m[vehicle, slot] / np.maximum(state.spread_m, SHARP_M)[vehicle]
    return Evidence(
        vehicle=vehicle,
        slot=slot,
        connection=connection,
        log_share=log_share,
        nats=np.stack((motion, against, silent, habit), axis=1),
        away_m=np.stack((away_m, next_away_m), axis=1),
        next_nats=np.stack((next_habit - np.log(ways), next_against + next_silent), axis=1),
        silent_nats=of_driver,
        first=first,
        alike=alike,
    )


def _group(
    vehicle: IntArray, connection: IntArray, following: IntArray, fit: IntArray
) -> tuple[IntArray, FloatArray, IntArray, IntArray]:
    """Ways on behind the next connection [Q], and log shares [Q] that sum to 1 for each connection.

    Every way on has the same share, and so has every line that takes it: how often the road forks
    further on says nothing of where a vehicle turns now. And lines with the same way on that the
    motion fits alike are alike: the first of each kind [G], and the kind [Q] of every line.
    """
    order = np.lexsort((fit, following, connection, vehicle))
    keys = np.stack((vehicle, connection, following, fit))[:, order]
    changes = np.ones(keys.shape, dtype=np.bool_)
    changes[:, 1:] = np.logical_or.accumulate(keys[:, 1:] != keys[:, :-1], axis=0)
    number = np.cumsum(changes, axis=1) - 1
    _, of_connection, of_way, of_kind = number
    ways, alike = np.empty(len(order), dtype=np.int64), np.empty(len(order), dtype=np.int64)
    log_share = np.empty(len(order))
    ways_here = np.bincount(of_connection[changes[2]])[of_connection]
    ways[order] = ways_here
    log_share[order] = -np.log(ways_here * np.bincount(of_way)[of_way])
    alike[order] = of_kind
    return ways, log_share, order[changes[3]], alike


def _nearness(away_m: FloatArray, reach_m: tuple[float, float]) -> FloatArray:
    """1 up to the first distance, falling to 0 at the second."""
    return np.clip((reach_m[1] - away_m) / (reach_m[1] - reach_m[0]), 0.0, 1.0)


def line_features(
    evidence: Evidence, state: LineState, road: Road, tracks: Tracks, scene: Scene
) -> FloatArray:
    """Features [G, len(FEATURES)] of the candidates `evidence.first`, each of about unit size."""
    rows = evidence.first
    vehicle, slot, nats = evidence.vehicle[rows], evidence.slot[rows], evidence.nats[rows]
    away_m, next_nats = evidence.away_m[rows], evidence.next_nats[rows]
    line, s = state.line[vehicle, slot], state.s_m[vehicle, slot]
    d, turned = state.d_m[vehicle, slot], state.turned_rad[vehicle, slot]
    own = _of_vehicles(evidence, state, tracks, scene)[vehicle]
    speed, way_per_m = own[:, 0], own[:, 1]
    first = np.flatnonzero(np.diff(vehicle, prepend=-1))
    many = np.diff(first, append=len(vehicle))

    def extra(values: FloatArray) -> FloatArray:
        """Beyond the least of the vehicle's candidates."""
        return values - np.repeat(np.minimum.reduceat(values, first), many)

    base, count = road.offset[line], road.count[line]
    look_m = np.stack(
        [
            np.clip(time_s * speed, *within_m)
            for time_s, within_m in zip(LOOK_S, LOOK_M, strict=True)
        ],
        axis=1,
    )
    ahead = s[:, None] + look_m
    at = np.concatenate((s[:, None], s[:, None] - BEHIND_M, ahead), axis=1) / LINE_STEP_M
    yaw = interpolate(road.yaw_rad, base, count, at)
    target = interpolate(road.xy_m, base, count, ahead / LINE_STEP_M)
    heading, offset = _driven_on(scene, vehicle, way_per_m, look_m, yaw[:, 2:], target)
    bend, behind = yaw[:, 3] - yaw[:, 0], yaw[:, 0] - yaw[:, 1]
    most, least = np.maximum.reduceat(bend, first), np.minimum.reduceat(bend, first)
    between = np.repeat(0.5 * (most + least), many)
    apart = bend - between
    side = np.tanh(apart / BEND_RAD)
    braking, pace = _speed_ahead(road, base, count, s, speed)
    near = np.exp(-np.maximum(away_m, 0.0) / NEAR_FORK_M)

    out = np.empty((len(vehicle), len(FEATURES)))
    columns = (
        extra(nats[:, 0]),
        nats[:, 1],
        nats[:, 2],
        nats[:, 3],
        extra(state.cost_m[vehicle, slot]),
        extra(np.abs(d)),
        2.0 * extra(np.abs(turned)),
        2.0 * extra(heading[:, 0]),
        2.0 * extra(heading[:, 1]),
        extra(offset[:, 0]),
        0.5 * extra(offset[:, 1]),
        side * d,
        2.0 * side * turned,
        10.0 * side * (way_per_m - between / look_m[:, 1]),
        side * np.tanh(behind / BEND_RAD),
        np.abs(apart),
        extra(np.abs(bend)),
        0.5 * braking,
        0.5 * extra(braking),
        pace,
        extra(pace),
        own[:, 2],
        0.1 * speed,
        np.exp(-speed),
        near[:, 0],
        np.clip(-away_m[:, 0] / PASSED_M, 0.0, 1.0),
        own[:, 3],
        own[:, 4],
        near[:, 1] * next_nats[:, 0],
        near[:, 1] * next_nats[:, 1],
    )
    for column, values in enumerate(columns):
        out[:, column] = values
    np.clip(out[:, len(HAND_MADE) :], -4.0, 4.0, out=out[:, len(HAND_MADE) :])
    return out


def _of_vehicles(evidence: Evidence, state: LineState, tracks: Tracks, scene: Scene) -> FloatArray:
    """Speed, curvature of the way driven, slowing, spread, signalling [N, 5] of the vehicles."""
    span_s = DT_S * (RECENT_FRAMES - 1)
    slowing_mps2 = (tracks.speed_mps[:, -RECENT_FRAMES] - tracks.speed_mps[:, -1]) / span_s
    spread = np.log(np.clip(state.spread_m, SHARP_M, 3.0) / BLUNT_M) / 3.0
    return np.stack(
        (
            scene.speed_mps,
            np.clip(state.bend_per_m, -BEND_PER_M, BEND_PER_M),
            0.5 * slowing_mps2,
            spread,
            np.full(len(spread), evidence.silent_nats),
        ),
        axis=1,
    )


def _driven_on(
    scene: Scene,
    vehicle: IntArray,
    way_per_m: FloatArray,
    look_m: FloatArray,
    yaw_rad: FloatArray,
    target_xy_m: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """How far fronts that go on as now for `look_m` [Q, K] are then turned [Q, K] and off [Q, K].

    They go on along the arc driven of late, as if the wheel were held still, and are held against
    the points [Q, K, 2] and directions [Q, K] that their lines have there.
    """
    now, half_m = scene.yaw_rad[vehicle, None], 0.5 * scene.size_m[vehicle, :1]
    turned = way_per_m[:, None] * look_m
    then, middle = now + turned, now + 0.5 * turned
    centre = scene.xy_m[vehicle]
    x = centre[:, :1] + look_m * np.cos(middle) + half_m * np.cos(then) - target_xy_m[..., 0]
    y = centre[:, 1:] + look_m * np.sin(middle) + half_m * np.sin(then) - target_xy_m[..., 1]
    offset = np.abs(np.cos(yaw_rad) * y - np.sin(yaw_rad) * x)
    return np.abs(wrap_angle(then - yaw_rad)), offset


def _speed_ahead(
    road: Road, base: IntArray, count: IntArray, s_m: FloatArray, speed_mps: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Braking [Q] in m/s2 that lines [Q] ahead ask for, and speed [Q] beyond what they allow."""
    at = (s_m[:, None] + np.array(PROFILE_M)) / LINE_STEP_M
    bend = np.maximum(np.abs(interpolate(road.curvature_per_m, base, count, at)), 1e-3)
    vertex = np.clip(np.rint(at).astype(np.int64), 0, count[:, None] - 1) + base[:, None]
    square = np.minimum(road.speed_limit_mps[vertex] ** 2, LATERAL_MPS2 / bend)
    surplus = speed_mps[:, None] ** 2 - square
    braking = (surplus / (2.0 * np.array(PROFILE_M))).max(axis=1)
    pace = speed_mps / np.sqrt(square.min(axis=1)) - 1.0
    return np.maximum(braking, 0.0), pace
