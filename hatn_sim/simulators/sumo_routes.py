"""Which lanes a vehicle drives: from the edges of its route to a chain of lanes. Pure."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass

from hatn_sim.datatypes import Route
from hatn_sim.simulators.sumo_lanes import LaneTable, edge_of, is_connection

BEHIND_M = 60.0
"""Lanes already driven are kept for this far behind the current lane."""
AHEAD_M = 150.0
"""Lanes are planned for this far beyond the end of the current lane."""
REPLAN_M = 100.0
"""They are planned anew where less than this is left. A vehicle that has to change lanes counts as
on the lane it has to change to from this far before its own ends."""


class LaneGraph:
    """The lanes of a net and what follows what."""

    def __init__(self, table: LaneTable) -> None:
        self.length_m = dict(zip(table.ids, table.length_m, strict=True))
        self.successors: dict[str, Route] = {
            lane: tuple(dict.fromkeys(link.successor for link in links))
            for lane, links in zip(table.ids, table.links, strict=True)
        }
        self.predecessors: dict[str, list[str]] = {lane: [] for lane in table.ids}
        self.lanes_of_edge: dict[str, list[str]] = {}
        for lane, following in self.successors.items():
            self.lanes_of_edge.setdefault(edge_of(lane), []).append(lane)
            for successor in following:
                self.predecessors[successor].append(lane)
        self._ways: dict[tuple[str, str], tuple[Route, ...]] = {}

    def ways(self, lane: str, edge: str) -> tuple[Route, ...]:
        """The ways from a lane to lanes of the next edge: connections, then the lane reached."""
        key = (lane, edge)
        if key not in self._ways:
            self._ways[key] = tuple(
                way
                for successor in self.successors[lane]
                if edge_of((way := self._through_junction(successor))[-1]) == edge
            )
        return self._ways[key]

    def _through_junction(self, lane: str) -> Route:
        way = [lane]
        while is_connection(way[-1]) and self.successors[way[-1]]:
            way.append(self.successors[way[-1]][0])
        return tuple(way)


def plan_ahead(
    graph: LaneGraph, lane: str, edges: Sequence[str], preferred: Collection[str]
) -> tuple[Route, bool]:
    """The lanes from `lane` (included) along `edges`, those of the route after the lane's own.

    Ends AHEAD_M beyond the end of `lane` or with the route. Where there is a choice it takes lanes
    in `preferred`. The second value is False where the lanes end before that, because the vehicle
    would have to change lanes; the longest chain is given then.
    """
    paths: dict[str, Route] = {lane: (lane,)}
    for edge in edges:
        first = next(iter(paths.values()))
        if sum(graph.length_m[part] for part in first[1:]) >= AHEAD_M:
            break
        onward: dict[str, Route] = {}
        for path in paths.values():
            for way in graph.ways(path[-1], edge):
                onward.setdefault(way[-1], path + way)
        if not onward:
            return first, False
        paths = {key: onward[key] for key in sorted(onward, key=lambda key: key not in preferred)}
    return next(iter(paths.values())), True


def plan_beside(
    graph: LaneGraph, lane: str, edges: Sequence[str], preferred: Collection[str]
) -> Route | None:
    """As `plan_ahead`, from the nearest lane beside `lane` that leads on; None if there is none."""
    if is_connection(lane):
        return None
    index = _index_of(lane)
    beside = [other for other in graph.lanes_of_edge[edge_of(lane)] if other != lane]
    for other in sorted(beside, key=lambda other: abs(_index_of(other) - index)):
        path, complete = plan_ahead(graph, other, edges, preferred)
        if complete:
            return path
    return None


def behind(graph: LaneGraph, lane: str, driven: Iterable[str]) -> Route:
    """At least BEHIND_M of lanes that lead to `lane`, as far as the vehicle has come that way.

    After a change of lanes these are lanes beside those driven. They are chosen by the graph, so
    that every lane of the answer leads to the next one and the last to `lane`.
    """
    lanes = set(driven)
    edges = {edge_of(part) for part in lanes}

    def strangeness(part: str) -> int | None:
        if part in lanes:
            return 0
        if edge_of(part) in edges:
            return 1
        if is_connection(part) and any(
            edge_of(source) in edges for source in graph.predecessors[part]
        ):
            return 2
        return None

    chain: list[str] = []
    head, length_m = lane, 0.0
    while length_m < BEHIND_M or is_connection(head):
        ranked = [
            (rank, part)
            for part in graph.predecessors[head]
            if part not in chain and (rank := strangeness(part)) is not None
        ]
        if not ranked:
            break
        head = min(ranked)[1]
        chain.append(head)
        length_m += graph.length_m[head]
    # Where it ends early it must not begin inside a junction that the vehicle was not in.
    while chain and is_connection(chain[-1]) and chain[-1] not in lanes:
        chain.pop()
    return tuple(reversed(chain))


def _index_of(lane: str) -> int:
    return int(lane.rpartition("_")[2])


@dataclass
class _Follower:
    """A vehicle on one of the tracker's routes."""

    lane: str
    route_id: str
    index: int  # of its route among the tracker's
    position: int  # of its lane in that route
    ends: bool  # the lanes end where the vehicle's journey does
    settled: bool  # nothing changes before the vehicle's lane does


class RouteTracker:
    """Keeps the lanes of every vehicle, asking the simulator as seldom as possible.

    `edges_and_lanes(vehicle)` gives the edges of its route after the current one and the normal
    lanes that SUMO would take; `gap_to_lane_end_m(vehicle)` what is left of its lane.
    """

    def __init__(
        self,
        graph: LaneGraph,
        edges_and_lanes: Callable[[str], tuple[Sequence[str], Collection[str]]],
        gap_to_lane_end_m: Callable[[str], float],
    ) -> None:
        self.routes: list[Route] = []
        self._graph = graph
        self._edges_and_lanes = edges_and_lanes
        self._gap_to_lane_end_m = gap_to_lane_end_m
        self._index_of: dict[Route, int] = {}
        self._followers: dict[str, _Follower] = {}

    def index(self, vehicle: str, lane: str, route_id: str) -> int:
        """The index in `routes` of the lanes a vehicle follows; -1 where it is on no lane."""
        follower = self._followers.get(vehicle)
        if follower is not None and follower.route_id == route_id:
            if follower.lane == lane:
                if follower.settled or self._gap_to_lane_end_m(vehicle) > REPLAN_M:
                    return follower.index
            elif self._advance(follower, lane):
                return follower.index
        if lane not in self._graph.length_m:
            return -1
        self._followers[vehicle] = follower = self._plan(vehicle, lane, route_id, follower)
        return follower.index

    def forget(self, vehicle: str) -> None:
        """Drops a vehicle that has left."""
        self._followers.pop(vehicle, None)

    def _advance(self, follower: _Follower, lane: str) -> bool:
        route = self.routes[follower.index]
        # A vehicle may pass more than one short lane in a step.
        upcoming = route[follower.position : follower.position + 5]
        if lane not in upcoming:
            return False
        position = follower.position + upcoming.index(lane)
        beyond_m = sum(self._graph.length_m[part] for part in route[position + 1 :])
        if not follower.ends and beyond_m < REPLAN_M:
            return False
        follower.lane, follower.position, follower.settled = lane, position, True
        return True

    def _plan(self, vehicle: str, lane: str, route_id: str, before: _Follower | None) -> _Follower:
        edges, preferred = self._edges_and_lanes(vehicle)
        path, complete = plan_ahead(self._graph, lane, edges, preferred)
        settled = True
        if not complete:
            if self._gap_to_lane_end_m(vehicle) > REPLAN_M:
                settled = False
            else:
                path = plan_beside(self._graph, lane, edges, preferred) or path
        driven = () if before is None else self.routes[before.index][: before.position + 1]
        chain = behind(self._graph, path[0], driven)
        route = chain + path
        if route not in self._index_of:
            self._index_of[route] = len(self.routes)
            self.routes.append(route)
        edges_planned = sum(not is_connection(part) for part in path[1:])
        return _Follower(
            lane, route_id, self._index_of[route], len(chain), edges_planned == len(edges), settled
        )
