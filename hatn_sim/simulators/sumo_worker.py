"""The process in which SUMO lives: `python -m hatn_sim.simulators.sumo_worker`.

It imports libsumo, NumPy and our types, nothing heavy. How it is asked, and what it says where SUMO
gives up, is `sumo_serving.py`. A message is a list of commands for one step, (vehicle, acceleration
in m/s²), answered with a `RawFrame`; `Advance` asks for several steps at once, for the pipe takes
longer than many a step. `AskFoes` and `AskLaneFoes` are answered with what SUMO knows now, and no
time passes; nor does it for `Spawn`, `AwaitBranch` and `StartBranches`, which forks children that
drive on by themselves.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from typing import Any, Final

import libsumo

from hatn_sim.datatypes import PEDESTRIAN_PREFIX, Kind
from hatn_sim.simulators.sumo_branch import Branches
from hatn_sim.simulators.sumo_foes import FoeReader
from hatn_sim.simulators.sumo_lane_table import read_lane_table
from hatn_sim.simulators.sumo_lanes import CLOSED_SIGNALS, KIND_OF_CLASS
from hatn_sim.simulators.sumo_messages import (
    Advance,
    Advanced,
    AskFoes,
    AskLaneFoes,
    AwaitBranch,
    BranchEnded,
    BranchesStarted,
    Drawn,
    JunctionFoes,
    LaneFoes,
    Picture,
    RawFrame,
    Spawn,
    Spawned,
    StartBranches,
)
from hatn_sim.simulators.sumo_reading import Read, Row, frames_of
from hatn_sim.simulators.sumo_routes import LaneGraph, RouteTracker
from hatn_sim.simulators.sumo_rows import (
    INVALID_M,
    OBEY_SPEED_MODE,
    OWN_SPEED_MODE,
    ROUNDING_MPS,
)
from hatn_sim.simulators.sumo_serving import serve
from hatn_sim.simulators.sumo_window import START, Canvas

SUMO_DEFAULT_COLOUR: Final = (255, 255, 0, 255)
"""Of a vehicle without a colour of its own; its type's counts then."""


class Simulation:
    """The one simulation of this process, from the start on."""

    def __init__(self, options: Sequence[str]) -> None:
        program = "sumo-gui" if START in options else "sumo"
        libsumo.start([program, *options])
        self._canvas = Canvas(libsumo) if START in options else None
        self.lane_table = read_lane_table(libsumo)
        self._tracker = RouteTracker(
            LaneGraph(self.lane_table), _edges_and_lanes, _gap_to_lane_end_m
        )
        self._routes_sent = 0
        self._lights: tuple[str, ...] = libsumo.trafficlight.getIDList()
        self._looks: dict[str, tuple[float, ...]] = {}
        self._commanded: set[str] = set()
        self._speeds_mps: dict[str, float] = {}
        self._sumo_s = 0.0
        self._foes = FoeReader(libsumo, self.lane_table)
        self._branches = Branches(libsumo, self._tracker, partial(_collisions, frozenset()))
        end_s = libsumo.simulation.getEndTime()
        self._end_s = end_s if end_s >= 0 else float("inf")

    def step(self, commands: Sequence[tuple[str, float]]) -> None:
        """Lets 0.1 s pass. Vehicles no longer commanded are given back to SUMO's driver."""
        if commands or self._commanded:
            self._command(commands)
        started = time.perf_counter()
        libsumo.simulationStep()
        self._sumo_s = time.perf_counter() - started
        if self._canvas is not None:
            self._canvas.keep_up()

    def _command(self, commands: Sequence[tuple[str, float]]) -> None:
        present = set(libsumo.vehicle.getIDList())
        dt_s = libsumo.simulation.getDeltaT()
        accelerations = {vehicle: value for vehicle, value in commands if vehicle in present}
        for vehicle in (self._commanded - accelerations.keys()) & present:
            libsumo.vehicle.setSpeed(vehicle, -1.0)
            libsumo.vehicle.setSpeedMode(vehicle, OWN_SPEED_MODE)
        for vehicle, acceleration_mps2 in accelerations.items():
            if vehicle not in self._commanded:
                libsumo.vehicle.setSpeedMode(vehicle, OBEY_SPEED_MODE)
            speed_mps = libsumo.vehicle.getSpeed(vehicle) + acceleration_mps2 * dt_s
            libsumo.vehicle.setSpeed(vehicle, max(speed_mps, 0.0))
        self._commanded = set(accelerations)

    def answer(
        self, message: object
    ) -> (
        RawFrame
        | Advanced
        | JunctionFoes
        | LaneFoes
        | BranchesStarted
        | BranchEnded
        | Spawned
        | Drawn
    ):
        """What is asked without time passing; else the frame after a step of commands."""
        self._branches.reap()
        match message:
            case StartBranches(futures, steps):
                return self._branches.start(futures, self._commanded, steps)
            case AwaitBranch(number):
                return self._branches.outcome(number)
            case Spawn(name, like):
                return self.spawn(name, like)
            case Advance(commands, kept):
                return self.advance(commands, kept)
            case Picture() if self._canvas is not None:
                return self._canvas.draw(message)
            case AskFoes(reach_m):
                return self.junction_foes(reach_m)
            case AskLaneFoes():
                return self.lane_foes()
            case _:
                self.step(message)  # type: ignore[arg-type]  # a list of commands
                return self.observe()

    def advance(self, commands: Sequence[Sequence[tuple[str, float]]], kept: int) -> Advanced:
        """A step for each list of commands, while there is somebody to drive."""
        read: list[Read] = []
        for left, wanted in zip(range(len(commands), 0, -1), commands, strict=True):
            self.step(wanted)
            is_last = self._done
            if is_last or left <= kept:
                read.append(self._read())
            else:
                self._glance(with_speeds=left == kept + 1 or self._ends_next)
            if is_last:
                break
        return Advanced(frames_of(read))

    def _glance(self, *, with_speeds: bool) -> None:
        """As `observe` for all that has an effect on frames to come, and on SUMO.

        Speeds are looked up by the next frame alone, if that is one to tell of.
        """
        vehicle, track = libsumo.vehicle, self._tracker.index
        get_position, get_lane, get_route = (
            vehicle.getPosition, vehicle.getLaneID, vehicle.getRouteID,
        )  # fmt: skip
        self._forget()
        names = [name for name in vehicle.getIDList() if get_position(name)[0] >= INVALID_M]
        for name in names:
            track(name, get_lane(name), get_route(name))
        if with_speeds:
            self._speeds_mps = {name: vehicle.getSpeed(name) for name in names}

    def _forget(self) -> tuple[str, ...]:
        """Drops those who have arrived; they are told."""
        arrived = tuple(libsumo.simulation.getArrivedIDList())
        for vehicle in arrived:
            self._tracker.forget(vehicle)
            self._looks.pop(vehicle, None)
        return arrived

    @property
    def _done(self) -> bool:
        simulation = libsumo.simulation
        return simulation.getMinExpectedNumber() == 0 or simulation.getTime() >= self._end_s

    @property
    def _ends_next(self) -> bool:
        simulation = libsumo.simulation
        return simulation.getTime() + 1.5 * simulation.getDeltaT() >= self._end_s

    def observe(self, names: Sequence[str] | None = None) -> RawFrame:
        """What is on the road now: everybody, or the vehicles named."""
        return frames_of([self._read(names)])[0]

    def _read(self, names: Sequence[str] | None = None) -> Read:
        simulation = libsumo.simulation
        arrived = self._forget()
        ids, rows, routes = self._vehicles(libsumo.vehicle.getIDList() if names is None else names)
        emergency_braking = self._emergency_braking(ids, rows)
        people = libsumo.person.getIDList()
        persons = frozenset(people).difference(ids)
        self._add_pedestrians(people, ids, rows, routes)
        new_routes = tuple(self._tracker.routes[self._routes_sent :])
        self._routes_sent += len(new_routes)
        return rows, partial(
            RawFrame,
            time_s=simulation.getTime(),
            ids=tuple(ids),
            routes=tuple(routes),
            new_routes=new_routes,
            closed=bytes(
                state in CLOSED_SIGNALS
                for light in self._lights
                for state in libsumo.trafficlight.getRedYellowGreenState(light)
            ),
            collisions=_collisions(persons),
            emergency_braking=emergency_braking,
            departed=tuple(simulation.getDepartedIDList()),
            arrived=arrived,
            teleported=tuple(simulation.getStartingTeleportIDList()),
            done=self._done,
            sumo_s=self._sumo_s,
        )

    def spawn(self, name: str, like: str) -> Spawned:
        """Queues a vehicle of the route and type of another, as it came in."""
        vehicle = libsumo.vehicle
        route, kind = vehicle.getRouteID(like), vehicle.getTypeID(like)
        vehicle.add(name, route, typeID=kind, departLane="best", departSpeed="max")
        return Spawned()

    def junction_foes(self, reach_m: float) -> JunctionFoes:
        """SUMO's list of conflicts within `reach_m` ahead of the vehicles of the newest frame."""
        vehicle = libsumo.vehicle
        seen = [name for name in vehicle.getIDList() if vehicle.getPosition(name)[0] >= INVALID_M]
        return self._foes.junction_foes(seen, reach_m)

    def lane_foes(self) -> LaneFoes:
        """What SUMO's junctions hold against each other."""
        return self._foes.lane_foes()

    @property
    def cannot_branch(self) -> str | None:
        """Why this simulation cannot be forked; None where it can."""
        if self._canvas is not None:
            return "SUMO's window runs threads, which a fork loses; leave out --gui"
        return self._branches.cannot

    def close(self) -> None:
        """Finishes the output files that a user's configuration asks for."""
        self._branches.end()
        libsumo.close()

    def _emergency_braking(self, ids: Sequence[str], rows: Sequence[Row]) -> tuple[str, ...]:
        """The vehicles that brake as hard as they can, which SUMO warns of but gives no list of.

        Its list of emergency stops is another thing: vehicles that a dead end surprises.
        """
        before_mps, dt_s = self._speeds_mps, libsumo.simulation.getDeltaT()
        self._speeds_mps = {name: row[3] for name, row in zip(ids, rows, strict=True)}
        lost_mps = {
            name: before_mps[name] - speed_mps
            for name, speed_mps in self._speeds_mps.items()
            if speed_mps < before_mps.get(name, 0.0)
        }
        return tuple(
            name
            for name, lost in lost_mps.items()
            if lost >= libsumo.vehicle.getEmergencyDecel(name) * dt_s - ROUNDING_MPS
        )

    def _vehicles(self, names: Sequence[str]) -> tuple[list[str], list[Row], list[int]]:
        vehicle = libsumo.vehicle
        get_position, get_angle, get_speed = (
            vehicle.getPosition, vehicle.getAngle, vehicle.getSpeed,
        )  # fmt: skip
        get_signals, get_lane, get_route = (
            vehicle.getSignals, vehicle.getLaneID, vehicle.getRouteID,
        )  # fmt: skip
        looks, route_index = self._looks, self._tracker.index
        ids: list[str] = []
        rows: list[Row] = []
        routes: list[int] = []
        for name in names:
            x_m, y_m = get_position(name)
            if x_m < INVALID_M:
                continue
            look = looks.get(name)
            if look is None:
                look = looks[name] = _look(vehicle, name)
            signals = get_signals(name)
            blinker = (signals >> 1 & 1) - (signals & 1)
            ids.append(name)
            rows.append((x_m, y_m, get_angle(name), get_speed(name), blinker, *look))
            routes.append(route_index(name, get_lane(name), get_route(name)))
        return ids, rows, routes

    @staticmethod
    def _add_pedestrians(
        people: Sequence[str], ids: list[str], rows: list[Row], routes: list[int]
    ) -> None:
        """Appends the persons on foot."""
        person = libsumo.person
        for name in people:
            x_m, y_m = person.getPosition(name)
            if x_m < INVALID_M or person.getVehicle(name):
                continue
            ids.append(PEDESTRIAN_PREFIX + name)
            look = _look(person, name)
            rows.append((x_m, y_m, person.getAngle(name), person.getSpeed(name), 0, *look))
            routes.append(-1)


def _look(domain: Any, name: str) -> tuple[float, ...]:
    """Length, width, kind, red, green, blue of a vehicle or person."""
    if domain is libsumo.person:
        kind = Kind.PEDESTRIAN
    else:
        kind = KIND_OF_CLASS.get(domain.getVehicleClass(name), Kind.OTHER)
    colour = domain.getColor(name)
    if colour == SUMO_DEFAULT_COLOUR:
        colour = libsumo.vehicletype.getColor(domain.getTypeID(name))
    red, green, blue = colour[:3]
    return (float(domain.getLength(name)), float(domain.getWidth(name)), kind, red, green, blue)


def _collisions(persons: frozenset[str]) -> tuple[tuple[str, str], ...]:
    pairs: set[tuple[str, str]] = set()
    for collision in libsumo.simulation.getCollisions():
        victim = collision.victim
        if victim in persons:
            victim = PEDESTRIAN_PREFIX + victim
        first, second = sorted((collision.collider, victim))
        pairs.add((first, second))
    return tuple(sorted(pairs))


def _edges_and_lanes(vehicle: str) -> tuple[Sequence[str], set[str]]:
    edges = libsumo.vehicle.getRoute(vehicle)[libsumo.vehicle.getRouteIndex(vehicle) + 1 :]
    return edges, {link[0] for link in libsumo.vehicle.getNextLinks(vehicle)}


def _gap_to_lane_end_m(vehicle: str) -> float:
    lane_id = libsumo.vehicle.getLaneID(vehicle)
    length_m: float = libsumo.lane.getLength(lane_id)
    position_m: float = libsumo.vehicle.getLanePosition(vehicle)
    return length_m - position_m


def main() -> None:
    """The life of a worker."""
    serve(Simulation, libsumo)


if __name__ == "__main__":
    main()
