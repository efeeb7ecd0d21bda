"""Simulated traffic as people drive: off the lane centres, cutting corners, sparing with blinkers.

Simulated vehicles keep to the middle of their lanes and always signal, so a choice of lines
learned from them alone would trust both too much. The vehicles here go where they went, when they
went there, on paths shifted sideways: towards the inside of bends, by a habit of each driver, by
a slow wander, and by where the lanes of the place are drawn wrong.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hatn_sim.datatypes import BoolArray, FloatArray, Frame

CUT_M: Final = 2.0
"""Drivers cut corners by up to this, each to an own degree."""
CUT_BEND_PER_M: Final = 0.06
"""A bend of this curvature is cut by three quarters of that."""
CUT_REACH_M: Final = 6.0
"""Corners are cut this long before and behind them."""
DRIVER_M: Final = 0.3
WANDER_M: Final = 0.15
WANDER_REACH_M: Final = 10.0
PLACE_M: Final = 0.3
PLACE_WAVE_M: Final = 40.0
"""Standard deviations of the other shifts, and how far they reach."""
GRID_M: Final = 0.5
STILL_M: Final = 2.0
"""Who drives less than this is shifted as a whole."""


def strayed(frames: Iterable[Frame], seed: int, signalling: float = 1.0) -> list[Frame]:
    """The frames of a run with every vehicle off its path, and only some drivers signalling.

    Args:
        frames: of a run, in order.
        seed: of the drivers' habits and the place.
        signalling: share of drivers who use their blinkers.
    """
    run = list(frames)
    random = np.random.default_rng(seed)
    place = random.normal(size=(6, 2)) * 2.0 * np.pi / PLACE_WAVE_M, random.uniform(0.0, 7.0, 6)
    where: dict[str, list[tuple[int, int]]] = {}
    for index, frame in enumerate(run):
        for row, name in enumerate(frame.scene.ids):
            where.setdefault(name, []).append((index, row))
    xy_m = [frame.scene.xy_m.copy() for frame in run]
    yaw_rad = [frame.scene.yaw_rad.copy() for frame in run]
    speed_mps = [frame.scene.speed_mps.copy() for frame in run]
    blinker = [frame.scene.blinker.copy() for frame in run]
    for at in where.values():
        track = np.array([run[index].scene.xy_m[row] for index, row in at])
        yaw = np.unwrap([float(run[index].scene.yaw_rad[row]) for index, row in at])
        shifted, turned, pace = _shifted(track, yaw, place, random)
        silent = random.uniform() >= signalling
        for k, (index, row) in enumerate(at):
            xy_m[index][row], yaw_rad[index][row] = shifted[k], turned[k]
            speed_mps[index][row] *= pace[k]
            if silent:
                blinker[index][row] = 0
    return [
        replace(
            frame,
            scene=replace(
                frame.scene,
                xy_m=xy_m[index],
                yaw_rad=(yaw_rad[index] + np.pi) % (2.0 * np.pi) - np.pi,
                speed_mps=speed_mps[index],
                blinker=blinker[index],
            ),
        )
        for index, frame in enumerate(run)
    ]


def _shifted(
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    place: tuple[FloatArray, FloatArray],
    random: np.random.Generator,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions [T, 2], headings [T] and factors [T] of the speed of one vehicle's new path."""
    waves, phases = place
    driver_m, cut = random.normal(0.0, DRIVER_M), random.uniform(0.0, 1.0)
    s_m = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(xy_m, axis=0), axis=1))))
    grid_m = np.arange(0.0, s_m[-1] + GRID_M, GRID_M)
    rough = random.normal(size=len(grid_m) + 200)
    side = np.stack((-np.sin(yaw_rad), np.cos(yaw_rad)), axis=1)
    if s_m[-1] < STILL_M:
        return xy_m + driver_m * side, yaw_rad, np.ones(len(s_m))
    moving: BoolArray = np.diff(s_m, prepend=-1.0) > 1e-6
    path = np.stack([np.interp(grid_m, s_m[moving], xy_m[moving, k]) for k in (0, 1)], axis=1)
    heading = np.interp(grid_m, s_m[moving], yaw_rad[moving])
    bend = gaussian_filter1d(np.gradient(heading, GRID_M), CUT_REACH_M / GRID_M, mode="nearest")
    wander = gaussian_filter1d(rough, WANDER_REACH_M / GRID_M)[100:-100]
    wander *= WANDER_M * np.sqrt(2.0 * np.sqrt(np.pi) * WANDER_REACH_M / GRID_M)
    drawn = np.cos(path @ waves.T + phases).sum(axis=1) * PLACE_M / np.sqrt(0.5 * len(phases))
    off_m = gaussian_filter1d(
        driver_m + cut * CUT_M * np.tanh(bend / CUT_BEND_PER_M) + wander + drawn,
        2.0 / GRID_M,
        mode="nearest",
    )
    slope = np.gradient(off_m, GRID_M)
    d, dd = np.interp(s_m, grid_m, off_m), np.interp(s_m, grid_m, slope)
    along = np.maximum(1.0 - np.interp(s_m, grid_m, bend) * d, 0.2)
    return xy_m + d[:, None] * side, yaw_rad + np.arctan2(dd, along), np.hypot(along, dd)
