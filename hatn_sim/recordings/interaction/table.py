"""One file of tracks in INTERACTION format -> checked rows, block by block, in bounded memory.

Columns: `track_id, frame_id, timestamp_ms, agent_type, x, y, vx, vy, psi_rad, length, width`, in
version 1.2 after a `case_id`; between them commas, semicolons or tabs. Rows are sorted by track,
100 ms from one to the next; a file whose first block is sorted otherwise (by frame) is sorted here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Kind
from hatn_sim.errors import InputError
from hatn_sim.recordings.interaction.checks import (
    BODY,
    CASE,
    COLUMNS,
    Columns,
    MotionCheck,
    check_clock,
    check_header,
    check_numbers,
    check_order,
    check_steps,
)
from hatn_sim.recordings.interaction.order import by_track

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
_DELIMITERS: Final = ",;\t"


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
        self._names, self._delimiter = _read_header(path)
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
        """The rows track by track, in each by frame. Raises InputError where they are at fault."""
        motion = MotionCheck(self.path)
        last: Columns | None = None
        held_yaw = 0.0
        for block in self._in_order():
            joined = block if last is None else block.after(last)
            check_order(self.path, joined, self.track_ids)
            check_steps(self.path, joined, self.track_ids)
            previous = -1 if last is None else int(last.track[0])
            starts = np.flatnonzero(np.diff(block.track, prepend=previous))
            self._check_clocks(block, starts)
            motion.add(joined)
            last = block.last()
            rows = self._made(block, starts, held_yaw)
            held_yaw = float(rows["yaw_rad"][-1])
            yield rows
        motion.finish()

    def _in_order(self) -> Iterator[Columns]:
        """The blocks, sorted where the first shows that they have to be."""
        blocks = self._blocks()
        first = next(blocks, None)
        if first is None:
            return iter(())
        is_sorted = bool((np.diff(first.track) >= 0).all())
        blocks = chain((first,), blocks)
        return blocks if is_sorted else by_track(blocks)

    def _blocks(self) -> Iterator[Columns]:
        """The rows that are wanted, in the file's order, their tracks numbered as they appear."""
        line = 2
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
            block = Columns(lines, self._numbered(texts, values), kind, values)
            check_numbers(self.path, block, np.isin(kind, list(DEFAULT_SIZE_M)))
            yield block

    def _batches(self) -> Iterator[Any]:
        text = pa.dictionary(pa.int32(), pa.string())
        types = dict.fromkeys(_TEXTS, text) | dict.fromkeys(_NUMBERS, pa.float64())
        try:
            reader = pyarrow.csv.open_csv(
                self.path,
                # By the names as they were read, without blanks around them.
                read_options=pyarrow.csv.ReadOptions(
                    block_size=BLOCK_BYTES,
                    use_threads=False,
                    column_names=self._names,
                    skip_rows=1,
                ),
                parse_options=pyarrow.csv.ParseOptions(delimiter=self._delimiter),
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
        texts: Mapping[str, tuple[list[str], IntArray]],
        values: Mapping[str, FloatArray],
    ) -> IntArray:
        """The track [R] of every row."""
        ids, id_codes = texts["track_id"]
        cases, case_codes = texts.get(CASE, ([""], np.zeros(len(id_codes), dtype=np.int64)))
        codes, first, which = np.unique(
            case_codes * len(ids) + id_codes, return_index=True, return_inverse=True
        )
        numbers = np.empty(len(codes), dtype=np.int64)
        for place in np.argsort(first).tolist():
            row = int(first[place])
            part = self._part(cases[case_codes[row]], row, values)
            key = (part, ids[id_codes[row]])
            if key not in self._track_of:
                self._track_of[key] = len(self.track_ids)
                self.track_ids.append(key[1])
                self.track_parts.append(part)
            numbers[place] = self._track_of[key]
        return numbers[which]

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

    def _made(self, block: Columns, starts: IntArray, held_yaw: float) -> Rows:
        values, kind = block.values, block.kind
        rows: Rows = np.zeros(len(block), dtype=ROW)
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


def _read_header(path: Path) -> tuple[list[str], str]:
    """The names of the columns, and what stands between them."""
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
    delimiter = max(_DELIMITERS, key=text.count)
    return [name.strip().strip("\"'").strip() for name in text.split(delimiter)], delimiter


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
