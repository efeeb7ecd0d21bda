"""Lines drawn from tracks, kept: a file named by a hash of all that they depend on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from hatn_sim.content import content_hash
from hatn_sim.datatypes import Lane
from hatn_sim.errors import InputError
from hatn_sim.kept import library_versions, source_version
from hatn_sim.log.road_file import read_road, write_road

SUFFIX: Final = ".road.json.gz"


class Kept(NamedTuple):
    lanes: list[Lane]
    vehicles: int  # that drew them


def file_of(folder: Path | None, names: Sequence[str], files: Sequence[Path]) -> Path | None:
    """Where lines from recordings are kept, of these files; None: nowhere. Raises InputError where
    one cannot be read."""
    if folder is None:
        return None
    said = json.dumps([source_version(), library_versions(), *names, *map(content_hash, files)])
    return folder / hashlib.sha256(said.encode()).hexdigest()[:32]


def read_kept(file: Path | None) -> Kept | None:
    """What was kept; None where nothing is, or nothing whole."""
    if file is None:
        return None
    for path in file.parent.glob(f"{file.name}-*{SUFFIX}"):
        vehicles = path.name.removeprefix(f"{file.name}-").removesuffix(SUFFIX)
        with suppress(InputError, ValueError):
            return Kept(read_road(path), int(vehicles))
    return None


def write_kept(file: Path | None, lanes: Sequence[Lane], vehicles: int) -> None:
    """Keep lines; where that cannot be, they are drawn again."""
    if file is None:
        return
    with suppress(OSError):
        write_road(file.with_name(f"{file.name}-{vehicles}{SUFFIX}"), lanes)
