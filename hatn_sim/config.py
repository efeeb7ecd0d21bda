"""A scene's settings: `scenario.toml`, or a user's own `.sumocfg`, read into one frozen object."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hatn_sim.errors import InputError, nearest
from hatn_sim.resources import find_scenarios
from hatn_sim.simulators.sumo_config import check_sumocfg

DEFAULT_DENSITY = "normal"
DEFAULT_RISK = "courteous"
SIMULATORS = ("sumo",)


@dataclass(frozen=True)
class Scenario:
    """A scene with its density and risk profile chosen."""

    name: str
    config_path: Path  # the .sumocfg
    title: str = ""
    description: str = ""
    simulator: str = "sumo"
    density: str | None = None  # None: the scene knows no densities
    risk: str | None = None  # None: the scene knows no risk profiles
    scale: float | None = None  # factor on the demand
    driver_path: Path | None = None  # the additional file that defines the drivers
    driver_paths: tuple[Path, ...] = ()  # those of all risk profiles; driver_path replaces them
    densities: tuple[str, ...] = ()
    risks: tuple[str, ...] = ()
    card: Mapping[str, Any] = field(default_factory=dict[str, Any])  # measured figures, free-form
    is_user_config: bool = False  # a .sumocfg without a scenario.toml


def load_scenario(
    name_or_path: str, density: str | None = None, risk: str | None = None
) -> Scenario:
    """The scene of that name, of that scenario.toml (or its folder), or of that .sumocfg.

    `density` and `risk` default to "normal" and "courteous" where the scene knows them. Raises
    InputError for an unknown scene, density or risk profile and for every fault in the files.
    """
    path = Path(name_or_path)
    if path.suffix == ".sumocfg":
        return _load_sumocfg(path, density, risk)
    shipped = find_scenarios()
    if name_or_path in shipped:
        return _load_toml(shipped[name_or_path], density, risk)
    if path.is_dir():
        path = path / "scenario.toml"
    if path.suffix == ".toml":
        return _load_toml(path, density, risk)
    if path.exists():
        raise InputError(f"{path}: expected the name of a scene, a scenario.toml or a .sumocfg")
    raise InputError(f"unknown scene {name_or_path!r}{nearest(name_or_path, shipped)}")


def _load_sumocfg(path: Path, density: str | None, risk: str | None) -> Scenario:
    for option, value in (("density", density), ("risk", risk)):
        if value is not None:
            raise InputError(
                f"{path}: --{option} {value} is for scenes with a scenario.toml; "
                "a .sumocfg has its own demand and drivers: leave the option out"
            )
    check_sumocfg(path)
    return Scenario(name=path.stem, config_path=path, title=path.stem, is_user_config=True)


def _load_toml(path: Path, density: str | None, risk: str | None) -> Scenario:
    table = _Table(path, "", _read_toml(path))
    table.allow("name", "title", "description", "simulator", "config", "density", "risk", "card")
    simulator = table.choice("simulator", SIMULATORS)
    config_path = path.parent / table.text("config")
    check_sumocfg(config_path)
    scales = {key: float(table.sub("density").number(key)) for key in table.keys_of("density")}
    drivers = {key: path.parent / table.sub("risk").text(key) for key in table.keys_of("risk")}
    density = _chosen(path, "density", density, DEFAULT_DENSITY, tuple(scales))
    risk = _chosen(path, "risk", risk, DEFAULT_RISK, tuple(drivers))
    driver_path = None if risk is None else drivers[risk]
    if driver_path is not None and not driver_path.is_file():
        raise InputError(f"{path}: risk.{risk}: no file {driver_path}; correct the name")
    return Scenario(
        name=table.text("name"),
        config_path=config_path,
        title=table.text("title"),
        description=table.text("description"),
        simulator=simulator,
        density=density,
        risk=risk,
        scale=None if density is None else scales[density],
        driver_path=driver_path,
        driver_paths=tuple(drivers.values()),
        densities=tuple(scales),
        risks=tuple(drivers),
        card=table.sub("card").values,
    )


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected UTF-8 text; save the file as UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"line (\d+)", str(error))
        where = f"{path}:{line.group(1)}" if line else str(path)
        raise InputError(f"{where}: not valid TOML: {error}; correct the file") from error


@dataclass(frozen=True)
class _Table:
    """A table of a TOML file that speaks up for itself in errors."""

    path: Path
    prefix: str
    values: Mapping[str, Any]

    def allow(self, *keys: str) -> None:
        for key in self.values:
            if key not in keys:
                raise InputError(f"{self.path}: unknown key {key!r}{nearest(key, keys)}")

    def keys_of(self, key: str) -> tuple[str, ...]:
        return tuple(self.sub(key).values)

    def sub(self, key: str) -> _Table:
        value = self.values.get(key, {})
        if not isinstance(value, dict):
            raise self._wrong(key, "a table", value)
        return _Table(self.path, f"{self.prefix}{key}.", value)

    def text(self, key: str) -> str:
        value = self._get(key, "a text")
        if not isinstance(value, str):
            raise self._wrong(key, "a text", value)
        return value

    def number(self, key: str) -> float:
        value = self._get(key, "a positive number")
        if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
            raise self._wrong(key, "a positive number", value)
        return value

    def choice(self, key: str, known: tuple[str, ...]) -> str:
        value = self.text(key)
        if value not in known:
            raise InputError(
                f"{self.path}: {self.prefix}{key}: unknown value {value!r}{nearest(value, known)}"
            )
        return value

    def _get(self, key: str, expected: str) -> Any:
        if key not in self.values:
            raise InputError(f"{self.path}: key '{self.prefix}{key}' is missing: add {expected}")
        return self.values[key]

    def _wrong(self, key: str, expected: str, found: Any) -> InputError:
        return InputError(f"{self.path}: {self.prefix}{key}: expected {expected}, found {found!r}")


def _chosen(
    path: Path, what: str, wanted: str | None, default: str, known: tuple[str, ...]
) -> str | None:
    if not known:
        if wanted is not None:
            raise InputError(f"{path}: has no [{what}]: leave --{what} {wanted} out")
        return None
    if wanted is None:
        if default not in known:
            raise InputError(f"{path}: [{what}] lacks {default!r}, the default: add it")
        return default
    if wanted not in known:
        raise InputError(f"{path}: unknown {what} {wanted!r}{nearest(wanted, known)}")
    return wanted
