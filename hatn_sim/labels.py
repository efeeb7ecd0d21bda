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
    """Where every vehicle of a run was; made by `trajectories_from_rows`.

    One row for each vehicle and frame in view, by vehicle and then by frame, so memory grows with
    what was seen and not with vehicles times frames. Row 0 is of nobody: where nothing is found.
    The vehicles and frames that the methods take may have any shapes [...] that broadcast.
    """

    ids: tuple[str, ...]  # [V]
    frame_count: int  # T
    row_vehicle: IntArray  # [1 + R] index into `ids`
    row_frame: IntArray  # [1 + R]
    row_xy_m: FloatArray  # [1 + R, 2] centres
    row_travelled_m: FloatArray  # [1 + R] path length of the centre so far, in view only
    row_seen_until: IntArray  # [1 + R] last frame of the unbroken view that the row belongs to

    def xy_at(self, vehicle: IntArray | int, frame: IntArray | int) -> tuple[FloatArray, BoolArray]:
        """(centres [..., 2], mask [...]): masked, and 0, where the vehicle is out of view."""
        row = self.row_at(vehicle, frame)
        return self.row_xy_m[row], row > 0

    def travelled_at(self, vehicle: IntArray | int, frame: IntArray | int) -> FloatArray:
        """[...] metres in view up to a frame: none before the first, no more while out of view."""
        travelled: FloatArray = self.row_travelled_m[self._last_row(vehicle, frame)]
        return travelled

    def seen_until(self, vehicle: IntArray | int, frame: IntArray | int) -> IntArray:
        """[...] last frame of the unbroken view that a frame belongs to; where unseen: before it.

        A vehicle is in view at all of t ... u if and only if `seen_until(v, t) >= u`.
        """
        row = self.row_at(vehicle, frame)
        return np.where(row > 0, self.row_seen_until[row], np.asarray(frame) - 1)

    def seen(self, vehicle: IntArray, first: IntArray, last: IntArray) -> BoolArray:
        """[...] the vehicle is in view at every frame `first` ... `last`, both within the run."""
        inside = (first >= 0) & (last < self.frame_count)
        return inside & (self.seen_until(vehicle, first) >= last)

    def row_at(self, vehicle: IntArray | int, frame: IntArray | int) -> IntArray:
        """[...] the row of a vehicle at a frame, 0 where it is out of view.

        The rows of an unbroken view follow each other.
        """
        row = self._last_row(vehicle, frame)
        return np.where(self.row_frame[row] == frame, row, 0)

    def _last_row(self, vehicle: IntArray | int, frame: IntArray | int) -> IntArray:
        """[...] the last row of a vehicle up to a frame, 0 where there is none."""
        # A frame past the end must not find the rows of the next vehicle.
        wanted = vehicle * self.frame_count + np.minimum(frame, self.frame_count - 1)
        row = np.maximum(np.searchsorted(self._key, wanted, side="right") - 1, 0)
        return np.where(self.row_vehicle[row] == vehicle, row, 0)

    @cached_property
    def _key(self) -> IntArray:
        return self.row_vehicle * self.frame_count + self.row_frame  # rising


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
    order = np.lexsort((frame, vehicle))
    row_vehicle = np.concatenate(([-1], vehicle[order]))
    row_frame = np.concatenate(([-1], frame[order]))
    row_xy_m = np.concatenate((np.zeros((1, 2)), xy_m[order]))
    same = np.diff(row_vehicle) == 0
    unbroken = same & (np.diff(row_frame) == 1)
    step_m = np.zeros(len(row_frame))
    step_m[1:] = np.linalg.norm(np.diff(row_xy_m, axis=0), axis=1) * unbroken
    # Vehicle by vehicle, so that nobody's sum is rounded by what others travelled.
    first_rows = np.flatnonzero(~same) + 1
    travelled_m = np.concatenate([np.cumsum(own) for own in np.split(step_m, first_rows)])
    last_rows = np.flatnonzero(np.append(~unbroken, True))
    seen_until = np.repeat(row_frame[last_rows], np.diff(last_rows, prepend=-1))
    return Trajectories(ids, frame_count, row_vehicle, row_frame, row_xy_m, travelled_m, seen_until)


def samples(
    trajectories: Trajectories,
    every_frames: int = SAMPLE_EVERY_FRAMES,
    history_frames: int = HISTORY_FRAMES,
) -> tuple[IntArray, IntArray]:
    """The samples of a run: (vehicle [S], frame [S]), by frame and then by vehicle.

    Every vehicle in view for the 11 frames up to t (`history_frames`) and the 30 after it, at
    every fifth frame.
    """
    row = np.flatnonzero(trajectories.row_frame % every_frames == 0)
    vehicle, frame = trajectories.row_vehicle[row], trajectories.row_frame[row]
    whole = trajectories.seen(vehicle, frame - history_frames + 1, frame + HORIZON_FRAMES)
    vehicle, frame = vehicle[whole], frame[whole]
    order = np.lexsort((vehicle, frame))
    return vehicle[order], frame[order]


def goal_m(
    trajectories: Trajectories, vehicle: IntArray, frame: IntArray
) -> tuple[FloatArray, BoolArray]:
    """Distance travelled in the next 3 s: (metres [S], mask [S]); masked where the track ends."""
    whole = trajectories.seen(vehicle, frame, frame + HORIZON_FRAMES)
    then_m = trajectories.travelled_at(vehicle, frame + HORIZON_FRAMES)
    return np.where(whole, then_m - trajectories.travelled_at(vehicle, frame), 0.0), whole


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
    row = trajectories.row_at(vehicle, frame)
    inside = row > 0
    now, start = frame[inside], row[inside]
    last_row = len(trajectories.row_frame) - 1
    travelled = trajectories.row_travelled_m
    goal = distance_m[inside] + travelled[start]
    # Path length never falls, so bisect the rows of every unbroken view at once. The answer is
    # in [low, high] frames from now; high is one past the last allowed and means "not reached".
    low = np.zeros(len(start), dtype=np.int64)
    high = np.minimum(limit_frames, trajectories.row_seen_until[start] - now) + 1
    end = high
    while np.any(low < high):
        middle = (low + high) // 2
        reached = travelled[np.minimum(start + middle, last_row)] >= goal
        open_ = low < high
        high = np.where(open_ & reached, middle, high)
        low = np.where(open_ & ~reached, middle + 1, low)
    at_xy_m = trajectories.row_xy_m[np.minimum(start + low, last_row)]
    away_m = np.linalg.norm(at_xy_m - conflict_xy_m[inside], axis=1)
    result[inside] = np.where((low < end) & (away_m <= CROSSING_RADIUS_M), now + low, -1)
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
