"""Which outlines touch, where a simulator does not say."""

from __future__ import annotations

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Scene


def touching_pairs(scene: Scene, margin_m: float = 0.0) -> tuple[tuple[str, str], ...]:
    """The pairs of road users whose rectangles come within `margin_m`, ids sorted."""
    first, second = np.triu_indices(len(scene.ids), 1)
    names = [
        sorted((scene.ids[i], scene.ids[j]))
        for i, j in _touching_rows(scene, first, second, margin_m)
    ]
    return tuple(sorted((one, other) for one, other in names))


def touching_rows_of(scene: Scene, of: BoolArray) -> list[tuple[int, int]]:
    """Rows (one, other) of a scene whose rectangles touch, one being of those marked [N]."""
    first, second = np.nonzero(of[:, None] & ~np.eye(len(of), dtype=np.bool_))
    once = ~of[second] | (first < second)  # pairs of marked ones
    return _touching_rows(scene, first[once], second[once], 0.0)


def _touching_rows(
    scene: Scene, first: IntArray, second: IntArray, margin_m: float
) -> list[tuple[int, int]]:
    reach_m = 0.5 * np.hypot(scene.size_m[:, 0], scene.size_m[:, 1])
    away_m = np.hypot(*(scene.xy_m[second] - scene.xy_m[first]).T)
    near = away_m <= reach_m[first] + reach_m[second] + margin_m
    first, second = first[near], second[near]
    touch = boxes_touch(scene.xy_m, scene.yaw_rad, scene.size_m, first, second, margin_m)
    return list(zip(first[touch].tolist(), second[touch].tolist(), strict=True))


def boxes_touch(
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    size_m: FloatArray,
    first: IntArray,
    second: IntArray,
    margin_m: float = 0.0,
) -> BoolArray:
    """Whether pairs [Q] of boxes come within `margin_m`: none of their four axes parts them.

    By the separating axis theorem. Boxes are [N] centres, yaws, lengths and widths; `first` and
    `second` [Q] are rows of them.
    """
    along = np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    half = 0.5 * size_m
    between = xy_m[second] - xy_m[first]
    touch = np.ones(len(first), dtype=np.bool_)
    for axis in (along[first], across[first], along[second], across[second]):
        reach = np.full(len(first), margin_m)
        for box in (first, second):
            reach += np.abs((along[box] * axis).sum(axis=1)) * half[box, 0]
            reach += np.abs((across[box] * axis).sum(axis=1)) * half[box, 1]
        touch &= np.abs((between * axis).sum(axis=1)) <= reach
    return touch
