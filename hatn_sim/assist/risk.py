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

from hatn_sim.assist.pairs import CROSS, FOLLOW, MERGE, Pairs
from hatn_sim.datatypes import (
    DT_S,
    BoolArray,
    FloatArray,
    IntArray,
    Prediction,
    Scene,
)

FAR_S: Final = 60.0
"""Predicted arrivals later than this count as this: the vehicle stands."""
STANDING_MPS: Final = 0.3
"""Who is slower stands."""
LEAST_GAP_M: Final = 0.1
"""Gaps are taken to be at least this long where something is divided by them."""


# ---------------------------------------------------------------------------------------------
# When who is in an area


@dataclass(frozen=True, eq=False)
class Times:
    """When the two of each pair [..., Q, 2] come into their area and are out of it, from now, s."""

    enter_s: FloatArray
    leave_s: FloatArray

    def encroachment_s(self) -> FloatArray:
        """Predictive encroachment time (PrET) [..., Q]: from the first leaving to the second
        entering.

        Negative where both are there at once.
        """
        is_first = self.enter_s[..., 0] <= self.enter_s[..., 1]
        second = self.second_s()
        never = np.isinf(second)
        leaves = np.where(is_first, self.leave_s[..., 0], self.leave_s[..., 1])
        return np.where(never, np.inf, np.where(never, 0.0, second) - leaves)

    def second_s(self) -> FloatArray:
        """[..., Q] when the second comes in."""
        return np.maximum(self.enter_s[..., 0], self.enter_s[..., 1])

    def of(self, rows: IntArray) -> Times:
        """Of some of the pairs."""
        return Times(self.enter_s[..., rows, :], self.leave_s[..., rows, :])

    def mixed(self) -> Times:
        """Of W futures [W, Q, 2]: the first in each of them, the second in each [W, W, Q, 2]."""
        return Times(*(_mixed(times) for times in (self.enter_s, self.leave_s)))


def _mixed(of_two: FloatArray) -> FloatArray:
    out = np.empty((len(of_two), *of_two.shape))
    out[..., 0], out[..., 1] = of_two[:, None, :, 0], of_two[:, :, 1]
    return out


def times_at_speed(pairs: Pairs, speed_mps: FloatArray) -> Times:
    """At constant speeds [N] along the lines; infinite for who stands before the area, or in it."""
    speed = speed_mps[pairs.index]
    return Times(_over(pairs.room_m, speed), _over(pairs.clear_m, speed))


def times_predicted(pairs: Pairs, travelled_m: FloatArray) -> Times:
    """Of W futures [W, Q, 2], with path lengths [N, W, F] driven from now on; at most `FAR_S`."""
    count, frames = travelled_m.shape[1:]
    way = pairs.index * count + np.arange(count)[:, None, None]
    distance_m = np.stack((pairs.room_m, pairs.clear_m))[:, None]
    return Times(*arrival_s(travelled_m.reshape(-1, frames), way, distance_m))


def _over(way_m: FloatArray, speed_mps: FloatArray) -> FloatArray:
    """The time for a way [...], 0 if it is done; infinite for who stands."""
    moving = speed_mps > 0.0
    time = np.where(moving, way_m / np.where(moving, speed_mps, 1.0), np.inf)
    return np.where(way_m <= 0.0, 0.0, time)


def travelled_m(scene: Scene, prediction: Prediction) -> FloatArray:
    """Path length [N, F] of everybody's most probable predicted trajectory."""
    best = prediction.mode_probability.argmax(axis=1)
    return path_length_m(scene.xy_m, prediction.xy_m[np.arange(len(best)), best])


def path_length_m(start_m: FloatArray, xy_m: FloatArray) -> FloatArray:
    """Path length [..., F] from starts [..., 2] along positions [..., F, 2]."""
    step = np.empty(xy_m.shape)
    np.subtract(xy_m[..., 0, :], start_m, out=step[..., 0, :])
    np.subtract(xy_m[..., 1:, :], xy_m[..., :-1, :], out=step[..., 1:, :])
    step *= step
    return np.cumsum(np.sqrt(step[..., 0] + step[..., 1]), axis=-1)


def arrival_s(travelled_m: FloatArray, vehicle: IntArray, distance_m: FloatArray) -> FloatArray:
    """When vehicles have driven a distance: linear between frames, at the last speed beyond them.

    `travelled_m` [N, F] is the predicted path length; `vehicle` and `distance_m` are broadcast
    against each other.
    """
    path = np.concatenate((np.zeros((len(travelled_m), 1)), travelled_m), axis=1)
    reached = path[:, 1:].copy()
    reached[:, -1] = np.inf  # what is beyond the last frame is reached after it
    after = (reached[vehicle] < distance_m[..., None]).argmin(axis=-1) + 1
    high, low = path[vehicle, after], path[vehicle, after - 1]
    time_s = (after - 1 + (distance_m - low) / np.maximum(high - low, 1e-3)) * DT_S
    return np.minimum(np.where(distance_m <= 0.0, 0.0, time_s), FAR_S)


# ---------------------------------------------------------------------------------------------
# Measures


def time_to_collision_s(pairs: Pairs, speed_mps: FloatArray) -> FloatArray:
    """TTC [Q] at constant speeds [N]; infinite where they do not meet."""
    times = times_at_speed(pairs, speed_mps)
    second = times.second_s()
    crossing = np.where(times.encroachment_s() < 0.0, second, np.inf)
    gap, closing, _ = _in_line(pairs, speed_mps[pairs.index])
    following = _over(gap, closing)
    # In one lane from when the second is in it: what is left of the gap then is closed.
    still = np.where(np.isfinite(second), second, 0.0)
    merging = np.where(
        np.isfinite(second), still + _over(gap - still * np.maximum(closing, 0.0), closing), np.inf
    )
    merged = np.minimum(crossing, np.where(gap - still * closing > 0.0, merging, second))
    return np.select([pairs.type == FOLLOW, pairs.type == MERGE], [following, merged], crossing)


def deceleration_to_avoid_mps2(
    pairs: Pairs, speed_mps: FloatArray, leave_s: FloatArray
) -> FloatArray:
    """DRAC [Q, 2]: what each of a pair would have to brake at, if the other goes on.

    `leave_s` [Q, 2] is when the other leaves the area. Infinite for the leader of two who follow:
    its braking helps nobody. Speeds, `leave_s` and the distances of `pairs` may have axes in front,
    of several cases at once.
    """
    speed = speed_mps[..., pairs.index]
    give_way = required_deceleration_mps2(pairs.room_m, speed, leave_s[..., ::-1])
    gap, closing, is_behind = _in_line(pairs, speed)
    brakes = np.maximum(closing, 0.0) ** 2 / (2.0 * np.maximum(gap, LEAST_GAP_M))
    follows = (pairs.type == FOLLOW)[:, None]
    give_way = np.where(follows, np.where(is_behind, 0.0, np.inf), give_way)
    brakes_too = is_behind & (pairs.type != CROSS)[:, None]
    return np.where(brakes_too, np.maximum(give_way, brakes[..., None]), give_way)


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
    time = np.minimum(np.maximum(time_s, 1e-3), 1e6)  # whoever never leaves, leaves late
    rolling = 2.0 * (speed_mps * time - distance_m) / time**2
    stopping = speed_mps**2 / (2.0 * np.maximum(distance_m, 0.1))
    needed = np.where(rolling * time > speed_mps, stopping, rolling)
    return np.where(speed_mps * time <= distance_m, 0.0, needed)


def _in_line(pairs: Pairs, speed_mps: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Of those who follow or merge, at speeds [..., Q, 2]: gap along the common lane [..., Q],
    closing speed [..., Q], who is behind [..., Q, 2].

    At a merge both are laid on one lane by their distances to it; of no meaning at a crossing.
    """
    follows = pairs.type == FOLLOW
    ahead = pairs.to_point_m[..., 0] - pairs.to_point_m[..., 1]
    first_behind = (ahead > 0.0) & ~follows
    # half lengths are what the way to the point has more than the room before it
    half = 0.5 * (pairs.length_m[:, 0] + pairs.length_m[:, 1])
    gap = np.where(follows, pairs.room_m[..., 1], np.abs(ahead) - half)
    gains = speed_mps[..., 0] - speed_mps[..., 1]
    closing = np.where(first_behind, gains, -gains)
    return gap, closing, np.stack((first_behind, ~first_behind), axis=-1)
