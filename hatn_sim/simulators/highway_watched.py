"""An environment of highway-env that somebody else drives, watched: its frames at our tick.

Its drivers, physics, rewards and random numbers stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.parking_env import ParkingEnv

from hatn_sim.datatypes import DT_S, FloatArray, Frame, Truth
from hatn_sim.errors import InputError
from hatn_sim.road import Road
from hatn_sim.simulators.highway_lanes import lane_graph
from hatn_sim.simulators.highway_scene import EGO, ego_name, rows_of, scene_at

ROUNDING: Final = 1e-6
PLACES: Final = 5
"""Each lane is looked at in so many places to tell a new road from the one before."""


class Moment(NamedTuple):
    """Who was where, in highway-env's frame."""

    vehicles: tuple[Any, ...]  # [N]
    rows: FloatArray  # [N, 6] as of `rows_of`


class Watched:
    """What goes on in an environment of highway-env, at 0.1 s a frame.

    Where its own steps fall between ours, positions are between its own, linearly. Vehicles are
    named as `HighwaySimulator` names them: its first controlled vehicle is "ego". Nothing is known
    to `Truth`.
    """

    def __init__(self, environment: object) -> None:
        """Raises InputError where this is no environment of highway-env with roads."""
        if not isinstance(environment, AbstractEnv):
            raise InputError(
                f"expected an environment of highway-env, such as 'intersection-v2', found "
                f"{type(environment).__name__}; hatn_sim/Scene-v0 is for others"
            )
        if isinstance(environment, ParkingEnv):
            raise InputError(
                f"{type(environment).__name__} has no roads to drive along, expected an "
                "environment of highway-env with traffic, such as 'intersection-v2'"
            )
        _check_rates(environment.config)
        self._environment: Any = environment
        self._watching: Any = None
        self._geometry: bytes = b""
        self._road: Road | None = None
        self._names: dict[Any, str] = {}
        self._newest = Moment((), np.zeros((0, 6)))
        self._tick = 0

    @property
    def road(self) -> Road:
        """The road of the episode; the same object while the environment builds the same one."""
        if self._road is None:
            raise InputError("there is no road before reset; call it first")
        return self._road

    @property
    def time_left(self) -> float:
        """Share of the environment's time limit; 1 where it has none."""
        limit_s = self._environment.config.get("duration")
        return 1.0 - self._environment.time / limit_s if limit_s else 1.0

    @property
    def is_begun_anew(self) -> bool:
        """Whether the environment was reset since `begin`, as by a wrapper at the end."""
        return self._environment.road is not self._watching

    def begin(self) -> Frame:
        """The first frame after a `reset` of the environment.

        Raises InputError where the steps of the environment do not end at ours.
        """
        _check_rates(self._environment.config)
        road = self._watching = self._environment.road
        _watch(road)
        geometry = _geometry(road.network)
        if self._road is None or geometry != self._geometry:
            graph = lane_graph(road.network, has_priorities=hasattr(road, "enforce_road_rules"))
            self._road, self._geometry = Road(graph.lanes), geometry
        self._names = {}
        self._tick = 0
        self._newest = _moment(road.vehicles)
        return self._frame(self._newest)

    def frames(self) -> list[Frame]:
        """The frames since the newest one, after a `step` of the environment; the last is now."""
        road = self._environment.road
        moments = [self._newest, *road.seen]
        own_s: float = road.own_s
        road.seen = []
        count = round((len(moments) - 1) * own_s / DT_S)
        # Who came in or left between two steps of the environment did so after its last own one.
        self._newest = _moment(road.vehicles)
        between = [_at(moments, (k + 1) * DT_S / own_s) for k in range(count - 1)]
        frames: list[Frame] = []
        for moment in (*between, self._newest):
            self._tick += 1
            frames.append(self._frame(moment))
        return frames

    def _frame(self, moment: Moment) -> Frame:
        names = [self._name(vehicle) for vehicle in moment.vehicles]
        scene = scene_at(self._tick * DT_S, names, moment.rows)
        return Frame(scene, Truth((None,) * len(names)), done=False)

    def _name(self, vehicle: Any) -> str:
        if vehicle not in self._names:
            controlled: list[Any] = self._environment.controlled_vehicles
            others = sum(not name.startswith(EGO) for name in self._names.values())
            self._names[vehicle] = (
                ego_name(controlled.index(vehicle)) if vehicle in controlled else f"v{others + 1}"
            )
        return self._names[vehicle]


def _check_rates(config: dict[str, Any]) -> None:
    own_hz, policy_hz = config["simulation_frequency"], config["policy_frequency"]
    step_s = int(own_hz // policy_hz) / own_hz
    ticks = round(step_s / DT_S)
    if ticks < 1 or abs(step_s - ticks * DT_S) > ROUNDING:
        raise InputError(
            f"policy_frequency: {policy_hz} Hz at a simulation_frequency of {own_hz} Hz makes "
            f"steps of {step_s:.4g} s, expected a multiple of {DT_S:g} s; simulation_frequency=20 "
            "goes with a policy_frequency of 1, 2, 5 or 10"
        )


def _watch(road: Any) -> None:
    """From now on, the road keeps what it was like after each of its own steps.

    highway-env can record trajectories itself, but then it draws them into the user's pictures,
    and steps take up to three times as long.
    """
    if not isinstance(road, _Noting):
        road.__class__ = _watched(type(road))
    road.seen, road.own_s = [], DT_S


class _Noting:
    """What a road remembers of its moments until they are taken."""

    kind: Any  # of road that it is besides
    vehicles: Sequence[Any]
    seen: list[Moment]
    own_s: float

    def step(self, dt: float) -> None:
        self.kind.step(self, dt)
        self.own_s = dt
        self.seen.append(_moment(self.vehicles))

    def __reduce__(self) -> tuple[Any, ...]:
        return _empty, (self.kind,), self.__dict__


@cache
def _watched(kind: Any) -> Any:
    return type(f"Watched{kind.__name__}", (_Noting, kind), {"kind": kind})


def _empty(kind: Any) -> Any:
    """To be filled by whoever copies or unpickles a road."""
    return object.__new__(_watched(kind))


def _moment(vehicles: Sequence[Any]) -> Moment:
    return Moment(tuple(vehicles), rows_of(vehicles))


def _at(moments: Sequence[Moment], place: float) -> Moment:
    """What it was like between two moments; those are there who are in both."""
    first = int(place + ROUNDING)
    part = place - first
    if part < ROUNDING:
        return moments[first]
    before, after = moments[first], moments[first + 1]
    row = {vehicle: k for k, vehicle in enumerate(before.vehicles)}
    both = [(row[vehicle], k) for k, vehicle in enumerate(after.vehicles) if vehicle in row]
    old, new = np.array(both, np.int64).reshape(-1, 2).T
    rows = (1.0 - part) * before.rows[old] + part * after.rows[new]
    return Moment(tuple(after.vehicles[k] for k in new.tolist()), rows)


def _geometry(network: Any) -> bytes:
    """What tells a network of lanes from another one."""
    words: list[object] = []
    for index, lane in network.lanes_dict().items():
        places = [lane.position(s_m, 0.0) for s_m in np.linspace(0.0, lane.length, PLACES)]
        words.append((index, np.array(places).tolist(), lane.speed_limit, lane.priority))
        words.append(lane.width_at(0.0))
    return repr(words).encode()
