"""Road geometries that highway-env does not have, for its own drivers and its own rules.

`RegulatedJunction` has any number of arms at any angles, with the priorities of highway-env's
intersection; `RegularRing` is its two-lane roundabout with other arms and another radius. Both are
made from settings, and nobody but the ego is there at the beginning. Bearings are in highway-env's
frame, whose y axis points down, so 90 degrees is south; traffic keeps to the right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import gymnasium
import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.intersection_env import ConnectedLaneIntersectionEnv
from highway_env.envs.roundabout_env import ConnectedLaneRoundaboutEnv
from highway_env.road.lane import AbstractLane, CircularLane, SineLane, StraightLane
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import Road, RoadNetwork
from highway_env.utils import class_from_path

from hatn_sim.datatypes import FloatArray
from hatn_sim.geometry import wrap_angle

WIDTH_M: Final = AbstractLane.DEFAULT_WIDTH
STRAIGHT_RAD: Final = 0.02
"""Ways through a junction that turn less are straight lanes."""
LEFT_RAD: Final = np.deg2rad(30.0)
"""Ways that turn farther to the left yield as left turns do."""
ENTRY_HALF_RAD: Final = np.deg2rad(24.0)
"""Of the ring, from the middle of an arm to where its entry and its exit meet the ring."""
APART_DEG: Final = (48.0, 220.0)
"""Arms of a ring: an entry would come before the exit; and highway-env finds places on an arc only
within half a turn from where it begins."""
OUTER_M: Final = 24.0
BEND_M: Final = 85.0
BEND_PART: Final = 0.2
BEND_ASIDE_M: Final = 5.0
"""highway-env's own roundabout: the radius of its outer lane; and the sine that its arms follow,
its length, the part of it that is driven, and its amplitude."""
DRIVERS: Final = {"DISTANCE_WANTED": 7, "COMFORT_ACC_MAX": 6, "COMFORT_ACC_MIN": -3}
"""What highway-env's intersection makes of all drivers."""
EGO_FROM_END_M: Final = 40.0


@dataclass(frozen=True)
class Arm:
    """A road with one lane each way: `priority` is highest of those who need not yield."""

    bearing_deg: float  # from the middle outwards
    length_m: float
    speed_limit_mps: float
    priority: int = 0


class RegulatedJunction(ConnectedLaneIntersectionEnv):
    """A junction without signals of `arms`, whose drivers yield as highway-env's regulation says.

    `ways` are pairs of arms, by their places in `arms`, from and to; none: from every arm to every
    other. `inner_m` is from the middle to where the arms end. Nodes have the names that
    highway-env's intersection gives them: outer "o0", inner of those who come in "ir0", inner of
    those who leave "il0".
    """

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        config = super().default_config()
        for key in ("destination", "initial_vehicle_count", "controlled_vehicles"):
            del config[key]
        arms = [
            {"bearing_deg": bearing, "length_m": 100.0, "speed_limit_mps": 10.0, "priority": 1}
            for bearing in (90.0, 180.0, 0.0)
        ]
        return config | {"arms": arms, "ways": [], "inner_m": 11.0}

    def _reset(self) -> None:
        self._make_road()
        drivers = class_from_path(self.config["other_vehicles_type"])
        for key, value in DRIVERS.items():
            setattr(drivers, key, value)
        _put_ego(self)

    def _make_road(self) -> None:
        arms = [Arm(**settings) for settings in self.config["arms"]]
        if len(arms) < 2:
            raise ValueError("arms: expected two or more")
        for k, arm in enumerate(arms):
            _check_positive(vars(arm), ("length_m", "speed_limit_mps"), f"arms: {k}: ")
            if not np.isfinite(arm.bearing_deg):
                raise ValueError(f"arms: {k}: bearing_deg: expected a number of degrees")
        _check_positive(self.config, ("inner_m",))
        inner_m = float(self.config["inner_m"])
        ways = self.config["ways"] or [
            (a, b) for a in range(len(arms)) for b in range(len(arms)) if a != b
        ]
        if any(a == b or not {a, b} <= set(range(len(arms))) for a, b in ways):
            raise ValueError("ways: expected pairs of different arms, numbers from 0")
        network = RoadNetwork()
        for a in sorted({a for a, _ in ways}):
            lane = _straight(*_ends(arms[a], inner_m, is_inbound=True), arms[a])
            network.add_lane(f"o{a}", f"ir{a}", lane)
        for a, b in ways:
            network.add_lane(f"ir{a}", f"il{b}", _through(arms[a], arms[b], inner_m))
        highest = max(arm.priority for arm in arms)
        for b in sorted({b for _, b in ways}):
            begin, end = _ends(arms[b], inner_m, is_inbound=False)
            # Who is through is not stopped again by those who wait.
            network.add_lane(f"il{b}", f"o{b}", _straight(begin, end, arms[b], highest))
        self.road = RegulatedRoad(network=network, **_road_settings(self))


class RegularRing(ConnectedLaneRoundaboutEnv):
    """highway-env's roundabout with other arms: two lanes round, one in and one out at each arm.

    Its drivers yield to nobody when they enter, as in highway-env's own. `radius_m` is of the inner
    lane; `ring_limit_mps` and `arm_limit_mps` are speed limits.
    """

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        config = super().default_config()
        del config["incoming_vehicle_destination"]
        return config | {
            "bearings_deg": [90.0, 210.0, 330.0],
            "radius_m": 20.0,
            "access_m": 100.0,
            "ring_limit_mps": 20.0,
            "arm_limit_mps": 20.0,
        }

    def _reset(self) -> None:
        self._make_road()
        _put_ego(self)

    def _make_road(self) -> None:
        config = self.config
        _check_positive(config, ("radius_m", "access_m", "ring_limit_mps", "arm_limit_mps"))
        # Traffic goes round against the bearings: an arm's exit comes before its entry.
        bearings = np.sort(np.deg2rad(np.asarray(config["bearings_deg"], np.float64)))[::-1]
        following = np.append(bearings[1:], bearings[:1] - 2.0 * np.pi)
        apart_deg = np.rad2deg(bearings - following)
        least_deg, most_deg = APART_DEG
        if len(bearings) < 2 or not ((apart_deg > least_deg) & (apart_deg < most_deg)).all():
            raise ValueError(
                f"bearings_deg: expected two or more, each more than {least_deg:g} and less than "
                f"{most_deg:g} degrees from the next"
            )
        network = RoadNetwork()
        radii_m = (config["radius_m"], config["radius_m"] + WIDTH_M)

        def ring_lane(radius_m: float, begin_rad: float, end_rad: float) -> CircularLane:
            limit_mps = config["ring_limit_mps"]
            return CircularLane(
                (0.0, 0.0), radius_m, begin_rad, end_rad, clockwise=False, speed_limit=limit_mps
            )

        for k, bearing in enumerate(bearings):
            self._add_arm(network, k, bearing, radii_m[-1])
        for k, (bearing, further) in enumerate(zip(bearings, following, strict=True)):
            exits, enters = bearing + ENTRY_HALF_RAD, bearing - ENTRY_HALF_RAD
            on = f"{(k + 1) % len(bearings)}x", further + ENTRY_HALF_RAD
            for radius_m in radii_m:
                network.add_lane(f"{k}x", f"{k}e", ring_lane(radius_m, exits, enters))
                network.add_lane(f"{k}e", on[0], ring_lane(radius_m, enters, on[1]))
        self.road = Road(network=network, **_road_settings(self))

    def _add_arm(self, network: RoadNetwork, k: int, bearing_rad: float, radius_m: float) -> None:
        """One arm of highway-env's roundabout, turned from the south and scaled with the ring."""
        scale = radius_m / OUTER_M
        far_m = 0.5 * BEND_M * scale
        ring_m = far_m - BEND_PART * BEND_M * scale
        aside_m = WIDTH_M / 2
        half_m = BEND_ASIDE_M * scale
        pulsation = 2.0 * np.pi / (BEND_M * scale)
        bent_rad = 2.0 * np.pi * BEND_PART
        turn = _rotation(bearing_rad - np.pi / 2)
        limit: dict[str, Any] = {"speed_limit": self.config["arm_limit_mps"]}

        def at(x_m: float, y_m: float) -> FloatArray:
            return turn @ np.array([x_m, y_m])

        def bend(side: float, begin_m: float, end_m: float, phase_rad: float) -> SineLane:
            x_m = side * (aside_m + half_m)
            return SineLane(at(x_m, begin_m), at(x_m, end_m), half_m, pulsation, phase_rad, **limit)

        begin_m = far_m + self.config["access_m"]
        inwards = StraightLane(at(aside_m, begin_m), at(aside_m, far_m), **limit)
        outwards = StraightLane(at(-aside_m, far_m), at(-aside_m, begin_m), **limit)
        network.add_lane(f"{k}er", f"{k}es", inwards)
        network.add_lane(f"{k}es", f"{k}e", bend(1.0, far_m, ring_m, -np.pi / 2))
        network.add_lane(f"{k}x", f"{k}xs", bend(-1.0, ring_m, far_m, -np.pi / 2 - bent_rad))
        network.add_lane(f"{k}xs", f"{k}xr", outwards)


def _check_positive(settings: Mapping[str, Any], names: Sequence[str], where: str = "") -> None:
    """Raises ValueError for the first of these settings that is not above 0, or not finite."""
    for name in names:
        if not 0.0 < settings[name] < np.inf:
            raise ValueError(f"{where}{name}: expected a positive number")


def _ends(arm: Arm, inner_m: float, is_inbound: bool) -> tuple[FloatArray, FloatArray]:
    """Where the lane towards the middle, or away from it, begins and ends."""
    turn = _rotation(np.deg2rad(arm.bearing_deg))
    side = -0.5 if is_inbound else 0.5  # y points down: on the right of who drives away
    outer, inner = (
        turn @ np.array([from_m, side * WIDTH_M]) for from_m in (inner_m + arm.length_m, inner_m)
    )
    return (outer, inner) if is_inbound else (inner, outer)


def _straight(
    begin: FloatArray, end: FloatArray, arm: Arm, priority: int | None = None
) -> StraightLane:
    return StraightLane(
        begin,
        end,
        speed_limit=arm.speed_limit_mps,
        priority=arm.priority if priority is None else priority,
    )


def _through(arm: Arm, other: Arm, inner_m: float) -> AbstractLane:
    """The way from one arm to another: an arc, since both ends are as far from the middle."""
    _, begin = _ends(arm, inner_m, is_inbound=True)
    end, _ = _ends(other, inner_m, is_inbound=False)
    heading = np.deg2rad(arm.bearing_deg) + np.pi
    turned = float(wrap_angle(np.asarray(np.deg2rad(other.bearing_deg) - heading)))
    rules: dict[str, Any] = {
        "speed_limit": min(arm.speed_limit_mps, other.speed_limit_mps),
        "priority": arm.priority - 1 if turned < -LEFT_RAD else arm.priority,
    }
    if abs(turned) < STRAIGHT_RAD:
        return StraightLane(begin, end, **rules)
    radius_m = float(np.linalg.norm(end - begin)) / (2.0 * np.sin(abs(turned) / 2.0))
    phase = heading - np.sign(turned) * np.pi / 2
    middle = begin - radius_m * np.array([np.cos(phase), np.sin(phase)])
    return CircularLane(middle, radius_m, phase, phase + turned, clockwise=turned > 0.0, **rules)


def _rotation(angle_rad: float) -> FloatArray:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[cos, -sin], [sin, cos]])


def _road_settings(environment: AbstractEnv) -> dict[str, Any]:
    return {
        "np_random": environment.np_random,
        "record_history": environment.config["show_trajectories"],
        "neighbour_vehicles_connected_lanes": environment.config[
            "neighbour_vehicles_connected_lanes"
        ],
    }


def _put_ego(environment: AbstractEnv) -> None:
    """The only vehicle at the beginning, on its way in."""
    network: Any = environment.road.network  # type: ignore[union-attr]
    lane: Any = next(iter(network.lanes_dict().values()))
    place_m = max(lane.length - EGO_FROM_END_M, 0.0)
    ego: Any = environment.action_type.vehicle_class(
        environment.road,
        lane.position(place_m, 0.0),
        heading=lane.heading_at(place_m),
        speed=0.8 * lane.speed_limit,
    )
    environment.road.vehicles.append(ego)  # type: ignore[union-attr]
    environment.controlled_vehicles = [ego]


PLACES: Final = {"regulated-junction-v0": RegulatedJunction, "regular-ring-v0": RegularRing}
"""By the ids that they are registered with."""


def register() -> None:
    """Make the environments known to gymnasium, once."""
    for name, made in PLACES.items():
        if name not in gymnasium.registry:
            gymnasium.register(name, entry_point=f"{made.__module__}:{made.__name__}")
