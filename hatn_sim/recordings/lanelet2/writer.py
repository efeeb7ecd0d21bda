"""Lanes -> a Lanelet2 map, as the INTERACTION data set has them (projection: see `osm`).

Lanes that follow each other share the ends of their bounds. Beside the bounds, offset by half the
width, every lanelet brings its centre line. What Lanelet2 has no word for (the lane's name) is a
tag of our own. Which signal stands at a lane is not written: the tracks have no signals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hatn_sim.datatypes import FloatArray, Gate, IntArray, Kind, Lane
from hatn_sim.geometry import arc_length_m
from hatn_sim.recordings.lanelet2.bounds import offset_line, split, thinned
from hatn_sim.recordings.lanelet2.osm import to_metres
from hatn_sim.recordings.lanelet2.reader import ID_TAG, TURN_OF_DIRECTION
from hatn_sim.recordings.lanelet2.rules import (
    KINDS_OF_SUBTYPE,
    KMH,
    PARTICIPANT_OF_KIND,
)
from hatn_sim.whole_file import save_whole

STOP_LINE_BACK_M: Final = 0.3
"""Stop lines stand this far before the end of their lane."""
SHORTEST_M: Final = 0.5
RULE_OF_GATE: Final[Mapping[Gate, tuple[str, str, str]]] = {
    Gate.STOP_LINE: ("traffic_sign", "traffic_sign", "de206"),
    Gate.GIVE_WAY_LINE: ("traffic_sign", "traffic_sign", "de205"),
    Gate.SIGNAL: ("traffic_light", "traffic_light", "red_yellow_green"),
}
"""Subtype of the rule; type and subtype of what it refers to."""
DIRECTION_OF_TURN: Final = {turn: name for name, turn in TURN_OF_DIRECTION.items()}


def write_lanelet2(path: Path, lanes: Sequence[Lane]) -> None:
    """Write a map that `read_lanelet2` reads back: names, successors, gates, kinds, limits, turns.

    Positions come back to within 0.1 mm. Lanes shorter than `SHORTEST_M` are left out; what they
    join follows each other directly.
    """
    is_long = np.array([arc_length_m(lane.xy_m)[-1] >= SHORTEST_M for lane in lanes], dtype=bool)
    joints = _joints(lanes, np.flatnonzero(~is_long))[is_long]
    lanes = [lane for lane, kept in zip(lanes, is_long, strict=True) if kept]
    sides = [(_side(lane, 0.5), _side(lane, -0.5)) for lane in lanes]
    corners_m = np.array([[[xy_m[end] for xy_m in pair] for end in (0, -1)] for pair in sides])
    drawing = _Drawing()
    nodes = _corner_nodes(drawing, joints, corners_m)
    for lane, (left, right), (start, end) in zip(lanes, sides, joints.tolist(), strict=True):
        inner = (drawing.nodes(left[1:-1]), drawing.nodes(right[1:-1]))
        left_way, right_way = (
            drawing.way([nodes[start][side], *inner[side], nodes[end][side]], {"type": "virtual"})
            for side in (0, 1)
        )
        centre = drawing.way(drawing.nodes(lane.xy_m), {"type": "virtual"})
        members = [("way", left_way, "left"), ("way", right_way, "right")]
        members.append(("way", centre, "centerline"))
        if lane.gate is not Gate.NONE:
            members.append(("relation", _rule(drawing, lane), "regulatory_element"))
        drawing.relation(members, _tags(lane))
    save_whole(path, drawing.text())


def _side(lane: Lane, widths: float) -> FloatArray:
    return offset_line(thinned(lane.xy_m), widths * lane.width_m)


def _joints(lanes: Sequence[Lane], points: IntArray) -> IntArray:
    """The joint [L, 2] at which every lane starts and ends: one for all that meet there.

    The lanes with the rows `points` start and end at the same.
    """
    row_of = {lane.id: row for row, lane in enumerate(lanes)}
    pairs = [
        (2 * row + 1, 2 * row_of[name])
        for row, lane in enumerate(lanes)
        for name in lane.successors
        if name in row_of
    ]
    pairs += [(2 * row, 2 * row + 1) for row in points.tolist()]
    one, other = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    size = 2 * len(lanes)
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(size, size))
    _, joint = connected_components(graph, directed=False)
    return joint.astype(np.int64).reshape(-1, 2)


def _corner_nodes(
    drawing: _Drawing, joints: IntArray, corners_m: FloatArray
) -> list[tuple[int, int]]:
    """The left and the right node of every joint: the means of its lanes' corners [L, 2, 2, 2]."""
    mean = np.zeros((joints.max(initial=-1) + 1, 2, 2))
    count = np.zeros(len(mean))
    np.add.at(mean, joints.ravel(), corners_m.reshape(-1, 2, 2))
    np.add.at(count, joints.ravel(), 1.0)
    mean /= np.maximum(count, 1.0)[:, None, None]
    left, right = drawing.nodes(mean[:, 0]), drawing.nodes(mean[:, 1])
    return list(zip(left, right, strict=True))


def _rule(drawing: _Drawing, lane: Lane) -> int:
    """The regulatory element of a lane's gate, with its stop line and sign."""
    subtype, sign_type, sign = RULE_OF_GATE[lane.gate]
    length_m = float(arc_length_m(lane.xy_m)[-1])
    before, _ = split(lane.xy_m, length_m - min(STOP_LINE_BACK_M, length_m / 2.0))
    half_m = lane.width_m / 2.0
    across = np.array([offset_line(before[-2:], side)[-1] for side in (half_m, -half_m)])
    line = drawing.way(drawing.nodes(across), {"type": "stop_line"})
    beside = across[1] + (across[1] - across[0]) * np.array([[0.1], [0.3]])
    sign_way = drawing.way(drawing.nodes(beside), {"type": sign_type, "subtype": sign})
    members = [("way", sign_way, "refers"), ("way", line, "ref_line")]
    return drawing.relation(members, {"type": "regulatory_element", "subtype": subtype})


def _tags(lane: Lane) -> dict[str, str]:
    tags = {"type": "lanelet", "location": "urban", "one_way": "yes", ID_TAG: lane.id}
    tags["speed_limit"] = f"{lane.speed_limit_mps / KMH!r} km/h"
    if lane.is_connection:
        tags["turn_direction"] = DIRECTION_OF_TURN[lane.turn]
    for subtype, kinds in KINDS_OF_SUBTYPE.items():
        if kinds == lane.kinds:
            return tags | {"subtype": subtype}
    said = {f"participant:{PARTICIPANT_OF_KIND[kind]}": "yes" for kind in sorted(lane.kinds)}
    if Kind.CAR in lane.kinds and Kind.VAN not in lane.kinds:
        said[f"participant:{PARTICIPANT_OF_KIND[Kind.VAN]}"] = "no"
    return tags | {"subtype": "road"} | (said or {"participant:vehicle": "no"})


class _Drawing:
    """Elements of a map, numbered as they are drawn."""

    def __init__(self) -> None:
        self._count = 0
        self._node_ids: list[int] = []
        self._xy_m: list[FloatArray] = []
        self._ways: list[str] = []
        self._relations: list[str] = []

    def number(self) -> int:
        self._count += 1
        return self._count

    def nodes(self, xy_m: FloatArray) -> list[int]:
        """Nodes at points [P, 2]."""
        ids = [self.number() for _ in range(len(xy_m))]
        self._node_ids += ids
        self._xy_m.append(xy_m)
        return ids

    def way(self, nodes: Sequence[int], tags: Mapping[str, str]) -> int:
        number = self.number()
        inside = [f'    <nd ref="{node}"/>' for node in nodes]
        self._ways.append(_element("way", number, [*inside, *_tag_lines(tags)]))
        return number

    def relation(self, members: Sequence[tuple[str, int, str]], tags: Mapping[str, str]) -> int:
        number = self.number()
        inside = [f'    <member type="{t}" ref="{ref}" role="{role}"/>' for t, ref, role in members]
        self._relations.append(_element("relation", number, [*inside, *_tag_lines(tags)]))
        return number

    def text(self) -> str:
        """The map as a file."""
        from pyproj.enums import TransformDirection

        xy_m = np.concatenate([*self._xy_m, np.zeros((0, 2))])
        project = to_metres().transform
        east_m, north_m = project(0.0, 0.0)
        lon, lat = project(
            xy_m[:, 0] + east_m, xy_m[:, 1] + north_m, direction=TransformDirection.INVERSE
        )
        nodes = [
            f'  <node id="{number}" visible="true" version="1" lat="{y:.12f}" lon="{x:.12f}"/>'
            for number, x, y in zip(self._node_ids, lon.tolist(), lat.tolist(), strict=True)
        ]
        head = [
            '<?xml version="1.0" encoding="UTF-8"?>',
            '<osm version="0.6" generator="hatn_sim">',
        ]
        return "\n".join([*head, *nodes, *self._ways, *self._relations, "</osm>", ""])


def _tag_lines(tags: Mapping[str, str]) -> list[str]:
    return [f'    <tag k="{key}" v={quoteattr(value)}/>' for key, value in sorted(tags.items())]


def _element(tag: str, number: int, inside: Sequence[str]) -> str:
    opening = f'  <{tag} id="{number}" visible="true" version="1">'
    return "\n".join([opening, *inside, f"  </{tag}>"])
