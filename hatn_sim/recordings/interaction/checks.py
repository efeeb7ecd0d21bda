"""What must hold of tracks in INTERACTION format; every fault is one line for the user."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hatn_sim.datatypes import DT_S, BoolArray, FloatArray, IntArray
from hatn_sim.errors import InputError

COLUMNS: Final = (
    "track_id", "frame_id", "timestamp_ms", "agent_type", "x", "y", "vx", "vy",
    "psi_rad", "length", "width",
)  # fmt: skip
CASE: Final = "case_id"
BODY: Final = ("psi_rad", "length", "width")
"""May be blank for pedestrians and bicycles, and missing from files of their own."""
NOT_READ: Final = ("track_to_predict", "interesting_agent")
"""Columns of the prediction challenges' files."""
STEP_MS: Final = 1000 * DT_S
LONGEST_M: Final = 80.0
FASTER_THAN_MPS: Final = 2.0
"""Speeds below this say nothing of units: positions are noisy."""
FEWEST_STEPS: Final = 20
MOST_STEPS: Final = 200_000
RATIO_BETWEEN: Final = (0.67, 1.5)
TURNED_RAD: Final = math.radians(60.0)
MOST_TURNED: Final = 0.1
"""Share of steps: some vehicles reverse."""
UNITS: Final = (
    (3.6, "km/h in vx, vy? divide them by 3.6"),
    (2.237, "miles an hour in vx, vy? multiply them by 0.447"),
    (3.281, "feet a second in vx, vy? multiply them by 0.3048"),
    (100.0, "cm/s in vx, vy? divide them by 100"),
    (0.01, "cm in x, y? divide them by 100"),
    (0.001, "mm in x, y? divide them by 1000"),
    (2.5, "25 Hz instead of 10? resample the tracks"),
    (3.0, "30 Hz instead of 10? resample the tracks"),
)


@dataclass(frozen=True, eq=False)
class Columns:
    """Rows of a file. The first may be the last one of the block before."""

    line: IntArray  # [R] in the file, the header is line 1
    track: IntArray  # [R] number of the track in the file, in order of appearance
    kind: IntArray  # [R] Kind
    values: Mapping[str, FloatArray]  # [R] by the column's name

    def __len__(self) -> int:
        return len(self.line)

    def last(self) -> Columns:
        """The last row."""
        values = {name: column[-1:] for name, column in self.values.items()}
        return Columns(self.line[-1:], self.track[-1:], self.kind[-1:], values)

    def after(self, before: Columns) -> Columns:
        """These rows with others before them."""
        return Columns(
            np.concatenate([before.line, self.line]),
            np.concatenate([before.track, self.track]),
            np.concatenate([before.kind, self.kind]),
            {
                name: np.concatenate([before.values[name], self.values[name]])
                for name in self.values
            },
        )


def check_header(path: Path, names: Sequence[str]) -> None:
    """Raises InputError where columns are missing, unknown or doubled."""
    is_own_file = path.name.startswith("pedestrian")
    needed = [name for name in COLUMNS if not (is_own_file and name in BODY)]
    missing = [name for name in needed if name not in names]
    extra = [name for name in names if name not in (*COLUMNS, CASE, *NOT_READ)]
    doubled = sorted({name for name in names if names.count(name) > 1})
    found = [
        f"{what} {', '.join(repr(name) for name in faults[:4])}"
        for what, faults in (("no", missing), ("unknown", extra), ("twice", doubled))
        if faults
    ]
    if found:
        raise InputError(
            f"{path}:1: expected the columns {','.join(COLUMNS)} of the INTERACTION format, found "
            f"{' and '.join(found)}; correct the header or give the right file"
        )


def check_numbers(path: Path, columns: Columns, may_be_blank: BoolArray) -> None:
    """Raises InputError where a number is blank, not finite, or cannot be what it should be.

    `may_be_blank` [R]: rows of pedestrians and bicycles, whose body need not be given.
    """
    for name, values in columns.values.items():
        wrong = ~np.isfinite(values)
        if name in BODY:
            wrong &= ~(may_be_blank & np.isnan(values))
        _refuse_first(path, columns, wrong, name, "a number")
        if name in ("frame_id", "timestamp_ms"):
            odd = (values != np.rint(values)) | ((name == "frame_id") & (np.abs(values) >= 2**31))
            _refuse_first(path, columns, odd, name, "a whole number")
        elif name == "psi_rad":
            far = np.abs(values) > 4 * math.pi  # not wrapped round a roundabout
            _refuse_first(path, columns, far, name, "radians within -4 pi and 4 pi", "degrees?")
        elif name in ("length", "width"):
            odd = (values <= 0) | (values > LONGEST_M)
            _refuse_first(
                path, columns, odd, name, f"metres above 0 and up to {LONGEST_M:g}", "another unit?"
            )


def _refuse_first(
    path: Path, columns: Columns, wrong: BoolArray, name: str, expected: str, hint: str = ""
) -> None:
    rows = np.flatnonzero(wrong)
    if len(rows):
        value = float(columns.values[name][rows[0]])
        found = "none" if math.isnan(value) else f"{value:g}"
        raise InputError(
            f"{path}:{columns.line[rows[0]]}: {name}: expected {expected}, found {found}; "
            + " ".join(filter(None, (hint, "correct the row")))
        )


def check_order(path: Path, columns: Columns, tracks: Sequence[str]) -> None:
    """Raises InputError where a track goes on after another one."""
    back = np.flatnonzero(np.diff(columns.track) < 0)
    if len(back):
        row = int(back[0]) + 1
        raise InputError(
            f"{path}:{columns.line[row]}: track {tracks[int(columns.track[row])]}: expected its "
            "rows together, found it again after another track; sort the file by track_id and "
            "frame_id"
        )


def check_steps(path: Path, columns: Columns, tracks: Sequence[str]) -> None:
    """Raises InputError where the rows of a track are not 100 ms and one frame apart."""
    frame, time_ms = columns.values["frame_id"], columns.values["timestamp_ms"]
    same = columns.track[1:] == columns.track[:-1]
    steps, steps_ms = np.diff(frame), np.diff(time_ms)
    wrong = np.flatnonzero(same & ((steps != 1) | (steps_ms != STEP_MS)))
    if not len(wrong):
        return
    row = int(wrong[0]) + 1
    step, step_ms = float(steps[row - 1]), float(steps_ms[row - 1])
    where = f"{path}:{columns.line[row]}: track {tracks[int(columns.track[row])]}"
    expected = f"expected frame {frame[row - 1] + 1:.0f} after {frame[row - 1]:.0f}"
    found = f"{expected}, found {frame[row]:.0f}"
    if step == 1 and step_ms > 0:
        raise InputError(
            f"{where}: expected {STEP_MS:g} ms from row to row (10 Hz), found {step_ms:g} ms "
            f"({1000 / step_ms:.3g} Hz); resample the tracks to 10 Hz"
        )
    if step == 0:
        raise InputError(f"{where}: {found} again; take the repeated row out")
    if step < 0 or step_ms <= 0:
        raise InputError(f"{where}: {found}; sort the rows by track_id and frame_id")
    if step_ms != step * STEP_MS:
        raise InputError(
            f"{where}: frame_id and timestamp_ms do not agree: {step:.0f} frames in {step_ms:g} ms,"
            f" expected {STEP_MS:g} ms each (10 Hz); correct the column that is wrong"
        )
    raise InputError(
        f"{where}: {found}: the track has a hole of {step - 1:.0f} frames; fill it, or give the "
        "rows behind it a track_id of their own"
    )


def check_clock(path: Path, columns: Columns, starts: IntArray, offset_ms: FloatArray) -> None:
    """Raises InputError where the time of a frame is not that of other tracks in its case.

    `starts` [K] are the first rows of tracks, `offset_ms` [K] the time of frame 0 in their cases.
    """
    frame, time_ms = columns.values["frame_id"][starts], columns.values["timestamp_ms"][starts]
    wrong = np.flatnonzero(time_ms - STEP_MS * frame != offset_ms)
    if len(wrong):
        first = wrong[0]
        expected = STEP_MS * frame[first] + offset_ms[first]
        raise InputError(
            f"{path}:{columns.line[starts[first]]}: frame_id and timestamp_ms do not agree: "
            f"expected frame {frame[first]:.0f} at {expected:.0f} ms as in the rows above, found "
            f"{time_ms[first]:.0f} ms; correct the column that is wrong"
        )


class MotionCheck:
    """Whether x, y move as vx, vy and psi_rad say: units, the true rate, the way angles run."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._ratios: list[NDArray[Any]] = []
        self._count = 0
        self._headed = 0
        self._turned = 0

    def add(self, columns: Columns) -> None:
        """Take account of the steps inside tracks, up to a bound."""
        if self._count >= MOST_STEPS:
            return
        x_m, y_m, vx, vy = (columns.values[name] for name in ("x", "y", "vx", "vy"))
        same = columns.track[1:] == columns.track[:-1]
        dx_m, dy_m = np.diff(x_m), np.diff(y_m)
        moved_mps = np.hypot(dx_m, dy_m) / DT_S
        speed_mps = np.hypot(vx, vy)
        said_mps = (speed_mps[1:] + speed_mps[:-1]) / 2.0
        moving = same & (np.maximum(moved_mps, said_mps) > FASTER_THAN_MPS)
        self._ratios.append(said_mps[moving] / np.maximum(moved_mps[moving], 1e-6))
        self._count += int(moving.sum())
        if "psi_rad" in columns.values:
            along = np.cos(columns.values["psi_rad"][1:] - np.arctan2(dy_m, dx_m))
            headed = same & (moved_mps > FASTER_THAN_MPS) & ~np.isnan(along)
            self._headed += int(headed.sum())
            self._turned += int((along[headed] < math.cos(TURNED_RAD)).sum())

    def finish(self) -> None:
        """Raises InputError where most of the speeds, or many of the headings, do not fit."""
        if self._count < FEWEST_STEPS:
            return
        ratio = float(np.median(np.concatenate(self._ratios)))
        if not RATIO_BETWEEN[0] <= ratio <= RATIO_BETWEEN[1]:
            hints = [hint for usual, hint in UNITS if abs(ratio / usual - 1.0) < 0.08]
            raise InputError(
                f"{self._path}: expected m/s in vx, vy at which x, y move in metres, found "
                f"{ratio:.3g} times that (median of {self._count} steps); "
                f"{hints[0] if hints else 'check the units and the rate'}"
            )
        if self._turned > MOST_TURNED * self._headed:
            raise InputError(
                f"{self._path}: expected psi_rad as x, y move, counter-clockwise from +x, found it "
                f"more than {math.degrees(TURNED_RAD):.0f} degrees off in "
                f"{self._turned / self._headed:.0%} of {self._headed} steps; clockwise, or from "
                "north? convert it"
            )
