"""One file of tracks in INTERACTION format -> checked rows, block by block, in bounded memory.

Columns: `track_id, frame_id, timestamp_ms, agent_type, x, y, vx, vy, psi_rad, length, width`, in
version 1.2 after a `case_id`. Rows are sorted by track, 100 ms from one to the next.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Kind
from hatn_sim.errors import InputError
from hatn_sim.recordings.interaction_checks import (
    BODY,
    CASE,
    COLUMNS,
    Columns,
    SpeedCheck,
    check_clock,
    check_header,
    check_numbers,
    check_steps,
)

ROW: Final = np.dtype(
    [
        ("part", np.int32),  # number of the case in its file, in order of appearance
        ("frame", np.int32),
        ("track", np.int32),  # number of the track in its file
        ("kind", np.int8),
        ("x_m", np.float64),
        ("y_m", np.float64),
        ("yaw_rad", np.float64),
        ("speed_mps", np.float64),
        ("length_m", np.float64),
        ("width_m", np.float64),
    ]
)
"""A road user at a moment."""
Rows = NDArray[Any]
"""[R] of `ROW`."""

KIND_OF_AGENT: Final[Mapping[str, Kind]] = {
    "car": Kind.CAR,
    "van": Kind.VAN,
    "truck": Kind.LORRY,
    "bus": Kind.BUS,
    "motorcycle": Kind.MOTORCYCLE,
    "bicycle": Kind.BICYCLE,
    "tram": Kind.TRAM,
    "pedestrian/bicycle": Kind.PEDESTRIAN,
    "pedestrian": Kind.PEDESTRIAN,
}
"""Other agent types are Kind.OTHER."""
DEFAULT_SIZE_M: Final[Mapping[Kind, tuple[float, float]]] = {
    Kind.PEDESTRIAN: (0.5, 0.5),
    Kind.BICYCLE: (1.8, 0.6),
}
"""(length, width) where the file leaves them blank; only these kinds may be blank."""
MOVING_MPS: Final = 0.3
"""Below this a heading cannot be told from the velocity."""
BLOCK_BYTES: Final = 4 << 20
_TEXTS: Final = (CASE, "track_id", "agent_type")
_NUMBERS: Final = tuple(name for name in COLUMNS if name not in _TEXTS)
_LONGEST_HEADER: Final = 4096


class InteractionTable:
    """A file, to be read once from its beginning to its end.

    While `rows` runs, `track_ids` and `track_parts` grow by track number, and `parts` (the names
    of the cases; a single empty name where the file knows none) and `zero_ms` (the time of frame 0)
    by part number.
    """

    def __init__(self, path: Path, wants: Callable[[str], bool] | None = None) -> None:
        """`wants` tells of a case whether it is to be read.

        Raises InputError where the file cannot be read or has other columns.
        """
        self.path = path
        self._names = _read_header(path)
        check_header(path, self._names)
        self.has_cases = CASE in self._names
        self._wants = wants
        self.track_ids: list[str] = []
        self.track_parts: list[int] = []
        self.parts: list[str] = []
        self.cases: dict[str, None] = {}  # seen while choosing among them, in order
        self._part_of: dict[str, int] = {}
        self._track_of: dict[tuple[int, str], int] = {}
        self.zero_ms: list[float] = []

    def rows(self) -> Iterator[Rows]:
        """The rows in the file's order. Raises InputError where they are at fault."""
        speeds = SpeedCheck(self.path)
        line = 2
        last: Columns | None = None
        held_yaw = 0.0
        for batch in self._batches():
            lines = np.arange(line, line + len(batch))
            line += len(batch)
            texts = {
                name: self._texts(batch, name, lines) for name in _TEXTS if name in self._names
            }
            values = {
                name: batch.column(name).to_numpy(zero_copy_only=False)
                for name in _NUMBERS
                if name in self._names
            }
            if CASE in texts and self._wants is not None:
                names, codes = texts[CASE]
                self.cases.update(dict.fromkeys(names))
                keep = np.array([self._wants(name) for name in names], dtype=np.bool_)[codes]
                if not keep.any():
                    continue
                lines = lines[keep]
                values = {name: column[keep] for name, column in values.items()}
                texts = {name: (names, codes[keep]) for name, (names, codes) in texts.items()}
            names, codes = texts["agent_type"]
            kind = np.array([KIND_OF_AGENT.get(n.lower(), Kind.OTHER) for n in names])[codes]
            previous = -1 if last is None else int(last.track[-1])
            track, starts = self._numbered(lines, texts, previous, values)
            block = Columns(lines, track, values)
            check_numbers(self.path, block, np.isin(kind, list(DEFAULT_SIZE_M)))
            joined = block if last is None else _joined(last, block)
            check_steps(self.path, joined, self.track_ids)
            self._check_clocks(block, starts)
            speeds.add(joined)
            last = _tail(block)
            rows = self._made(block, kind, starts, held_yaw)
            held_yaw = float(rows["yaw_rad"][-1])
            yield rows
        if last is None and not self.cases:
            raise InputError(f"{self.path}: expected tracks, found none; give a file with rows")
        speeds.finish()

    def _batches(self) -> Iterator[Any]:
        text = pa.dictionary(pa.int32(), pa.string())
        types = dict.fromkeys(_TEXTS, text) | dict.fromkeys(_NUMBERS, pa.float64())
        try:
            reader = pyarrow.csv.open_csv(
                self.path,
                read_options=pyarrow.csv.ReadOptions(block_size=BLOCK_BYTES, use_threads=False),
                convert_options=pyarrow.csv.ConvertOptions(
                    column_types=types,
                    null_values=["", "nan", "NaN", "null", "None"],
                    strings_can_be_null=True,
                ),
            )
            with reader:
                for batch in reader:
                    if len(batch):
                        yield batch
        except pa.ArrowInvalid as error:
            raise self._unreadable(str(error)) from error
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error}; correct the path") from error

    def _unreadable(self, said: str) -> InputError:
        """What the reader of the table says, as a line of ours."""
        row = re.search(r"Row #(\d+)", said)
        where = f"{self.path}:{row[1]}" if row else str(self.path)
        value = re.search(r"CSV column #(\d+): .*error to \w+: (?:invalid value )?(.*)", said)
        if value is not None and int(value[1]) < len(self._names):
            name = self._names[int(value[1])]
            expected = "UTF-8 text" if name in _TEXTS else "a number"
            return InputError(f"{where}: {name}: expected {expected}, found {value[2][:80]}")
        count = re.search(r"Expected (\d+) columns, got (\d+)", said)
        if count is not None:
            return InputError(
                f"{where}: expected {count[1]} columns, found {count[2]}; correct the row, or "
                "copy the file again if it is cut off here"
            )
        reason = said.splitlines()[0][:120]
        return InputError(f"{where}: expected CSV, cannot be read: {reason}; correct the file")

    def _texts(self, batch: Any, name: str, lines: IntArray) -> tuple[list[str], IntArray]:
        """Distinct texts of a column and the index [R] of every row's; numbers without `.0`."""
        column = batch.column(name)
        if column.null_count:
            row = int(np.flatnonzero(column.is_null().to_numpy(zero_copy_only=False))[0])
            raise InputError(
                f"{self.path}:{lines[row]}: {name}: expected a name, found none; fill it in"
            )
        names = [str(value).strip() for value in column.dictionary.to_pylist()]
        whole = [re.sub(r"^(\d+)\.0+$", r"\1", text) for text in names]
        return whole, column.indices.to_numpy().astype(np.int64)

    def _numbered(
        self,
        lines: IntArray,
        texts: Mapping[str, tuple[list[str], IntArray]],
        previous: int,
        values: Mapping[str, FloatArray],
    ) -> tuple[IntArray, IntArray]:
        """The track [R] of every row and the rows [K] at which new tracks begin."""
        ids, id_codes = texts["track_id"]
        cases, case_codes = texts.get(CASE, ([""], np.zeros(len(lines), dtype=np.int64)))
        codes = case_codes * len(ids) + id_codes
        first = np.concatenate([[0], np.flatnonzero(np.diff(codes)) + 1])
        counts = np.diff([*first.tolist(), len(codes)])
        numbers: list[int] = []
        new: list[int] = []
        for row in first.tolist():
            part = self._part(cases[case_codes[row]], row, values)
            key = (part, ids[id_codes[row]])
            number = self._track_of.get(key)
            if number is None:
                number = len(self.track_ids)
                self._track_of[key] = number
                self.track_ids.append(key[1])
                self.track_parts.append(part)
                new.append(row)
            elif number != previous:
                raise InputError(
                    f"{self.path}:{lines[row]}: track {key[1]}: expected its rows together, found "
                    "it again after another track; sort the file by track_id and frame_id"
                )
            numbers.append(number)
            previous = number
        return np.repeat(numbers, counts), np.array(new, dtype=np.int64)

    def _part(self, case: str, row: int, values: Mapping[str, FloatArray]) -> int:
        if case not in self._part_of:
            self._part_of[case] = len(self.parts)
            self.parts.append(case)
            frame, time_ms = values["frame_id"][row], values["timestamp_ms"][row]
            self.zero_ms.append(float(time_ms - 100.0 * frame))
        return self._part_of[case]

    def _check_clocks(self, block: Columns, starts: IntArray) -> None:
        parts = [self.track_parts[track] for track in block.track[starts].tolist()]
        offset_ms = np.array(self.zero_ms)[parts] if parts else np.zeros(0)
        check_clock(self.path, block, starts, offset_ms)

    def _made(self, block: Columns, kind: NDArray[Any], starts: IntArray, held_yaw: float) -> Rows:
        values = block.values
        rows: Rows = np.zeros(len(block.line), dtype=ROW)
        rows["part"] = np.array(self.track_parts)[block.track]
        rows["frame"] = values["frame_id"]
        rows["track"] = block.track
        rows["kind"] = kind
        rows["x_m"], rows["y_m"] = values["x"], values["y"]
        rows["speed_mps"] = np.hypot(values["vx"], values["vy"])
        blank = np.full(len(rows), np.nan)
        yaw, length, width = (values.get(name, blank) for name in BODY)
        held = _held_yaw(values["vx"], values["vy"], starts, held_yaw)
        rows["yaw_rad"] = np.where(np.isnan(yaw), held, _wrapped(yaw))
        for axis, (name, size) in enumerate((("length_m", length), ("width_m", width))):
            usual = np.ones(len(Kind))
            for other, size_m in DEFAULT_SIZE_M.items():
                usual[other] = size_m[axis]
            rows[name] = np.where(np.isnan(size), usual[kind], size)
        return rows


def _read_header(path: Path) -> list[str]:
    try:
        with path.open("rb") as file:
            line = file.readline(_LONGEST_HEADER)
        text = line.decode("utf-8-sig").strip()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; correct the path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected CSV, found no text; give the right file") from error
    if not text:
        raise InputError(f"{path}: expected CSV with a header, found an empty file or line")
    return [name.strip().strip('"') for name in text.split(",")]


def _tail(block: Columns) -> Columns:
    values = {name: column[-1:] for name, column in block.values.items()}
    return Columns(block.line[-1:], block.track[-1:], values)


def _joined(last: Columns, block: Columns) -> Columns:
    return Columns(
        np.concatenate([last.line, block.line]),
        np.concatenate([last.track, block.track]),
        {name: np.concatenate([last.values[name], block.values[name]]) for name in block.values},
    )


def _held_yaw(vx: FloatArray, vy: FloatArray, starts: IntArray, held_yaw: float) -> FloatArray:
    """Direction of motion [R]; while standing the last one, at first 0. `held_yaw`: from before."""
    count = len(vx)
    moving: BoolArray = np.hypot(vx, vy) >= MOVING_MPS
    yaw = np.where(moving, np.arctan2(vy, vx), 0.0)
    known = moving.copy()
    known[starts] = True
    last = np.maximum.accumulate(np.where(known, np.arange(count), -1))
    return np.where(last < 0, held_yaw, yaw[last])


def _wrapped(yaw_rad: FloatArray) -> FloatArray:
    """Angles in (-pi, pi]; those that are there stay as they are, to the last bit."""
    outside = (yaw_rad <= -np.pi) | (yaw_rad > np.pi)
    return np.where(outside, np.pi - (np.pi - yaw_rad) % (2 * np.pi), yaw_rad)
