"""Ten seconds of a log -> whole numbers. `data.js` reads them in the same order.

A chunk has R rows, one per vehicle and frame, by vehicle and then by frame. Its columns, one after
the other (d: first, dd: second differences along a vehicle's stretch of frames):

| numbers | content |
|---|---|
| 3 | frames, stretches S, rows R |
| S each | vehicle, first frame (within the chunk), frames of the stretch |
| R each | x (dd, 2 cm), y (dd), yaw (dd, 1/4096 turn), speed (d, 0.1 m/s), blinker (d) |
| 2 + L + 2 C | links L, changes C; closed at first; then frame (d) and link of each change |
| R each | flags (d; see `FLAGS`), line (d, 0: none), s on it (dd, 0.1 m), modes, slots |
| M, 6 M, 6 M | of each mode: percent, way points forward and left of the vehicle (dd, 0.1 m) |
| Q each | of each slot: the vehicle behind (d), percent + 1 (0: none), focus, type, length, |
|  | conflict x (d), y (d), the ego's way to it, that of the vehicle behind: all in 0.1 m |
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray
from hatn_sim.log import PART_FRAMES, PredictionTable, Run, TrackTable
from hatn_sim.report.page.lines import GRID_PER_M, LinesDriven
from hatn_sim.report.page.pack import first_differences, second_differences, varints

CHUNK_FRAMES: Final = 100
YAW_STEPS: Final = 4096
LEAST_CHANCE: Final = 0.05
WAY_POINTS: Final = slice(4, None, 5)
"""Of the 30 predicted frames: those at 0.5 s, 1 s ... 3 s."""
FLAGS: Final = {"fallback": 1, "adapted": 2, "has_conflict": 4, "predicted": 8}


@dataclass(frozen=True, eq=False)
class Rows:
    """A chunk's rows, ordered."""

    track: IntArray  # [R] rows of the run's tracks
    starts: BoolArray  # [R] a stretch starts here
    yaw: IntArray  # [R] in steps
    said: IntArray  # [R] row of the table of predictions, -1: none


def chunks(run: Run, origin_m: FloatArray, driven: LinesDriven) -> Iterator[bytes]:
    """The chunks of a run, one after the other."""
    tracks, closed = run.tracks, _signals(run)
    tables = run.prediction_parts(run.predictors[0]) if run.predictors else None
    table: PredictionTable | None = None
    for first in range(0, run.frame_count, CHUNK_FRAMES):
        if tables is not None and first % PART_FRAMES == 0:
            table = next(tables)
        last = min(first + CHUNK_FRAMES, run.frame_count)
        rows = _rows(tracks, table, first, last)
        yield varints(
            [
                *_stretches(tracks, rows, first, last),
                *_places(tracks, rows, origin_m),
                *_closed(closed[first:last]),
                *_said(tracks, table, rows, driven, origin_m),
            ]
        )


def _signals(run: Run) -> list[BoolArray]:
    return [frame.scene.signal_closed for frame in run.frames()]


def _rows(tracks: TrackTable, table: PredictionTable | None, first: int, last: int) -> Rows:
    begin, end = np.searchsorted(tracks.frame, [first, last])
    here = np.arange(begin, end)
    track = here[np.lexsort((tracks.frame[here], tracks.vehicle[here]))]
    vehicle, frame = tracks.vehicle[track], tracks.frame[track]
    starts = np.ones(len(track), dtype=np.bool_)
    starts[1:] = (np.diff(vehicle) != 0) | (np.diff(frame) != 1)
    yaw = np.rint(tracks.yaw_rad[track] * YAW_STEPS / (2.0 * np.pi)).astype(np.int64)
    # Unwrapped along each stretch, so that differences are small.
    turns = np.rint(first_differences(yaw, starts) / YAW_STEPS).astype(np.int64)
    turns[starts] = 0
    total = np.cumsum(turns)
    yaw -= YAW_STEPS * (total - total[np.flatnonzero(starts)[np.cumsum(starts) - 1]])
    said = np.full(len(track), -1)
    if table is not None and len(table.frame):
        key = table.frame * (tracks.vehicle.max() + 1) + table.vehicle
        order = np.argsort(key)
        wanted = frame * (tracks.vehicle.max() + 1) + vehicle
        at = np.minimum(np.searchsorted(key, wanted, sorter=order), len(key) - 1)
        said = np.where(key[order[at]] == wanted, order[at], -1)
    return Rows(track, starts, yaw, said)


def _stretches(tracks: TrackTable, rows: Rows, first: int, last: int) -> list[IntArray]:
    start = np.flatnonzero(rows.starts)
    count = np.diff(np.append(start, len(rows.track)))
    at = rows.track[start]
    sizes = np.array([last - first, len(start), len(rows.track)])
    return [sizes, tracks.vehicle[at], tracks.frame[at] - first, count]


def _places(tracks: TrackTable, rows: Rows, origin_m: FloatArray) -> list[IntArray]:
    xy = whole((tracks.xy_m[rows.track] - origin_m) * GRID_PER_M)
    return [
        second_differences(xy[:, 0], rows.starts),
        second_differences(xy[:, 1], rows.starts),
        second_differences(rows.yaw, rows.starts),
        first_differences(whole(tracks.speed_mps[rows.track] * 10.0), rows.starts),
        first_differences(tracks.blinker[rows.track], rows.starts),
    ]


def _closed(frames: list[BoolArray]) -> list[IntArray]:
    """Which links may not be entered at first, and what changes."""
    links = min(len(frame) for frame in frames)
    closed = np.array([frame[:links] for frame in frames])
    frame, link = np.nonzero(closed[1:] != closed[:-1])
    starts = np.arange(len(frame)) == 0
    return [
        np.array([links, len(frame)]),
        closed[0].astype(np.int64),
        first_differences(frame + 1, starts),
        link,
    ]


def _said(
    tracks: TrackTable,
    table: PredictionTable | None,
    rows: Rows,
    driven: LinesDriven,
    origin_m: FloatArray,
) -> list[IntArray]:
    line = driven.line[rows.track] + 1
    new_line = rows.starts.copy()
    new_line[1:] |= np.diff(line) != 0
    lines = [
        first_differences(line, rows.starts),
        second_differences(whole(driven.s_m[rows.track] * 10.0), new_line),
    ]
    row = np.flatnonzero(rows.said >= 0)
    flags, modes, slots = (np.zeros(len(rows.track), dtype=np.int64) for _ in range(3))
    if table is None or not len(row):
        return [flags, *lines, modes, slots]
    at = rows.said[row]
    flags[row] = FLAGS["predicted"]
    for name in ("fallback", "adapted", "has_conflict"):
        flags[row] += FLAGS[name] * getattr(table, name)[at]
    kept = table.mode_probability[at] >= LEAST_CHANCE
    modes[row] = kept.sum(axis=1)
    slots[row] = table.slot_mask[at].sum(axis=1)
    return [
        first_differences(flags, rows.starts),
        *lines,
        modes,
        slots,
        *_modes(tracks, table, rows, row, kept),
        *_slots(table, at, origin_m),
    ]


def _modes(
    tracks: TrackTable, table: PredictionTable, rows: Rows, row: IntArray, kept: BoolArray
) -> list[IntArray]:
    at = rows.said[row]
    which, mode = np.nonzero(kept)
    now_m = tracks.xy_m[rows.track[row]][which]
    away_m = table.xy_m[at[which], mode][:, WAY_POINTS] - now_m[:, None]
    yaw_rad = rows.yaw[row][which][:, None] * (2.0 * np.pi / YAW_STEPS)
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    forward_m = cos * away_m[..., 0] + sin * away_m[..., 1]
    left_m = cos * away_m[..., 1] - sin * away_m[..., 0]
    starts = np.zeros(forward_m.shape, dtype=np.bool_)
    starts[:, 0] = True
    return [
        np.rint(100.0 * table.mode_probability[at[which], mode]).astype(np.int64),
        second_differences(whole(forward_m * 10.0).ravel(), starts.ravel()),
        second_differences(whole(left_m * 10.0).ravel(), starts.ravel()),
    ]


def _slots(table: PredictionTable, at: IntArray, origin_m: FloatArray) -> list[IntArray]:
    which, node = np.nonzero(table.slot_mask[at])
    place = at[which], node
    told = table.has_slot_probability[place[0]] & table.slot_in_focus[place]
    chance = np.rint(100.0 * table.slot_probability[place]).astype(np.int64)
    conflict = whole((table.conflict_xy_m[place] - origin_m) * 10.0)
    # Without a conflict there is no place for it.
    conflict[~table.has_conflict[place[0]]] = 0
    once = np.arange(len(which)) == 0
    return [
        first_differences(table.slot_vehicle[place], once),
        np.where(told, chance + 1, 0),
        table.slot_in_focus[place].astype(np.int64),
        table.conflict_type[place],
        whole(table.slot_length_m[place] * 10.0),
        first_differences(conflict[:, 0], once),
        first_differences(conflict[:, 1], once),
        whole(table.ego_to_conflict_m[place] * 10.0),
        whole(table.rear_to_conflict_m[place] * 10.0),
    ]


def whole(values: FloatArray) -> IntArray:
    """Rounded; what is not finite is 0, what is beyond all maps is cut."""
    return np.rint(np.clip(np.nan_to_num(values), -1e9, 1e9)).astype(np.int64)
