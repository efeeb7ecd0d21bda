"""Which outlines touch, where a simulator does not say."""

from __future__ import annotations

import numpy as np

from hatn_sim.datatypes import FloatArray, Scene


def touching_pairs(scene: Scene, margin_m: float = 0.0) -> tuple[tuple[str, str], ...]:
    """The pairs of road users whose rectangles come within `margin_m`, ids sorted.

    By the separating axis theorem: two rectangles are apart if they are along a side of either.
    """
    count = len(scene.ids)
    first, second = np.triu_indices(count, 1)
    reach_m = 0.5 * np.hypot(scene.size_m[:, 0], scene.size_m[:, 1])
    away_m = scene.xy_m[second] - scene.xy_m[first]
    near = np.hypot(away_m[:, 0], away_m[:, 1]) < reach_m[first] + reach_m[second] + margin_m
    first, second, away_m = first[near], second[near], away_m[near]
    ahead = np.stack((np.cos(scene.yaw_rad), np.sin(scene.yaw_rad)), axis=1)
    sides = np.stack((ahead, np.stack((-ahead[:, 1], ahead[:, 0]), axis=1)), axis=1)  # [N, 2, 2]
    axes = np.concatenate((sides[first], sides[second]), axis=1)  # [Q, 4, 2]
    gap_m = np.abs((axes * away_m[:, None]).sum(axis=2))
    gap_m -= _half_widths_m(axes, sides[first], scene.size_m[first])
    gap_m -= _half_widths_m(axes, sides[second], scene.size_m[second])
    touch = gap_m.max(axis=1, initial=-np.inf) <= margin_m
    names = [
        sorted((scene.ids[i], scene.ids[j]))
        for i, j in zip(first[touch], second[touch], strict=True)
    ]
    return tuple(sorted((one, other) for one, other in names))


def _half_widths_m(axes: FloatArray, sides: FloatArray, size_m: FloatArray) -> FloatArray:
    """Half the extent [Q, 4] of rectangles along axes [Q, 4, 2]."""
    along = np.abs(np.einsum("qak,qsk->qas", axes, sides))
    return 0.5 * (along * size_m[:, None]).sum(axis=2)
