"""Which files of a data set in INTERACTION format make which recording."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hatn_sim.errors import InputError, nearest

_TRACKS: Final = re.compile(r"^(vehicle|pedestrian)_tracks_(.+)\.csv$")
_IDS: Final = re.compile(r"^vehicle_ids_.+\.csv$")
ID_COLUMNS: Final = ["track_id", "id"]


@dataclass(frozen=True)
class Recorded:
    """A recording: `000` of `vehicle_tracks_000.csv`, else the file's name without its ending."""

    name: str
    paths: tuple[Path, ...]  # of vehicles first
    found_beside: bool = False  # pedestrians that were not asked for by name

    @property
    def ids_path(self) -> Path:
        """Where the names of its tracks are, if they have others than numbers."""
        return self.paths[0].with_name(f"vehicle_ids_{self.name}.csv")


def group_files(paths: Sequence[Path], wanted: Sequence[str]) -> list[Recorded]:
    """The recordings of files, in order; pedestrians beside vehicles belong to them.

    `wanted` names recordings, with or without leading zeros; empty: all.

    Raises InputError for a wanted recording that is not there, and for two of the same name.
    """
    files: dict[str, list[Path]] = {}
    for path in paths:
        if not _IDS.match(path.name):
            found = _TRACKS.match(path.name)
            files.setdefault(found[2] if found else path.stem, []).append(path)
    if not files:
        raise InputError(
            f"{paths[0]}: expected tracks, found only names; give vehicle_tracks_*.csv"
        )
    recordings = [_recorded(name, together) for name, together in files.items()]
    if not wanted:
        return recordings
    is_wanted = among(wanted)
    chosen = [one for one in recordings if is_wanted(one.name)]
    refuse_unknown(paths[0].parent, wanted, files)
    return chosen


def among(wanted: Iterable[str]) -> Callable[[str], bool]:
    """Tells of a name whether it is among those wanted; `7` and `007` are the same."""
    names = {_plain(name) for name in wanted}
    return lambda name: _plain(name) in names


def refuse_unknown(where: Path, wanted: Iterable[str], known: Iterable[str]) -> None:
    """Raises InputError for the first wanted name that is not known."""
    names = {_plain(name) for name in known}
    for name in wanted:
        if _plain(name) not in names:
            raise InputError(f"{where}: there is no recording {name!r}{_hint(name, list(known))}")


def read_ids(path: Path) -> Mapping[str, str]:
    """track_id -> name. An absent file names nobody. Raises InputError where it is malformed."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.reader(file))
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error}); write it anew") from error
    if not rows or rows[0] != ID_COLUMNS or any(len(row) != 2 for row in rows):
        raise InputError(
            f"{path}: expected rows of {','.join(ID_COLUMNS)} below a header of these names; "
            "correct the file or take it away"
        )
    return {row[0]: row[1] for row in rows[1:]}


def _recorded(name: str, paths: Sequence[Path]) -> Recorded:
    kinds = [(_TRACKS.match(path.name) or ["", "vehicle"])[1] for path in paths]
    if len(set(kinds)) < len(kinds):
        raise InputError(
            f"{paths[0]} and {paths[-1]}: expected recordings of different names, found two called "
            f"{name!r}; give those of one place at a time"
        )
    ordered = tuple(path for _, path in sorted(zip(kinds, paths, strict=True), reverse=True))
    beside = paths[0].with_name(f"pedestrian_tracks_{name}.csv")
    if kinds == ["vehicle"] and _TRACKS.match(paths[0].name) and beside.is_file():
        return Recorded(name, (*ordered, beside), found_beside=True)
    return Recorded(name, ordered)


def _plain(name: str) -> str:
    return str(int(name)) if name.isdecimal() else name


def _hint(name: str, known: list[str]) -> str:
    if len(known) > 12 and all(other.isdecimal() for other in known):
        numbers = sorted(known, key=int)
        return f"; known: {numbers[0]} to {numbers[-1]} ({len(numbers)})"
    return nearest(name, known)
