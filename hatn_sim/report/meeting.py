"""Where the two of an event met, by what they drove, for whoever looks at it. No drawing here."""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.assist.outlines import Boxes, overlap
from hatn_sim.datatypes import DT_S, FloatArray, IntArray
from hatn_sim.geometry import wrap_angle
from hatn_sim.score.close_passes import ANGLE_RAD, same_way
from hatn_sim.score.driven import Driven

BEFORE_S: Final = 4.0
AFTER_S: Final = 8.0
"""Looked at of both ways, around the start of an event."""
ALIKE_FRAMES: Final = 6
"""Places that differ in time between the two by no more than this: the first of them ..."""
PASSING_FRAMES: Final = 10
"""... and, of those so soon after it, where their centres were nearest."""


def meeting_place(driven: Driven, one: int, other: int, frame: int) -> FloatArray | None:
    """[2] where the one came the soonest after the other, around a frame.

    That is where their outlines touched, else where the outline of the one lay over that of the
    other, some time apart and at an angle. None: their ways did not meet, as where one braked and
    took another way, or passed beside the other; or the one only followed the other.

    Args:
        driven: the motion of all.
        one: index into its ids.
        other: the same.
        frame: of the event.
    """
    a, b = (_rows_around(driven, who, frame) for who in (one, other))
    boxes = Boxes(driven.xy_m, driven.yaw_rad, driven.size_m[driven.vehicle])
    turned = np.abs(wrap_angle(driven.yaw_rad[a][:, None] - driven.yaw_rad[b]))
    same_time = driven.frame[a][:, None] == driven.frame[b]
    over = overlap(boxes[a[:, None]], boxes[b[None]])
    k, m = np.nonzero(over & (same_time | (turned >= ANGLE_RAD)))
    if not len(k):
        return None
    rows = np.stack((a[k], b[m]))
    at = driven.frame[rows]
    apart, later = np.abs(at[0] - at[1]), at.max(axis=0)
    least = np.lexsort((later, apart))[0]
    earlier_row, later_row = rows[np.argsort(at[:, least], kind="stable"), least].tolist()
    if apart[least] and same_way(driven, earlier_row, later_row):
        return None
    if apart[least] == 0:
        soon = np.arange(len(k)) == least
    else:
        soon = apart <= apart[least] + ALIKE_FRAMES
        soon &= later <= later[soon].min() + PASSING_FRAMES
    away_m = np.hypot(*(driven.xy_m[rows[0]] - driven.xy_m[rows[1]]).T)
    best = np.argmin(np.where(soon, away_m, np.inf))
    place: FloatArray = driven.xy_m[rows[:, best]].mean(axis=0)
    return place


def _rows_around(driven: Driven, vehicle: int, frame: int) -> IntArray:
    rows = driven.rows_of(vehicle)
    after = driven.frame[rows] - frame
    near = (after >= -round(BEFORE_S / DT_S)) & (after <= round(AFTER_S / DT_S))
    return rows.start + np.flatnonzero(near)
