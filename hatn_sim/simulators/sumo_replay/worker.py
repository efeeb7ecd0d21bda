"""The process of a replay inside SUMO: `python -m hatn_sim.simulators.sumo_replay.worker`.

It is served as `sumo_worker.py` is. Every message after the options is a `ReplayStep`, and the
answer a `ReplayFrame`.

What was measured of SUMO 1.28, on recordings of its own traffic: `moveToXY` with keepRoute=2 puts
a vehicle exactly where it is wanted at the end of the step. With the edges that it will drive as
its route SUMO finds its lane for at least 99.8 % of the frames (95 % without). The speed that SUMO
makes of the displacement is off by up to 3 m/s at the 99th percentile, where lanes meet, and by
all of it in a vehicle's first step; `setPreviousSpeed` after the step sets it right before any
driver looks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import libsumo
import numpy as np

from hatn_sim.datatypes import Route
from hatn_sim.simulators.sumo_lanes import LaneTable, is_connection
from hatn_sim.simulators.sumo_messages import Newcomer, RawFrame, ReplayFrame, ReplayStep
from hatn_sim.simulators.sumo_serving import serve
from hatn_sim.simulators.sumo_worker import Simulation

MOVE_ANYWHERE: Final = 2
"""keepRoute: exactly there, whatever edge and whether or not there is one."""
ON_LANE_M: Final = 10.0
BESIDE_THE_ROAD_M: Final = 0.01
"""How far `moveToXY` looks for a lane."""


class ReplaySimulation:
    """A simulation in which recorded vehicles are moved and others drive."""

    def __init__(self, options: Sequence[str]) -> None:
        self._simulation = Simulation(options)
        self._routes: dict[Route, str] = {}
        self._beginnings: dict[str, tuple[str, str]] = {}

    @property
    def lane_table(self) -> LaneTable:
        return self._simulation.lane_table

    @property
    def cannot_branch(self) -> str:
        return "recorded vehicles are moved from outside"

    def close(self) -> None:
        self._simulation.close()

    def observe(self) -> RawFrame:
        """Nobody is on the road yet."""
        return self._simulation.observe(())

    def answer(self, message: ReplayStep) -> ReplayFrame:
        """Lets 0.1 s pass as the message says."""
        vehicle = libsumo.vehicle
        present = set(vehicle.getIDList())
        for name in message.leavers:
            if name in present:
                vehicle.remove(name)
        for newcomer in message.newcomers:
            self._add(newcomer)
        refused = tuple(name for name, edges in message.released if not _release(name, edges))
        for name, pose, on_lane in zip(
            message.placed, message.poses.tolist(), message.on_lane.tolist(), strict=True
        ):
            x_m, y_m, angle_deg, _ = pose
            reach_m = ON_LANE_M if on_lane else BESIDE_THE_ROAD_M
            vehicle.moveToXY(name, "", -1, x_m, y_m, angle_deg, MOVE_ANYWHERE, reach_m)
        self._simulation.step(message.commands)
        present = set(vehicle.getIDList())
        rows = np.full((len(message.placed), 3), np.nan)
        lanes: list[str] = []
        for row, (name, speed_mps) in enumerate(
            zip(message.placed, message.poses[:, 3].tolist(), strict=True)
        ):
            if name not in present:
                lanes.append("")
                continue
            rows[row] = (*vehicle.getPosition(name), vehicle.getSpeed(name))
            lanes.append(vehicle.getLaneID(name))
            vehicle.setPreviousSpeed(name, speed_mps)
        driven = self._simulation.observe([name for name in message.driven if name in present])
        lost = tuple(name for name in message.placed if name not in present)
        return ReplayFrame(driven, rows, tuple(lanes), lost, refused)

    def _add(self, newcomer: Newcomer) -> None:
        vehicle = libsumo.vehicle
        try:
            vehicle.add(newcomer.id, self._route_of(newcomer.edges), newcomer.type, depart="now")
        except libsumo.TraCIException:  # a way that is not known, or forbidden to its class
            type_id, edge = self._beginning(newcomer.type)
            vehicle.add(newcomer.id, self._route_of((edge,)), type_id)
        vehicle.setLength(newcomer.id, newcomer.length_m)
        vehicle.setWidth(newcomer.id, newcomer.width_m)

    def _beginning(self, type_id: str) -> tuple[str, str]:
        """A type and an edge for a vehicle whose way is not known, its own type if that may drive.

        SUMO lets nobody begin where its class may not be; nobody is seen there, all are moved.
        """
        if type_id not in self._beginnings:
            of_ours = (name for name in libsumo.vehicletype.getIDList() if "DEFAULT" not in name)
            self._beginnings[type_id] = next(
                (name, edge)
                for name in (type_id, *of_ours)
                if (edge := _edge_for(libsumo.vehicletype.getVehicleClass(name))) is not None
            )
        return self._beginnings[type_id]

    def _route_of(self, edges: Route) -> str:
        if edges not in self._routes:
            name = f"route{len(self._routes)}"
            libsumo.route.add(name, edges)
            self._routes[edges] = name
        return self._routes[edges]


def _edge_for(vehicle_class: str) -> str | None:
    """The first edge that vehicles of a class may drive on."""
    for lane in libsumo.lane.getIDList():
        edge: str = libsumo.lane.getEdgeID(lane)
        allowed = libsumo.lane.getAllowed(lane)
        # SUMO says nothing both where all are allowed and where nobody is.
        all_may = not allowed and not libsumo.lane.getDisallowed(lane)
        if not is_connection(edge) and (all_may or vehicle_class in allowed):
            return edge
    return None


def _release(name: str, edges: Route) -> bool:
    """Gives a vehicle with the rest of its way to SUMO's driver; False where it has no way.

    Where SUMO takes the vehicle to be on another edge than it was matched to, it first drives the
    shortest way to the next edge of its way that can be reached.
    """
    vehicle = libsumo.vehicle
    edge = vehicle.getRoute(name)[vehicle.getRouteIndex(name)]
    ways = [edges[edges.index(edge) :]] if edge in edges else []
    for place, goal in enumerate(edges):
        if ways:
            break
        found = libsumo.simulation.findRoute(edge, goal, vehicle.getTypeID(name)).edges
        if found:
            ways.append((*found, *edges[place + 1 :]))
    try:
        for way in ways:
            vehicle.setRoute(name, way)
    except libsumo.TraCIException:
        return False
    return bool(ways)


def main() -> None:
    """The life of a worker."""
    serve(ReplaySimulation, libsumo)


if __name__ == "__main__":
    main()
