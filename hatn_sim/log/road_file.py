"""The lanes of a run, in a file of its folder: a log can be drawn and replayed without the net."""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import Gate, Kind, Lane
from hatn_sim.errors import InputError
from hatn_sim.whole_file import write_whole

ROAD_FILE: Final = "road.json.gz"
"""Its name in the folder of a run."""
FORMAT: Final = 1
MAX_RATIO: Final = 100
"""Expanded over compressed bytes. Lanes compress 3 to 10 times, a bomb 1,000 times."""
RATIO_FROM_BYTES: Final = 16 << 20
"""Below this many expanded bytes any ratio is harmless."""


def write_road(path: Path, lanes: Iterable[Lane]) -> None:
    """Write lanes exactly, as gzipped JSON; the same lanes give the same bytes."""
    content = {"format": FORMAT, "lanes": [_to_json(lane) for lane in lanes]}
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    # mtime: gzip would otherwise store the time of writing.
    data = gzip.compress(text.encode("utf-8"), compresslevel=6, mtime=0)
    write_whole(path, lambda file: file.write_bytes(data))


def read_road(path: Path) -> list[Lane]:
    """The lanes as they were written, in their order.

    Raises:
        InputError: the file is not there, is damaged, or of another format.
    """
    if not path.is_file():
        raise InputError(
            f"{path}: expected the lanes of the run, found no such file; "
            "make the run again with `hatn-sim run`"
        )
    try:
        content = json.loads(_expanded(path))
        found = content["format"]
        lanes = [_from_json(lane) for lane in content["lanes"]] if found == FORMAT else []
    except (OSError, EOFError, zlib.error, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: expected the lanes of a run, found a damaged file "
            f"({type(error).__name__}); make the run again"
        ) from error
    if found != FORMAT:
        raise InputError(
            f"{path}: expected format {FORMAT}, found {found}; make the run again with this "
            "version of hatn-sim"
        )
    return lanes


def is_whole_road(path: Path) -> bool:
    """Whether a file of lanes is there from its beginning to its end; cheaper than to read it."""
    try:
        return bool(_expanded(path))
    except (OSError, EOFError, zlib.error, InputError):
        return False


def _expanded(path: Path) -> bytes:
    limit = max(MAX_RATIO * path.stat().st_size, RATIO_FROM_BYTES)
    with gzip.open(path) as stream:
        text = stream.read(limit + 1)
    if len(text) > limit:
        raise InputError(
            f"{path}: expected the lanes of a run, found gzip that expands more than {MAX_RATIO} "
            "times; make the run again"
        )
    return text


def _to_json(lane: Lane) -> dict[str, Any]:
    return {
        "id": lane.id,
        "xy_m": lane.xy_m.tolist(),
        "width_m": float(lane.width_m),
        "speed_limit_mps": float(lane.speed_limit_mps),
        "successors": list(lane.successors),
        "kinds": sorted(int(kind) for kind in lane.kinds),
        "gate": int(lane.gate),
        "signals": None if lane.signals is None else dict(lane.signals),
        "turn": int(lane.turn),
        "is_connection": bool(lane.is_connection),
    }


def _from_json(content: dict[str, Any]) -> Lane:
    return Lane(
        id=content["id"],
        xy_m=np.array(content["xy_m"], dtype=np.float64).reshape(-1, 2),
        width_m=content["width_m"],
        speed_limit_mps=content["speed_limit_mps"],
        successors=tuple(content["successors"]),
        kinds=frozenset(Kind(kind) for kind in content["kinds"]),
        gate=Gate(content["gate"]),
        signals=content["signals"],
        turn=content["turn"],
        is_connection=content["is_connection"],
    )
