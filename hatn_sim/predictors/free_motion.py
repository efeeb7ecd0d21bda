"""Motion that goes on as it began: accelerating, turning, and both fading. No road is needed."""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES, FloatArray, Tracks
from hatn_sim.predictors.present import Present, present_motion

TIMES_S: Final = DT_S * np.arange(1, HORIZON_FRAMES + 1, dtype=np.float64)
ACCELERATION_FADE_S: Final = 5.0
TURN_FADE_S: Final = 5.0


def travelled_m(speed_mps: FloatArray, acceleration_mps2: FloatArray, fade_s: float) -> FloatArray:
    """Distance travelled [N, F] at an acceleration of a exp(-t / fade), up to a standstill.

    v(t) = v + a fade (1 - exp(-t / fade)), integrated exactly; who stops stays.
    """
    v, a = speed_mps[:, None], acceleration_mps2[:, None]
    # How much of the acceleration's whole effect it takes to stop; 1: it does not suffice.
    share = np.divide(v, -a * fade_s, out=np.ones_like(v), where=-a * fade_s > v)
    stops_s = np.where(share < 1.0, -fade_s * np.log1p(-np.minimum(share, 1.0 - 1e-9)), np.inf)
    t: FloatArray = np.minimum(TIMES_S, stops_s)
    return v * t + a * fade_s * (t - faded_s(t, fade_s))


def faded_s(time_s: FloatArray, fade_s: float) -> FloatArray:
    """The integral of exp(-t / fade) up to `time_s`."""
    integral: FloatArray = -fade_s * np.expm1(-time_s / fade_s)
    return integral


def turning_xy_m(
    xy_m: FloatArray, course_rad: FloatArray, turned_rad: FloatArray, travel_m: FloatArray
) -> FloatArray:
    """Positions [N, F, 2] from `xy_m` [N, 2] on, of vehicles that have turned and travelled so far
    [N, F] at every frame; arcs of circles within a frame."""
    start = np.zeros((len(xy_m), 1))
    turn = np.diff(turned_rad, axis=1, prepend=start)
    step_m = np.diff(travel_m, axis=1, prepend=start) * np.sinc(turn / (2.0 * np.pi))  # chords
    direction = course_rad[:, None] + turned_rad - 0.5 * turn
    steps = np.stack((step_m * np.cos(direction), step_m * np.sin(direction)), axis=2)
    return xy_m[:, None] + np.cumsum(steps, axis=1)


def fallback_motion(tracks: Tracks) -> FloatArray:
    """Positions [N, F, 2] at today's turn rate and acceleration: for vehicles on no line."""
    return continued_xy_m(tracks, present_motion(tracks))


def continued_xy_m(tracks: Tracks, now: Present) -> FloatArray:
    """Positions [N, F, 2] when today's turn rate and acceleration go on, fading."""
    travel_m = travelled_m(now.speed_mps, now.acceleration_mps2, ACCELERATION_FADE_S)
    turned_rad = now.turn_rate_radps[:, None] * faded_s(TIMES_S, TURN_FADE_S)
    return turning_xy_m(tracks.xy_m[:, -1], now.course_rad, turned_rad, travel_m)
