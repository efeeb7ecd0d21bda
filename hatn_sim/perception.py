"""From scenes to what every predictor starts from: tracks, lines, motion along them, leaders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from hatn_sim.datatypes import HISTORY_FRAMES, FloatArray, IntArray, Lines, Route, Scene, Tracks
from hatn_sim.geometry import wrap_angle
from hatn_sim.line_choice import LineChoice, shipped_line_choice
from hatn_sim.lines import LineState, empty_lines, follow_all, follow_lines
from hatn_sim.road import Road
from hatn_sim.tracks import empty_tracks, extend
from hatn_sim.worlds import ids_joined, joined, near_pairs, part, worlds_joined

CORRIDOR_M: Final = 1.8
"""A vehicle this near to a line, heading along it, is in the line's corridor."""
CORRIDOR_RAD: Final = np.deg2rad(60.0)
LEADER_REACH_M: Final = 60.0


@dataclass(frozen=True, eq=False)
class Motion:
    """Vehicles along lines over the history: [N, T] each, T = HISTORY_FRAMES, the last is now."""

    s_m: FloatArray
    d_m: FloatArray
    phi_rad: FloatArray
    speed_mps: FloatArray  # along the line: v cos phi
    lateral_mps: FloatArray  # v sin phi


@dataclass(frozen=True, eq=False)
class Perception:
    """One moment as every predictor sees it; what no frame to come hangs on is made when asked."""

    road: Road
    scene: Scene
    tracks: Tracks
    lines: Lines

    @cached_property
    def own(self) -> Motion:
        """Every vehicle on its own line."""
        lines = self.lines
        every = np.arange(len(self.scene.ids))
        return motion_along(self.road, self.tracks, lines.line, lines.s_m, every)

    @property
    def leader(self) -> IntArray:
        """The vehicle [N] ahead in the own corridor, -1: none."""
        return self._leaders[0]

    @property
    def leader_s_m(self) -> FloatArray:
        """Its arc length [N] on the follower's line."""
        return self._leaders[1]

    @cached_property
    def _leaders(self) -> tuple[IntArray, FloatArray]:
        return find_leaders(self.road, self.scene, self.lines)

    @cached_property
    def waited_s(self) -> FloatArray:
        """How long [N] it has stood, as far as the tracks go back."""
        return _waited_s(self.tracks)


@dataclass(frozen=True, eq=False)
class PerceptionState:
    """Memory of what was seen so far, and the newest moment."""

    road: Road
    choice: LineChoice
    line_state: LineState
    seen: Perception


def choose_lines_by(road: Road, choice: LineChoice) -> None:
    """From the next `begin` on, all predictors choose lines on this road by `choice`."""
    road.shared["choice"] = choice


def begin(road: Road, choice: LineChoice | None = None) -> PerceptionState:
    """Nothing seen yet; lines will be chosen by `choice`, None: the one that ships.

    A choice that the road was given by `choose_lines_by` comes before it. The same object for the
    same road and choice, so that predictors share their work.
    """
    of_road: LineChoice | None = road.shared.get("choice")
    choice = of_road or choice or shipped_line_choice()
    known: dict[LineChoice, PerceptionState] = road.shared.setdefault("begin", {})
    if choice not in known:
        nothing = np.zeros(0)
        none = np.zeros(0, dtype=np.int64)
        scene = Scene(
            time_s=0.0,
            ids=(),
            xy_m=np.zeros((0, 2)),
            yaw_rad=nothing,
            speed_mps=nothing,
            size_m=np.zeros((0, 2)),
            kind=none,
            colour=np.zeros((0, 3), dtype=np.int64),
            blinker=none,
            signal_closed=np.zeros(0, dtype=np.bool_),
        )
        lines = Lines(none, nothing, nothing, nothing, nothing)
        seen = Perception(road, scene, empty_tracks(), lines)
        known[choice] = PerceptionState(road, choice, empty_lines(), seen)
    return known[choice]


_Done = tuple[PerceptionState, Scene, bool, PerceptionState]
"""What `perceive` was given last, and what it gave."""


def perceive(
    state: PerceptionState, scene: Scene, routes: tuple[Route | None, ...] | None
) -> PerceptionState:
    """One frame on. Predictors that look at one scene from one memory share the result."""
    road, choice, by_route = state.road, state.choice, routes is not None
    done: dict[LineChoice, _Done] = road.shared.setdefault("last", {})
    last = done.get(choice)
    if last and last[0] is state and last[1] is scene and last[2] == by_route:
        return last[3]
    tracks = extend(state.seen.tracks, scene)
    line_state, lines = follow_lines(state.line_state, road, tracks, scene, routes, choice)
    road.touch(line_state.line)
    seen = Perception(road, scene, tracks, lines)
    after = PerceptionState(road, choice, line_state, seen)
    done[choice] = state, scene, by_route, after
    return after


def recall(state: PerceptionState, scenes: Sequence[Scene]) -> PerceptionState:
    """Frames as history alone, in place of `perceive`, for a memory that has seen nothing yet.

    Lines are chosen at the first frame that is perceived then, from all of the tracks, as those of
    vehicles that come into view are; so that to begin in the midst of traffic takes no longer.
    """
    if not scenes:
        return state
    tracks = state.seen.tracks
    for scene in scenes:
        tracks = extend(tracks, scene)
    nothing = np.zeros(len(tracks.ids))
    lines = Lines(np.full(len(tracks.ids), -1), nothing, nothing, nothing, nothing)
    seen = Perception(state.road, scenes[-1], tracks, lines)
    return PerceptionState(state.road, state.choice, state.line_state, seen)


def perceive_all(
    states: Sequence[PerceptionState],
    scenes: Sequence[Scene],
    routes: Sequence[tuple[Route | None, ...]] | None,
) -> list[PerceptionState]:
    """What `perceive` gives of each, of worlds on one road that choose lines alike, in one go."""
    road, choice = states[0].road, states[0].choice
    scene = worlds_joined(scenes)
    tracks = extend(_tracks_joined([state.seen.tracks for state in states]), scene)
    all_routes = None if routes is None else tuple(route for own in routes for route in own)
    line_states = [state.line_state for state in states]
    line_states, lines = follow_all(line_states, road, tracks, scene, all_routes, choice)
    after: list[PerceptionState] = []
    for one, line_state, rows in zip(scenes, line_states, scene.rows, strict=True):
        seen = Perception(road, one, part(tracks, rows, ids=one.ids), part(lines, rows))
        after.append(PerceptionState(road, choice, line_state, seen))
    return after


def perceptions_joined(every: Sequence[Perception]) -> Perception:
    """What was seen of several worlds on one road, as of one."""
    return Perception(
        every[0].road,
        worlds_joined([seen.scene for seen in every]),
        _tracks_joined([seen.tracks for seen in every]),
        joined(Lines, [seen.lines for seen in every]),
    )


def _tracks_joined(every: Sequence[Tracks]) -> Tracks:
    return joined(Tracks, every, ids=ids_joined([tracks.ids for tracks in every]))


def motion_along(
    road: Road,
    tracks: Tracks,
    line: IntArray,
    s_now_m: FloatArray,
    vehicle: IntArray,
    steps: int = 1,
) -> Motion:
    """The history of vehicles [Q] on lines [Q], where they are now at arc lengths `s_now_m`.

    Entries without a line (-1) stay zero. The search goes back from now by the distance travelled,
    so that a line which meets itself again is followed on the right lap; it takes more `steps` for
    vehicles that may have come from elsewhere.
    """
    shape = (len(vehicle), HISTORY_FRAMES)
    s, d, phi = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    speed = tracks.speed_mps[vehicle, -HISTORY_FRAMES:]
    on = np.flatnonzero(line >= 0)
    if len(on):
        xy = tracks.xy_m[vehicle[on], -HISTORY_FRAMES:]
        step_m = np.linalg.norm(np.diff(xy, axis=1), axis=2)
        behind = np.zeros((len(on), HISTORY_FRAMES))
        behind[:, :-1] = np.cumsum(step_m[:, ::-1], axis=1)[:, ::-1]
        flat_line = np.repeat(line[on], HISTORY_FRAMES)
        flat_xy = xy.reshape(-1, 2)
        flat_s, flat_d = road.track(flat_line, flat_xy, (s_now_m[on, None] - behind).ravel(), steps)
        tangent = road.line_yaw_rad(flat_line, flat_s).reshape(len(on), -1)
        s[on], d[on] = flat_s.reshape(len(on), -1), flat_d.reshape(len(on), -1)
        phi[on] = wrap_angle(tracks.yaw_rad[vehicle[on], -HISTORY_FRAMES:] - tangent)
    return Motion(s, d, phi, speed * np.cos(phi), speed * np.sin(phi))


def find_leaders(road: Road, scene: Scene, lines: Lines) -> tuple[IntArray, FloatArray]:
    """The nearest vehicle ahead in the corridor of every line, and its arc length there."""
    count = len(scene.ids)
    leader = np.full(count, -1, dtype=np.int64)
    leader_s_m = np.full(count, np.inf)
    if count < 2:
        return leader, leader_s_m
    pairs = near_pairs(scene, np.arange(count), LEADER_REACH_M)
    follower = np.concatenate((pairs[:, 0], pairs[:, 1]))
    ahead = np.concatenate((pairs[:, 1], pairs[:, 0]))
    keep = lines.line[follower] >= 0
    follower, ahead = follower[keep], ahead[keep]
    if not len(follower):
        return leader, leader_s_m
    line, low_m = lines.line[follower], lines.s_m[follower]
    near_s, near_m = road.coarse_distance_m(line, scene.xy_m[ahead], low_m, LEADER_REACH_M)
    close = near_m < CORRIDOR_M + 2.5
    follower, ahead, line, low_m = follower[close], ahead[close], line[close], low_m[close]
    s, d = road.project(line, scene.xy_m[ahead], near_s[close], 3.0)
    turned = np.abs(wrap_angle(scene.yaw_rad[ahead] - road.line_yaw_rad(line, s)))
    inside = (np.abs(d) < CORRIDOR_M) & (turned < CORRIDOR_RAD) & (s > low_m + 0.1)
    follower, ahead, s = follower[inside], ahead[inside], s[inside]
    order = np.lexsort((ahead, s, follower))
    follower, ahead, s = follower[order], ahead[order], s[order]
    first = np.concatenate(([True], follower[1:] != follower[:-1])) if len(follower) else []
    leader[follower[first]] = ahead[first]
    leader_s_m[follower[first]] = s[first]
    return leader, leader_s_m


def _waited_s(tracks: Tracks) -> FloatArray:
    """Time since the vehicle last moved (more than 0.3 m/s), at most the length of the tracks."""
    standing = (tracks.speed_mps < 0.3) & tracks.valid
    still = np.cumprod(standing[:, ::-1], axis=1)
    return 0.1 * still.sum(axis=1).astype(np.float64)
