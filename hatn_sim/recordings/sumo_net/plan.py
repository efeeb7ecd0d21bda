"""Lanes -> what a SUMO net is made of: edges, junctions and the ways through them. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial import ConvexHull, KDTree

from hatn_sim.datatypes import FloatArray, Gate, Kind, Lane, Route
from hatn_sim.geometry import resample, tangent_rad, wrap_angle
from hatn_sim.recordings.sumo_net.cut import cut_long

OVERLAP_M: Final = 0.75
"""Centre lines of connections nearer than this to each other are of one junction."""
SIBLING_M: Final = 1.0
"""How far the centre lines of lanes side by side may be from half the sum of their widths."""
SIBLING_RAD: Final = np.deg2rad(20.0)
LIP_M: Final = 0.1
"""A junction's outline reaches this far beyond the ends of its lanes, so that it has an area."""
MAX_LANES_INSIDE: Final = 12
"""Longest way through one junction, in lanes."""


@dataclass(frozen=True, eq=False)
class PlannedLane:
    """A lane of an edge: one lane as given, or several that follow one another."""

    given: Route
    lane: Lane  # with the geometry of all of them and the gate of the last


@dataclass(frozen=True, eq=False)
class PlannedEdge:
    """Lanes side by side, the rightmost first."""

    id: str
    source: str  # node
    target: str  # node
    lanes: tuple[PlannedLane, ...]
    has_right_of_way: bool


@dataclass(frozen=True, eq=False)
class PlannedNode:
    id: str
    type: str  # as SUMO calls it
    shape_m: FloatArray  # [P, 2]


@dataclass(frozen=True, eq=False)
class PlannedConnection:
    """A way through a junction, from lane to lane; an edge and the index of its lane."""

    source: tuple[str, int]
    target: tuple[str, int]
    through: Route  # the connections as given; empty where lanes follow directly
    shape_m: FloatArray  # [P, 2]
    speed_mps: float
    given: tuple[str, str]  # the lane before and the lane after


@dataclass(frozen=True, eq=False)
class NetPlan:
    lanes: tuple[Lane, ...]  # as given, cut as `sumo_net_cut` says
    nodes: tuple[PlannedNode, ...]
    edges: tuple[PlannedEdge, ...]
    connections: tuple[PlannedConnection, ...]


class _Groups:
    """Union-find over names."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}

    def find(self, name: str) -> str:
        self._parent.setdefault(name, name)
        while self._parent[name] != name:
            self._parent[name] = self._parent[self._parent[name]]
            name = self._parent[name]
        return name

    def join(self, first: str, second: str) -> None:
        one, other = sorted((self.find(first), self.find(second)))
        self._parent[other] = one


def plan_net(given: Iterable[Lane]) -> NetPlan:
    """The net of lanes; those for pedestrians only are left out.

    Lanes outside junctions become lanes of edges, side by side where they run so; what touches or
    overlaps inside is one junction, and every way through it one connection. A lane of a junction
    without a lane before or after it (where the map ends) is an edge of its own, and so is a free
    stretch of a long one (`sumo_net_cut`).
    """
    lanes = cut_long(_driveable(given))
    before = _predecessors(lanes)
    inside = {
        name
        for name, lane in lanes.items()
        if lane.is_connection and lane.successors and before[name]
    }
    while True:
        chains = _chains(lanes, before, inside)
        edges = _side_by_side(chains)
        node_of = _nodes(lanes, inside, edges)
        # An edge that would begin and end in one junction is part of it.
        loops = {
            name
            for number, edge in enumerate(edges)
            if node_of[f"start {number}"] == node_of[f"end {number}"]
            for chain in edge
            for name in chain.given
        }
        if not loops:
            break
        inside |= loops
    return _assemble(lanes, inside, edges, node_of)


def _driveable(given: Iterable[Lane]) -> dict[str, Lane]:
    """The lanes that are not for pedestrians only, with their successors among these."""
    lanes = {lane.id: lane for lane in given if lane.kinds - {Kind.PEDESTRIAN}}
    return {
        name: replace(lane, successors=tuple(s for s in lane.successors if s in lanes))
        for name, lane in lanes.items()
    }


def _predecessors(lanes: Mapping[str, Lane]) -> dict[str, list[str]]:
    before: dict[str, list[str]] = {name: [] for name in lanes}
    for name, lane in lanes.items():
        for successor in lane.successors:
            before[successor].append(name)
    return before


def _chains(
    lanes: Mapping[str, Lane], before: Mapping[str, Sequence[str]], inside: set[str]
) -> list[PlannedLane]:
    """Lanes outside junctions, joined where one simply goes on as the other."""

    def goes_on_as(name: str) -> str | None:
        lane = lanes[name]
        if len(lane.successors) != 1 or lane.gate is not Gate.NONE:
            return None
        other = lanes[lane.successors[0]]
        same = (
            other.id not in inside
            and len(before[other.id]) == 1
            and other.kinds == lane.kinds
            and other.speed_limit_mps == lane.speed_limit_mps
            and abs(other.width_m - lane.width_m) < 0.2
        )
        return other.id if same else None

    following = {name: goes_on_as(name) for name in lanes if name not in inside}
    followed = set(following.values())
    chains: list[PlannedLane] = []
    done: set[str] = set()
    # First those that nobody goes on as; then what is left, which are rings.
    for first in sorted(following, key=lambda name: name in followed):
        route: list[str] = []
        name: str | None = first
        while name is not None and name not in done:
            route.append(name)
            done.add(name)
            name = following[name]
        if route:
            chains.append(_chain(tuple(route), lanes))
    return chains


def _chain(route: Route, lanes: Mapping[str, Lane]) -> PlannedLane:
    parts = [lanes[name] for name in route]
    xy_m = _joined([part.xy_m for part in parts])
    return PlannedLane(route, replace(parts[0], xy_m=xy_m, gate=parts[-1].gate))


def _joined(parts: Sequence[FloatArray]) -> FloatArray:
    """Polylines one after the other, a point at their joints once."""
    xy_m = np.concatenate(parts)
    return xy_m[np.append(True, np.linalg.norm(np.diff(xy_m, axis=0), axis=1) > 1e-3)]


def _side_by_side(chains: Sequence[PlannedLane]) -> list[list[PlannedLane]]:
    """Chains grouped into edges, the rightmost lane of each first."""
    groups = _Groups()
    ends = [
        (chain.lane.xy_m[place], tangent_rad(chain.lane.xy_m)[place])
        for chain in chains
        for place in (0, -1)
    ]
    starts = np.array([xy_m for xy_m, _ in ends[::2]]).reshape(-1, 2)
    widest_m = max((chain.lane.width_m for chain in chains), default=0.0)
    for i, j in KDTree(starts).query_pairs(widest_m + SIBLING_M) if len(starts) else ():
        beside = [
            _offset_beside(ends[2 * i + k], ends[2 * j + k], chains[i].lane, chains[j].lane)
            for k in (0, 1)
        ]
        # On the same side at both ends.
        if all(beside) and np.sign(beside[0]) == np.sign(beside[1]):
            groups.join(str(i), str(j))
    members: dict[str, list[int]] = {}
    for i in range(len(chains)):
        members.setdefault(groups.find(str(i)), []).append(i)
    edges: list[list[PlannedLane]] = []
    for group in members.values():
        origin, yaw = ends[2 * group[0]]
        left = np.array([-np.sin(yaw), np.cos(yaw)])
        group.sort(key=lambda i: float((starts[i] - origin) @ left))
        edges.append([chains[i] for i in group])
    return edges


def _offset_beside(
    one: tuple[FloatArray, float], other: tuple[FloatArray, float], lane: Lane, neighbour: Lane
) -> float:
    """Metres to the left that the other's end lies beside; 0 where it does not."""
    (xy_m, yaw), (other_xy_m, other_yaw) = one, other
    away = other_xy_m - xy_m
    ahead_m = float(away @ np.array([np.cos(yaw), np.sin(yaw)]))
    left_m = float(away @ np.array([-np.sin(yaw), np.cos(yaw)]))
    wanted_m = 0.5 * (lane.width_m + neighbour.width_m)
    turned = abs(float(wrap_angle(np.asarray(other_yaw - yaw))))
    fits = (
        abs(abs(left_m) - wanted_m) <= SIBLING_M
        and abs(ahead_m) <= wanted_m
        and turned <= SIBLING_RAD
    )
    return left_m if fits else 0.0


def _nodes(
    lanes: Mapping[str, Lane], inside: set[str], edges: Sequence[Sequence[PlannedLane]]
) -> dict[str, str]:
    """The node of every `start i` and `end i` of an edge and of every lane inside, by its name."""
    start_of = {chain.given[0]: f"start {i}" for i, edge in enumerate(edges) for chain in edge}
    end_of = {chain.given[-1]: f"end {i}" for i, edge in enumerate(edges) for chain in edge}
    groups = _Groups()
    for name, lane in lanes.items():
        source = f"lane {name}" if name in inside else end_of.get(name)
        for successor in lane.successors:
            target = f"lane {successor}" if successor in inside else start_of.get(successor)
            if source is not None and target is not None:
                groups.join(source, target)
    names = sorted(inside)
    if names:
        points = [resample(lanes[name].xy_m, 0.5) for name in names]
        owner = np.repeat(np.arange(len(names)), [len(part) for part in points])
        pairs = KDTree(np.concatenate(points)).query_pairs(OVERLAP_M, output_type="ndarray")
        for i, j in np.unique(owner[pairs], axis=0).tolist():
            groups.join(f"lane {names[i]}", f"lane {names[j]}")
    wanted = [*start_of.values(), *end_of.values(), *(f"lane {name}" for name in names)]
    number: dict[str, str] = {}
    return {name: number.setdefault(groups.find(name), f"junction{len(number)}") for name in wanted}


def _assemble(
    lanes: Mapping[str, Lane],
    inside: set[str],
    edges: Sequence[Sequence[PlannedLane]],
    node_of: Mapping[str, str],
) -> NetPlan:
    planned: list[PlannedEdge] = []
    place: dict[str, tuple[str, int]] = {}
    used: set[str] = set()
    for number, edge in enumerate(edges):
        name = _edge_name(edge[0].given[0], number, used)
        source, target = node_of[f"start {number}"], node_of[f"end {number}"]
        yields = any(chain.lane.gate in (Gate.STOP_LINE, Gate.GIVE_WAY_LINE) for chain in edge)
        planned.append(PlannedEdge(name, source, target, tuple(edge), not yields))
        for index, chain in enumerate(edge):
            place[chain.given[0]] = place[chain.given[-1]] = (name, index)
    connections = [
        connection
        for edge in planned
        for index, chain in enumerate(edge.lanes)
        for connection in _ways(lanes, inside, place, (edge.id, index), chain.given[-1])
    ]
    nodes = tuple(
        _node(name, planned, connections)
        for name in dict.fromkeys(node for edge in planned for node in (edge.source, edge.target))
    )
    return NetPlan(tuple(lanes.values()), nodes, tuple(planned), tuple(connections))


def _edge_name(lane: str, number: int, used: set[str]) -> str:
    """A name that SUMO takes, the lane's own if it is one."""
    plain = lane.isascii() and all(sign.isalnum() or sign in "_-.#~" for sign in lane)
    name = lane if plain and lane not in used else f"edge{number}"
    while name in used:
        name += "_"
    used.add(name)
    return name


def _ways(
    lanes: Mapping[str, Lane],
    inside: set[str],
    place: Mapping[str, tuple[str, int]],
    source: tuple[str, int],
    last: str,
) -> list[PlannedConnection]:
    """The ways from the end of a lane through the junction there, the shortest to each lane."""
    found: dict[tuple[str, int], PlannedConnection] = {}
    queue: list[Route] = [(successor,) for successor in lanes[last].successors]
    while queue:
        route = queue.pop(0)
        lane = lanes[route[-1]]
        if lane.id in inside:
            if len(route) <= MAX_LANES_INSIDE:
                queue += [(*route, name) for name in lane.successors if name not in route]
            continue
        target, through = place[lane.id], route[:-1]
        if target in found:
            continue
        parts = [lanes[name].xy_m for name in through]
        ends = [lanes[last].xy_m[-1:], *parts, lane.xy_m[:1]]
        limits = [lanes[name].speed_limit_mps for name in through]
        found[target] = PlannedConnection(
            source,
            target,
            through,
            _joined(ends),
            float(np.mean(limits)) if limits else lane.speed_limit_mps,
            (last, lane.id),
        )
    return list(found.values())


def _node(
    name: str, edges: Sequence[PlannedEdge], connections: Sequence[PlannedConnection]
) -> PlannedNode:
    incoming = [edge for edge in edges if edge.target == name]
    outgoing = [edge for edge in edges if edge.source == name]
    corners = [_corners(chain.lane, -1) for edge in incoming for chain in edge.lanes]
    corners += [_corners(chain.lane, 0) for edge in outgoing for chain in edge.lanes]
    here = {edge.id for edge in incoming}
    corners += [way.shape_m for way in connections if way.source[0] in here]
    points = np.concatenate(corners)
    return PlannedNode(name, _type(incoming, outgoing), points[ConvexHull(points).vertices])


def _corners(lane: Lane, place: int) -> FloatArray:
    """The corners of a lane's end (-1) or beginning (0), and of a lip beyond it."""
    yaw = tangent_rad(lane.xy_m)[place]
    ahead = np.array([np.cos(yaw), np.sin(yaw)]) * (LIP_M if place else -LIP_M)
    left = 0.5 * lane.width_m * np.array([-np.sin(yaw), np.cos(yaw)])
    at = lane.xy_m[place]
    return np.stack([at + left, at - left, at + left + ahead, at - left + ahead])


def _type(incoming: Sequence[PlannedEdge], outgoing: Sequence[PlannedEdge]) -> str:
    """SUMO's type of a junction, from what stands at the ends of the lanes that lead to it."""
    gates = [
        max((chain.lane.gate for chain in edge.lanes), key=(_STRENGTH.index)) for edge in incoming
    ]
    if Gate.SIGNAL in gates:
        return "traffic_light"
    if len(gates) > 1 and all(gate is Gate.STOP_LINE for gate in gates):
        return "allway_stop"
    if gates.count(Gate.STOP_LINE) > gates.count(Gate.GIVE_WAY_LINE):
        return "priority_stop"
    if Gate.GIVE_WAY_LINE in gates or len(incoming) < 2 or len(outgoing) < 2:
        return "priority"
    return "right_before_left"


_STRENGTH: Final = (Gate.NONE, Gate.GIVE_WAY_LINE, Gate.STOP_LINE, Gate.SIGNAL)
