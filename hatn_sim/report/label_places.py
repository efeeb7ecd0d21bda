"""Where to put labels so that they cover nothing and each other neither. Pure geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray
from hatn_sim.report.road_shapes import Box

DISTANCES_M: Final = (3.2, 4.2, 5.4, 7.0, 9.0, 12.0)
DIRECTIONS: Final = 24
GAP_M: Final = 0.5
DRIFT_COST_PER_M: Final = 0.6
"""How much a label holds on to where it was a frame before."""


@dataclass(frozen=True, eq=False)
class Label:
    """A text to be put beside something."""

    key: str
    anchor_xy_m: FloatArray  # [2] what it belongs to
    size_m: tuple[float, float]  # width, height of its box


def place_labels(
    labels: Sequence[Label],
    obstacles_xy_m: FloatArray,
    box: Box,
    before: Mapping[str, FloatArray] | None = None,
) -> dict[str, FloatArray]:
    """Centres [2] of all labels, the first placed first.

    Args:
        labels: to be placed.
        obstacles_xy_m: [P, 2] points better not covered, densely along whatever is drawn.
        box: what is shown; labels stay inside.
        before: offsets of the centres from their anchors a frame ago, to keep labels calm.
    """
    angle = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)
    ring = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    placed: dict[str, FloatArray] = {}
    taken: list[tuple[FloatArray, FloatArray]] = []
    for label in labels:
        half = 0.5 * np.array(label.size_m)
        # Farther out sideways, as boxes are wide: the gap to the anchor is the same all around.
        offsets = np.concatenate([ring * (d + half * (0.8, 0.4)) for d in DISTANCES_M])
        last = None if before is None else before.get(label.key)
        if last is not None:
            offsets = np.concatenate((last[None], offsets))
        centres = label.anchor_xy_m + offsets
        low = np.array([box.west_m, box.south_m]) + half + GAP_M
        high = np.array([box.east_m, box.north_m]) - half - GAP_M
        centres = np.clip(centres, low, np.maximum(low, high))
        inside = np.abs(obstacles_xy_m - centres[:, None]) < half + GAP_M
        cost = inside.all(axis=2).sum(axis=1) * 1.0
        for centre, other_half in taken:
            cost += 1e3 * (np.abs(centres - centre) < half + other_half + GAP_M).all(axis=1)
        cost += 0.35 * np.linalg.norm(centres - label.anchor_xy_m, axis=1)
        if last is not None:
            moved_m = np.linalg.norm(centres - label.anchor_xy_m - last, axis=1)
            cost += DRIFT_COST_PER_M * np.minimum(moved_m, 6.0)
        best = centres[int(cost.argmin())]
        placed[label.key] = best
        taken.append((best, half))
    return placed
