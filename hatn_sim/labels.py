"""What really happened next: goals, crossings and slots of a run (METHOD 1.8). Pure NumPy.

Labels look into the future of a run that is over, for training and scores; no predictor sees them.
Letters: V vehicles and T frames of the run, S samples (a vehicle at a frame), E graphs, M nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hatn_sim.datatypes import HISTORY_FRAMES, HORIZON_FRAMES, BoolArray, FloatArray, IntArray

SAMPLE_EVERY_FRAMES = 5
"""Samples are taken at frames 0, 5, 10 ... (METHOD 6: every 0.5 s)."""
NEXT_FRAMES = 50
"""Somebody has to cross the focus within 5 s, else the class is masked."""
FOLLOW_FRAMES = 100
"""The vehicle passed before has to cross within 10 s after the ego."""
CROSSING_RADIUS_M = 4.0
"""Who is farther from the conflict after driving the distance to it has taken another way."""
MOVING_M = 1.0
"""A sample is moving when it travels more than this in 3 s (METHOD 6)."""


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Where every vehicle of a run was at every frame; made by `trajectories_from_rows`."""

    ids: tuple[str, ...]  # [V]
    xy_m: FloatArray  # [V, T, 2] centres; finite where not valid, but without meaning
    valid: BoolArray  # [V, T] the vehicle was in view
    travelled_m: FloatArray  # [V, T] path length of the centre so far, jumps out of view left out

    @property
    def frame_count(self) -> int:
        return int(self.valid.shape[1])

    @cached_property
    def seen_until(self) -> IntArray:
        """[V, T] last frame of the unbroken view that a frame belongs to; where unseen: before it.

        A vehicle is in view at all of t ... u if and only if `seen_until[v, t] >= u`.
        """
        frames = np.arange(self.frame_count)
        unseen = np.where(self.valid, self.frame_count, frames)
        return np.minimum.accumulate(unseen[:, ::-1], axis=1)[:, ::-1] - 1

    def seen(self, vehicle: IntArray, first: IntArray, last: IntArray) -> BoolArray:
        """[S] the vehicle is in view at every frame `first` ... `last`, both within the run."""
        inside = (first >= 0) & (last < self.frame_count)
        if not inside.any():
            return inside
        return inside & (self.seen_until[vehicle, np.where(inside, first, 0)] >= last)


def trajectories_from_rows(
    ids: tuple[str, ...], vehicle: IntArray, frame: IntArray, xy_m: FloatArray, frame_count: int
) -> Trajectories:
    """Trajectories from one row per vehicle and frame, in any order.

    Args:
        ids: [V] vehicles.
        vehicle: [R] index into `ids`.
        frame: [R] in 0 ... frame_count - 1.
        xy_m: [R, 2] box centres.
        frame_count: T.
    """
    xy = np.zeros((len(ids), frame_count, 2))
    valid = np.zeros((len(ids), frame_count), dtype=bool)
    xy[vehicle, frame] = xy_m
    valid[vehicle, frame] = True
    step_m = np.zeros((len(ids), frame_count))
    step_m[:, 1:] = np.linalg.norm(np.diff(xy, axis=1), axis=2)
    step_m[:, 1:] *= valid[:, 1:] & valid[:, :-1]
    return Trajectories(ids, xy, valid, np.cumsum(step_m, axis=1))


def samples(
    trajectories: Trajectories, every_frames: int = SAMPLE_EVERY_FRAMES
) -> tuple[IntArray, IntArray]:
    """The samples of a run: (vehicle [S], frame [S]), by frame and then by vehicle.

    Every vehicle in view for the 11 frames up to t and the 30 after it, at every fifth frame.
    """
    frames = np.arange(0, trajectories.frame_count, every_frames)
    frame, vehicle = (
        index.ravel()
        for index in np.meshgrid(frames, np.arange(len(trajectories.ids)), indexing="ij")
    )
    whole = trajectories.seen(vehicle, frame - HISTORY_FRAMES + 1, frame + HORIZON_FRAMES)
    return vehicle[whole], frame[whole]


def goal_m(
    trajectories: Trajectories, vehicle: IntArray, frame: IntArray
) -> tuple[FloatArray, BoolArray]:
    """Distance travelled in the next 3 s: (metres [S], mask [S]); masked where the track ends."""
    whole = trajectories.seen(vehicle, frame, frame + HORIZON_FRAMES)
    value = np.zeros(len(vehicle))
    travelled = trajectories.travelled_m
    now, then = frame[whole], frame[whole] + HORIZON_FRAMES
    value[whole] = travelled[vehicle[whole], then] - travelled[vehicle[whole], now]
    return value, whole


def crossing_frame(
    trajectories: Trajectories,
    vehicle: IntArray,
    frame: IntArray,
    distance_m: FloatArray,
    conflict_xy_m: FloatArray,
    limit_frames: int,
) -> IntArray:
    """When each vehicle crosses its conflict: [S] a frame in t ... t + limit_frames, or -1.

    It crosses at the first frame at which it has driven `distance_m` since t, if it has been in
    view all the while and is then within `CROSSING_RADIUS_M` of the conflict: one that took
    another way never crosses. A vehicle already past its conflict (`distance_m` < 0; graphs keep
    conflicts up to 2 m behind) still occupies it and so crosses at t.

    Args:
        trajectories: of the run.
        vehicle: [S], -1 where there is none, which never crosses.
        frame: [S] t.
        distance_m: [S] from the vehicle at t to the conflict along its line.
        conflict_xy_m: [S, 2].
        limit_frames: how far to look ahead.
    """
    result = np.full(len(vehicle), -1, dtype=np.int64)
    inside = (vehicle >= 0) & (frame >= 0) & (frame < trajectories.frame_count)
    who, now = vehicle[inside], frame[inside]
    travelled = trajectories.travelled_m
    goal = distance_m[inside] + (travelled[who, now] if len(who) else 0.0)
    # Path length never falls along a row, so bisect every row at once. The answer is in
    # [low, high]; high is one past the last frame allowed and means "not reached".
    low = now
    high = np.minimum(now + limit_frames, trajectories.seen_until[who, now]) + 1
    end = high
    while np.any(low < high):
        middle = (low + high) // 2
        reached = travelled[who, np.minimum(middle, trajectories.frame_count - 1)] >= goal
        open_ = low < high
        high = np.where(open_ & reached, middle, high)
        low = np.where(open_ & ~reached, middle + 1, low)
    at = np.minimum(low, trajectories.frame_count - 1)
    away_m = np.linalg.norm(trajectories.xy_m[who, at] - conflict_xy_m[inside], axis=1)
    result[inside] = np.where((low < end) & (away_m <= CROSSING_RADIUS_M), low, -1)
    return result


def slot_label(
    trajectories: Trajectories,
    ego: IntArray,
    frame: IntArray,
    node: IntArray,
    focus_mask: BoolArray,
    ego_to_conflict_m: FloatArray,
    rear_to_conflict_m: FloatArray,
    conflict_xy_m: FloatArray,
) -> IntArray:
    """The slot each ego really took: [E] a node in 0 ... M - 1, or -1 where the class is masked.

    The focus is the nearest conflict of the focus group along the ego's line. Who of the ego and
    vehicle j goes first is always decided at the conflict of these two, and at the same frame the
    ego yields. Then:

    - a vehicle of the group crosses within 5 s, before the ego: 0, the ego yielded;
    - otherwise, the ego crosses the focus within 5 s: the node of the next of the group to cross
      after it, within 10 s: the ego passed before that one;
    - nobody within 5 s, or nobody left to follow: -1.

    Whoever leaves view before its conflict, or takes another way, does not cross; see
    `crossing_frame` for those already past it.

    Args:
        trajectories: of the run.
        ego: [E] vehicle.
        frame: [E] t.
        node: [E, M] the vehicle behind each slot, -1 where there is none; node 0 is the ego's.
        focus_mask: [E, M] node 0 and the nodes of the focus group.
        ego_to_conflict_m: [E, M] from the ego to the node's conflict, along its line.
        rear_to_conflict_m: [E, M] from the node's vehicle to the conflict, along its line.
        conflict_xy_m: [E, M, 2].
    """
    count, nodes = node.shape
    group = focus_mask & (node >= 0)
    group[:, :1] = False
    if not group.any():
        return np.full(count, -1, dtype=np.int64)
    row, column = np.nonzero(group)
    limit = NEXT_FRAMES + FOLLOW_FRAMES

    def crossing(vehicle: IntArray, distance_m: FloatArray) -> IntArray:
        found = np.full((count, nodes), -1, dtype=np.int64)
        found[row, column] = crossing_frame(
            trajectories,
            vehicle,
            frame[row],
            distance_m[row, column],
            conflict_xy_m[row, column],
            limit,
        )
        return found

    ego_at = crossing(ego[row], ego_to_conflict_m)
    other_at = crossing(node[row, column], rear_to_conflict_m)

    other_crosses, ego_crosses = other_at >= 0, ego_at >= 0
    before = other_crosses & (~ego_crosses | (other_at <= ego_at))
    after = other_crosses & ego_crosses & (other_at > ego_at)
    soon = frame + NEXT_FRAMES
    yields = (before & (other_at <= soon[:, None])).any(axis=1)

    focus = np.where(group, ego_to_conflict_m, np.inf).argmin(axis=1)
    ego_at_focus = np.take_along_axis(ego_at, focus[:, None], axis=1)[:, 0]
    first = (ego_at_focus >= 0) & (ego_at_focus <= soon)
    never = np.iinfo(np.int64).max
    follows_at = np.where(after & (other_at - ego_at <= FOLLOW_FRAMES), other_at, never)
    follower = follows_at.argmin(axis=1)
    followed = follows_at.min(axis=1) < never
    return np.where(yields, 0, np.where(first & followed, follower, -1))
