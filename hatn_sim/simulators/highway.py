"""highway-env as a `Simulator`: its roads, drivers and physics as traffic that goes on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from hatn_sim.config import Scenario
from hatn_sim.datatypes import (
    DT_S,
    BranchFuture,
    Change,
    Command,
    Frame,
    Lane,
    Truth,
)
from hatn_sim.errors import InputError, SimulatorError
from hatn_sim.road import Road
from hatn_sim.simulators.highway_environment import SUBSTEPS, make_environment, own_drivers
from hatn_sim.simulators.highway_lanes import lane_graph
from hatn_sim.simulators.highway_scene import rows_of, scene_at
from hatn_sim.simulators.highway_traffic import Leaving, Traffic, drive
from hatn_sim.simulators.touching import touching_pairs

MAX_SEED: Final = 2**31 - 1
TOUCH_M: Final = 0.1
"""Its physics push colliding vehicles apart within the step."""


class HighwaySimulator:
    """An environment of highway-env at 0.1 s a frame (two steps of its own, at 20 Hz).

    Its own ego is the vehicle "ego" and is driven by highway-env's IDM and MOBIL like everybody
    else. Any vehicle with a `Command` takes that acceleration, whatever lies ahead, and keeps
    highway-env's own steering along its lanes, unless it is told how to steer; nobody drives
    backwards. Vehicles show no blinkers,
    since highway-env has none, and obstacles on its roads are not in the scene. The end of an
    episode is ignored: see `highway_traffic` for who comes in and who leaves.

    `Scene.yaw_rad` is the heading; in turns the centres move up to 0.26 rad aside of it, and
    `Scene.speed_mps` is the speed of that motion, as highway-env's own.

    The same seed gives the same frames bit for bit. A context manager; `close` may be called again.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Raises InputError where the environment is unknown, has no roads or refuses a setting."""
        if scenario.highway is None:
            raise InputError(f"{scenario.config_path}: expected a scene with [highway]; add it")
        self.scenario = scenario
        self._environment, self._settings, self.notices = make_environment(
            scenario.config_path, scenario.highway, scenario.scale or 1.0
        )
        network: Any = self._environment.road.network  # type: ignore[union-attr]
        self._graph = lane_graph(
            network, has_priorities=hasattr(self._environment.road, "enforce_road_rules")
        )
        self._road = Road(self._graph.lanes)
        self._traffic: Traffic | None = None
        self._tick = 0

    @property
    def name(self) -> str:
        return self.scenario.name

    @property
    def dt_s(self) -> float:
        return DT_S

    @property
    def lanes(self) -> list[Lane]:
        return list(self._graph.lanes)

    @property
    def road(self) -> Road:
        return self._road

    def reset(self, seed: int) -> Frame:
        """Starts anew with the vehicles that the environment begins with."""
        if not 0 <= seed <= MAX_SEED:
            raise InputError(f"seed: expected 0 to {MAX_SEED}, found {seed}")
        with own_drivers(self._settings) as parameters:
            self._environment.reset(seed=seed)
        self._traffic = Traffic(self._environment, self._graph, self._settings, parameters)
        self._tick = 0
        return self._frame(self._traffic, None)

    def step(self, commands: Sequence[Command] = ()) -> Frame:
        """Lets 0.1 s pass. Commands for vehicles not on the road are without effect."""
        traffic = self._traffic
        if traffic is None:
            raise SimulatorError("highway-env is not running: call reset(seed) first")
        wanted = {command.ego_id: command for command in commands}
        for _ in range(SUBSTEPS):
            drive(traffic, wanted, DT_S / SUBSTEPS)
        self._tick += 1
        traffic.follow()
        return self._frame(traffic, traffic.leave(), traffic.enter())

    @property
    def cannot_branch(self) -> str:
        """Why `branch` raises InputError."""
        return "highway-env is not branched; use a scene simulated by SUMO"

    def branch(self, futures: Sequence[Sequence[Change]], horizon_s: float) -> list[BranchFuture]:
        """Raises InputError: there are no branches here."""
        raise InputError(f"{self.name}: no branches: {self.cannot_branch}")

    def close(self) -> None:
        """Ends the traffic."""
        self._traffic = None
        self._environment.close()

    def __enter__(self) -> HighwaySimulator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _frame(
        self, traffic: Traffic, leaving: Leaving | None, departed: tuple[str, ...] = ()
    ) -> Frame:
        journeys = traffic.journeys
        ids = tuple(journey.name for journey in journeys.values())
        scene = scene_at(self._tick * DT_S, ids, rows_of(journeys))
        truth = Truth(
            routes=tuple(journey.route for journey in journeys.values()),
            collisions=touching_pairs(scene, TOUCH_M),
            emergency_braking=traffic.braking_hard(),
            departed=ids if leaving is None else departed,
            arrived=() if leaving is None else leaving.arrived,
            teleported=() if leaving is None else leaving.removed,
        )
        return Frame(scene=scene, truth=truth, done=not traffic.goes_on)
