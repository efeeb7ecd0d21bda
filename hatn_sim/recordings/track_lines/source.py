"""Recorded tracks with reference lines from the tracks of other recordings of the same place.

A recording under test never has a part in its own lines.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.config import DrawnLines, RecordedSource, Scenario
from hatn_sim.content import content_hash
from hatn_sim.datatypes import Lane
from hatn_sim.errors import InputError
from hatn_sim.recordings.fit import check_place
from hatn_sim.recordings.interaction.files import Recorded, group_files
from hatn_sim.recordings.interaction.table import InteractionTable
from hatn_sim.recordings.maps import read_lanes
from hatn_sim.recordings.track_lines.kept import file_of, read_kept, write_kept
from hatn_sim.recordings.track_lines.lanes import PREFIX, lanes_from_paths
from hatn_sim.recordings.track_lines.paths import Path as DrivenPath
from hatn_sim.recordings.track_lines.paths import driven_path
from hatn_sim.recordings.track_lines.read import read_tracks

FEWEST_VEHICLES: Final = 40
"""With fewer in the other recordings, `auto` keeps to the lanes of the map."""
_WHERE: Final = ("xy_m", "yaw_rad")
_Stamp = tuple[Path, int, int]
"""A file as it is now: its path, time and size."""


@dataclass(frozen=True)
class Drawing:
    """Where lines that were drawn are kept and found again, and who is told how far they are."""

    keep: Path | None = None  # a folder; None: nowhere
    tell: Callable[[int, int, str], object] = lambda done, total, words: None


def other_recordings(scenario: Scenario) -> list[str]:
    """Names of the recordings in the files of a scene that are not among those it shows."""
    source = scenario.recorded
    if source is None or _without_recordings(source):
        return []
    shown = {one.name for one in group_files(source.tracks, source.recordings)}
    return [one.name for one in group_files(source.tracks, ()) if one.name not in shown]


def with_track_lines(
    scenario: Scenario, others: Sequence[str], lines: str = "auto", drawing: Drawing | None = None
) -> Scenario:
    """The scene with lines drawn from the tracks of other recordings among its files.

    Those that the scene shows are left out if they are among `others`, copies of their files under
    other names as well. With "auto" the scene keeps
    the lanes of its map, and says so in a notice, where there is too little to draw lines from;
    what are no INTERACTION tracks stays as it is. With "lanes" nothing changes. Lines drawn once
    from the same files are kept, and beyond this process where `drawing` says.

    Raises:
        InputError: files are at fault; with "tracks" also where no lines can be drawn.
    """
    source = scenario.recorded
    if lines == "lanes" or (lines == "auto" and (source is None or _why_not(source))):
        return scenario
    if source is None:
        raise InputError(
            f"{scenario.name}: lines from tracks are for recorded tracks; leave --lines-from out"
        )
    reason = _why_not(source)
    if reason:
        raise InputError(f"{source.tracks[0]}: {reason}; leave --lines-from tracks out")
    shown = group_files(source.tracks, source.recordings)
    wanted = set(others) - {one.name for one in shown}
    own = {content_hash(one.paths[0]) for one in shown}  # of vehicles; pedestrians may be none
    by_others = [
        one
        for one in group_files(source.tracks, ())
        if one.name in wanted and content_hash(one.paths[0]) not in own
    ]
    assert source.map_path is not None
    drawn = _drawn(
        tuple(by_others), _stamps(by_others), _stamp(source.map_path), drawing or Drawing()
    )
    is_drawn = any(lane.id.startswith(PREFIX) for lane in drawn.lanes)
    enough = is_drawn and (lines == "tracks" or drawn.vehicles >= FEWEST_VEHICLES)
    if enough:
        return replace(scenario, recorded=replace(source, drawn=drawn))
    found = f"{drawn.vehicles} vehicles in {len(by_others)} other recordings of --tracks"
    if lines == "tracks":
        raise InputError(
            f"{source.tracks[0]}: expected vehicles that drove the same ways, to draw lines from, "
            f"found {found}; name more recordings with --tracks and choose with --recordings, or "
            "leave --lines-from tracks out"
        )
    notice = f"reference lines along the lanes of the map: found {found}, too few to draw lines"
    return replace(scenario, recorded=replace(source, lines_notice=notice))


def _without_recordings(source: RecordedSource) -> bool:
    return bool(_why_not(replace(source, replay=None)))


def _why_not(source: RecordedSource) -> str:
    """Why lines cannot be drawn from such tracks; empty where they can."""
    if source.replay is not None:
        return "in SUMO, vehicles drive along the lanes of its net"
    if source.map_path is None or any(path.suffix.lower() != ".csv" for path in source.tracks):
        return "lines are drawn from INTERACTION tracks (*.csv), found others"
    if any(path.is_file() and InteractionTable(path).has_cases for path in source.tracks[:1]):
        return "lines are drawn from whole tracks, found cases"
    return ""


def _stamps(recordings: Sequence[Recorded]) -> tuple[_Stamp, ...]:
    return tuple(_stamp(path) for one in recordings for path in one.paths)


def _stamp(path: Path) -> _Stamp:
    try:
        stat = path.stat()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; correct the path") from error
    return path, stat.st_mtime_ns, stat.st_size


@lru_cache(maxsize=16)
def _drawn(
    recordings: tuple[Recorded, ...],
    stamps: tuple[_Stamp, ...],
    map_stamp: _Stamp,
    drawing: Drawing,
) -> DrawnLines:
    """The lines from recordings on a map; the stamps tell whether files are still the same."""
    of_map = read_lanes(map_stamp[0])
    if not recordings:
        return DrawnLines(tuple(of_map), (), 0, _hash(of_map))
    names = tuple(one.name for one in recordings)
    file = file_of(drawing.keep, names, [path for path, *_ in (*stamps, map_stamp)])
    if (kept := read_kept(file)) is not None:
        return DrawnLines(tuple(kept.lanes), names, kept.vehicles, _hash(kept.lanes))
    steps = len(recordings) + 1
    paths: list[DrivenPath] = []
    for done, one in enumerate(recordings):
        drawing.tell(done, steps, f"reading {one.name}")
        paths += _paths(one, _stamps([one]))
    drawing.tell(len(recordings), steps, f"drawing from {len(paths)} vehicles")
    if paths:
        xy_m, yaw_rad = (np.concatenate([getattr(one, k) for one in paths]) for k in _WHERE)
        check_place(recordings[0].paths[0], map_stamp[0], of_map, xy_m, yaw_rad)
    lanes = lanes_from_paths(paths, of_map)
    write_kept(file, lanes, len(paths))
    drawing.tell(steps, steps, f"drawn from {len(paths)} vehicles of {len(recordings)} recordings")
    return DrawnLines(tuple(lanes), names, len(paths), _hash(lanes))


@lru_cache(maxsize=512)
def _paths(recorded: Recorded, stamps: tuple[_Stamp, ...]) -> tuple[DrivenPath, ...]:
    """The paths of a recording's vehicles."""
    found = map(driven_path, read_tracks(recorded))
    return tuple(path for path in found if path is not None)


def _hash(lanes: Sequence[Lane]) -> str:
    """Of what makes the lanes, to 0.1 mm."""
    digest = hashlib.sha256()
    for lane in lanes:
        about = (lane.id, lane.successors, int(lane.gate), lane.turn, lane.is_connection)
        digest.update(repr((*about, round(lane.speed_limit_mps, 4), sorted(lane.kinds))).encode())
        digest.update(np.rint(lane.xy_m * 1e4).astype(np.int64).tobytes())
    return digest.hexdigest()
