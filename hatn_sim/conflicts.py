"""Where two reference lines cross or merge, from their geometry alone (METHOD section 1.3)."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy import ndimage
from scipy.spatial.distance import cdist

from hatn_sim.datatypes import Conflict, ConflictType, FloatArray, IntArray
from hatn_sim.geometry import wrap_angle

CONFLICT_WIDTH_M: Final = 1.8
"""Centre lines nearer than this share an area: about the width of a car."""
SAME_PLACE_M: Final = 0.9
"""Lines that never come nearer than this only pass side by side."""
TOGETHER_M: Final = 8.0
SAME_LINE_M: Final = 0.5
"""A merge stays together, within `SAME_LINE_M`, for at least `TOGETHER_M`."""
ALIGNED_RAD: Final = np.deg2rad(30.0)
OPPOSITE_RAD: Final = np.deg2rad(150.0)
_COARSE: Final = 2  # every second vertex is enough to find the contacts
_FINE_STEP_M: Final = 0.1
_MERGE_HEAD: Final = 24  # vertices


def find_conflicts(
    first_xy_m: FloatArray,
    first_yaw_rad: FloatArray,
    second_xy_m: FloatArray,
    second_yaw_rad: FloatArray,
    step_m: float,
) -> tuple[Conflict, ...]:
    """All conflicts of two lines with vertices every `step_m`, in order along the first.

    A contact is a connected set of vertex pairs within `CONFLICT_WIDTH_M`. It is no conflict where
    the lines begin in it, driving the same way (a shared upstream part: they diverge), where they
    run against each other, or where they only pass side by side.
    """
    low = np.maximum(first_xy_m.min(axis=0), second_xy_m.min(axis=0))
    high = np.minimum(first_xy_m.max(axis=0), second_xy_m.max(axis=0))
    if (low > high + CONFLICT_WIDTH_M).any():
        return ()
    coarse_m = step_m * _COARSE
    one, other = first_xy_m[::_COARSE], second_xy_m[::_COARSE]
    distance = cdist(one, other)
    # Two points of crossing lines may miss each other by up to half a step on either line.
    near = distance < np.hypot(CONFLICT_WIDTH_M, coarse_m / 2)
    if not near.any():
        return ()
    labels: IntArray = np.empty(near.shape, dtype=np.int64)
    ndimage.label(near, structure=np.ones((3, 3)), output=labels)
    one_yaw, other_yaw = first_yaw_rad[::_COARSE], second_yaw_rad[::_COARSE]
    found: list[Conflict] = []
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        member = labels[box] == number
        conflict = _classify(
            np.where(member, distance[box], np.inf),
            np.abs(wrap_angle(one_yaw[box[0]][:, None] - other_yaw[box[1]][None, :])),
            (box[0].start, box[1].start),
            distance.shape,
            coarse_m,
        )
        if conflict is None:
            continue
        i = slice(max((box[0].start - 1) * _COARSE, 0), (box[0].stop + 1) * _COARSE)
        j = slice(max((box[1].start - 1) * _COARSE, 0), (box[1].stop + 1) * _COARSE)
        if conflict is ConflictType.MERGE:  # only its beginning needs to be known exactly
            leave = ((box[0].stop - 1) * coarse_m, (box[1].stop - 1) * coarse_m)
            i = slice(i.start, min(i.stop, i.start + _MERGE_HEAD))
            j = slice(j.start, min(j.stop, j.start + _MERGE_HEAD))
        else:
            leave = None
        refined = _refine(
            conflict,
            (first_xy_m[i], second_xy_m[j]),
            (i.start * step_m, j.start * step_m),
            step_m,
            leave,
        )
        if refined is not None:
            found.append(refined)
    return tuple(sorted(found, key=lambda c: c.point_s_m[0]))


def _classify(
    distance: FloatArray,
    turned_rad: FloatArray,
    start: tuple[int, int],
    shape: tuple[int, ...],
    step_m: float,
) -> ConflictType | None:
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    if distance[i, j] > SAME_PLACE_M + step_m / 2:
        return None
    inside = np.isfinite(distance)
    aligned = inside & (turned_rad < ALIGNED_RAD)
    at_start = (inside[0] & aligned[0]).any() and start[0] == 0
    at_start |= (inside[:, 0] & aligned[:, 0]).any() and start[1] == 0
    if at_start:
        return None
    if (turned_rad[inside] > OPPOSITE_RAD).all():
        return None
    together = (aligned & (distance < SAME_LINE_M)).any(axis=1).sum() * step_m
    reaches_end = start[0] + len(distance) == shape[0] or start[1] + distance.shape[1] == shape[1]
    if together >= TOGETHER_M or (reaches_end and aligned[-1].any() | aligned[:, -1].any()):
        return ConflictType.MERGE
    return ConflictType.CROSS


def _refine(
    kind: ConflictType,
    stretches: tuple[FloatArray, FloatArray],
    start_s_m: tuple[float, float],
    step_m: float,
    leave_s_m: tuple[float, float] | None,
) -> Conflict | None:
    """Entry, point and exit to `_FINE_STEP_M`, on the stretches around one contact."""
    factor = round(step_m / _FINE_STEP_M)
    distance = cdist(_finer(stretches[0], factor), _finer(stretches[1], factor))
    inside = [np.flatnonzero(distance.min(axis=axis) < CONFLICT_WIDTH_M) for axis in (1, 0)]
    if not len(inside[0]):
        return None
    entry = _arc_lengths(start_s_m, inside[0][0], inside[1][0])
    if kind is ConflictType.MERGE:
        assert leave_s_m is not None
        return Conflict(kind, entry, entry, leave_s_m)
    if distance.min() > SAME_PLACE_M:
        return None
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    leave = _arc_lengths(start_s_m, inside[0][-1], inside[1][-1])
    return Conflict(kind, entry, _arc_lengths(start_s_m, i, j), leave)


def _arc_lengths(start_s_m: tuple[float, float], i: np.intp, j: np.intp) -> tuple[float, float]:
    return start_s_m[0] + float(i) * _FINE_STEP_M, start_s_m[1] + float(j) * _FINE_STEP_M


def _finer(xy_m: FloatArray, factor: int) -> FloatArray:
    at = np.arange((len(xy_m) - 1) * factor + 1) / factor
    return np.stack([np.interp(at, np.arange(len(xy_m)), xy_m[:, k]) for k in (0, 1)], axis=1)
