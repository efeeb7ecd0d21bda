"""What of a map nobody drove is laid into a web of driven paths, so that no way is lost."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import BoolArray, FloatArray, Lane
from hatn_sim.geometry import arc_length_m, cut_polyline, resample, tangent_rad, wrap_angle
from hatn_sim.recordings.track_lines.paths import STEP_M, Path, path_through, poses
from hatn_sim.recordings.track_lines.web import Near, Web

SPARE_M: Final = 0.8
"""Drivers this far outside of a lane's half width still drive along it."""
TURNED_RAD: Final = np.deg2rad(45.0)
PARTING_RAD: Final = np.deg2rad(15.0)
CONTEXT_M: Final = 25.0
"""So much is laid before and behind what nobody drove, to find the way from and to what is there.
"""
AROUND_M: Final = 10.0
"""A lane is driven if one can drive from this far before it to this far behind it."""
LEVEL_STEPS: Final = 0.8
LONGER: Final = 1.3
LONGER_M: Final = 10.0
"""Who drives it so drives at most so much further than the map says."""
AT_END_M: Final = 3.0
STUB_M: Final = 20.0
"""Where a view ends, paths end here and there; those of the longest lead on."""


@dataclass(frozen=True, eq=False)
class _Map:
    """The lanes by name, and those that lead to each."""

    lanes: Mapping[str, Lane]
    before: Mapping[str, Sequence[Lane]]


def lay_undriven(web: Web, lanes: Sequence[Lane]) -> None:
    """Lay what of a map's lanes cannot be driven along a web, and how they follow each other.

    What does not lead on as it does on the map, is taken away again where nobody drove.
    """
    driven = len(web.ahead)
    by_id = {lane.id: lane for lane in lanes}
    before: dict[str, list[Lane]] = {}
    for lane in lanes:
        for name in lane.successors:
            before.setdefault(name, []).append(lane)
    net = _Map(by_id, before)
    for lane in lanes:
        if not _is_driven(web, _way(net, lane, lane), lane):
            for path in _undriven(web, lane):
                web.lay(path, _near(lane))
    for one in lanes:
        for other in (by_id[name] for name in one.successors if name in by_id):
            way = _way(net, one, other)
            end_m = _length_m(one) + way.from_m
            joint = _Way(way.xy_m, end_m, end_m)
            if not _is_driven(web, joint, other):
                web.lay(path_through(joint.cut(CONTEXT_M), vehicles=0), _near(other))
    _prune(web, driven, lanes)


@dataclass(frozen=True, eq=False)
class _Way:
    """A stretch of a way over several lanes."""

    xy_m: FloatArray  # [P, 2]
    from_m: float
    to_m: float

    def wider(self, by_m: float) -> tuple[float, float]:
        """The stretch with so much before and behind, as far as the way goes."""
        length_m = float(arc_length_m(self.xy_m)[-1])
        return max(self.from_m - by_m, 0.0), min(self.to_m + by_m, length_m)

    def cut(self, by_m: float) -> FloatArray:
        """The points of the stretch with so much before and behind."""
        return cut_polyline(self.xy_m, *self.wider(by_m))


def _way(net: _Map, first: Lane, last: Lane) -> _Way:
    """From one lane to itself or the next, with the straightest lanes before and behind."""
    route = [first] if first is last else [first, last]
    inner_m = sum(_length_m(lane) for lane in route)
    names = {lane.id for lane in route}
    head_m = tail_m = 0.0
    while head_m < CONTEXT_M:
        options = [one for one in net.before.get(route[0].id, ()) if one.id not in names]
        if not options:
            break
        route.insert(0, min(options, key=_straightness))
        names.add(route[0].id)
        head_m += _length_m(route[0])
    while tail_m < CONTEXT_M:
        following = (net.lanes[n] for n in route[-1].successors if n in net.lanes)
        options = [one for one in following if one.id not in names]
        if not options:
            break
        route.append(min(options, key=_straightness))
        names.add(route[-1].id)
        tail_m += _length_m(route[-1])
    xy_m = np.concatenate([lane.xy_m for lane in route])
    return _Way(xy_m, head_m, head_m + inner_m)


def _straightness(lane: Lane) -> tuple[int, str]:
    return abs(lane.turn), lane.id


def _near(lane: Lane) -> Near:
    return Near(_beside_m(lane), PARTING_RAD)


def _beside_m(lane: Lane) -> float:
    return 0.5 * lane.width_m + SPARE_M


def _length_m(lane: Lane) -> float:
    return float(arc_length_m(lane.xy_m)[-1])


def _is_driven(web: Web, way: _Way, lane: Lane) -> bool:
    """Whether the web leads from before a stretch to behind it, about as far as the way does."""
    from_m, to_m = way.wider(AROUND_M)
    goals = set(np.flatnonzero(_around(web, way.xy_m, to_m, lane)).tolist())
    edge = set(np.flatnonzero(_around(web, way.xy_m, from_m, lane)).tolist())
    reached = set(edge)
    for _ in range(int((LONGER * (to_m - from_m) + LONGER_M) / STEP_M)):
        if not edge or goals & edge:
            break
        edge = {following for point in edge for following in web.ahead[point]} - reached
        reached |= edge
    return bool(goals & edge)


def _around(web: Web, xy_m: FloatArray, at_m: float, lane: Lane) -> BoolArray:
    """The points [V] of a web on a level with a place on a way, as near as one drives to a lane."""
    before, after = cut_polyline(xy_m, *_window(xy_m, at_m))[[0, -1]]
    at = cut_polyline(xy_m, at_m, at_m)[0]
    yaw = float(np.arctan2(after[1] - before[1], after[0] - before[0]))
    away = web.xy_m - at
    ahead_m = away @ np.array([np.cos(yaw), np.sin(yaw)])
    left_m = away @ np.array([-np.sin(yaw), np.cos(yaw)])
    turned = np.abs(wrap_angle(web.yaw_rad - yaw))
    level = np.abs(ahead_m) <= LEVEL_STEPS * STEP_M
    return level & (np.abs(left_m) <= _beside_m(lane)) & (turned <= TURNED_RAD)


def _undriven(web: Web, lane: Lane) -> Iterator[Path]:
    """The stretches of a lane that nobody drove; all of it if nobody drove it through."""
    xy_m = resample(lane.xy_m, STEP_M)
    yaw_rad = tangent_rad(xy_m)
    _, found = KDTree(poses(web.xy_m, web.yaw_rad)).query(poses(xy_m, yaw_rad))
    away_m = np.linalg.norm(web.xy_m[found] - xy_m, axis=1)
    turned = np.abs(wrap_angle(web.yaw_rad[found] - yaw_rad))
    alone = np.flatnonzero((away_m > _beside_m(lane)) | (turned > PARTING_RAD))
    if not len(alone):
        alone = np.arange(len(xy_m))
    length_m = _length_m(lane)
    for stretch in np.split(alone, np.flatnonzero(np.diff(alone) > 2 * CONTEXT_M / STEP_M) + 1):
        low_m = max(float(stretch[0]) * STEP_M - CONTEXT_M, 0.0)
        high_m = min(float(stretch[-1]) * STEP_M + CONTEXT_M, length_m)
        yield path_through(cut_polyline(lane.xy_m, low_m, high_m), vehicles=0)


def _window(xy_m: FloatArray, at_m: float) -> tuple[float, float]:
    """A metre around an arc length of a polyline."""
    length_m = float(arc_length_m(xy_m)[-1])
    return max(at_m - STEP_M, 0.0), min(at_m + STEP_M, length_m)


def _prune(web: Web, driven: int, lanes: Sequence[Lane]) -> None:
    """Take away what was laid beside the `driven` first points, but leads nowhere on the map."""
    following = {name for lane in lanes for name in lane.successors}
    known = {lane.id for lane in lanes}
    sources = [lane.xy_m[0] for lane in lanes if lane.id not in following]
    sinks = [lane.xy_m[-1] for lane in lanes if not known.intersection(lane.successors)]
    _unlink_ends(web.ahead, web.behind, _away_from(web, driven, sinks))
    _unlink_ends(web.behind, web.ahead, _away_from(web, driven, sources))
    _unlink_ends(web.ahead, web.behind, _stubs(web.ahead, web.behind))
    _unlink_ends(web.behind, web.ahead, _stubs(web.behind, web.ahead))


def _away_from(web: Web, driven: int, places: Iterable[FloatArray]) -> set[int]:
    """The points of a web behind the `driven` ones that are at none of some places."""
    away = np.arange(len(web.ahead)) >= driven
    for place in places:
        away &= np.linalg.norm(web.xy_m - place, axis=1) > AT_END_M
    return set(np.flatnonzero(away).tolist())


def _stubs(ahead: Sequence[Sequence[int]], behind: Sequence[Sequence[int]]) -> set[int]:
    """The points of ends shorter than `STUB_M` beside a way that leads on."""
    found: set[int] = set()
    for end in range(len(ahead)):
        stub = [end]
        while len(stub) * STEP_M < STUB_M and len(behind[stub[-1]]) == 1 and not ahead[end]:
            before = behind[stub[-1]][0]
            if len(ahead[before]) > 1:
                found.update(stub)
                break
            stub.append(before)
    return found


def _unlink_ends(ahead: list[list[int]], behind: list[list[int]], among: set[int]) -> None:
    """Unlink the points that nothing is ahead of, and those that then are, among some."""
    ends = [point for point in sorted(among) if not ahead[point]]
    while ends:
        point = ends.pop()
        for before in behind[point]:
            ahead[before].remove(point)
            if before in among and not ahead[before]:
                ends.append(before)
        behind[point].clear()
