"""SUMO's floating car data, row by row: XML, gzipped XML and Parquet, in bounded memory.

Format: https://sumo.dlr.de/docs/Simulation/Output/FCDOutput.html. In Parquet the columns are named
`timestep_time`, `vehicle_id` ... (or `time`, `id` ...); a timestep without vehicles is a row of
nulls, and persons are rows with an edge and no lane.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Final, NamedTuple

from hatn_sim.errors import InputError
from hatn_sim.safe_xml import iterparse_xml

Row = Mapping[str, Any]
"""Attribute -> its value, as text from XML and as a number from Parquet."""

ATTRIBUTES: Final = (
    "id", "x", "y", "angle", "speed", "type", "signals", "vehicle", "lane", "edge",
    "length", "width", "kind", "color",
)  # fmt: skip
"""What is read of a road user; those of the last line are written by our own export only."""
CLOSED_ATTRIBUTE: Final = "closed"
"""Of a timestep, by our own export only: a 1 for every closed signal and a 0 for every other."""
_PARQUET_MAGIC: Final = b"PAR1"
_PARQUET_ROWS: Final = 20_000


class RoadUser(NamedTuple):
    """A vehicle or person of one moment."""

    row: Row
    on_foot: bool  # a person; it may ride in a vehicle nevertheless


@dataclass(frozen=True)
class Timestep:
    """The road users of one moment as the file has them."""

    time: str  # as the file has it, for messages
    time_s: float
    users: tuple[RoadUser, ...]
    closed: str = ""


def read_timesteps(path: Path) -> Iterator[Timestep]:
    """The timesteps of a file, in its order.

    Raises:
        InputError: at the place where the file is no floating car data, damaged or cut off.
    """
    try:
        with path.open("rb") as file:
            magic = file.read(len(_PARQUET_MAGIC))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; correct the path") from error
    return _from_parquet(path) if magic == _PARQUET_MAGIC else _from_xml(path)


def _from_xml(path: Path) -> Iterator[Timestep]:
    for element in iterparse_xml(path, "fcd-export"):
        if element.tag != "timestep":
            continue
        time = element.get("time")
        yield Timestep(
            time=str(time),
            time_s=_seconds(path, time),
            users=tuple(
                RoadUser(child.attrib, child.tag == "person")
                for child in element
                if child.tag in ("vehicle", "person")
            ),
            closed=element.get(CLOSED_ATTRIBUTE, ""),
        )


def _from_parquet(path: Path) -> Iterator[Timestep]:
    for time, rows in groupby(_parquet_rows(path), key=lambda row: row["time"]):
        users = tuple(
            RoadUser(row, on_foot=row.get("edge") is not None and row.get("lane") is None)
            for row in rows
            if row["id"] is not None
        )
        yield Timestep(str(time), _seconds(path, time), users)


def _parquet_rows(path: Path) -> Iterator[Row]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            columns = _columns(path, file.schema_arrow.names)
            for batch in file.iter_batches(_PARQUET_ROWS, columns=list(columns)):
                names = [columns[name] for name in batch.schema.names]
                yield from batch.rename_columns(names).to_pylist()
    except (OSError, pa.ArrowException) as error:
        raise InputError(
            f"{path}: expected floating car data in Parquet, found a file that cannot be read "
            f"({str(error).splitlines()[0]}); make it anew"
        ) from error


def _columns(path: Path, names: list[str]) -> dict[str, str]:
    """Column of the file -> attribute, for the attributes that are read."""
    found = {"time": "timestep_time"} if "timestep_time" in names else {}
    for attribute in ("time", *ATTRIBUTES):
        for name in (f"vehicle_{attribute}", f"person_{attribute}", attribute):
            if name in names:
                found.setdefault(attribute, name)
    for needed in ("time", "id"):
        if needed not in found:
            raise InputError(
                f"{path}: expected a column {needed!r} as SUMO names them (timestep_time, "
                f"vehicle_id ...), found {', '.join(names[:12])}; record it with --fcd-output "
                "and named columns"
            )
    return {name: attribute for attribute, name in found.items()}


def _seconds(path: Path, time: object) -> float:
    """Seconds from `12.30` or from SUMO's human-readable `[days:]hours:minutes:seconds`."""
    seconds = 0.0
    try:
        parts = [float(part) for part in reversed(str(time).split(":"))]
        for part, unit_s in zip(parts, (1.0, 60.0, 3600.0, 86400.0)[: len(parts)], strict=True):
            seconds += part * unit_s
    except ValueError:
        seconds = float("nan")
    if not abs(seconds) < float("inf"):
        raise InputError(f"{path}: expected a timestep with a time in seconds, found {time!r}")
    return seconds
