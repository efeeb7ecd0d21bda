"""How far off a predictor is, learnt from how far off it was: the same way for all predictors.

Every `EVERY_FRAMES` the most probable path of every vehicle is noted, and compared with where the
vehicle is later. The mean squared errors along and across it, growing with time, begin from what is
assumed of a predictor nobody knows, and are learnt apart for those who move and those who stand.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, FloatArray, Prediction, Scene
from hatn_sim.planning.occupancy import TIMES_S

AFTER_S: Final = np.array([0.5, 1.0, 2.0, 3.0])
"""When what was predicted is compared with what is."""
EVERY_FRAMES: Final = 5
MOVING_MPS: Final = 1.0
ASSUMED_M: Final = np.array([[0.1, 0.25, 0.7, 1.3], [0.05, 0.1, 0.2, 0.3]])
"""Standard deviations along and across after `AFTER_S`, before anything is known ..."""
ASSUMED_OF: Final = 60.0
"""... which weighs as much as so many comparisons."""
LEAST_M: Final = 0.1
FAR_M: Final = 6.0
"""An error of more than this says that somebody was mistaken for another; it counts as this."""


@dataclass(frozen=True, eq=False)
class Noted:
    """What was predicted at some time: the most probable paths."""

    time_s: float
    ids: tuple[str, ...]
    at_m: FloatArray  # [N, A, 2] after `AFTER_S`
    yaw_rad: FloatArray  # [N, A] of the path there
    moving: FloatArray  # [N] 1: it moved, or was to


@dataclass(frozen=True, eq=False)
class Doubt:
    """Mean squared errors [2 still or moving, 2 along or across, A] and what they are of."""

    square_m2: FloatArray = field(default_factory=lambda: np.stack((ASSUMED_M, ASSUMED_M)) ** 2)
    count: FloatArray = field(default_factory=lambda: np.full((2, 1, len(AFTER_S)), ASSUMED_OF))
    noted: tuple[Noted, ...] = ()
    frame: int = 0


def learn(doubt: Doubt, scene: Scene, prediction: Prediction, ego_id: str) -> Doubt:
    """A frame on; the ego does as it likes and counts for nothing."""
    noted, square, count = doubt.noted, doubt.square_m2, doubt.count
    for old in noted:
        late = np.flatnonzero(np.abs(old.time_s + AFTER_S - scene.time_s) < 0.5 * DT_S)
        if len(late):
            square, count = _compared(square, count, old, scene, int(late[0]), ego_id)
    if doubt.frame % EVERY_FRAMES == 0:
        newest = scene.time_s - AFTER_S[-1]
        noted = (*(old for old in noted if old.time_s > newest), _note(scene, prediction))
    return replace(doubt, square_m2=square, count=count, noted=noted, frame=doubt.frame + 1)


def doubts_m(doubt: Doubt, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Standard deviations [N, G] along and across at `TIMES_S`, growing on beyond the last."""
    std = np.sqrt(doubt.square_m2)  # [2, 2, A]
    more = std[..., -1:] + (std[..., -1:] - std[..., -2:-1]) * (TIMES_S[-1] - AFTER_S[-1])
    nodes = np.concatenate((np.full_like(more, 0.0), std, more), axis=-1)
    at = np.concatenate(([0.0], AFTER_S, TIMES_S[-1:]))
    table = np.array([[np.interp(TIMES_S, at, row) for row in kind] for kind in nodes])
    table = np.maximum(table, LEAST_M)
    moving = (scene.speed_mps > MOVING_MPS).astype(np.int64)
    return table[moving, 0], table[moving, 1]


def _note(scene: Scene, prediction: Prediction) -> Noted:
    rows = np.arange(len(scene.ids))
    path = prediction.xy_m[rows, prediction.mode_probability.argmax(axis=1)]
    frame = np.rint(AFTER_S / DT_S).astype(np.int64) - 1
    whole = np.concatenate((scene.xy_m[:, None], path), axis=1)
    step = whole[:, frame + 1] - whole[:, np.maximum(frame - 4, 0)]
    short = np.hypot(step[..., 0], step[..., 1]) < LEAST_M
    yaw = np.where(short, scene.yaw_rad[:, None], np.arctan2(step[..., 1], step[..., 0]))
    moving = (scene.speed_mps > MOVING_MPS).astype(np.float64)
    return Noted(scene.time_s, scene.ids, path[:, frame], yaw, moving)


def _compared(
    square: FloatArray, count: FloatArray, old: Noted, scene: Scene, late: int, ego_id: str
) -> tuple[FloatArray, FloatArray]:
    row_of = {name: row for row, name in enumerate(scene.ids) if name != ego_id}
    pairs = [(k, row_of[name]) for k, name in enumerate(old.ids) if name in row_of]
    if not pairs:
        return square, count
    then, here = np.array(pairs).T
    off = scene.xy_m[here] - old.at_m[then, late]
    cos, sin = np.cos(old.yaw_rad[then, late]), np.sin(old.yaw_rad[then, late])
    errors = np.stack((off[:, 0] * cos + off[:, 1] * sin, off[:, 1] * cos - off[:, 0] * sin))
    errors = np.minimum(errors**2, FAR_M**2)
    square, count = square.copy(), count.copy()
    for kind in (0, 1):
        its = old.moving[then] == kind
        before = count[kind, 0, late]
        after = before + its.sum()
        total = square[kind, :, late] * before + errors[:, its].sum(axis=1)
        square[kind, :, late], count[kind, 0, late] = total / after, after
    return square, count
