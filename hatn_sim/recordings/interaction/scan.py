"""The files of one recording in INTERACTION format, read through once: checked and sorted by time.

Rows are sorted by track in the files, so nothing can be played before the last row is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, IntArray, Kind, Lane
from hatn_sim.errors import InputError
from hatn_sim.recordings.fit import check_place, distance_to_lanes_m
from hatn_sim.recordings.interaction.files import Recorded, among, read_ids
from hatn_sim.recordings.interaction.spool import Spool
from hatn_sim.recordings.interaction.table import MOVING_MPS, InteractionTable, Rows
from hatn_sim.recordings.lanelet2.rules import MOTOR

BUCKET_FRAMES: Final = 600
BUCKET_PARTS: Final = 256
FAR_M: Final = 30.0
"""Road users further than this from the middle of every lane are off the map."""
FAR_SHARE: Final = 0.2
BESIDE_M: Final = 2.0
"""Drivers cut corners, but at the median they are nearer than this to the middle of a lane."""
LOOK_EVERY_FRAMES: Final = 10
MOST_PLACES: Final = 100_000


@dataclass(frozen=True, eq=False)
class Part:
    """A recording, or a case of a file with cases."""

    name: str  # of the case; empty for a recording
    first_frame: int
    last_frame: int
    zero_ms: float  # the time of its frame 0


@dataclass(frozen=True, eq=False)
class Scan:
    """What was found; the rows are in the spool, their track and part as numbered here."""

    track_names: list[str]
    track_part: IntArray
    parts: list[Part]
    cases: list[str]  # of the files, where some were to be chosen
    doubts: list[str]  # whether the map fits


def scan(
    recorded: Recorded, cases: Sequence[str], lanes: Sequence[Lane], map_path: Path, spool: Spool
) -> Scan:
    """Read the files of a recording into a spool, bucket by bucket in order of time.

    `cases` names those wanted of a file with cases; empty: all.

    Raises:
        InputError: the files are at fault, or their road users are not on the map.
    """
    names_of = read_ids(recorded.ids_path)
    track_names: list[str] = []
    track_part: list[int] = []
    parts: list[Part] = []
    seen: list[str] = []
    doubts: list[str] = []
    is_wanted = among(cases) if cases else None
    for path in recorded.paths:
        table = InteractionTable(path, is_wanted)
        first = np.zeros(0, dtype=np.int64)
        last = np.zeros(0, dtype=np.int64)
        places: list[FloatArray] = [np.zeros((0, 4))]
        for rows in table.rows():
            first, last = _spans(first, last, rows, len(table.parts))
            if sum(len(some) for some in places) < MOST_PLACES:
                places.append(_places(rows))
            rows["track"] += len(track_names)
            buckets = rows["part"] // BUCKET_PARTS if table.has_cases else (
                rows["frame"] // BUCKET_FRAMES
            )  # fmt: skip
            spool.add(buckets.astype(np.int64), rows)
        if path == recorded.paths[0]:
            # Of pedestrians, who are read after the vehicles, there may be none.
            _check_tracks(path, table, len(recorded.paths))
        doubts += _check_places(path, map_path, lanes, np.concatenate(places))
        parts = _merged(path, parts, table, first, last)
        taken = set(track_names)
        # Pedestrians may be numbered as vehicles are.
        ids = [names_of.get(name, name) for name in table.track_ids]
        track_names += [f"P{name}" if name in taken else name for name in ids]
        track_part += table.track_parts
        seen += table.cases
    return Scan(track_names, np.array(track_part, dtype=np.int64), parts, seen, doubts)


def _check_tracks(path: Path, table: InteractionTable, files: int) -> None:
    if not table.track_ids and not table.cases:
        raise InputError(f"{path}: expected tracks, found none; give a file with rows")
    if table.has_cases and files > 1:
        raise InputError(
            f"{path}: expected cases with their pedestrians in one file, found {files} files of "
            "one recording; join them"
        )


def _spans(first: IntArray, last: IntArray, rows: Rows, count: int) -> tuple[IntArray, IntArray]:
    """The first and last frame of every part, widened by rows."""
    more = count - len(first)
    first = np.concatenate([first, np.full(more, np.iinfo(np.int64).max)])
    last = np.concatenate([last, np.full(more, np.iinfo(np.int64).min)])
    np.minimum.at(first, rows["part"], rows["frame"])
    np.maximum.at(last, rows["part"], rows["frame"])
    return first, last


def _merged(
    path: Path, parts: Sequence[Part], table: InteractionTable, first: IntArray, last: IntArray
) -> list[Part]:
    """The parts of a file; pedestrians have the clock of the vehicles read before."""
    found = [
        Part(name, int(first[k]), int(last[k]), table.zero_ms[k])
        for k, name in enumerate(table.parts)
    ]
    if not parts or not found:
        return list(parts) or found
    (one,), (other,) = parts, found
    if one.zero_ms != other.zero_ms:
        raise InputError(
            f"{path}: expected frame 0 at {one.zero_ms:g} ms as with the vehicles, found it at "
            f"{other.zero_ms:g} ms; correct timestamp_ms or frame_id"
        )
    start, end = min(one.first_frame, other.first_frame), max(one.last_frame, other.last_frame)
    return [Part(one.name, start, end, one.zero_ms)]


def _places(rows: Rows) -> FloatArray:
    """Where drivers are, once a second, and which of these places motor vehicles drive through."""
    some = rows[(rows["frame"] % LOOK_EVERY_FRAMES == 0) & (rows["kind"] != Kind.PEDESTRIAN)]
    # Who is parked stands anywhere, for as long as is recorded.
    drives = np.isin(some["kind"], list(MOTOR)) & (some["speed_mps"] >= MOVING_MPS)
    return np.stack((some["x_m"], some["y_m"], some["yaw_rad"], drives.astype(np.float64)), axis=1)


def _check_places(
    path: Path, map_path: Path, lanes: Sequence[Lane], places: FloatArray
) -> list[str]:
    """A notice where places are beside the lanes. Raises InputError where they are off the map."""
    if not len(places):
        return []
    xy_m = places[:, :2]
    far_m = distance_to_lanes_m(lanes, xy_m)
    share = float((far_m > FAR_M).mean())
    if share > FAR_SHARE:
        on_map = np.median(np.concatenate([lane.xy_m for lane in lanes]), axis=0)
        middle = np.median(xy_m, axis=0)
        raise InputError(
            f"{path}: expected vehicles on the map {map_path}, found {share:.0%} of their places "
            f"more than {FAR_M:g} m from every lane (median {np.median(far_m):.0f} m, the farthest "
            f"{far_m.max():.0f} m; tracks around ({middle[0]:.0f}, {middle[1]:.0f}), lanes around "
            f"({on_map[0]:.0f}, {on_map[1]:.0f})): map and tracks seem not to belong together; "
            "give the map of this place"
        )
    drives = places[:, 3] > 0.0
    doubt = check_place(path, map_path, lanes, xy_m[drives], places[drives, 2])
    if doubt:
        return [doubt]
    median_m = float(np.median(far_m[drives] if drives.any() else far_m))
    if median_m <= BESIDE_M:
        return []
    return [
        f"{path.name}: vehicles are {median_m:.1f} m from the middle of the nearest lane at the "
        f"median: is {map_path.name} the map of this place, and in its place?"
    ]
