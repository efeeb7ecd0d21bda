"""Where two reference lines cross or merge, from their geometry alone (METHOD section 1.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import ndimage
from scipy.spatial.distance import cdist

from hatn_sim.datatypes import BoolArray, Conflict, ConflictType, FloatArray, IntArray
from hatn_sim.geometry import wrap_angle

CONFLICT_WIDTH_M: Final = 1.8
"""Centre lines nearer than this share an area: about the width of a car."""
SAME_PLACE_M: Final = 0.9
"""Lines that never come nearer than this only pass side by side."""
ONE_LANE_M: Final = ((0.5, 8.0), (0.25, 4.0))
"""Lines that stay within the first for the second, either pair, are one lane there. Lines that
cross at more than 7 degrees do neither."""
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
    the lines begin in it together, driving the same way (a shared upstream part: they diverge), or
    where they only pass side by side, in whichever directions. Where they run against each other
    on one lane, the conflict is all of that lane and its point the middle.
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
        contact = _Contact(
            np.where(labels[box] == number, distance[box], np.inf),
            np.abs(wrap_angle(one_yaw[box[0]][:, None] - other_yaw[box[1]][None, :])),
            _offset_m(one[box[0]], other[box[1]], other_yaw[box[1]]),
            box,
            distance.shape,
            coarse_m,
        )
        if contact.min_m > SAME_PLACE_M + coarse_m / 2 or contact.diverges():
            continue
        if contact.runs_against():
            found.append(contact.head_on())
        elif not contact.passes_by():
            conflict = _meet(contact, first_xy_m, second_xy_m, step_m)
            if conflict is not None:
                found.append(conflict)
    return tuple(sorted(found, key=lambda c: c.point_s_m[0]))


@dataclass(frozen=True, eq=False)
class _Contact:
    """A connected set of pairs of vertices, `step_m` apart, within a box of all pairs."""

    distance_m: FloatArray  # [I, J] inf where the pair is not in the set
    turned_rad: FloatArray  # [I, J] between the directions, 0 ... pi
    offset_m: FloatArray  # [I, J] of the first line's vertex, left of the second's tangent
    box: tuple[slice, slice]
    shape: tuple[int, ...]  # of all pairs
    step_m: float

    @property
    def min_m(self) -> float:
        return float(self.distance_m.min())

    def diverges(self) -> bool:
        """The lines begin here side by side, driving the same way, and come no nearer."""
        together = np.where(self.turned_rad < ALIGNED_RAD, self.distance_m, np.inf)
        at_start_m = min(
            together[0].min() if self.box[0].start == 0 else np.inf,
            together[:, 0].min() if self.box[1].start == 0 else np.inf,
        )
        return bool(at_start_m <= self.min_m + self.step_m / 2)

    def runs_against(self) -> bool:
        """They are one lane, driven in opposite directions."""
        return self._is_one_lane(self.turned_rad > OPPOSITE_RAD)

    def passes_by(self) -> bool:
        """They only drive in opposite directions and each stays on its side."""
        if (np.isfinite(self.distance_m) & (self.turned_rad <= OPPOSITE_RAD)).any():
            return False
        first, last = (self.offset_m[k, self.distance_m[k].argmin()] for k in (0, -1))
        return bool(first * last > 0.0 or min(abs(first), abs(last)) < SAME_PLACE_M)

    def merges(self) -> bool:
        aligned = np.isfinite(self.distance_m) & (self.turned_rad < ALIGNED_RAD)
        ends = [self.box[k].stop == self.shape[k] for k in (0, 1)]
        at_end = (ends[0] or ends[1]) and bool(aligned[-1].any() or aligned[:, -1].any())
        return at_end or self._is_one_lane(self.turned_rad < ALIGNED_RAD)

    def head_on(self) -> Conflict:
        entry, leave = self.bounds_s_m()
        middle = (entry[0] + leave[0]) / 2, (entry[1] + leave[1]) / 2
        return Conflict(ConflictType.CROSS, entry, middle, leave)

    def bounds_s_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Arc lengths of its first and of its last vertices on both lines."""
        one, other = self.box
        entry = one.start * self.step_m, other.start * self.step_m
        return entry, ((one.stop - 1) * self.step_m, (other.stop - 1) * self.step_m)

    def _is_one_lane(self, wanted: BoolArray) -> bool:
        """Whether they stay as near as one lane's centre lines, in the wanted directions [I, J]."""
        rows = np.arange(len(self.distance_m))
        nearest = self.distance_m.argmin(axis=1)
        beside_m = np.where(wanted[rows, nearest], np.abs(self.offset_m[rows, nearest]), np.inf)
        return any(
            float((beside_m < apart_m).sum()) * self.step_m >= for_m
            for apart_m, for_m in ONE_LANE_M
        )


def _offset_m(one_xy_m: FloatArray, other_xy_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """How far points [I, 2] lie left of the tangents at vertices [J, 2] of a line [I, J]."""
    away = one_xy_m[:, None] - other_xy_m[None]
    return np.asarray(away[..., 1] * np.cos(yaw_rad) - away[..., 0] * np.sin(yaw_rad))


def _meet(
    contact: _Contact, first_xy_m: FloatArray, second_xy_m: FloatArray, step_m: float
) -> Conflict | None:
    """The crossing or merge of a contact, to `_FINE_STEP_M`; None where it is too wide."""
    i, j = (
        slice(max((part.start - 1) * _COARSE, 0), (part.stop + 1) * _COARSE) for part in contact.box
    )
    if not contact.merges():
        start = (i.start * step_m, j.start * step_m)
        return _refine(ConflictType.CROSS, (first_xy_m[i], second_xy_m[j]), start, step_m, None)
    # Only the beginning of a merge needs to be known exactly.
    i = slice(i.start, min(i.stop, i.start + _MERGE_HEAD))
    j = slice(j.start, min(j.stop, j.start + _MERGE_HEAD))
    return _refine(
        ConflictType.MERGE,
        (first_xy_m[i], second_xy_m[j]),
        (i.start * step_m, j.start * step_m),
        step_m,
        contact.bounds_s_m()[1],
    )


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
