"""The tracks of a run in INTERACTION format, with its road as a Lanelet2 map.

`vehicle_tracks_000.csv`, `pedestrian_tracks_000.csv` (pedestrians and bicycles) and `map.osm`. The
format names tracks by numbers: other names are in `vehicle_ids_000.csv` beside them. A vehicle that
was away for a while is two tracks of the same name. Colours, blinkers and signals have no place in
the format.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, IntArray, Kind
from hatn_sim.log import Run, TrackTable
from hatn_sim.log.road_file import ROAD_FILE, read_road
from hatn_sim.recordings.interaction.checks import COLUMNS, STEP_MS
from hatn_sim.recordings.interaction.files import ID_COLUMNS
from hatn_sim.recordings.interaction.table import KIND_OF_AGENT
from hatn_sim.recordings.lanelet2.writer import write_lanelet2
from hatn_sim.whole_file import save_csv

VEHICLES_FILE: Final = "vehicle_tracks_000.csv"
PEDESTRIANS_FILE: Final = "pedestrian_tracks_000.csv"
IDS_FILE: Final = "vehicle_ids_000.csv"
MAP_FILE: Final = "map.osm"
AGENT_OF_KIND: Final[Mapping[Kind, str]] = {
    **{kind: agent for agent, kind in KIND_OF_AGENT.items()},
    Kind.OTHER: "other",
}
ON_FOOT_OR_BICYCLE: Final = (Kind.PEDESTRIAN, Kind.BICYCLE)


def export_interaction(run: Run, folder: Path) -> tuple[Path, ...]:
    """Write the files into a folder that is there; their paths, the tracks first, the map last.

    Raises:
        InputError: the run is damaged.
    """
    tracks = run.tracks
    first_frame = max(1, round(float(run.times_s[0]) / DT_S)) if run.frame_count else 1
    pieces = _pieces(tracks)
    names = [run.ids[tracks.vehicle[rows[0]]] for rows in pieces]
    numbers = names if _are_numbers(names) else [str(k + 1) for k in range(len(names))]
    light = [Kind(tracks.kind[rows[0]]) in ON_FOOT_OR_BICYCLE for rows in pieces]
    track_ids = [f"P{n}" if is_light else n for n, is_light in zip(numbers, light, strict=True)]

    files = [folder / VEHICLES_FILE]
    _write_tracks(files[0], tracks, first_frame, _chosen(track_ids, pieces, light, False))
    if any(light):
        files.append(folder / PEDESTRIANS_FILE)
        _write_tracks(files[1], tracks, first_frame, _chosen(track_ids, pieces, light, True))
    if track_ids != names:
        files.append(folder / IDS_FILE)
        save_csv(files[-1], [ID_COLUMNS, *zip(track_ids, names, strict=True)])
    files.append(folder / MAP_FILE)
    write_lanelet2(files[-1], read_road(run.path / ROAD_FILE))
    return tuple(files)


def _pieces(tracks: TrackTable) -> list[IntArray]:
    """The rows of every vehicle in order of time, cut where it is away."""
    order = np.lexsort((tracks.frame, tracks.vehicle))
    cut = (np.diff(tracks.vehicle[order]) != 0) | (np.diff(tracks.frame[order]) != 1)
    pieces = np.split(order, np.flatnonzero(cut) + 1)
    return [rows for rows in pieces if len(rows)]


def _are_numbers(names: Sequence[str]) -> bool:
    """Whether the names are track numbers as they are, and none is there twice."""
    plain = all(name.isdecimal() and name == str(int(name)) for name in names)
    return plain and len(set(names)) == len(names)


def _chosen(
    track_ids: Sequence[str], pieces: Sequence[IntArray], light: Sequence[bool], wanted: bool
) -> list[tuple[str, IntArray]]:
    return [
        (name, rows)
        for name, rows, is_light in zip(track_ids, pieces, light, strict=True)
        if is_light is wanted
    ]


def _write_tracks(
    path: Path, tracks: TrackTable, first_frame: int, pieces: Sequence[tuple[str, IntArray]]
) -> None:
    """Rows with numbers to the last digit; the velocity is along the yaw."""
    vx = tracks.speed_mps * np.cos(tracks.yaw_rad)
    vy = tracks.speed_mps * np.sin(tracks.yaw_rad)
    numbers = np.column_stack((tracks.xy_m, vx, vy, tracks.yaw_rad, tracks.size_m))
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(COLUMNS) + "\n")
        for name, rows in pieces:
            for row, values in zip(rows.tolist(), numbers[rows].tolist(), strict=True):
                frame = first_frame + int(tracks.frame[row])
                agent = AGENT_OF_KIND[Kind(tracks.kind[row])]
                texts = ",".join(map(repr, values))
                file.write(f"{name},{frame},{frame * STEP_MS:.0f},{agent},{texts}\n")
