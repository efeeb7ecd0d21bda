"""Lanelet2 maps -> lanes.

| Lanelet2 | here |
|---|---|
| lanelet | lane, named by the relation's id; two if it may be driven both ways, the second `IDr` |
| left and right bound | centre line (unless the lanelet brings one) and width |
| shared ends of both bounds | successor |
| subtype, participants | kinds |
| regulatory elements | gates (the lane ends at its stop line) and speed limits |
| lanelets that fork, merge or cross | connections of a junction, their turn by change of heading |

What a map lists twice is one lane. Multipolygons (areas) are left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from hatn_sim.datatypes import FloatArray, Gate, Kind, Lane
from hatn_sim.errors import InputError
from hatn_sim.geometry import arc_length_m, tangent_rad
from hatn_sim.recordings.lanelet2.bounds import centre_line, crossings, orientation, thinned
from hatn_sim.recordings.lanelet2.gates import with_gates
from hatn_sim.recordings.lanelet2.osm import OsmMap, Relation, Way, read_osm
from hatn_sim.recordings.lanelet2.rules import MOTOR, is_one_way, kinds_of, speed_limit_mps

_T = TypeVar("_T")

REVERSED: Final = "r"
"""Ends the name of the lane that runs against its lanelet."""
ID_TAG: Final = "hatn_sim:lane"
"""Carries the name of a lane in maps that were written here."""
SAME_PLACE_M: Final = 0.05
"""Nodes nearer to each other are one."""
END_M: Final = 0.3
"""Lines that meet nearer than this to an end do not cross, they follow or merge."""
TURN_RAD: Final = np.deg2rad(30.0)
TURN_OF_DIRECTION: Final[Mapping[str, int]] = {"left": 1, "straight": 0, "right": -1}
"""Of the tag `turn_direction`, which marks lanelets inside a junction."""


@dataclass(frozen=True, eq=False)
class Lanelet:
    """A lane as a map gives it. A place where lanelets meet is a pair of rounded points."""

    lane: Lane  # without successors, gate, and place in a junction
    lanelet: str  # the relation's id
    start: tuple[int, int]  # places of the left and the right bound's first point
    end: tuple[int, int]
    turn: int | None  # where the map says so, which makes it a connection


def read_lanelet2(path: Path) -> list[Lane]:
    """The lanes of a map, in the order of its lanelets.

    Raises:
        InputError: as `osm.read_osm`; no lanelets; a lanelet without bounds, or that names a way
            or a rule that is not in the map.
    """
    osm = read_osm(path)
    relations = {
        name: relation
        for name, relation in osm.relations.items()
        if relation.tags.get("type") == "lanelet"
    }
    if not relations:
        raise InputError(
            f"{path}: expected lanelets (relations tagged type=lanelet), found none among "
            f"{len(osm.relations)} relations and {len(osm.ways)} ways; give a Lanelet2 map"
        )
    lanelets = _lanelets(path, osm, relations)
    lanelet_of = {one.lane.id: one.lanelet for one in lanelets}
    lanes = with_gates(path, osm, _linked(lanelets), lanelet_of)
    return _with_junctions(lanes, {one.lane.id: one.turn for one in lanelets})


def _lanelets(path: Path, osm: OsmMap, relations: Mapping[str, Relation]) -> list[Lanelet]:
    places = _Places()
    lanelets: list[Lanelet] = []
    known: set[tuple[str, str]] = set()
    for name, relation in relations.items():
        left, right = (_bound(path, osm, name, relation, side) for side in ("left", "right"))
        key = (relation.refs("way", "left")[0], relation.refs("way", "right")[0])
        if key in known:
            continue
        known.add(key)
        drawn = relation.refs("way", "centerline")
        centre = _found(path, osm.ways, f"lanelet {name}", "way", drawn[0]).xy_m if drawn else None
        as_stored = centre is not None and _runs_between(centre, left.xy_m, right.xy_m)
        flips = (False, False) if as_stored else orientation(left.xy_m, right.xy_m)
        left_xy, right_xy = (
            way.xy_m[::-1] if flip else way.xy_m
            for way, flip in zip((left, right), flips, strict=True)
        )
        xy_m, width_m = centre_line(left_xy, right_xy)
        if centre is not None:
            xy_m = _driven(thinned(centre), xy_m)
        rules = [
            _found(path, osm.relations, f"lanelet {name}", "regulatory element", ref)
            for ref in relation.refs("relation", "regulatory_element")
        ]
        kinds = kinds_of(relation.tags)
        lane = Lane(
            id=relation.tags.get(ID_TAG, name),
            xy_m=xy_m,
            width_m=width_m,
            speed_limit_mps=speed_limit_mps(relation.tags, rules, osm),
            successors=(),
            kinds=kinds,
        )
        start = (places.at(left_xy[0]), places.at(right_xy[0]))
        end = (places.at(left_xy[-1]), places.at(right_xy[-1]))
        turn = TURN_OF_DIRECTION.get(relation.tags.get("turn_direction", ""))
        lanelets.append(Lanelet(lane, name, start, end, turn))
        if not is_one_way(relation.tags, kinds):
            back = replace(lane, id=lane.id + REVERSED, xy_m=xy_m[::-1].copy())
            turn = None if turn is None else -turn
            lanelets.append(Lanelet(back, name, (end[1], end[0]), (start[1], start[0]), turn))
    return lanelets


def _bound(path: Path, osm: OsmMap, name: str, relation: Relation, side: str) -> Way:
    refs = relation.refs("way", side)
    if len(refs) != 1:
        raise InputError(
            f"{path}: lanelet {name}: expected one {side} bound, found {len(refs)}; "
            "correct the map (join the parts of a bound into one way)"
        )
    way = _found(path, osm.ways, f"lanelet {name}", "way", refs[0])
    if len(way.xy_m) < 2 or arc_length_m(way.xy_m)[-1] < SAME_PLACE_M:
        raise InputError(
            f"{path}: lanelet {name}: its {side} bound, way {refs[0]}, has no length; "
            "correct the map"
        )
    return way


def _found(path: Path, known: Mapping[str, _T], where: str, what: str, ref: str) -> _T:
    if ref not in known:
        raise InputError(
            f"{path}: {where} names {what} {ref}, which is not in the map; the file is cut off "
            "or was cut out: export the whole map"
        )
    return known[ref]


def _runs_between(centre: FloatArray, left: FloatArray, right: FloatArray) -> bool:
    """Whether bounds, as they are stored, begin and end on either side of a centre line's ends.

    Of a lanelet wider than long (to turn around) the bounds alone do not tell its direction.
    """
    middle = (left[[0, -1]] + right[[0, -1]]) / 2.0
    away_m = np.linalg.norm(middle - centre[[0, -1]], axis=1)
    return bool((away_m < SAME_PLACE_M).all()) and arc_length_m(centre)[-1] > 2.0 * SAME_PLACE_M


def _driven(centre: FloatArray, between: FloatArray) -> FloatArray:
    """A lanelet's own centre line, in the direction in which it is driven."""
    same = math.dist(centre[0], between[0]) <= math.dist(centre[-1], between[0])
    return centre if same else centre[::-1]


class _Places:
    """Numbers for points: the same number for points at the same place."""

    def __init__(self) -> None:
        self._cells: dict[tuple[int, int], list[tuple[FloatArray, int]]] = {}
        self._count = 0

    def at(self, xy_m: FloatArray) -> int:
        column, row = (int(value) for value in np.floor(xy_m / SAME_PLACE_M))
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                for point, number in self._cells.get((column + i, row + j), ()):
                    if np.linalg.norm(point - xy_m) < SAME_PLACE_M:
                        return number
        self._cells.setdefault((column, row), []).append((xy_m, self._count))
        self._count += 1
        return self._count - 1


def _linked(lanelets: Sequence[Lanelet]) -> list[Lane]:
    """The lanes with their successors: those that begin where both bounds end."""
    starting: dict[tuple[int, int], list[Lanelet]] = {}
    for one in lanelets:
        starting.setdefault(one.start, []).append(one)
    return [
        replace(
            one.lane,
            successors=tuple(
                other.lane.id
                for other in starting.get(one.end, ())
                # Neither back along the same lanelet, nor where nobody can go on.
                if other.lanelet != one.lanelet and other.lane.kinds & one.lane.kinds
            ),
        )
        for one in lanelets
    ]


def _with_junctions(lanes: Sequence[Lane], turns: Mapping[str, int | None]) -> list[Lane]:
    """The lanes with those marked that are part of a junction, and how they turn there."""
    if any(turn is not None for turn in turns.values()):
        inside = {name for name, turn in turns.items() if turn is not None}
    else:
        inside = _forking(lanes) | _crossing(lanes)
    out: list[Lane] = []
    for lane in lanes:
        if lane.id in inside and lane.gate is Gate.NONE:
            turn = turns.get(lane.id)
            turn = _turn(lane.xy_m) if turn is None else turn
            lane = replace(lane, is_connection=True, turn=turn)
        out.append(lane)
    return out


def _turn(xy_m: FloatArray) -> int:
    yaw = tangent_rad(xy_m)
    change = float(yaw[-1] - yaw[0])
    return 0 if abs(change) < TURN_RAD else 1 if change > 0 else -1


def _forking(lanes: Sequence[Lane]) -> set[str]:
    """Lanes that are one of several ways on, or one of several ways to the same lane."""
    counts: dict[str, int] = {}
    for lane in lanes:
        for name in lane.successors:
            counts[name] = counts.get(name, 0) + 1
    forking = {name for lane in lanes if len(lane.successors) > 1 for name in lane.successors}
    merging = {lane.id for lane in lanes if any(counts[name] > 1 for name in lane.successors)}
    return forking | merging


def _crossing(lanes: Sequence[Lane]) -> set[str]:
    """Lanes for motor vehicles whose centre lines cross away from their ends."""
    motor = [lane for lane in lanes if lane.kinds & MOTOR and Kind.CAR in lane.kinds]
    low = np.array([lane.xy_m.min(axis=0) for lane in motor]).reshape(-1, 2)
    high = np.array([lane.xy_m.max(axis=0) for lane in motor]).reshape(-1, 2)
    lengths = [float(arc_length_m(lane.xy_m)[-1]) for lane in motor]
    found: set[str] = set()
    for i, lane in enumerate(motor):
        near = ((low[i] <= high[i + 1 :]) & (high[i] >= low[i + 1 :])).all(axis=1)
        for j in (np.flatnonzero(near) + i + 1).tolist():
            one_s, other_s, _ = crossings(lane.xy_m, motor[j].xy_m)
            inner = (np.minimum(one_s, lengths[i] - one_s) > END_M) & (
                np.minimum(other_s, lengths[j] - other_s) > END_M
            )
            if inner.any():
                found |= {lane.id, motor[j].id}
    return found
