"""The parts of a map that nobody drove, as paths that lead from and to where people drove."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import BoolArray, Lane
from hatn_sim.geometry import arc_length_m, cut_polyline, resample, tangent_rad, wrap_angle
from hatn_sim.recordings.track_lines.paths import STEP_M, Path, path_through, poses
from hatn_sim.recordings.track_lines.web import Near, Web

SPARE_M: Final = 0.8
"""Drivers this far outside of a lane's middle half still drive on it."""
TURNED_RAD: Final = np.deg2rad(45.0)
PARTING_RAD: Final = np.deg2rad(15.0)
CONTEXT_M: Final = 25.0
"""So much of the map is laid before and behind what nobody drove, to find the way from and to it.
"""
LONGER: Final = 1.3
LONGER_M: Final = 10.0
"""Who drives a lane from its start to its end drives at most so much further than its length."""


def lay_undriven(web: Web, lanes: Sequence[Lane]) -> None:
    """Lay those of a map's lanes over a web that cannot be driven along it, each bent to it."""
    by_id = {lane.id: lane for lane in lanes}
    before = _before(lanes)
    for lane in lanes:
        if not _is_driven(web, lane):
            near = Near(_beside_m(lane), PARTING_RAD)
            for path in _undriven(web, lane, by_id, before):
                web.lay(path, near)


def _beside_m(lane: Lane) -> float:
    return 0.5 * lane.width_m + SPARE_M


def _is_driven(web: Web, lane: Lane) -> bool:
    """Whether the web leads from the start of a lane to its end, about as far as the lane does."""
    if not web.ahead:
        return False
    ends = _beside(web, lane)
    length_m = float(arc_length_m(lane.xy_m)[-1])
    most = int((LONGER * length_m + LONGER_M) / STEP_M)
    reached = set(np.flatnonzero(ends[0]).tolist())
    goals = set(np.flatnonzero(ends[1]).tolist())
    edge = reached
    for _ in range(most + 1):
        if goals & edge or not edge:
            break
        edge = {following for point in edge for following in web.ahead[point]} - reached
        reached = reached | edge
    return bool(goals & reached)


def _beside(web: Web, lane: Lane) -> tuple[BoolArray, BoolArray]:
    """The points [V] of a web beside the start, and beside the end of a lane."""
    yaw = tangent_rad(lane.xy_m)
    return _around(web, lane, 0, float(yaw[0])), _around(web, lane, -1, float(yaw[-1]))


def _around(web: Web, lane: Lane, end: int, yaw_rad: float) -> BoolArray:
    away_m = np.linalg.norm(web.xy_m - lane.xy_m[end], axis=1)
    turned = np.abs(wrap_angle(web.yaw_rad - yaw_rad))
    return (away_m <= _beside_m(lane)) & (turned <= TURNED_RAD)


def _undriven(
    web: Web, lane: Lane, by_id: dict[str, Lane], before: dict[str, list[Lane]]
) -> Iterator[Path]:
    """The stretches of a lane that nobody drove, with what comes before and behind."""
    xy_m = resample(lane.xy_m, STEP_M)
    driven = np.zeros(len(xy_m), dtype=np.bool_)
    if web.ahead:
        yaw_rad = tangent_rad(xy_m)
        _, found = KDTree(poses(web.xy_m, web.yaw_rad)).query(poses(xy_m, yaw_rad))
        away_m = np.linalg.norm(web.xy_m[found] - xy_m, axis=1)
        turned = np.abs(wrap_angle(web.yaw_rad[found] - yaw_rad))
        driven = (away_m <= _beside_m(lane)) & (turned <= PARTING_RAD)
    alone = np.flatnonzero(~driven)
    if not len(alone):
        alone = np.arange(len(xy_m))  # all of it was driven, but nobody drove it through
    first, last = lane, lane
    parts = [lane.xy_m]
    head_m, tail_m = 0.0, 0.0
    seen = {lane.id}
    while head_m < CONTEXT_M:
        options = [one for one in before.get(first.id, []) if one.id not in seen]
        if not options:
            break
        first = min(options, key=lambda one: (abs(one.turn), one.id))
        seen.add(first.id)
        parts.insert(0, first.xy_m)
        head_m += float(arc_length_m(first.xy_m)[-1])
    while tail_m < CONTEXT_M:
        options = [by_id[n] for n in last.successors if n in by_id and n not in seen]
        if not options:
            break
        last = min(options, key=lambda one: (abs(one.turn), one.id))
        seen.add(last.id)
        parts.append(last.xy_m)
        tail_m += float(arc_length_m(last.xy_m)[-1])
    whole = np.concatenate(parts)
    for stretch in np.split(alone, np.flatnonzero(np.diff(alone) > 2 * CONTEXT_M / STEP_M) + 1):
        low_m = max(head_m + float(stretch[0]) * STEP_M - CONTEXT_M, 0.0)
        high_m = head_m + float(stretch[-1]) * STEP_M + CONTEXT_M
        high_m = min(high_m, float(arc_length_m(whole)[-1]))
        if high_m - low_m > 2.0 * STEP_M:
            yield path_through(cut_polyline(whole, low_m, high_m), vehicles=0)


def _before(lanes: Sequence[Lane]) -> dict[str, list[Lane]]:
    """The lanes that lead to each."""
    before: dict[str, list[Lane]] = {}
    for lane in lanes:
        for name in lane.successors:
            before.setdefault(name, []).append(lane)
    return before
