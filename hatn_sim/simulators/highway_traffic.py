"""Traffic that lasts on a road of highway-env: who comes in, who leaves, and where each drives.

highway-env ends an episode when its ego crashes, arrives or runs out of time, and only its
intersection lets new vehicles in. Here vehicles come in at every lane on which traffic comes from
outside, at a stated rate, and leave at the end of the road; a vehicle that has crashed or stands
still for long is taken off the road.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.utils import class_from_path
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle

from hatn_sim.datatypes import DT_S, Command, Route
from hatn_sim.simulators.highway_lanes import LaneGraph, LaneIndex, ends, entries, lane_id
from hatn_sim.simulators.highway_scene import ego_name

ENTRY_M: Final = 5.0
"""Where vehicles come in, along the lane, as in highway-env's own intersection."""
EXIT_M: Final = 5.0
"""Vehicles leave this far before the end of the road, where their drivers would look for more."""
CRASH_S: Final = 3.0
"""How long those that crashed stay on the road."""
STUCK_S: Final = 30.0
"""How long a vehicle may stand: now and then those of the intersection all wait for each other."""
WAIT_S: Final = 1.0
"""How long a vehicle stands before the end of its lane until it pushes over."""
STANDING_MPS: Final = 0.1
BEHIND_M: Final = 80.0
"""How much of the way a vehicle came is kept in its route."""
AHEAD_M: Final = 400.0
"""How far routes are planned at least, where the road goes on."""
RENEW_M: Final = 200.0


@dataclass(eq=False)
class Journey:
    """Where a vehicle came from and goes: mutable, one for each vehicle on the road."""

    name: str
    path: tuple[LaneIndex, ...]
    position: int  # of the lane it follows now, in `path`
    route: Route
    stood_s: float = 0.0
    crashed_s: float = 0.0

    @property
    def lane(self) -> LaneIndex:
        return self.path[self.position]


@dataclass(frozen=True)
class Leaving:
    """Who has left the road."""

    arrived: tuple[str, ...]
    removed: tuple[str, ...]  # after a crash, or stuck


class Traffic:
    """The vehicles of an environment that was reset, from their entry to their exit."""

    def __init__(
        self,
        environment: AbstractEnv,
        graph: LaneGraph,
        settings: Mapping[str, Any],
        parameters: Mapping[str, Any],
    ) -> None:
        """`settings` are the environment's and ours, `parameters` those of every driver."""
        self._road: Any = environment.road
        self._random: np.random.Generator = environment.np_random
        self.graph = graph
        self._parameters = parameters
        self._driver: Any = class_from_path(settings["other_vehicles_type"])
        self._spawn_per_s: float = settings["spawn_probability"]
        self._desired_speed_mps: float | None = settings["desired_speed_mps"]
        self._entries = entries(graph, self._road.network)
        self._named = 0
        self.journeys: dict[Any, Journey] = {}
        self._take_over(environment)

    @property
    def goes_on(self) -> bool:
        """Vehicles are there, or some will come."""
        return bool(self.journeys) or (bool(self._entries) and self._spawn_per_s > 0.0)

    @property
    def road(self) -> Any:
        """highway-env's road."""
        return self._road

    def _take_over(self, environment: AbstractEnv) -> None:
        """Gives the environment's egos a driver, everybody a name and a journey."""
        egos: list[Any] = environment.controlled_vehicles
        for number, vehicle in enumerate(list(self._road.vehicles)):
            if vehicle in egos:
                place = egos.index(vehicle)
                vehicle = self._driver(
                    self._road,
                    vehicle.position,
                    vehicle.heading,
                    vehicle.speed,
                    target_lane_index=getattr(vehicle, "target_lane_index", None),
                    target_speed=getattr(vehicle, "target_speed", None),
                    route=getattr(vehicle, "route", None),
                )
                self._road.vehicles[number] = vehicle
                self._add(vehicle, ego_name(place))
            else:
                self._add(vehicle)
            self._tune(vehicle)
            if self._desired_speed_mps is not None:
                vehicle.target_speed = self._draw_speed_mps(vehicle.lane)
                vehicle.speed = min(vehicle.speed, vehicle.target_speed)

    def _draw_speed_mps(self, lane: Any) -> float:
        """The speed that a driver wants: a mean, and a deviation of 1 m/s."""
        limit_mps = Vehicle.MAX_SPEED if lane.speed_limit is None else lane.speed_limit
        mean_mps = self._desired_speed_mps or 0.8 * limit_mps
        return float(np.clip(mean_mps + self._random.normal(), 1.0, limit_mps))

    def _tune(self, vehicle: Any) -> None:
        for key, value in self._parameters.items():
            setattr(vehicle, key, value)

    def _add(self, vehicle: Any, name: str | None = None) -> None:
        if name is None:
            self._named += 1
            name = f"v{self._named}"
        if not vehicle.route:
            self._choose_exit(vehicle)
        path = self._plan(vehicle.target_lane_index, vehicle.route)
        self.journeys[vehicle] = self._journey(name, (), path)

    def _choose_exit(self, vehicle: Any) -> None:
        """Plans a way to one of the ends of the road; where there is one only, none is needed."""
        exits = sorted({end[1] for end in ends(self.graph, vehicle.target_lane_index)})
        if len(exits) > 1:
            vehicle.plan_route_to(exits[int(self._random.integers(len(exits)))])

    def braking_hard(self) -> tuple[str, ...]:
        """Those whose driver brakes as hard as it can."""
        return tuple(
            journey.name
            for vehicle, journey in self.journeys.items()
            if not vehicle.crashed and vehicle.action["acceleration"] <= -vehicle.ACC_MAX
        )

    # -- in and out -----------------------------------------------------------------------------

    def enter(self) -> tuple[str, ...]:
        """Lets vehicles in for one tick, where there is room; the names of those that came."""
        if not self._entries or self._random.uniform() >= self._spawn_per_s * DT_S:
            return ()
        index = self._entries[int(self._random.integers(len(self._entries)))]
        lane = self._road.network.get_lane(index)
        speed_mps = self._draw_speed_mps(lane)
        vehicle = self._driver(
            self._road,
            lane.position(ENTRY_M, 0.0),
            lane.heading_at(ENTRY_M),
            speed_mps,
            target_lane_index=index,
        )
        self._tune(vehicle)
        room_m = vehicle.DISTANCE_WANTED + speed_mps * vehicle.TIME_WANTED
        away = [np.linalg.norm(v.position - vehicle.position) for v in self._road.vehicles]
        if min(away, default=np.inf) < room_m:
            return ()
        vehicle.randomize_behavior()
        self._road.vehicles.append(vehicle)
        self._add(vehicle)
        return (self.journeys[vehicle].name,)

    def leave(self) -> Leaving:
        """Takes those off the road that are at its end, crashed a while ago or stuck."""
        arrived: list[str] = []
        removed: list[str] = []
        for vehicle, journey in list(self.journeys.items()):
            journey.stood_s = journey.stood_s + DT_S if vehicle.speed < STANDING_MPS else 0.0
            journey.crashed_s += DT_S if vehicle.crashed else 0.0
            if self._is_at_end(vehicle, journey):
                arrived.append(journey.name)
            elif journey.crashed_s > CRASH_S or journey.stood_s > STUCK_S:
                removed.append(journey.name)
            else:
                continue
            del self.journeys[vehicle]
            self._road.vehicles.remove(vehicle)
        return Leaving(tuple(arrived), tuple(removed))

    def _is_at_end(self, vehicle: Any, journey: Journey) -> bool:
        for index in (journey.lane, vehicle.target_lane_index):
            if not self.graph.successors[index]:
                lane = self._road.network.get_lane(index)
                if lane.local_coordinates(vehicle.position)[0] > lane.length - EXIT_M:
                    return True
        return False

    # -- journeys -------------------------------------------------------------------------------

    def follow(self) -> None:
        """Carries every journey on to the lane that its vehicle follows now."""
        for vehicle, journey in self.journeys.items():
            target: LaneIndex = vehicle.target_lane_index
            ahead = journey.path[journey.position :]
            if target in ahead:
                journey.position += ahead.index(target)
                if not self._is_short(journey):
                    continue
                driven = journey.path[: journey.position]
                path = self._plan(target, vehicle.route)
            elif not self._is_nearer(vehicle, target, ahead):
                continue  # a change of lanes that has not come half way
            else:
                driven = self._driven_beside(journey, target)
                path = self._plan(target, vehicle.route)
            fresh = self._journey(journey.name, driven, path)
            journey.path, journey.position, journey.route = fresh.path, fresh.position, fresh.route

    def _is_short(self, journey: Journey) -> bool:
        if not self.graph.successors[journey.path[-1]]:
            return False
        left_m = sum(self._length_m(index) for index in journey.path[journey.position + 1 :])
        return left_m < RENEW_M and journey.position > 0

    def _is_nearer(self, vehicle: Any, target: LaneIndex, planned: tuple[LaneIndex, ...]) -> bool:
        """Nearer to the target than to the lane planned beside it; there may be none."""
        get_lane = self._road.network.get_lane
        beside = [index for index in planned if index[:2] == target[:2]]
        aside_m = [
            abs(get_lane(index).local_coordinates(vehicle.position)[1])
            for index in (target, *beside)
        ]
        return not beside or bool(aside_m[0] < aside_m[1])

    def _driven_beside(self, journey: Journey, target: LaneIndex) -> tuple[LaneIndex, ...]:
        """The lanes driven before the one that is followed now, if they lead to the other too."""
        driven = journey.path[: journey.position]
        leads = bool(driven) and target in self.graph.successors[driven[-1]]
        return driven if leads else ()

    def _journey(
        self, name: str, driven: tuple[LaneIndex, ...], path: tuple[LaneIndex, ...]
    ) -> Journey:
        behind = self._behind(driven, path)
        whole = behind + path
        return Journey(name, whole, len(behind), self.graph.route(whole))

    def _behind(
        self, driven: tuple[LaneIndex, ...], path: tuple[LaneIndex, ...]
    ) -> tuple[LaneIndex, ...]:
        """Lanes that lead to a path: those driven, and before them the first that do."""
        chain: list[LaneIndex] = []
        length_m = 0.0
        waiting = [index for index in driven if index not in path]
        while length_m < BEHIND_M:
            first = chain[0] if chain else path[0]
            before = [
                index
                for index in self.graph.predecessors[first]
                if index not in chain and index not in path
            ]
            if not before:
                break
            index = waiting.pop() if waiting and waiting[-1] in before else before[0]
            chain.insert(0, index)
            length_m += self._length_m(index)
        return tuple(chain)

    def _plan(self, lane: LaneIndex, route: Sequence[Any] | None) -> tuple[LaneIndex, ...]:
        """The lanes that highway-env's driver will follow from a lane on, no lane twice."""
        roads = {step[0]: (step[0], step[1]) for step in route or ()}
        path, length_m = [lane], 0.0
        while length_m < AHEAD_M:
            following = [
                index
                for index in self.graph.successors[path[-1]]
                if index[:2] == roads.get(path[-1][1], index[:2]) and index not in path
            ]
            if not following:
                break
            path.append(min(following, key=lambda index: self._gap_m(path[-1], index)))
            length_m += self._length_m(path[-1])
        return tuple(path)

    def _gap_m(self, lane: LaneIndex, other: LaneIndex) -> float:
        get_lane = self._road.network.get_lane
        end = get_lane(lane).position(get_lane(lane).length, 0.0)
        return float(get_lane(other).distance(end))

    def _length_m(self, lane: LaneIndex) -> float:
        return self.graph.length_m[lane_id(lane)]


def drive(traffic: Traffic, commands: Mapping[str, Command], step_s: float) -> None:
    """One step of highway-env's own drivers and physics.

    Those with a command, by name, take its acceleration, and keep their own steering where it has
    none. Nobody drives backwards: its IDM does, to open a gap when it stands too close.
    """
    road = traffic.road
    road.act()
    for vehicle, journey in traffic.journeys.items():
        if vehicle.crashed:
            continue
        if journey.lane in traffic.graph.merging:
            _change_over(road, vehicle, is_waiting=journey.stood_s > WAIT_S)
        command = commands.get(journey.name)
        wanted = vehicle.action["acceleration"] if command is None else command.acceleration_mps2
        if command is not None and command.steering_rad is not None:
            vehicle.action["steering"] = -command.steering_rad  # its y grows downward
        vehicle.action["acceleration"] = max(wanted, -max(vehicle.speed, 0.0) / step_s)
    road.step(step_s)


def _change_over(road: Any, vehicle: Any, is_waiting: bool) -> None:
    """Lets a driver out of a lane that ends, who would stand before its end for ever.

    highway-env's drivers begin no change of lanes from a standstill, and in a change they mind the
    end of the lane that they leave. MOBIL still says whether there is room.
    """
    if is_waiting and vehicle.target_lane_index == vehicle.lane_index:
        for beside in road.network.side_lanes(vehicle.lane_index):
            if vehicle.mobil(beside):
                vehicle.target_lane_index = beside
    if vehicle.target_lane_index != vehicle.lane_index:
        ahead = [
            road.neighbour_vehicles(vehicle, index)[0]
            for index in (vehicle.lane_index, vehicle.target_lane_index)
        ]
        wanted = min(
            vehicle.acceleration(vehicle, None if isinstance(front, Obstacle) else front)
            for front in ahead
        )
        vehicle.action["acceleration"] = np.clip(wanted, -vehicle.ACC_MAX, vehicle.ACC_MAX)
