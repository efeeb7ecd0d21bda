"""A scene's settings: a `scenario.toml`, a user's own `.sumocfg` or recorded tracks, read into one
frozen object."""

from __future__ import annotations

import glob
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hatn_sim.datatypes import Lane
from hatn_sim.errors import InputError, nearest
from hatn_sim.resources import SUITES, find_scenarios
from hatn_sim.simulators.sumo_config import check_sumocfg

DEFAULT_DENSITY = "normal"
DEFAULT_RISK = "courteous"
MOST_NAMED = 100_000
"""Recordings or cases in one span of names."""
KEYS_OF_SIMULATOR = {
    "sumo": ("config", "density", "risk"),
    "highway": ("highway", "density"),
    "recorded": ("recorded",),
}
"""What a scenario.toml may hold beside what all of them do."""
SIMULATORS = tuple(KEYS_OF_SIMULATOR)


@dataclass(frozen=True)
class HighwaySource:
    """An environment of highway-env."""

    environment: str  # its id, "intersection-v2"
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])  # of its configuration


@dataclass(frozen=True)
class ReplaySource:
    """A recording is replayed inside SUMO, where vehicles can be taken over."""

    net_path: Path
    take_over: str = ""  # ID[@S],ID[@S] ...
    react_from_s: float | None = None  # from this time on everybody drives


@dataclass(frozen=True, eq=False)
class DrawnLines:
    """Lanes drawn from tracks of other recordings of the same place, in place of the map's."""

    lanes: tuple[Lane, ...]
    recordings: tuple[str, ...]  # whose tracks drew them
    vehicles: int
    sha256: str  # of the lanes: equal where they are

    @property
    def words(self) -> str:
        """Where they are from, for a notice."""
        return (
            f"{self.vehicles} vehicles of {len(self.recordings)} other recordings; where none "
            "drove, the map's lanes"
        )


@dataclass(frozen=True)
class RecordedSource:
    """Recorded tracks and the map that they were driven on."""

    tracks: tuple[Path, ...]  # files, or the folder of a run
    map_path: Path | None  # None: the tracks bring their own (the folder of a run)
    recordings: tuple[str, ...] = ()  # those wanted of the files' recordings; empty: all
    replay: ReplaySource | None = None  # None: nothing but the recording happens
    drawn: DrawnLines | None = None  # None: reference lines along the lanes of the map
    lines_notice: str = ""  # said of its lines, in place of where they were drawn from


@dataclass(frozen=True)
class Scenario:
    """A scene with its density and risk profile chosen."""

    name: str
    config_path: Path  # the .sumocfg; of other simulators: the file that says what to run
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
    suite: str | None = None  # one of resources.SUITES, where the scene is scripted for one
    card: Mapping[str, Any] = field(default_factory=dict[str, Any])  # measured figures, free-form
    is_user_config: bool = False  # a .sumocfg or tracks without a scenario.toml
    highway: HighwaySource | None = None  # with the simulator "highway"
    recorded: RecordedSource | None = None  # with the simulator "recorded"


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
    if (path / "run.json").is_file():
        _refuse_traffic(name_or_path, density, risk)
        return load_tracks((name_or_path,), None)
    if path.is_dir() and not (path / "scenario.toml").is_file():
        raise InputError(
            f"{path}: expected the folder of a scene (with a scenario.toml) or of a run (with a "
            "run.json), found neither; name another"
        )
    if path.is_dir():
        path = path / "scenario.toml"
    if path.suffix == ".toml":
        return _load_toml(path, density, risk)
    if path.exists():
        hint = "recorded tracks are given with --tracks"
        if path.name.endswith((".net.xml", ".net.xml.gz")):
            hint = "a net alone has no traffic, name the .sumocfg that runs it"
        raise InputError(
            f"{path}: expected the name of a scene, a scenario.toml, a .sumocfg or the folder of "
            f"a run; {hint}"
        )
    raise InputError(f"unknown scene {name_or_path!r}{nearest(name_or_path, shipped)}")


def load_tracks(
    patterns: Sequence[str], map_path: Path | None, recordings: Sequence[str] = ()
) -> Scenario:
    """A scene of recorded tracks: files, patterns (`*`) of files, or the folder of a run.

    Raises InputError where nothing is there, or where a map is missing or one too many.
    """
    paths = tuple(dict.fromkeys(path for pattern in patterns for path in _matches(pattern)))
    if not paths:
        raise InputError("no tracks are named; give files, a pattern or the folder of a run")
    first = paths[0]
    is_run = any((path / "run.json").is_file() for path in paths)
    if is_run and len(paths) > 1:
        raise InputError(f"{first}: one run at a time can be replayed, found {len(paths)}")
    if is_run and map_path is not None:
        raise InputError(f"{first}: a run brings its own lanes; leave --map {map_path} out")
    if not is_run and map_path is None:
        raise InputError(
            f"{first}: recorded tracks need the map they were driven on: add --map FILE "
            "(Lanelet2 .osm for INTERACTION tracks, .net.xml for SUMO's FCD)"
        )
    if map_path is not None and not map_path.is_file():
        raise InputError(f"{map_path}: there is no such map; correct --map")
    # Recordings 000, 001 ... of a place lie in a folder that is named after it.
    is_numbered = re.match("(vehicle|pedestrian)_tracks_", first.name) is not None
    is_place = len(paths) > 1 or is_numbered
    name = first.resolve().parent.name if is_place else first.name.partition(".")[0]
    return Scenario(
        name=name,
        config_path=first,
        title=f"recorded tracks, {name}",
        simulator="recorded",
        is_user_config=True,
        recorded=RecordedSource(paths, map_path, tuple(recordings)),
    )


def _matches(pattern: str) -> list[Path]:
    """The files of a pattern, in order of their names."""
    if Path(pattern).exists():
        return [Path(pattern)]
    found = [Path(name) for name in sorted(glob.glob(pattern))]  # noqa: PTH207 - may be absolute
    if not found:
        raise InputError(f"{pattern}: there are no such tracks; correct the path or the pattern")
    return found


def _refuse_traffic(where: object, density: str | None, risk: str | None) -> None:
    for option, value in (("density", density), ("risk", risk)):
        if value is not None:
            raise InputError(
                f"{where}: --{option} {value} is for scenes with a scenario.toml; "
                "this traffic has its own demand and drivers: leave the option out"
            )


def _load_sumocfg(path: Path, density: str | None, risk: str | None) -> Scenario:
    _refuse_traffic(path, density, risk)
    check_sumocfg(path)
    return Scenario(name=path.stem, config_path=path, title=path.stem, is_user_config=True)


def _load_toml(path: Path, density: str | None, risk: str | None) -> Scenario:
    table = _Table(path, "", read_toml(path))
    common = ("name", "title", "description", "simulator", "suite", "card")
    table.allow(*common, *{key for keys in KEYS_OF_SIMULATOR.values() for key in keys})
    simulator = table.choice("simulator", SIMULATORS)
    table.allow(*common, *KEYS_OF_SIMULATOR[simulator])
    scenario = Scenario(
        name=table.text("name"),
        config_path=path,
        title=table.text("title"),
        description=table.text("description"),
        simulator=simulator,
        suite=table.choice("suite", SUITES) if "suite" in table.values else None,
        card=table.sub("card").values,
    )
    if simulator == "recorded":
        _refuse_traffic(path, density, risk)
        return replace(scenario, recorded=_recorded(table.sub("recorded")))
    scales = {key: float(table.sub("density").number(key)) for key in table.keys_of("density")}
    density = _chosen(path, "density", density, DEFAULT_DENSITY, tuple(scales))
    scenario = replace(
        scenario,
        density=density,
        scale=None if density is None else scales[density],
        densities=tuple(scales),
    )
    if simulator == "highway":
        _refuse_traffic(path, None, risk)
        source = table.sub("highway")
        source.allow("environment", "settings")
        highway = HighwaySource(source.text("environment"), source.sub("settings").values)
        return replace(scenario, highway=highway)
    config_path = path.parent / table.text("config")
    check_sumocfg(config_path)
    drivers = {key: path.parent / table.sub("risk").text(key) for key in table.keys_of("risk")}
    risk = _chosen(path, "risk", risk, DEFAULT_RISK, tuple(drivers))
    driver_path = None if risk is None else drivers[risk]
    if driver_path is not None and not driver_path.is_file():
        raise InputError(f"{path}: risk.{risk}: no file {driver_path}; correct the name")
    return replace(
        scenario,
        config_path=config_path,
        risk=risk,
        driver_path=driver_path,
        driver_paths=tuple(drivers.values()),
        risks=tuple(drivers),
    )


def _recorded(table: _Table) -> RecordedSource:
    table.allow("tracks", "map", "recordings")
    folder = table.path.parent
    map_path = folder / table.text("map")
    if not map_path.is_file():
        raise InputError(f"{table.path}: recorded.map: there is no file {map_path}; correct it")
    recordings = table.text("recordings") if "recordings" in table.values else ""
    return RecordedSource(
        tracks=tuple(_matches(str(folder / table.text("tracks")))),
        map_path=map_path,
        recordings=recording_names(recordings),
    )


def recording_names(text: str) -> tuple[str, ...]:
    """Names of recordings as `000-004,017`, every one spelled out; an empty text: none."""
    names: list[str] = []
    for part in filter(None, (part.strip() for part in text.split(","))):
        first, dash, last = part.partition("-")
        if not dash:
            names.append(part)
        elif first.isdecimal() and last.isdecimal() and 0 <= int(last) - int(first) < MOST_NAMED:
            names += [f"{k:0{len(first)}d}" for k in range(int(first), int(last) + 1)]
        else:
            is_back = first.isdecimal() and last.isdecimal() and int(last) < int(first)
            instead = f"; say {last}-{first}" if is_back else ""
            raise InputError(
                f"recordings: expected names like 000-004,017, found {part!r}{instead}"
            )
    return tuple(dict.fromkeys(names))


def seed_numbers(text: str, where: str = "") -> tuple[int, ...]:
    """Seeds as `7`, `1-12` or `1-4,9`, each once.

    Raises InputError, which begins with `where`, as "--seeds: ".
    """
    found: list[int] = []
    for part in (part.strip() for part in text.split(",")):
        first, dash, last = part.partition("-")
        if not (first.isdecimal() and (last.isdecimal() or not dash)):
            raise InputError(f"{where}expected seeds like 7, 1-12 or 1-4,9, found {text!r}")
        start, stop = int(first), int(last or first)
        if stop < start:
            raise InputError(
                f"{where}expected seeds in rising order, found {part!r}; say {last}-{first}"
            )
        if stop - start >= MOST_NAMED:
            raise InputError(f"{where}expected at most {MOST_NAMED:,} seeds, found {part!r}")
        found += range(start, stop + 1)
    return tuple(dict.fromkeys(found))


def read_toml(path: Path) -> dict[str, Any]:
    """What is in a TOML file. Raises InputError where it cannot be read."""
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
