"""Missed gaps: openings that were long enough to cross in, and that a waiting vehicle let go by.

Precisely. A vehicle *waits* while it is slower than `SLOW_MPS`, its front bumper is no more than
`NEAR_M` before its crossing or its rear bumper not yet out of it, and no closed signal stands
before it. At every fifth of a second of that it is asked what a start would have come to: along its
own way, with `START_MPS2` up to `FASTEST_MPS`, until its rear bumper is out of the crossing. The
moment is *open* if its outline would have met nobody's at a time within `MARGIN_S` of when that one
really was there. Open moments that follow each other for `NOTICED_S` are a gap; it is *missed* if
it ends in a moment that is not open, and the vehicle still waits. A gap in which it starts is
taken; one that nobody can tell the end of, because the run ends, is neither.

The others are taken as they really drove while the vehicle stood: that they would have made room is
not asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.assist.outlines import Boxes, overlap
from hatn_sim.datatypes import DT_S, BoolArray, FloatArray
from hatn_sim.geometry import tangent_rad
from hatn_sim.score.driven import Driven
from hatn_sim.way import STEP_M, Way

SLOW_MPS: Final = 2.0
NEAR_M: Final = 15.0
START_MPS2: Final = 2.0
FASTEST_MPS: Final = 10.0
MARGIN_S: Final = 1.0
NOTICED_S: Final = 1.0
LOOK_EVERY_FRAMES: Final = 2
LONGEST_START_S: Final = 10.0
"""What takes longer to cross is not looked at to its end."""
_STEP_S: Final = LOOK_EVERY_FRAMES * DT_S
_TIMES_S: Final = np.arange(0.0, LONGEST_START_S + 0.5 * _STEP_S, _STEP_S)


@dataclass(frozen=True, eq=False)
class Start:
    """A moment of waiting, and where the vehicle would be on each of the steps of a start."""

    frame: int
    xy_m: FloatArray  # [K, 2]
    yaw_rad: FloatArray  # [K]


def start_of(frame: int, way: Way, speed_mps: float, length_m: float, at_red: bool) -> Start | None:
    """The start that would be possible now; None where the vehicle does not wait."""
    crossing = way.first_crossing
    if crossing is None or at_red or speed_mps >= SLOW_MPS:
        return None
    if way.s_m + 0.5 * length_m < crossing.entry_s_m - NEAR_M:
        return None
    to_go_m = crossing.exit_s_m + 0.5 * length_m - way.s_m
    if to_go_m <= 0.0:
        return None
    gaining_s = (FASTEST_MPS - speed_mps) / START_MPS2
    gaining = np.minimum(_TIMES_S, gaining_s)
    s_m = speed_mps * gaining + 0.5 * START_MPS2 * gaining**2
    s_m += FASTEST_MPS * (_TIMES_S - gaining)
    s_m = way.s_m + s_m[: int(np.searchsorted(s_m, to_go_m)) + 1]
    points_m = STEP_M * np.arange(len(way.xy_m))
    xy_m = np.stack([np.interp(s_m, points_m, axis) for axis in way.xy_m.T], axis=1)
    return Start(frame, xy_m, np.interp(s_m, points_m, tangent_rad(way.xy_m)))


def missed_gaps(driven: Driven, ego: int, starts: Sequence[Start]) -> int:
    """How many gaps the vehicle of that number let go by, of the starts that it could have made."""
    known = [start for start in starts if _end_frame(start) < len(driven.time_s)]
    if not known:
        return 0
    is_open = _open(driven, ego, known)
    missed, lasted = 0, 0
    for number, start in enumerate(known):
        follows = number > 0 and start.frame - known[number - 1].frame == LOOK_EVERY_FRAMES
        lasted = lasted if follows else 0
        if is_open[number]:
            lasted += 1
            continue
        missed += lasted * _STEP_S >= NOTICED_S - 1e-9
        lasted = 0
    return missed


def _end_frame(start: Start) -> int:
    """The last frame that has to be known of the others."""
    return start.frame + LOOK_EVERY_FRAMES * (len(start.yaw_rad) - 1) + round(MARGIN_S / DT_S)


def _open(driven: Driven, ego: int, starts: Sequence[Start]) -> BoolArray:
    """[M] nobody else was within the margin, in time, of where a start would have led."""
    counts = [len(start.yaw_rad) for start in starts]
    moment = np.repeat(np.arange(len(starts)), counts)  # [Q] steps of all starts
    frame = np.concatenate(
        [start.frame + LOOK_EVERY_FRAMES * np.arange(len(start.yaw_rad)) for start in starts]
    )
    xy_m = np.concatenate([start.xy_m for start in starts])
    yaw_rad = np.concatenate([start.yaw_rad for start in starts])
    others = np.flatnonzero(driven.vehicle != ego)
    others = others[np.argsort(driven.frame[others], kind="stable")]
    rows_until = np.searchsorted(driven.frame[others], np.arange(len(driven.time_s) + 1))
    blocked = np.zeros(len(starts), dtype=np.bool_)
    reach = round(MARGIN_S / DT_S)
    size_m = driven.size_m[ego]
    for k in range(-reach, reach + 1, LOOK_EVERY_FRAMES):
        at = np.maximum(frame + k, 0)
        first, count = rows_until[at], rows_until[at + 1] - rows_until[at]
        step = np.repeat(np.arange(len(at)), count)  # [P] a step, and somebody there then
        row = others[np.arange(len(step)) - np.repeat(np.cumsum(count) - count - first, count)]
        their_m = driven.size_m[driven.vehicle[row]]
        away_m = np.hypot(*(driven.xy_m[row] - xy_m[step]).T)
        near = away_m < 0.5 * (np.hypot(*size_m) + np.hypot(*their_m.T))
        step, row = step[near], row[near]
        met = overlap(
            Boxes(xy_m[step], yaw_rad[step], size_m),
            Boxes(driven.xy_m[row], driven.yaw_rad[row], their_m[near]),
        )
        blocked[moment[step[met]]] = True
    return ~blocked
