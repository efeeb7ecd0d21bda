"""Parquet parts of a table, written and read. The only place that knows pyarrow."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hatn_sim.errors import InputError
from hatn_sim.log.schema import ID, Column, part_name
from hatn_sim.whole_file import write_whole

Array = NDArray[Any]
Ragged = tuple[Array, Array]
"""Values of all rows one after the other, and how many each row has."""


class PartBuffer:
    """Collects the rows of a table frame by frame and writes them as one part."""

    def __init__(self, folder: Path, columns: Sequence[Column]) -> None:
        self._folder = folder
        self._columns = columns
        self._frames: list[dict[str, Array | Ragged]] = []

    def append(self, rows: Mapping[str, Array | Ragged]) -> None:
        """Add a copy of a frame's rows; ids are given as indices into all ids so far."""
        self._frames.append({c.name: _stored(rows[c.name], c) for c in self._columns})

    def write(self, part: int, ids: Sequence[str]) -> None:
        """Write what was collected, whole or not at all, and start anew."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        if not self._frames:
            return
        table = pa.table({column.name: self._arrow(column, ids) for column in self._columns})
        path = self._folder / part_name(part)
        # Neighbouring floats share their high bytes: split, they are smaller and faster to pack.
        floats = [_leaf(c) for c in self._columns if c.dtype.startswith("float")]
        options: dict[str, Any] = {
            "compression": "zstd",
            "compression_level": 1,
            "use_dictionary": [_leaf(c) for c in self._columns if c.dtype == ID],
            "column_encoding": dict.fromkeys(floats, "BYTE_STREAM_SPLIT"),
            "write_statistics": False,
        }
        write_whole(path, lambda file: pq.write_table(table, file, **options))
        self._frames.clear()

    def _arrow(self, column: Column, ids: Sequence[str]) -> Any:
        import pyarrow as pa

        values, lengths = _concatenated([frame[column.name] for frame in self._frames])
        if column.dtype == ID:
            used, codes = np.unique(values, return_inverse=True)
            arrow = pa.DictionaryArray.from_arrays(
                pa.array(codes.astype(np.int32)),
                pa.array([ids[index] for index in used], pa.string()),
            )
        else:
            arrow = pa.array(values)
        if lengths is None:
            return arrow
        offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
        return pa.ListArray.from_arrays(pa.array(offsets), arrow)


def _leaf(column: Column) -> str:
    return f"{column.name}.list.element" if column.ragged else column.name


def _stored(rows: Array | Ragged, column: Column) -> Array | Ragged:
    dtype = np.int32 if column.dtype == ID else column.dtype
    if isinstance(rows, tuple):
        values, lengths = rows
        return values.astype(dtype), lengths
    return rows.astype(dtype)


def _concatenated(chunks: Sequence[Array | Ragged]) -> tuple[Array, Array | None]:
    """(values, lengths of ragged rows or None) of one column's frames or parts together."""
    ragged = [chunk for chunk in chunks if isinstance(chunk, tuple)]
    if ragged:
        values, lengths = zip(*ragged, strict=True)
        return np.concatenate(values), np.concatenate(lengths)
    return np.concatenate([chunk for chunk in chunks if not isinstance(chunk, tuple)]), None


def part_count(folder: Path) -> int:
    """Parts in a folder: they are numbered from 0 without gaps. A gap is an `InputError`."""
    found = sorted(path.name for path in folder.glob("part-*.parquet"))
    for part, name in enumerate(found):
        if name != part_name(part):
            raise InputError(
                f"{folder}: {part_name(part)} is missing although {name} is there; "
                "make the run again"
            )
    return len(found)


def read_parts(
    folder: Path,
    parts: Iterable[int],
    columns: Sequence[Column],
    ids: Mapping[str, int] | None = None,
    frames: range | None = None,
) -> dict[str, Any]:
    """Parts of a table by column: arrays, or `Ragged` where it is ragged.

    A part that is not there has no rows (a predictor may be asked for a few frames only).

    Args:
        folder: of the table.
        parts: which of them.
        columns: which to read.
        ids: index of every vehicle; without it, columns of ids are left as strings.
        frames: take only the rows of these frames; it starts at 0.

    Raises:
        InputError: a part cannot be read, lacks a column or names somebody who is not in `ids`.
    """
    chunks: dict[str, list[Array | Ragged]] = {c.name: [_no_rows(c, ids)] for c in columns}
    for path in (folder / part_name(part) for part in parts):
        if not path.exists():
            continue
        table = _read_part(path, list(chunks))
        if frames is not None:
            frame = table["frame"].to_numpy()
            table = table.filter((frame < frames.stop) & (frame % frames.step == 0))
        for column in columns:
            arrow = table[column.name].combine_chunks()
            try:
                values = _numpy(arrow.flatten() if column.ragged else arrow, column, ids)
            except KeyError as error:
                raise InputError(
                    f"{path}: names {error.args[0]!r}, who is nowhere in tracks/; parts of the log "
                    "are missing, make the run again"
                ) from None
            lengths = arrow.value_lengths().to_numpy() if column.ragged else None
            chunks[column.name].append(values if lengths is None else (values, lengths))
    rows: dict[str, Any] = {}
    for name, of_parts in chunks.items():
        values, lengths = _concatenated(of_parts)
        rows[name] = values if lengths is None else (values, lengths)
    return rows


def check_part(path: Path) -> None:
    """Raises InputError where a part is missing or cut off: what it tells of itself comes last."""
    if not path.is_file():
        raise InputError(f"{path}: expected a part of a run's log, found none; make the run again")
    _read_part(path, [])


def _read_part(path: Path, names: list[str]) -> Any:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            table = file.read(columns=names)
    except (OSError, pa.ArrowException) as error:
        raise InputError(
            f"{path}: expected a Parquet part of a run's log, found a file that cannot be read "
            f"({str(error).splitlines()[0]}); make the run again"
        ) from error
    if missing := sorted(set(names) - set(table.column_names)):
        raise InputError(
            f"{path}: expected a column {missing[0]!r}, found none; the file is damaged, "
            "make the run again"
        )
    return table


def _numpy(arrow: Any, column: Column, ids: Mapping[str, int] | None) -> Array:
    if column.dtype != ID:
        plain: Array = arrow.to_numpy(zero_copy_only=False)
        return plain
    names = arrow.dictionary.to_pylist()
    known = names if ids is None else [ids[name] for name in names]
    array = np.array(known, dtype=_read_dtype(column, ids))
    taken: Array = array[arrow.indices.to_numpy(zero_copy_only=False)]
    return taken


def _no_rows(column: Column, ids: Mapping[str, int] | None) -> Array | Ragged:
    empty = np.zeros(0, dtype=_read_dtype(column, ids))
    return (empty, np.zeros(0, dtype=np.int32)) if column.ragged else empty


def _read_dtype(column: Column, ids: Mapping[str, int] | None) -> Any:
    if column.dtype == ID:
        return np.object_ if ids is None else np.int64
    return column.dtype


def padded(ragged: Ragged, fill: float = 0.0) -> tuple[Array, Array]:
    """Ragged rows as ([R, L] values, [R, L] mask), L the longest row; `fill` where masked."""
    flat, lengths = ragged
    longest = int(lengths.max(initial=0))
    mask = np.arange(longest) < lengths[:, None]
    values = np.full(mask.shape, fill, dtype=flat.dtype)
    values[mask] = flat
    return values, mask
