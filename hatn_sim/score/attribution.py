"""For whom a vehicle braked: the foe with the smallest encroachment time in the second before.

At three moments of the second before the braking it is asked what would have come: the vehicle
drives on, on the way that it really took later, at the speed that it had, or speeding up as it did.
A foe is taken both ways: as it really drove on, and as the vehicle itself, so that neither one who
stops himself nor one who starts from a standstill is missed. The encroachment time is the least
|tau| at which the outline of the one at t and that of the other at t + tau overlap.

Nobody brakes for those behind: who is on the way that the vehicle has come, heading as it did, is
no foe. A leader is: its encroachment time is the time gap to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.assist.outlines import Boxes, overlap
from hatn_sim.datatypes import DT_S, FloatArray
from hatn_sim.geometry import wrap_angle
from hatn_sim.score.driven import Driven

MOST_ENCROACHMENT_S: Final = 3.0
"""None under this: the braking is unattributed (METHOD 7)."""
LOOKED_BACK_FRAMES: Final = (0, 5, 10)
HORIZON_S: Final = 6.0
STEP_S: Final = 0.2
REACH_M: Final = 100.0
SPEEDING_UP_FRAMES: Final = 5
"""Acceleration is the mean over so many."""
FASTEST_MPS: Final = 15.0
"""Who speeds up does so up to this, or to the speed it has."""
BEHIND_M: Final = 1.5
"""This near to where the vehicle was: behind it on its way."""
BEFORE_M: Final = np.arange(1.0, 61.0)
"""Before it came into view it is taken to have driven straight."""
BEHIND_RAD: Final = np.deg2rad(60.0)


@dataclass(frozen=True)
class Found:
    """A foe, and how near the two would have come."""

    foe: int  # index into Driven.ids
    encroachment_s: float


@dataclass(frozen=True, eq=False)
class _Way:
    """Outlines of one vehicle at moments from now on."""

    xy_m: FloatArray  # [K, 2]
    yaw_rad: FloatArray  # [K]


def foe_of_braking(driven: Driven, vehicle: int, frame: int) -> Found | None:
    """For whom a vehicle began to brake at `frame`; None: for nobody to be seen.

    Of foes that come equally near, the one that is met first.
    """
    best: tuple[float, float, int] | None = None
    own_rows = driven.rows_of(vehicle)
    for back in LOOKED_BACK_FRAMES:
        at = frame - back
        place = int(np.searchsorted(driven.frame[own_rows], at)) + own_rows.start
        if place >= own_rows.stop or driven.frame[place] != at:
            continue
        own = _held(driven, place, own_rows)
        for row in np.flatnonzero(driven.frame == at).tolist():
            foe = int(driven.vehicle[row])
            away_m = np.hypot(*(driven.xy_m[row] - driven.xy_m[place]))
            if foe == vehicle or away_m > REACH_M or _is_behind(driven, own_rows, place, row):
                continue
            rows = driven.rows_of(foe)
            for way in (_held(driven, row, rows), _real(driven, row, rows.stop)):
                met = _encroachment(own, driven.size_m[vehicle], way, driven.size_m[foe])
                if met is not None and (best is None or (*met, foe) < best):
                    best = (*met, foe)
    if best is None or best[0] >= MOST_ENCROACHMENT_S:
        return None
    return Found(best[2], best[0])


def _is_behind(driven: Driven, own_rows: slice, place: int, row: int) -> bool:
    """The vehicle of `row` is where that of `place` came from, heading as it did."""
    first = own_rows.start
    back = np.array([np.cos(driven.yaw_rad[first]), np.sin(driven.yaw_rad[first])])
    come_m = np.concatenate(
        [driven.xy_m[first] - BEFORE_M[::-1, None] * back, driven.xy_m[first:place]]
    )
    away_m = np.hypot(*(come_m - driven.xy_m[row]).T)
    there = int(away_m.argmin())
    yaw_rad = driven.yaw_rad[max(first, first + there - len(BEFORE_M))]
    turned = abs(float(wrap_angle(yaw_rad - driven.yaw_rad[row])))
    is_nearer = away_m[there] < np.hypot(*(driven.xy_m[place] - driven.xy_m[row]))
    return bool(away_m[there] < BEHIND_M and turned < BEHIND_RAD and is_nearer)


def _held(driven: Driven, row: int, rows: slice) -> _Way:
    """On as in `row` along what the vehicle of `rows` really drove, straight on behind its end."""
    xy_m, yaw_rad = driven.xy_m[row : rows.stop], np.unwrap(driven.yaw_rad[row : rows.stop])
    path_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(xy_m, axis=0).T)))
    before, speed_mps = max(rows.start, row - SPEEDING_UP_FRAMES), driven.speed_mps[row]
    gained_mps = speed_mps - driven.speed_mps[before]
    gain_mps2 = max(gained_mps / (DT_S * max(row - before, 1)), 0.0)
    speeds_mps = np.minimum(speed_mps + gain_mps2 * _MOMENTS_S, max(FASTEST_MPS, speed_mps))
    steps_m = STEP_S * 0.5 * (speeds_mps[1:] + speeds_mps[:-1])
    wanted_m = np.append(0.0, np.cumsum(steps_m))
    along = np.array([np.interp(wanted_m, path_m, values) for values in xy_m.T]).T
    beyond_m = np.maximum(wanted_m - path_m[-1], 0.0)
    ahead = np.array([np.cos(yaw_rad[-1]), np.sin(yaw_rad[-1])])
    return _Way(along + beyond_m[:, None] * ahead, np.interp(wanted_m, path_m, yaw_rad))


def _real(driven: Driven, row: int, stop: int) -> _Way:
    """As it really drove on, as long as it was in view."""
    taken = row + np.round(_MOMENTS_S / DT_S).astype(np.int64)
    taken = taken[taken < stop]
    return _Way(driven.xy_m[taken], driven.yaw_rad[taken])


_MOMENTS_S: Final = np.arange(0.0, HORIZON_S + 0.5 * STEP_S, STEP_S)


def _encroachment(
    one: _Way, one_size_m: FloatArray, other: _Way, other_size_m: FloatArray
) -> tuple[float, float] | None:
    """(least |tau| in s, when the first of the two is there then); None: their ways stay apart."""
    between = other.xy_m[None] - one.xy_m[:, None]
    reach_m = 0.5 * (np.hypot(*one_size_m) + np.hypot(*other_size_m))
    k, m = np.nonzero(np.hypot(between[..., 0], between[..., 1]) <= reach_m)
    if not len(k):
        return None
    touch = overlap(
        Boxes(one.xy_m[k], one.yaw_rad[k], one_size_m),
        Boxes(other.xy_m[m], other.yaw_rad[m], other_size_m),
    )
    k, m = k[touch], m[touch]
    if not len(k):
        return None
    apart = np.abs(k - m)
    first = np.lexsort((np.minimum(k, m), apart))[0]
    return float(STEP_S * apart[first]), float(STEP_S * min(k[first], m[first]))
