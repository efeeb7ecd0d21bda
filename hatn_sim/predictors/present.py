"""How every vehicle moves now, out of what was seen of it: speed, acceleration, course, turn rate.

Simulators differ in what a speed and a heading are: SUMO moves a vehicle by the speed at the end of
a step, a bicycle model moves its centre aslant to its heading. So speed and heading as reported are
put right by how far, and in which direction, the vehicle has really gone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, HISTORY_FRAMES, BoolArray, FloatArray, Tracks
from hatn_sim.geometry import wrap_angle

TREND_FRAMES: Final = 6
"""Frames of the slow estimates: half a second."""
DOUBT: Final = 2.0
"""Standard deviations by which the newest values may differ from the slow estimates by chance."""
STILL_M: Final = 0.05
"""A step about as short as this says little of the direction of motion."""
SLIP_RAD: Final = 0.5
SPEED_OFFSET_MPS: Final = 1.0
HARDEST_MPS2: Final = 8.0
STRONGEST_MPS2: Final = 4.0
LATERAL_MPS2: Final = 10.0
TURN_RADPS: Final = 1.5
"""Bounds of what a road vehicle does: whatever is beyond them was not well seen."""


@dataclass(frozen=True, eq=False)
class Present:
    """The motion of vehicles [N] now, of their centres along their way."""

    speed_mps: FloatArray  # never negative
    acceleration_mps2: FloatArray
    course_rad: FloatArray  # direction of motion
    turn_rate_radps: FloatArray


def present_motion(tracks: Tracks) -> Present:
    """The motion now of all vehicles, from the last `HISTORY_FRAMES` of their tracks."""
    valid = tracks.valid[:, -HISTORY_FRAMES:]
    speed = tracks.speed_mps[:, -HISTORY_FRAMES:]
    yaw = np.unwrap(tracks.yaw_rad[:, -HISTORY_FRAMES:], axis=1)
    slip, offset = _beyond_reported(tracks.xy_m[:, -HISTORY_FRAMES:], yaw, speed)
    both = valid[:, 1:] & valid[:, :-1]
    true_speed = speed[:, -1] + np.clip(_level(offset, both), -SPEED_OFFSET_MPS, SPEED_OFFSET_MPS)
    true_speed = np.maximum(true_speed, 0.0)
    fastest_turn = np.minimum(TURN_RADPS, LATERAL_MPS2 / np.maximum(true_speed, 0.1))
    return Present(
        speed_mps=true_speed,
        acceleration_mps2=np.clip(_rate(speed, valid), -HARDEST_MPS2, STRONGEST_MPS2),
        course_rad=yaw[:, -1] + np.clip(_level(slip, both), -SLIP_RAD, SLIP_RAD),
        turn_rate_radps=np.clip(_rate(yaw, valid), -fastest_turn, fastest_turn),
    )


def _beyond_reported(
    xy_m: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Per step [N, T - 1]: direction of motion less heading, way per second less speed."""
    step = np.diff(xy_m, axis=1)
    square = (step * step).sum(axis=2)
    heading = 0.5 * (yaw_rad[:, 1:] + yaw_rad[:, :-1])
    slip = wrap_angle(np.arctan2(step[..., 1], step[..., 0]) - heading)
    known_slip = slip * square / (square + STILL_M**2)
    along_m = np.sqrt(square) * np.cos(slip - known_slip)
    offset = along_m / DT_S - 0.5 * (speed_mps[:, 1:] + speed_mps[:, :-1])
    return known_slip, offset


def _rate(values: FloatArray, valid: BoolArray) -> FloatArray:
    """Change per second [N] of values [N, T], now."""
    last = np.where(valid[:, -2], values[:, -1] - values[:, -2], 0.0) / DT_S
    recent, weight = values[:, -TREND_FRAMES:], valid[:, -TREND_FRAMES:].astype(np.float64)
    time_s = DT_S * np.arange(1 - TREND_FRAMES, 1)
    total = np.maximum(weight.sum(axis=1), 1.0)
    away_s = time_s - ((weight * time_s).sum(axis=1) / total)[:, None]
    spread = (weight * away_s**2).sum(axis=1)
    slope = (weight * away_s * recent).sum(axis=1) / np.maximum(spread, DT_S**2 / 2.0)
    return _trusted(last, slope, 2.0 * _noise(values, valid) / DT_S**2)


def _level(values: FloatArray, valid: BoolArray) -> FloatArray:
    """Values [N, T] as they are now [N]; 0 where nothing is known."""
    recent, weight = values[:, -TREND_FRAMES:], valid[:, -TREND_FRAMES:].astype(np.float64)
    mean = (weight * recent).sum(axis=1) / np.maximum(weight.sum(axis=1), 1.0)
    last = np.where(valid[:, -1], values[:, -1], 0.0)
    return _trusted(last, mean, _noise(values, valid))


def _trusted(newest: FloatArray, steady: FloatArray, noise: FloatArray) -> FloatArray:
    """The newest estimate as far as its `noise`, a variance, does not explain the difference.

    Within `DOUBT` standard deviations of the steady one it is that one, and the newest far away
    from it (the positive part of James and Stein's estimator).
    """
    gap = newest - steady
    return steady + np.maximum(0.0, 1.0 - DOUBT**2 * noise / np.maximum(gap * gap, 1e-12)) * gap


def _noise(values: FloatArray, valid: BoolArray) -> FloatArray:
    """Variance [N] of independent noise in values [N, T], by their third differences.

    What moves smoothly leaves next to nothing in these; of noise they keep 1 + 9 + 9 + 1 times the
    variance.
    """
    third = np.diff(values, n=3, axis=1)
    there = valid[:, 3:] & valid[:, 2:-1] & valid[:, 1:-2] & valid[:, :-3]
    total = (there * third**2).sum(axis=1)
    return total / (20.0 * np.maximum(there.sum(axis=1), 1))
