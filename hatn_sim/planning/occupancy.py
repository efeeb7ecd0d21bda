"""Where others may be, by anybody's prediction, and how likely a way through them ends in contact.

Letters as in `datatypes`, and J others, R ways of the ego, G times `TIMES_S`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtr

from hatn_sim.assist.outlines import Boxes
from hatn_sim.datatypes import DT_S, HORIZON_FRAMES, FloatArray, IntArray, Prediction
from hatn_sim.geometry import wrap_angle
from hatn_sim.perception import CORRIDOR_M, CORRIDOR_RAD
from hatn_sim.planning.situation import Situation

STEP_FRAMES: Final = 2
TIMES_S: Final[FloatArray] = STEP_FRAMES * DT_S * np.arange(1.0, 26.0)
"""5 s; beyond the predicted 3 s, others drive on at their last speed along their line."""
PREDICTED: Final = HORIZON_FRAMES // STEP_FRAMES
NEAR_M: Final = 70.0
"""Others farther away are not met within 5 s."""
OFF_LINE_M: Final = 2.0
"""Whoever is predicted farther than this from its line drives on straight."""
STRAY_M: Final = 0.3
"""Whose line does not meet the ego's keeps to its lane, this standard deviation apart: what is not
known of the others is mostly where they turn."""
STILL_M: Final = 0.05
LEAST_MODE: Final = 0.01


@dataclass(frozen=True, eq=False)
class Occupancy:
    """The boxes of others at `TIMES_S`, one for each mode, and how far off they may be."""

    vehicle: IntArray  # [J] rows of the scene
    probability: FloatArray  # [J, K] of modes
    boxes: Boxes  # [J, K, G]
    along_m: FloatArray  # [J, G] standard deviation in the direction of each
    across_m: FloatArray  # [J, G]


def predicted_occupancy(
    now: Situation, prediction: Prediction, along_m: FloatArray, across_m: FloatArray
) -> Occupancy:
    """Where the others are of whom a way of the ego has to be clear.

    Those are all but the leader and others in the own corridor: these are followed, or follow.
    `along_m`, `across_m` [N, G] are the standard deviations of where vehicles will be.
    """
    others = _others(now)
    path = prediction.xy_m[others][:, :, STEP_FRAMES - 1 :: STEP_FRAMES]
    path = np.concatenate((path, _beyond(now, others, path)), axis=2)
    probability = prediction.mode_probability[others]
    size = np.broadcast_to(now.scene.size_m[others][:, None, None], path.shape)
    return Occupancy(
        vehicle=others,
        probability=probability / np.maximum(probability.sum(axis=1, keepdims=True), 1e-9),
        boxes=Boxes(path, _headings(now, others, path), size),
        along_m=along_m[others],
        across_m=np.where(
            np.isin(others, now.meetings.other)[:, None],
            across_m[others],
            np.minimum(across_m[others], STRAY_M),
        ),
    )


def _others(now: Situation) -> IntArray:
    scene, count = now.scene, len(now.scene.ids)
    far_m = np.linalg.norm(scene.xy_m - scene.xy_m[now.ego], axis=1)
    other = np.flatnonzero((far_m < NEAR_M) & (np.arange(count) != now.ego))
    line = np.full(len(other), now.line)
    low_m = np.full(len(other), now.s_m - NEAR_M)
    s_m, d_m = now.road.search(line, scene.xy_m[other], low_m, 2.0 * NEAR_M)
    turned = wrap_angle(scene.yaw_rad[other] - now.road.line_yaw_rad(line, s_m))
    alike = (np.abs(d_m) < CORRIDOR_M) & (np.abs(turned) < CORRIDOR_RAD)
    return other[~alike]


def _beyond(now: Situation, others: IntArray, path: FloatArray) -> FloatArray:
    """Positions [J, K, G - PREDICTED, 2] after those predicted."""
    end, step = path[:, :, -1], (path[:, :, -1] - path[:, :, -3]) / (2 * STEP_FRAMES * DT_S)
    later_s = TIMES_S[PREDICTED:] - TIMES_S[PREDICTED - 1]
    straight = end[:, :, None] + step[:, :, None] * later_s[:, None]
    modes = path.shape[1]
    line, s_m = np.repeat(now.lines.line[others], modes), np.repeat(now.lines.s_m[others], modes)
    on = np.flatnonzero(line >= 0)
    if not len(on):
        return straight
    flat = end.reshape(-1, 2)[on]
    end_s, end_d = now.road.search(line[on], flat, s_m[on] - 5.0, NEAR_M)
    speed = np.linalg.norm(step.reshape(-1, 2)[on], axis=1)
    along = now.road.locate(
        line[on],
        end_s[:, None] + speed[:, None] * later_s,
        np.repeat(end_d[:, None], len(later_s), axis=1),
    )
    near = np.abs(end_d) < OFF_LINE_M
    out = straight.reshape(-1, len(later_s), 2)
    out[on[near]] = along[near]
    return out.reshape(straight.shape)


def _headings(now: Situation, others: IntArray, path: FloatArray) -> FloatArray:
    """[J, K, G] in the direction of motion; who stands keeps the last one."""
    start = np.broadcast_to(now.scene.xy_m[others][:, None, None], (*path.shape[:2], 1, 2))
    step = np.diff(np.concatenate((start, path), axis=2), axis=2)
    yaw = np.arctan2(step[..., 1], step[..., 0])
    moves = np.hypot(step[..., 0], step[..., 1]) > STILL_M
    newest = np.maximum.accumulate(np.where(moves, np.arange(path.shape[2]), -1), axis=2)
    held = np.take_along_axis(yaw, np.maximum(newest, 0), axis=2)
    return np.where(newest >= 0, held, now.scene.yaw_rad[others][:, None, None])


def ego_boxes(now: Situation, travelled_m: FloatArray) -> Boxes:
    """The ego's outline [R, G] when it has come so far [R, G] along its line.

    Both of its ends are on the line: a long body cuts corners.
    """
    shape = travelled_m.shape
    line = np.full(shape[0], now.line)
    at_m, none = now.s_m + travelled_m, np.zeros(shape)
    front = now.road.locate(line, at_m + now.half_m, none)
    rear = now.road.locate(line, at_m - now.half_m, none)
    along = front - rear
    size = np.broadcast_to(now.scene.size_m[now.ego], (*shape, 2))
    return Boxes(0.5 * (front + rear), np.arctan2(along[..., 1], along[..., 0]), size)


def contact_probability(ego: Boxes, others: Occupancy, margin_m: float) -> FloatArray:
    """[R, J, K]: of ways of the ego [R, G], to end in contact with others if they drive so.

    Positions are normal about the predicted ones, so that the overlap of boxes along one axis has a
    closed form. Boxes meet only where they overlap along the axes of either: the less likely of the
    two bounds it. Errors last, so the likeliest moment stands for all. `margin_m` is kept free
    around the ego.
    """
    mode = np.nonzero(others.probability >= LEAST_MODE)
    path = others.boxes[mode]  # [B, G] of modes in turn
    along, across = others.along_m[mode[0]], others.across_m[mode[0]]
    away = path.xy_m[None] - ego.xy_m[:, None]
    turn = path.yaw_rad[None] - ego.yaw_rad[:, None]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    half, other_half = 0.5 * ego.size_m[:, None] + margin_m, 0.5 * path.size_m[None]
    of_other = _overlap(away, path.yaw_rad[None], other_half, half, cos, sin, along, across)
    # The errors of the other, seen along the axes of the ego.
    lengthwise = np.sqrt((along * cos) ** 2 + (across * sin) ** 2)
    sideways = np.sqrt((along * sin) ** 2 + (across * cos) ** 2)
    yaw = ego.yaw_rad[:, None]
    of_ego = _overlap(away, yaw, half, other_half, cos, sin, lengthwise, sideways)
    likeliest = np.minimum(of_other, of_ego).max(axis=-1)  # [R, B]
    out = np.zeros((len(likeliest), *others.probability.shape))
    out[:, mode[0], mode[1]] = likeliest
    return out


def _overlap(
    away: FloatArray,
    yaw: FloatArray,
    half: FloatArray,
    far: FloatArray,
    cos: FloatArray,
    sin: FloatArray,
    along_m: FloatArray,
    across_m: FloatArray,
) -> FloatArray:
    """[R, B, G]: that the projections on both axes of a box of heading `yaw` overlap."""
    c, s = np.cos(yaw), np.sin(yaw)
    ahead = np.abs(away[..., 0] * c + away[..., 1] * s)
    aside = np.abs(away[..., 1] * c - away[..., 0] * s)
    long = half[..., 0] + far[..., 0] * cos + far[..., 1] * sin
    wide = half[..., 1] + far[..., 0] * sin + far[..., 1] * cos
    lengthwise = ndtr((long - ahead) / along_m) - ndtr((-long - ahead) / along_m)
    return lengthwise * (ndtr((wide - aside) / across_m) - ndtr((-wide - aside) / across_m))
