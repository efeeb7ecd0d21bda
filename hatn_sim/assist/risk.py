"""Measures of risk, for all pairs of a moment at once: TTC, PrET, DRAC, time headway.

Distances come from our own conflict geometry and real outlines (`pairs`). What takes place never
has the time infinity, what needs no braking a deceleration of 0, and what no braking can prevent an
infinite one.

| measure | unit | following | crossing | merging | source |
|---|---|---|---|---|---|
| `time_to_collision_s` | s | gap / closing speed | entry of the second, if the first is in then | \
the same, or the gap behind the point / closing speed | Hayward 1972; van der Horst 1990 |
| `encroachment_s` | s | none | from the first leaving to the second entering | as crossing | \
Allen, Shin and Cooper 1978, ahead of the event |
| `deceleration_to_avoid_mps2` | m/s2 | closing speed^2 / (2 gap) | to enter as the other leaves | \
the larger of both | Archer 2005; Gettman et al. 2008 (SSAM) |
| `time_headway_s` | s | gap / speed | none | none | Vogel 2003, from bumper to bumper |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.assist.pairs import FOLLOW, Pairs
from hatn_sim.datatypes import DT_S, ConflictType, FloatArray, IntArray, Prediction, Scene

FAR_S: Final = 60.0
"""Predicted arrivals later than this count as this: the vehicle stands."""
LEAST_GAP_M: Final = 0.1
"""Gaps are taken to be at least this long where something is divided by them."""


# ---------------------------------------------------------------------------------------------
# When who is in an area


@dataclass(frozen=True, eq=False)
class Times:
    """When the two of each pair [Q, 2] come into their area and are out of it, from now, s."""

    enter_s: FloatArray
    leave_s: FloatArray

    def encroachment_s(self) -> FloatArray:
        """Predictive encroachment time (PrET) [Q]: from the first leaving to the second entering.

        Negative where both are there at once.
        """
        first = self.enter_s[:, 0] <= self.enter_s[:, 1]
        second = self.second_s()
        never = np.isinf(second)
        leaves = np.where(first, self.leave_s[:, 0], self.leave_s[:, 1])
        return np.where(never, np.inf, np.where(never, 0.0, second) - leaves)

    def second_s(self) -> FloatArray:
        """[Q] when the second comes in."""
        return np.asarray(self.enter_s.max(axis=1))

    def of(self, rows: IntArray) -> Times:
        """Of some of the pairs."""
        return Times(self.enter_s[rows], self.leave_s[rows])


def times_at_speed(pairs: Pairs, speed_mps: FloatArray) -> Times:
    """At constant speeds [N] along the lines; infinite for who stands before the area, or in it."""
    speed = speed_mps[pairs.index]
    return Times(_over(pairs.room_m, speed), _over(pairs.clear_m, speed))


def times_predicted(pairs: Pairs, travelled_m: FloatArray) -> Times:
    """With path lengths [N, F] driven from now on; at most `FAR_S`."""
    enter, leave = (
        np.stack([arrival_s(travelled_m, pairs.index[:, k], way[:, k]) for k in (0, 1)], axis=1)
        for way in (pairs.room_m, pairs.clear_m)
    )
    return Times(enter, leave)


def _over(way_m: FloatArray, speed_mps: FloatArray) -> FloatArray:
    """The time for a way [...], 0 if it is done; infinite for who stands."""
    moving = speed_mps > 0.0
    time = np.where(moving, way_m / np.where(moving, speed_mps, 1.0), np.inf)
    return np.where(way_m <= 0.0, 0.0, time)


def travelled_m(scene: Scene, prediction: Prediction) -> FloatArray:
    """Path length [N, F] of everybody's most probable predicted trajectory."""
    best = prediction.mode_probability.argmax(axis=1)
    path = prediction.xy_m[np.arange(len(best)), best]
    whole = np.concatenate((scene.xy_m[:, None], path), axis=1)
    return np.cumsum(np.linalg.norm(np.diff(whole, axis=1), axis=2), axis=1)


def arrival_s(travelled_m: FloatArray, vehicle: np.ndarray, distance_m: FloatArray) -> FloatArray:
    """When vehicles have driven a distance: linear between frames, at the last speed beyond them.

    `travelled_m` [N, F] is the predicted path length; `vehicle` and `distance_m` share any shape.
    """
    path = np.concatenate((np.zeros((len(travelled_m), 1)), travelled_m), axis=1)
    own = path[vehicle]
    frames = own.shape[-1] - 1
    after = np.clip((own < distance_m[..., None]).sum(axis=-1), 1, frames)
    high = np.take_along_axis(own, after[..., None], -1)[..., 0]
    low = np.take_along_axis(own, after[..., None] - 1, -1)[..., 0]
    step = np.maximum(high - low, 1e-3)
    time_s = (after - 1 + (distance_m - low) / step) * DT_S
    return np.clip(np.where(distance_m <= 0, 0.0, time_s), 0.0, FAR_S)


# ---------------------------------------------------------------------------------------------
# Measures


def time_to_collision_s(pairs: Pairs, speed_mps: FloatArray) -> FloatArray:
    """TTC [Q] at constant speeds [N]; infinite where they do not meet."""
    times = times_at_speed(pairs, speed_mps)
    second = times.second_s()
    crossing = np.where(times.encroachment_s() < 0.0, second, np.inf)
    gap, closing, _ = _in_line(pairs, speed_mps)
    following = _over(gap, closing)
    # In one lane from when the second is in it: what is left of the gap then is closed.
    still = np.where(np.isfinite(second), second, 0.0)
    merging = np.where(
        np.isfinite(second), still + _over(gap - still * np.maximum(closing, 0.0), closing), np.inf
    )
    merged = np.minimum(crossing, np.where(gap - still * closing > 0.0, merging, second))
    return np.select(
        [pairs.type == FOLLOW, pairs.type == ConflictType.MERGE], [following, merged], crossing
    )


def deceleration_to_avoid_mps2(
    pairs: Pairs, speed_mps: FloatArray, leave_s: FloatArray
) -> FloatArray:
    """DRAC [Q, 2]: what each of a pair would have to brake at, if the other goes on.

    `leave_s` [Q, 2] is when the other leaves the area. Infinite for the leader of two who follow:
    its braking helps nobody.
    """
    speed = speed_mps[pairs.index]
    give_way = np.stack(
        [
            required_deceleration_mps2(pairs.room_m[:, k], speed[:, k], leave_s[:, 1 - k])
            for k in (0, 1)
        ],
        axis=1,
    )
    gap, closing, behind = _in_line(pairs, speed_mps)
    brakes = np.maximum(closing, 0.0) ** 2 / (2.0 * np.maximum(gap, LEAST_GAP_M))
    is_behind = np.arange(2) == behind[:, None]
    follow = np.where(is_behind, brakes[:, None], np.inf)
    merge = np.where(is_behind, np.maximum(give_way, brakes[:, None]), give_way)
    return np.select(
        [(pairs.type == kind)[:, None] for kind in (FOLLOW, ConflictType.MERGE)],
        [follow, merge],
        give_way,
    )


def time_headway_s(pairs: Pairs, speed_mps: FloatArray) -> FloatArray:
    """Time [Q] until the follower is where its leader's rear bumper is now; infinite for others."""
    speed = speed_mps[pairs.index[:, 1]]
    return np.where(pairs.type == FOLLOW, _over(pairs.room_m[:, 1], speed), np.inf)


def required_deceleration_mps2(
    distance_m: FloatArray, speed_mps: FloatArray, time_s: FloatArray
) -> FloatArray:
    """DRAC: constant braking that lets a vehicle arrive no earlier than `time_s` from now.

    2 (v t - d) / t^2 while it still rolls then, v^2 / 2d where it has to stop before; 0 where it
    would come later anyhow (after Archer 2005, eq. 4.6; the limit is the arrival of the other).
    """
    time = np.clip(time_s, 1e-3, 1e6)  # whoever never leaves, leaves late
    rolling = 2.0 * (speed_mps * time - distance_m) / time**2
    stopping = speed_mps**2 / (2.0 * np.maximum(distance_m, 0.1))
    needed = np.where(rolling * time > speed_mps, stopping, rolling)
    return np.where(speed_mps * time <= distance_m, 0.0, needed)


def _in_line(pairs: Pairs, speed_mps: FloatArray) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Of those who follow or merge [Q]: gap along the common lane, closing speed, who is behind.

    At a merge both are laid on one lane by their distances to it; of no meaning at a crossing.
    """
    ahead = pairs.to_point_m[:, 0] - pairs.to_point_m[:, 1]
    ahead = np.where(pairs.type == FOLLOW, 0.0, ahead)
    behind = np.where(ahead > 0.0, 0, 1)
    # half lengths are what the way to the point has more than the room before it
    half = 0.5 * pairs.length_m.sum(axis=1)
    gap = np.where(pairs.type == FOLLOW, pairs.room_m[:, 1], np.abs(ahead) - half)
    rows = np.arange(len(behind))
    speed = speed_mps[pairs.index]
    return gap, speed[rows, behind] - speed[rows, 1 - behind], behind
