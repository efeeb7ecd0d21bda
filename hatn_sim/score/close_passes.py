"""Close passes (T3): pairs whose ways meet at an angle, by the time between them (METHOD 7).

The encroachment time of a pair is the least |tau| for which the outline of the one at t overlaps
that of the other at t + tau (`assist.encroachment`), here only where the two head at least 15
degrees apart: of a merge, until the two follow each other, which is no encroachment. Who came the
way that the other had come follows it, and is left out however the way turns; so is who was not
seen to come at all. The event starts when
the later of the two gets there.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.assist.encroachment import encroachments
from hatn_sim.assist.outlines import Boxes, overlap
from hatn_sim.datatypes import DT_S, SafetyEvent
from hatn_sim.geometry import wrap_angle
from hatn_sim.score.driven import Driven

LONGEST_S: Final = 3.0
"""Longer encroachment times are no close pass, whatever is counted as one."""
CLOSE_S: Final = 1.5
"""What is shown and counted as T3."""
ANGLE_RAD: Final = np.deg2rad(15.0)
BACK_M: Final = 8.0
"""So far back it is asked whether the two came the same way ..."""
SAME_WAY_M: Final = 1.5
SAME_WAY_RAD: Final = np.deg2rad(45.0)
"""... this near, and heading alike."""


def close_passes(driven: Driven) -> list[SafetyEvent]:
    """The events of all pairs under `LONGEST_S`, by start; their encroachment time is told."""
    boxes = Boxes(driven.xy_m, driven.yaw_rad, driven.size_m[driven.vehicle])
    found = encroachments(driven.vehicle, driven.frame, boxes, LONGEST_S)
    events: list[SafetyEvent] = []
    for one, other in zip(found.first.tolist(), found.second.tolist(), strict=True):
        met = _met(driven, boxes, one, other)
        if met is None or same_way(driven, *met):
            continue
        earlier, later = met
        first, second = sorted((driven.ids[one], driven.ids[other]))
        apart_s = float((driven.frame[later] - driven.frame[earlier]) * DT_S)
        start_s = float(driven.time_s[driven.frame[later]])
        events.append(SafetyEvent("T3", first, second, start_s, "encroachment", apart_s))
    return sorted(events, key=lambda event: (event.start_s, event.first_id, event.second_id or ""))


def shown_passes(driven: Driven) -> list[SafetyEvent]:
    """Those under `CLOSE_S`: what people are shown as T3."""
    return [one for one in close_passes(driven) if (one.encroachment_s or 0.0) < CLOSE_S]


def _met(driven: Driven, boxes: Boxes, one: int, other: int) -> tuple[int, int] | None:
    """The rows, earlier first, at which the two were at one place with the least time between."""
    a, b = (np.arange(rows.start, rows.stop) for rows in map(driven.rows_of, (one, other)))
    reach_m = boxes.radius_m[a].max() + boxes.radius_m[b].max()
    near = np.ones((len(a), len(b)), dtype=np.bool_)
    for axis in (0, 1):
        near &= np.abs(driven.xy_m[a, axis][:, None] - driven.xy_m[b, axis]) < reach_m
    k, m = np.nonzero(near)
    apart = np.abs(driven.frame[a[k]] - driven.frame[b[m]])
    turned = np.abs(wrap_angle(driven.yaw_rad[a[k]] - driven.yaw_rad[b[m]]))
    kept = (apart <= round(LONGEST_S / DT_S)) & (turned >= ANGLE_RAD)
    k, m, apart = k[kept], m[kept], apart[kept]
    touch = overlap(boxes[a[k]], boxes[b[m]])
    k, m, apart = k[touch], m[touch], apart[touch]
    if not len(k):
        return None
    later = np.maximum(driven.frame[a[k]], driven.frame[b[m]])
    best = np.lexsort((later, apart))[0]
    rows = sorted((int(a[k[best]]), int(b[m[best]])), key=lambda row: driven.frame[row])
    return rows[0], rows[1]


def same_way(driven: Driven, earlier: int, later: int) -> bool:
    """Whether the later one was where the earlier one had been, `BACK_M` before they met."""
    rows = driven.rows_of(int(driven.vehicle[later]))
    come_m = np.hypot(*(driven.xy_m[rows.start : later + 1] - driven.xy_m[later]).T)
    far = np.flatnonzero(come_m >= BACK_M)
    if not len(far):
        return True  # where it came from was not seen
    before = rows.start + int(far[-1])
    others = driven.rows_of(int(driven.vehicle[earlier]))
    away_m = np.hypot(*(driven.xy_m[others] - driven.xy_m[before]).T)
    there = others.start + int(away_m.argmin())
    turned = abs(float(wrap_angle(driven.yaw_rad[there] - driven.yaw_rad[before])))
    return bool(away_m.min() < SAME_WAY_M and turned < SAME_WAY_RAD)
