"""Post-encroachment time from tracks: how narrowly vehicles missed each other, after the fact.

Of two vehicles A and B, PET is the least |tau| for which the outline of A at some time t overlaps
that of B at t + tau: how long after the one had left a place the other was there (Allen, Shin and
Cooper 1978). Where outlines overlap at the same time, PET is negative: by so much either would
have had to come earlier or later for them not to touch. It follows the outlines alone, so it needs
no area of conflict, and holds for crossing, merging and following. Unit: s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.assist.outlines import Boxes, overlap
from hatn_sim.datatypes import DT_S, BoolArray, FloatArray, IntArray

LONGEST_S: Final = 5.0
"""Longer encroachment times are none."""
SAME_PLACE_M: Final = 0.01
SAME_PLACE_RAD: Final = 0.001
"""Frames with less motion than this are of one place."""
_LONGEST_STAY: Final = 20  # frames of one place: longer stays are cut


@dataclass(frozen=True, eq=False)
class Encroachments:
    """Pairs of vehicles that were at one place within `LONGEST_S` of each other, [P]."""

    first: IntArray  # vehicle, the lower number
    second: IntArray
    pet_s: FloatArray  # negative where they touched
    entry_frame: IntArray  # when the later of the two came there; contact where they touched


def encroachments(
    vehicle: IntArray, frame: IntArray, boxes: Boxes, longest_s: float = LONGEST_S
) -> Encroachments:
    """The encroachment times of all pairs of vehicles, one row for each vehicle and frame in view.

    Args:
        vehicle: [R] numbers of the vehicles.
        frame: [R] frames of `DT_S`.
        boxes: [R] outlines.
        longest_s: pairs that never came nearer in time are left out: their PET is undefined.
    """
    order = np.lexsort((frame, vehicle))
    vehicle, frame, boxes = vehicle[order], frame[order], boxes[order]
    start, stop = _places(vehicle, frame, boxes)
    one, other = _near(vehicle[start], frame[start], boxes[start], round(longest_s / DT_S))
    met = overlap(boxes[start[one]], boxes[start[other]])
    one, other = one[met], other[met]
    swap = vehicle[start[one]] > vehicle[start[other]]
    one, other = np.where(swap, other, one), np.where(swap, one, other)
    # Frames between the end of the earlier and the beginning of the later; 0: there together.
    begins, ends = frame[start], frame[stop]
    apart = np.maximum(begins[other] - ends[one], begins[one] - ends[other])
    apart = np.maximum(apart, 0)
    entry = np.maximum(begins[one], begins[other])
    near = apart <= round(longest_s / DT_S)
    one, other, apart, entry = one[near], other[near], apart[near], entry[near]
    first, second = vehicle[start[one]], vehicle[start[other]]
    least = np.lexsort((entry, apart, second, first))
    first, second, apart, entry = first[least], second[least], apart[least], entry[least]
    begin = np.ones(len(first), dtype=np.bool_)
    begin[1:] = (first[1:] != first[:-1]) | (second[1:] != second[:-1])
    first, second, apart, entry = first[begin], second[begin], apart[begin], entry[begin]
    pet_s = apart * DT_S
    for k in np.flatnonzero(apart <= 1).tolist():
        a, b = (np.flatnonzero(vehicle == who[k]) for who in (first, second))
        touch = _contact(frame[a], boxes[a], frame[b], boxes[b])
        if touch is not None:
            pet_s[k], entry[k] = touch
        else:  # of one place for longer than they really were
            pet_s[k] = max(pet_s[k], DT_S)
    return Encroachments(first, second, pet_s, entry)


def _places(vehicle: IntArray, frame: IntArray, boxes: Boxes) -> tuple[IntArray, IntArray]:
    """First and last row of every place: of rows that follow each other without motion."""
    moved = np.linalg.norm(np.diff(boxes.xy_m, axis=0), axis=1) > SAME_PLACE_M
    moved |= np.abs(np.diff(boxes.yaw_rad)) > SAME_PLACE_RAD
    new = np.ones(len(vehicle), dtype=np.bool_)
    new[1:] = moved | (np.diff(vehicle) != 0) | (np.diff(frame) != 1)
    row = np.arange(len(vehicle))
    since = row - np.maximum.accumulate(np.where(new, row, 0))
    new |= since % _LONGEST_STAY == 0
    start = np.flatnonzero(new)
    return start, np.append(start, len(vehicle))[1:] - 1


def _near(
    vehicle: IntArray, frame: IntArray, boxes: Boxes, reach: int
) -> tuple[IntArray, IntArray]:
    """Pairs of places of different vehicles that are near in space and within `reach` frames."""
    if not len(vehicle):
        nothing = np.zeros(0, dtype=np.int64)
        return nothing, nothing
    radius = boxes.radius_m
    far_m = 2.0 * float(radius.max())
    # Time as a third dimension, so that what is too long ago is never looked at.
    scaled = frame[:, None] * (far_m / (reach + _LONGEST_STAY))
    tree = KDTree(np.concatenate((boxes.xy_m, scaled), axis=1))
    pairs = tree.query_pairs(far_m, p=np.inf, output_type="ndarray")
    one, other = pairs[:, 0], pairs[:, 1]
    away = boxes.xy_m[one] - boxes.xy_m[other]
    keep = vehicle[one] != vehicle[other]
    keep &= (away * away).sum(axis=1) < (radius[one] + radius[other]) ** 2
    return one[keep], other[keep]


def _contact(a_frame: IntArray, a: Boxes, b_frame: IntArray, b: Boxes) -> tuple[float, int] | None:
    """PET (negative) of two vehicles that touched and the frame of contact; None: they did not."""
    together, at_a, at_b = np.intersect1d(a_frame, b_frame, return_indices=True)
    touching = overlap(a[at_a], b[at_b])
    if not touching.any():
        return None
    shift = 1
    while _overlaps(a_frame, a, b_frame, b, shift) and _overlaps(a_frame, a, b_frame, b, -shift):
        shift += 1
    return -shift * DT_S, int(together[touching.argmax()])


def _overlaps(a_frame: IntArray, a: Boxes, b_frame: IntArray, b: Boxes, shift: int) -> BoolArray:
    """Whether A at some t overlaps B at t + shift."""
    _, at_a, at_b = np.intersect1d(a_frame + shift, b_frame, return_indices=True)
    return np.asarray(overlap(a[at_a], b[at_b]).any())
