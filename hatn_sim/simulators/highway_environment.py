"""An environment of highway-env by its id, with checked settings, run at our tick."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import gymnasium
import highway_env  # registers its environments
from gymnasium.envs.registration import load_env_creator
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.utils import class_from_path
from highway_env.vehicle import behavior

from hatn_sim.config import HighwaySource
from hatn_sim.errors import InputError, nearest
from hatn_sim.simulators.highway_places import PLACES, register

SUBSTEPS: Final = 2
FREQUENCY_HZ: Final = 20
"""highway-env's own 15 Hz is no multiple of our 10 Hz."""
DEFAULT_SPAWN_PROBABILITY: Final = 0.2
OURS: Final = {"spawn_probability": DEFAULT_SPAWN_PROBABILITY, "desired_speed_mps": None}
"""Settings that every environment takes here: the chance that a vehicle comes in within a second
(as in highway-env's own intersection), and the mean of the speeds that drivers want (None: those
of the environment, and 0.8 of the lane's limit for those who come in)."""
FIXED: Final = ("simulation_frequency", "policy_frequency", "manual_control")
WITHOUT_EFFECT: Final = (
    "duration",
    "offroad_terminal",
    "terminate_off_road",
    "real_time_rendering",
)
NO_TRAFFIC: Final = ("parking",)
"""Environments whose lanes are no roads."""
COUNTS: Final = ("vehicles_count", "initial_vehicle_count", "other_vehicles")
"""Settings that say how many vehicles there are at the beginning."""
DRAWN_IF_ZERO: Final = {"length": 150, "no_lanes": 4}
"""racetrack-large draws these anew at every reset, not from the seed, where they are 0."""

DRIVERS: Final = tuple(
    f"{behavior.__name__}.{name}"
    for name, found in vars(behavior).items()
    if isinstance(found, type) and issubclass(found, behavior.IDMVehicle)
)
RANGES: Final = {
    **dict.fromkeys(COUNTS, "a whole number from 0 on"),
    "controlled_vehicles": "a whole number from 1 on",
    "spawn_probability": "a number from 0 to 1",
    "desired_speed_mps": "a positive number",
}
"""What is expected of settings that are numbers, where any number will not do."""


def known_environments() -> tuple[str, ...]:
    """The ids of highway-env's environments with roads, and of ours."""
    register()
    return tuple(
        sorted(
            name
            for name, spec in gymnasium.registry.items()
            if name in PLACES
            or (
                str(spec.entry_point).startswith(f"{highway_env.__name__}.")
                and not name.startswith(NO_TRAFFIC)
            )
        )
    )


def make_environment(
    path: Path, source: HighwaySource, scale: float
) -> tuple[AbstractEnv, dict[str, Any], tuple[str, ...]]:
    """The environment, not yet reset from a seed, all its settings, and notices for the user.

    `scale` is a factor on how many vehicles there are at the beginning, and on the chance that one
    comes in. Raises InputError, naming `path`, for an unknown environment, one without roads,
    unknown settings and values of the wrong type.
    """
    name = source.environment
    if name.startswith(NO_TRAFFIC):
        raise InputError(
            f"{path}: highway.environment: {name!r} has no roads to drive along, "
            "expected one with traffic, such as 'intersection-v2'"
        )
    known = known_environments()
    if name not in known:
        raise InputError(
            f"{path}: highway.environment: unknown environment {name!r}{nearest(name, known)}"
        )
    creator: Any = load_env_creator(str(gymnasium.registry[name].entry_point))
    defaults: dict[str, Any] = {**OURS, **creator.default_config()}
    _check(path, source.settings, defaults)
    settings = defaults | dict(source.settings)
    settings |= {key: v for key, v in DRAWN_IF_ZERO.items() if settings.get(key) == 0}
    for key in COUNTS:
        if key in settings:
            settings[key] = max(round(settings[key] * scale), 1) if settings[key] else 0
    settings["spawn_probability"] *= scale
    settings |= {"simulation_frequency": FREQUENCY_HZ}
    own = {key: value for key, value in settings.items() if key in creator.default_config()}
    notices = tuple(
        f"{key} in {path.name}: without effect, traffic goes on"
        for key in source.settings
        if key in WITHOUT_EFFECT
    )
    try:
        with own_drivers(settings):
            return creator(config=own), settings, notices
    except Exception as error:  # highway-env checks little of what it is given
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"{path}: highway.settings: {name} fails with them: {reason}; correct them"
        ) from error


@contextmanager
def own_drivers(settings: Mapping[str, Any]) -> Generator[dict[str, Any]]:
    """What the body sets on the class of the drivers is undone, and found in the yielded dict.

    highway-env's intersection changes the parameters of all drivers of a process.
    """
    driver = class_from_path(settings["other_vehicles_type"])
    before = dict(vars(driver))
    changed: dict[str, Any] = {}
    try:
        yield changed
    finally:
        for key, value in list(vars(driver).items()):
            if key not in before:
                changed[key] = value
                delattr(driver, key)
            elif before[key] is not value:
                changed[key] = value
                setattr(driver, key, before[key])


def _check(path: Path, settings: Mapping[str, Any], defaults: Mapping[str, Any]) -> None:
    for key, value in settings.items():
        where = f"{path}: highway.settings.{key}"
        if key in FIXED:
            raise InputError(f"{where}: is set here, for frames at 10 Hz: leave it out")
        if key not in defaults:
            raise InputError(
                f"{path}: highway.settings: unknown key {key!r}{nearest(key, defaults)}"
            )
        expected = RANGES.get(key) or _expected(defaults[key])
        if not _fits(value, expected):
            raise InputError(f"{where}: expected {expected}, found {value!r}; correct it")
        if key == "other_vehicles_type" and value not in DRIVERS:
            raise InputError(f"{where}: unknown driver {value!r}{nearest(value, DRIVERS)}")


def _expected(default: Any) -> str:
    match default:
        case bool():
            return "true or false"
        case int() | float():
            return "a number"
        case str():
            return "a text"
        case list() | tuple():
            return "a list"
        case dict():
            return "a table"
        case _:
            return "a value"


def _fits(value: Any, expected: str) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    is_whole = is_number and isinstance(value, int)
    fits = {
        "true or false": isinstance(value, bool),
        "a number": is_number,
        "a text": isinstance(value, str),
        "a list": isinstance(value, list),
        "a table": isinstance(value, dict),
        "a value": True,
        "a whole number from 0 on": is_whole and value >= 0,
        "a whole number from 1 on": is_whole and value >= 1,
        "a number from 0 to 1": is_number and 0 <= value <= 1,
        "a positive number": is_number and 0 < value < float("inf"),
    }
    return fits[expected]
