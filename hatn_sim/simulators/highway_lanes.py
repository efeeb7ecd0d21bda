"""highway-env's road network -> our lanes: bridged where its own lanes do not meet.

A network of highway-env is a graph of nodes with lanes as edges. Lanes that share a node need not
meet: the exits of its roundabouts begin 5.6 to 7.7 m away from the ring, and its drivers cut
across, since they turn to the next lane 2.5 m before the end of theirs. So a lane is linked to
another where a driver can go on (less than `MAX_TURN_RAD` round, `MAX_GAP_M` ahead, a lane's width
aside), and where the two do not meet in a straight line the link is a connection of its own, along
the path on which highway-env's own steering leads from the one to the other. That path depends on
the speed, the slower the sharper: of those at all speeds, the connection is the one that the others
are nearest to. Its y axis points down: y and headings are negated here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
from highway_env.road.road import Road as HighwayRoad
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle
from scipy.spatial.distance import cdist

from hatn_sim.datatypes import FloatArray, Gate, Kind, Lane, Route
from hatn_sim.geometry import arc_length_m, resample, wrap_angle

LaneIndex = tuple[str, str, int]
"""How highway-env names a lane: from node, to node, number on that road."""

MAX_TURN_RAD: Final = 1.0
MAX_GAP_M: Final = 10.0
MEET_M: Final = 0.3
MEET_RAD: Final = 0.1
"""Lanes that differ by less where they join are driven as one."""
LOOK_AHEAD_M: Final = 2.5
"""highway-env's drivers turn to the next lane this far before the end of theirs."""
MERGE_M: Final = IDMVehicle.DISTANCE_WANTED
"""A lane that ends beside another leads over to it this far before its end: where drivers who found
no gap on the way stand and wait."""
PATH_SPEEDS_MPS: Final = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 16.0)
TURNS_RAD: Final = np.deg2rad(30.0)
SAMPLE_M: Final = 1.0
PATH_STEP_M: Final = 0.2
STEERING_S: Final = 0.05
ARRIVED_M: Final = 0.2
ARRIVED_RAD: Final = 0.05
VEHICLES: Final = frozenset(Kind) - {Kind.PEDESTRIAN, Kind.TRAM}


@dataclass(frozen=True, eq=False)
class LaneGraph:
    """The lanes of a network and what leads where."""

    lanes: tuple[Lane, ...]
    successors: dict[LaneIndex, tuple[LaneIndex, ...]]  # of highway-env's lanes
    merging: frozenset[LaneIndex]  # those that end beside another and lead over to it

    @cached_property
    def predecessors(self) -> dict[LaneIndex, tuple[LaneIndex, ...]]:
        before: dict[LaneIndex, list[LaneIndex]] = {index: [] for index in self.successors}
        for index, following in self.successors.items():
            for other in following:
                before[other].append(index)
        return {index: tuple(others) for index, others in before.items()}

    @cached_property
    def _by_id(self) -> dict[str, Lane]:
        return {lane.id: lane for lane in self.lanes}

    @cached_property
    def length_m(self) -> dict[str, float]:
        """Of every lane, by its id."""
        return {lane.id: float(arc_length_m(lane.xy_m)[-1]) for lane in self.lanes}

    def route(self, path: Sequence[LaneIndex]) -> Route:
        """The lanes, connections included, along linked lanes of highway-env."""
        names = [lane_id(path[0])] if path else []
        for source, target in pairwise(path):
            link = link_id(source, target)
            names += [link, lane_id(target)] if link in self._by_id else [lane_id(target)]
        return tuple(names)


def lane_id(index: LaneIndex) -> str:
    """`a_b_0`: our name for a lane of highway-env."""
    return f"{index[0]}_{index[1]}_{index[2]}"


def link_id(source: LaneIndex, target: LaneIndex) -> str:
    """Our name for the connection between two lanes of highway-env."""
    return f"{lane_id(source)}>{lane_id(target)}"


@dataclass(frozen=True, eq=False)
class _Link:
    """How one lane leads to another."""

    meets: bool
    path_xy_m: FloatArray  # [P, 2] in highway-env's frame; of lanes that meet: nothing
    leave_m: float  # before the end of the first lane
    arrive_m: float  # on the second


def lane_graph(network: RoadNetwork, has_priorities: bool) -> LaneGraph:
    """Every lane of a network, and the connections.

    `has_priorities`: the drivers respect the lanes' priorities; give-way lines are marked then.
    """
    found: dict[LaneIndex, Any] = network.lanes_dict()  # type: ignore[assignment]
    straight = {index: _next_lanes(network, index) for index in found}
    links: dict[tuple[LaneIndex, LaneIndex], _Link] = {}
    for source, targets in straight.items():
        for target in targets:
            links[source, target] = _link(network, source, target)
        if not targets:
            links |= _merges(network, source, straight)
    merging = frozenset(source for source, _ in links if not straight[source])
    successors = {index: tuple(b for a, b in links if a == index) for index in found}
    leave_m = {
        index: max((links[index, b].leave_m for b in successors[index]), default=0.0)
        for index in found
    }
    arrive_m = {
        index: min(
            max((link.arrive_m for (_, b), link in links.items() if b == index), default=0.0),
            max(found[index].length - leave_m[index] - 1.0, 0.5 * found[index].length),
        )
        for index in found
    }
    bare = {  # neither lane is cut where they meet: nothing is needed between them
        (a, b)
        for (a, b), link in links.items()
        if link.meets and leave_m[a] == 0.0 and arrive_m[b] == 0.0
    }
    forks = {b for a, b in bare if len(successors[a]) > 1}
    highest = max((lane.priority for lane in found.values()), default=0)
    lanes: list[Lane] = []
    for index, lane in found.items():
        following = tuple(
            lane_id(b) if (index, b) in bare else link_id(index, b) for b in successors[index]
        )
        yields = has_priorities and len(following) > 1 and lane.priority < highest
        begin_m, end_m = arrive_m[index], float(lane.length) - leave_m[index]
        lanes.append(
            _as_lane(
                lane_id(index),
                _samples(lane, begin_m, end_m),
                (lane,),
                following,
                is_connection=index in forks,
                gate=Gate.GIVE_WAY_LINE if yields else Gate.NONE,
            )
        )
    for (a, b), link in links.items():
        if (a, b) not in bare:
            xy_m = _between(found[a], found[b], link, leave_m[a], arrive_m[b])
            lanes.append(
                _as_lane(
                    link_id(a, b), xy_m, (found[a], found[b]), (lane_id(b),), is_connection=True
                )
            )
    return LaneGraph(tuple(lanes), successors, merging)


def _as_lane(
    name: str,
    xy_m: FloatArray,
    of: Sequence[Any],
    successors: Route,
    *,
    is_connection: bool,
    gate: Gate = Gate.NONE,
) -> Lane:
    """A lane of ours from a polyline in highway-env's frame."""
    xy_m = xy_m * np.array([1.0, -1.0])
    limits = [lane.speed_limit for lane in of if lane.speed_limit is not None]
    step = np.diff(xy_m, axis=0)
    yaw = np.arctan2(step[[0, -1], 1], step[[0, -1], 0])
    turned_rad = float(wrap_angle(np.asarray(yaw[1] - yaw[0])))
    turns = is_connection and abs(turned_rad) > TURNS_RAD
    return Lane(
        id=name,
        xy_m=xy_m,
        width_m=float(min(lane.width_at(0.0) for lane in of)),
        speed_limit_mps=float(min(limits, default=ControlledVehicle.MAX_SPEED)),
        successors=successors,
        kinds=VEHICLES,
        gate=gate,
        turn=int(np.sign(turned_rad)) if turns else 0,
        is_connection=is_connection,
    )


def _next_lanes(network: RoadNetwork, index: LaneIndex) -> list[LaneIndex]:
    """The lanes that a driver at the end of a lane can go on to, one for each further road."""
    lane: Any = network.get_lane(index)
    end, heading = lane.position(lane.length, 0.0), lane.heading_at(lane.length)
    out: list[LaneIndex] = []
    for further in network.graph.get(index[1], {}):
        number, _ = network.next_lane_given_next_road(*index, further, None, end)  # type: ignore[arg-type]
        target: LaneIndex = (index[1], further, int(number))
        other: Any = network.get_lane(target)
        ahead_m, aside_m = other.local_coordinates(end)
        turned_rad = wrap_angle(np.asarray(other.heading_at(0.0) - heading))
        if (
            abs(turned_rad) < MAX_TURN_RAD
            and abs(ahead_m) < MAX_GAP_M
            and abs(aside_m) < 0.9 * other.width_at(0.0)
        ):
            out.append(target)
    return out


def _link(network: RoadNetwork, source: LaneIndex, target: LaneIndex) -> _Link:
    lane: Any = network.get_lane(source)
    other: Any = network.get_lane(target)
    gap_m = np.linalg.norm(other.position(0.0, 0.0) - lane.position(lane.length, 0.0))
    turned_rad = wrap_angle(np.asarray(other.heading_at(0.0) - lane.heading_at(lane.length)))
    if gap_m < MEET_M and abs(turned_rad) < MEET_RAD:
        return _Link(True, np.zeros((0, 2)), 0.0, 0.0)
    limits = [one.speed_limit for one in (lane, other) if one.speed_limit is not None]
    fastest_mps = min(limits, default=np.inf)
    speeds_mps = [speed for speed in PATH_SPEEDS_MPS if speed <= fastest_mps]
    ways = [_driven(lane, other, speed) for speed in speeds_mps or PATH_SPEEDS_MPS[:1]]
    # All are drawn out to the same end, so that their distances are of the paths alone.
    end_m = max(way.arrive_m for way in ways)
    whole = [resample(_drawn_out(way, other, end_m), PATH_STEP_M) for way in ways]
    farthest_m = [max(cdist(one, two).min(axis=1).max() for two in whole) for one in whole]
    return ways[int(np.argmin(farthest_m))]


def _drawn_out(link: _Link, other: Any, end_m: float) -> FloatArray:
    """The path of a link, and on along the second lane to an arc length."""
    return np.concatenate((link.path_xy_m, _samples(other, link.arrive_m, end_m)))


def _driven(lane: Any, other: Any, speed_mps: float) -> _Link:
    """The path of highway-env's own steering at a speed, from the end of one lane onto another."""
    pair = RoadNetwork()
    pair.add_lane("a", "b", lane)
    pair.add_lane("b", "c", other)
    leave_m = min(LOOK_AHEAD_M + 0.5, 0.4 * lane.length)
    begin_m = lane.length - leave_m
    driver: Any = ControlledVehicle(
        HighwayRoad(pair),
        lane.position(begin_m, 0.0),
        heading=lane.heading_at(begin_m),
        speed=speed_mps,
    )
    path = [driver.position.copy()]
    s_m, d_m, turning = 0.0, 0.0, False
    while s_m < 0.8 * other.length:
        turning = turning or bool(lane.after_end(driver.position))
        goal = ("b", "c", 0) if turning else ("a", "b", 0)
        driver.action = {"steering": driver.steering_control(goal), "acceleration": 0.0}
        driver.step(STEERING_S)
        path.append(driver.position.copy())
        s_m, d_m = other.local_coordinates(driver.position)
        off_rad = wrap_angle(np.asarray(driver.heading - other.heading_at(s_m)))
        if turning and s_m > 0.0 and abs(d_m) < ARRIVED_M and abs(off_rad) < ARRIVED_RAD:
            break
    xy_m = np.array(path)
    # What is left to the middle of the lane is spread over the second half of the way.
    part = np.clip(np.linspace(-1.0, 1.0, len(xy_m)), 0.0, 1.0)[:, None]
    xy_m += part * (other.position(s_m, 0.0) - xy_m[-1])
    return _Link(False, xy_m, leave_m, float(s_m))


def _merges(
    network: RoadNetwork, source: LaneIndex, following: dict[LaneIndex, list[LaneIndex]]
) -> dict[tuple[LaneIndex, LaneIndex], _Link]:
    """Where a lane ends beside another that goes on: a change over to that one by the end."""
    lane: Any = network.get_lane(source)
    end = lane.position(lane.length, 0.0)
    for beside in network.side_lanes(source):
        other: Any = network.get_lane(beside)
        s_m, aside_m = other.local_coordinates(end)
        if not following[beside] or abs(s_m - other.length) > MEET_M or abs(aside_m) > MAX_GAP_M:
            continue
        leave_m = min(MERGE_M, 0.5 * lane.length)
        one, two = (_samples(each, each.length - leave_m, each.length) for each in (lane, other))
        part = np.linspace(0.0, 1.0, len(one))[:, None]
        part = part * part * (3.0 - 2.0 * part)
        xy_m = (1.0 - part) * one + part * two
        return {(source, target): _Link(False, xy_m, leave_m, 0.0) for target in following[beside]}
    return {}


def _between(lane: Any, other: Any, link: _Link, leave_m: float, arrive_m: float) -> FloatArray:
    """The connection: from where the first lane was cut to where the second begins."""
    before = _samples(lane, lane.length - leave_m, lane.length - link.leave_m)
    xy_m = np.concatenate((before, _drawn_out(link, other, max(arrive_m, link.arrive_m))))
    fresh = np.linalg.norm(np.diff(xy_m, axis=0), axis=1) > 1e-3
    return xy_m[np.concatenate(([True], fresh))]


def _samples(lane: Any, begin_m: float, end_m: float) -> FloatArray:
    """The centre line between two arc lengths."""
    count = max(int(np.ceil((end_m - begin_m) / SAMPLE_M)) + 1, 2)
    return np.array([lane.position(s_m, 0.0) for s_m in np.linspace(begin_m, end_m, count)])


def ends(graph: LaneGraph, begin: LaneIndex) -> tuple[LaneIndex, ...]:
    """The lanes without a successor that can be reached from a lane, in a fixed order."""
    seen, waiting = {begin}, [begin]
    while waiting:
        for index in graph.successors[waiting.pop()]:
            if index not in seen:
                seen.add(index)
                waiting.append(index)
    return tuple(sorted(index for index in seen if not graph.successors[index]))


def entries(graph: LaneGraph, network: RoadNetwork) -> tuple[LaneIndex, ...]:
    """The lanes on which traffic comes from outside.

    They are those that no lane leads to, of roads that no lane leads to. A lane that is also driven
    the other way is for overtaking, unless its road has no other.
    """
    fed = {index[:2] for index, before in graph.predecessors.items() if before}
    open_ = [index for index in graph.successors if index[:2] not in fed]
    shared = {index for index in open_ if _is_driven_back(network, index, graph.successors)}
    roads = {index[:2] for index in open_ if index not in shared}
    return tuple(index for index in open_ if index not in shared or index[:2] not in roads)


def _is_driven_back(network: RoadNetwork, index: LaneIndex, others: Iterable[LaneIndex]) -> bool:
    lane: Any = network.get_lane(index)
    middle, heading = lane.position(lane.length / 2, 0.0), lane.heading_at(lane.length / 2)
    for other_index in others:
        other: Any = network.get_lane(other_index)
        s_m, d_m = other.local_coordinates(middle)
        turned_rad = wrap_angle(np.asarray(other.heading_at(s_m) - heading))
        if 0.0 <= s_m <= other.length and abs(d_m) < 1.0 and abs(turned_rad) > 3.0:
            return True
    return False
