"""Recordings of human traffic in INTERACTION format, version 1 and 1.2, as frames.

Several recordings, or the cases of a file of version 1.2, come one after the other as one stream:
time goes on, and between them lie empty frames, so that nothing connects.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hatn_sim.config import RecordedSource
from hatn_sim.datatypes import (
    CASE_HISTORY_FRAMES,
    HISTORY_FRAMES,
    Frame,
    IntArray,
    Lane,
    Scene,
    Truth,
)
from hatn_sim.errors import InputError
from hatn_sim.recordings.ending import with_end
from hatn_sim.recordings.interaction.checks import STEP_MS
from hatn_sim.recordings.interaction.files import Recorded, group_files, refuse_unknown
from hatn_sim.recordings.interaction.scan import Part, Scan, scan
from hatn_sim.recordings.interaction.spool import Spool
from hatn_sim.recordings.interaction.table import ROW, InteractionTable, Rows
from hatn_sim.recordings.maps import read_lanes
from hatn_sim.recordings.pause import check_pause

GAP_FRAMES: Final = HISTORY_FRAMES
"""Empty frames between two recordings, at least."""
CASE_NOW: Final = CASE_HISTORY_FRAMES - 1
"""The last observed frame of a case is its tenth ..."""
SAMPLE_FRAMES: Final = 5
"""... and comes on a multiple of this, where samples are taken."""
PALETTE: Final = np.array(
    [(214, 39, 40), (31, 119, 180), (44, 160, 44), (255, 127, 14),
     (148, 103, 189), (23, 190, 207), (227, 119, 194), (188, 189, 34)]
)  # fmt: skip
"""The files know no colours: a road user's name gives it one of these."""


class InteractionRecording:
    """Tracks in INTERACTION format with their map."""

    def __init__(self, name: str, source: RecordedSource) -> None:
        """Raises InputError where files are missing or have other columns."""
        assert source.map_path is not None
        self._name = name
        self._map_path = source.map_path
        self._drawn, self._lines_notice = source.drawn, source.lines_notice
        self._recordings = group_files(source.tracks, ())
        self._doubts: dict[str, None] = {}  # on what has been read, in order
        paths = [path for recorded in self._recordings for path in recorded.paths]
        with_cases = [path for path in paths if InteractionTable(path).has_cases]
        if with_cases and len(with_cases) < len(paths):
            raise InputError(
                f"{with_cases[0]}: expected files of one kind, found some with cases (case_id) and "
                "some without; give them one kind at a time"
            )
        self._has_cases = bool(with_cases)
        self._cases = source.recordings if with_cases else ()
        if not with_cases:
            self._recordings = group_files(source.tracks, source.recordings)

    @property
    def name(self) -> str:
        return self._name

    @property
    def ids_by(self) -> str:
        if self._has_cases:
            return "cases"
        return "recordings" if len(self._recordings) > 1 else ""

    @property
    def lanes(self) -> Sequence[Lane]:
        """Those of the map, or those drawn from tracks of other recordings."""
        return self._map_lanes if self._drawn is None else self._drawn.lanes

    @property
    def notices(self) -> Sequence[str]:
        """On the files; once the first frame has been given, also on how they fit the map."""
        notices: list[str] = []
        if self._has_cases or len(self._recordings) > 1:
            what = "cases" if self._has_cases else f"{len(self._recordings)} recordings"
            notices.append(f"{what} follow each other, {GAP_FRAMES} empty frames or more between")
        if self._has_cases:
            notices.append(
                f"cases have {CASE_HISTORY_FRAMES} frames behind what is scored, "
                f"where other traffic has {HISTORY_FRAMES}"
            )
        beside = [one.paths[-1].name for one in self._recordings if one.found_beside]
        if beside:
            more = f" and {len(beside) - 3} more" if len(beside) > 3 else ""
            notices.append(f"read along with the vehicles: {', '.join(beside[:3])}{more}")
        if self._lines_notice:
            notices.append(self._lines_notice)
        elif self._drawn is not None:
            notices.append(f"reference lines drawn from {self._drawn.words}")
        return [*notices, *self._doubts]

    @property
    def doubts(self) -> Sequence[str]:
        return list(self._doubts)

    def frames(self) -> Iterator[Frame]:
        """The frames from the beginning.

        Raises:
            InputError: the files are at fault, or a case that is wanted is in none of them.
        """
        return with_end(self._frames())

    def _frames(self) -> Iterator[Frame]:
        start_ms: float | None = None
        index = 0
        before: frozenset[str] = frozenset()
        for moment in self._moments():
            if start_ms is None:
                start_ms = moment.time_ms - STEP_MS * moment.index
            while index <= moment.index:
                time_s = (start_ms + STEP_MS * index) / 1000.0
                shown = moment if index == moment.index else NOBODY
                scene = _scene(time_s, shown)
                present = frozenset(scene.ids)
                truth = Truth(
                    routes=(None,) * len(scene.ids),
                    departed=tuple(name for name in scene.ids if name not in before),
                    arrived=tuple(sorted(before - present)),
                )
                yield Frame(scene, truth, done=False)
                before = present
                index += 1

    @cached_property
    def _map_lanes(self) -> Sequence[Lane]:
        return read_lanes(self._map_path)

    def _moments(self) -> Iterator[Moment]:
        """The frames with somebody in them, in order of time."""
        free = 0
        last = -1
        known: list[str] = []
        for recorded in self._recordings:
            with Spool(ROW) as spool:
                found = scan(recorded, self._cases, self._map_lanes, self._map_path, spool)
                known += found.cases
                self._doubts.update(dict.fromkeys(found.doubts))
                if recorded is self._recordings[-1]:
                    refuse_unknown(recorded.paths[0], self._cases, known)
                starts = _starts(found.parts, free, self._has_cases)
                if found.parts:
                    free = _end(starts[-1], found.parts[-1]) + GAP_FRAMES
                ids = np.array(self._ids(recorded, found), dtype=object)
                colour = _colours(ids)
                for bucket in spool.buckets:
                    for rows in _by_frame(spool.read(bucket)):
                        part, frame = int(rows["part"][0]), int(rows["frame"][0])
                        origin = found.parts[part]
                        index = starts[part] + frame - origin.first_frame
                        check_pause(f"{recorded.paths[0]}: frame {frame}", index - last - 1)
                        last = index
                        yield Moment(
                            index=index,
                            time_ms=origin.zero_ms + STEP_MS * frame,
                            ids=tuple(ids[rows["track"]].tolist()),
                            rows=rows,
                            colour=colour[rows["track"]],
                        )

    def _ids(self, recorded: Recorded, found: Scan) -> list[str]:
        """A name for every track: `12`, of several recordings `000:12`, of cases `7:12`, or
        `FILE/7:12` of cases in several files."""
        several = len(self._recordings) > 1
        if not self._has_cases:
            before = f"{recorded.name}:" if several else ""
            return [before + name for name in found.track_names]
        before = f"{recorded.name}/" if several else ""
        cases = [found.parts[part].name for part in found.track_part.tolist()]
        return [f"{before}{c}:{n}" for c, n in zip(cases, found.track_names, strict=True)]


@dataclass(frozen=True, eq=False)
class Moment:
    index: int  # of its frame in the stream
    time_ms: float  # by the clock of its file
    ids: tuple[str, ...]  # [N]
    rows: Rows  # [N]
    colour: IntArray  # [N, 3]


NOBODY: Final = Moment(-1, 0.0, (), np.zeros(0, dtype=ROW), np.zeros((0, 3), dtype=np.int64))


def _scene(time_s: float, moment: Moment) -> Scene:
    rows = moment.rows
    return Scene(
        time_s=time_s,
        ids=moment.ids,
        xy_m=np.stack([rows["x_m"], rows["y_m"]], axis=1),
        yaw_rad=rows["yaw_rad"].copy(),
        speed_mps=rows["speed_mps"].copy(),
        size_m=np.stack([rows["length_m"], rows["width_m"]], axis=1),
        kind=rows["kind"].astype(np.int64),
        colour=moment.colour,
        blinker=np.zeros(len(rows), dtype=np.int64),
        signal_closed=np.zeros(0, dtype=np.bool_),
    )


def _starts(parts: Sequence[Part], free: int, are_cases: bool) -> list[int]:
    """The index in the stream of every part's first frame, from the first free one on."""
    starts: list[int] = []
    for part in parts:
        if are_cases:
            free += -(free + CASE_NOW) % SAMPLE_FRAMES
        starts.append(free)
        free = _end(free, part) + GAP_FRAMES
    return starts


def _end(start: int, part: Part) -> int:
    """The index behind a part's last frame."""
    return start + part.last_frame - part.first_frame + 1


def _by_frame(rows: Rows) -> Iterator[Rows]:
    """Rows of a bucket, moment by moment, in each as they came."""
    rows = rows[np.lexsort((rows["frame"], rows["part"]))]
    new = (np.diff(rows["frame"]) != 0) | (np.diff(rows["part"]) != 0)
    yield from np.split(rows, np.flatnonzero(new) + 1)


def _colours(ids: NDArray[Any]) -> IntArray:
    """[K, 3]"""
    which = [zlib.crc32(str(name).encode()) % len(PALETTE) for name in ids.tolist()]
    return PALETTE[which].astype(np.int64)
