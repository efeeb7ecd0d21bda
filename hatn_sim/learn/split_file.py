"""A split named in a small file: tables [[train]], [[tune]] and [[test]], each of one kind.

[[train]]
scenes = ["intersection5", "roundabout8"]
seeds = "1-12"
risks = ["courteous", "assertive"]      # the seeds take them in turn
density = "normal"
duration_s = 600

[[train]]
tracks = "site/vehicle_tracks_*.csv"    # from the file's folder
map = "site.osm"
recordings = "000-014"

[[tune]]
runs = ["runs/intersection5-101"]
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from hatn_sim.config import seed_numbers
from hatn_sim.errors import InputError, nearest
from hatn_sim.learn.split import (
    DURATION_S,
    PARTS,
    Split,
    Traffic,
    make_split,
    traffic_of_runs,
    traffic_of_scenes,
    traffic_of_tracks,
)
from hatn_sim.recordings.track_lines.source import Drawing
from hatn_sim.resources import find_scenarios

KEYS: Final[Mapping[str, tuple[str, ...]]] = {
    "scenes": ("scenes", "seeds", "risks", "density", "duration_s", "warm_up_s"),
    "tracks": ("tracks", "map", "recordings", "lines"),
    "runs": ("runs",),
}
"""What a table has, by the key that tells its kind."""
LINES: Final = ("lanes", "tracks", "auto")


def read_split(path: Path, drawing: Drawing | None = None, lines: str | None = None) -> Split:
    """The split that a file names; `drawing`: how its lines are drawn.

    `lines`: for all recordings, whatever the file says; with "lanes" a file is soon checked.

    Raises InputError for every fault in it, and where it overlaps itself.
    """
    content = read_toml(path)
    for name in content:
        if name not in PARTS:
            raise InputError(f"{path}: unknown table {name!r}{nearest(name, PARTS)}")
    parts: dict[str, list[Traffic]] = {}
    for name, tables in content.items():
        if not isinstance(tables, list):
            found = f"[{name}]; double the brackets" if isinstance(tables, dict) else repr(tables)
            raise InputError(f"{path}: {name}: expected tables [[{name}]], found {found}")
        parts[name] = [
            one
            for k, table in enumerate(tables, start=1)
            for one in _traffic(path, f"{name} {k}", table, drawing, lines)
        ]
    return make_split(parts, {name: f"{path}: [[{name}]]" for name in PARTS})


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file. Raises InputError where it cannot be read."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; correct the name") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected UTF-8 text; save the file as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}; correct the file") from None


def _traffic(
    path: Path, where: str, table: Any, drawing: Drawing | None, lines: str | None
) -> list[Traffic]:
    """The traffic of one table."""
    kind = next((key for key in KEYS if key in table), None) if isinstance(table, dict) else None
    if kind is None:
        raise InputError(f"{path}: [[{where}]]: expected one of {', '.join(KEYS)} in it")
    for key in table:
        if key not in KEYS[kind]:
            raise InputError(f"{path}: [[{where}]]: unknown key {key!r}{nearest(key, KEYS[kind])}")
    values = _Values(f"{path}: [[{where}]]", table)
    folder = path.parent
    if kind == "runs":
        return traffic_of_runs([str(folder / run) for run in values.texts("runs")])
    if kind == "tracks":
        patterns = [str(folder / pattern) for pattern in values.texts("tracks")]
        asked = values.choice("lines", LINES, "auto")
        return traffic_of_tracks(
            patterns,
            folder / values.text("map"),
            values.text("recordings", ""),
            lines or asked,
            drawing,
        )
    shipped = find_scenarios()
    scenes = [word if word in shipped else _beside(folder, word) for word in values.texts("scenes")]
    return traffic_of_scenes(
        scenes,
        values.seeds("seeds"),
        values.texts("risks", ()),
        values.text("density", "") or None,
        values.number("duration_s", DURATION_S),
        values.number("warm_up_s") if "warm_up_s" in table else None,
    )


def _beside(folder: Path, word: str) -> str:
    """A scene by its path from the file's folder; a name that is none is left for the error."""
    return str(folder / word) if (folder / word).exists() else word


class _Values:
    """The values of a table, checked."""

    def __init__(self, where: str, table: Mapping[str, Any]) -> None:
        self._where, self._table = where, table

    def text(self, key: str, default: str | None = None) -> str:
        value = self._table.get(key, default)
        if not isinstance(value, str):
            raise self._wrong(key, "a text", value)
        return value

    def texts(self, key: str, default: tuple[str, ...] | None = None) -> tuple[str, ...]:
        value = self._table.get(key, default)
        value = (value,) if isinstance(value, str) else value
        if not isinstance(value, list | tuple) or not all(isinstance(one, str) for one in value):
            raise self._wrong(key, "a list of texts", value)
        return tuple(value)

    def choice(self, key: str, known: tuple[str, ...], default: str) -> str:
        value = self.text(key, default)
        if value not in known:
            raise InputError(f"{self._where}: {key}: unknown {value!r}{nearest(value, known)}")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        value = self._table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0:
            raise self._wrong(key, "a number, 0 or more", value)
        return float(value)

    def seeds(self, key: str) -> tuple[int, ...]:
        value = self._table.get(key)
        if isinstance(value, list) and all(type(one) is int and one >= 0 for one in value):
            return tuple(dict.fromkeys(value))
        if type(value) is int and value >= 0:
            return (value,)
        if not isinstance(value, str):
            raise self._wrong(key, 'seeds like 7, "1-12" or [1, 5]', value)
        return seed_numbers(value, f"{self._where}: {key}: ")

    def _wrong(self, key: str, expected: str, found: Any) -> InputError:
        if found is None:
            return InputError(f"{self._where}: {key} is missing: add {expected}")
        return InputError(f"{self._where}: {key}: expected {expected}, found {found!r}")
