"""SUMO's floating car data as a `Recording`."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.config import RecordedSource
from hatn_sim.datatypes import DT_S, Frame, Lane, Scene, Truth
from hatn_sim.errors import InputError
from hatn_sim.recordings.ending import with_end
from hatn_sim.recordings.fcd.head import Moment, check_net, check_speeds, first_moments, lacks
from hatn_sim.recordings.fcd.rows import Timestep, read_timesteps
from hatn_sim.recordings.fcd.scenes import SceneReader
from hatn_sim.recordings.fcd.vehicle_types import VehicleType, read_types
from hatn_sim.recordings.maps import read_lanes
from hatn_sim.recordings.pause import check_pause

GRID_TOLERANCE_S: Final = 0.006
"""SUMO writes times to two decimals."""


class FcdRecording:
    """A file of floating car data (XML, gzipped XML, Parquet) and the net it was recorded in.

    A finer step is thinned out to 0.1 s from the first timestep on. `departed` and `arrived` are
    who appears and who disappears; routes are not known. Every iterator reads the file anew and
    holds one timestep of it.
    """

    def __init__(self, name: str, source: RecordedSource) -> None:
        """Raises InputError where not exactly one file and a map are given."""
        path = source.tracks[0]
        if len(source.tracks) > 1:
            raise InputError(
                f"{path}: one file of floating car data can be played at a time, found "
                f"{len(source.tracks)}; name one"
            )
        if source.recordings:
            raise InputError(
                f"{path}: floating car data is one recording; leave --recordings "
                f"{','.join(source.recordings)} out"
            )
        if source.map_path is None:
            raise InputError(f"{path}: add --map FILE, the net that it was recorded in")
        self.name = name
        self.ids_by = ""
        self._path = path
        self._map_path = source.map_path

    @property
    def lanes(self) -> list[Lane]:
        return self._lanes

    @property
    def notices(self) -> tuple[str, ...]:
        """What the recording lacks. Reads the beginning of the file; raises as `frames` does."""
        return self._checked[0]

    @property
    def doubts(self) -> tuple[str, ...]:
        return self._checked[1]

    @cached_property
    def _lanes(self) -> list[Lane]:
        return read_lanes(self._map_path)

    @cached_property
    def _checked(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The beginning of the file is looked at once; all notices, and those on the map alone."""
        head = list(first_moments(self._moments()))
        if not any(moment.scene.ids for moment in head):
            raise InputError(
                f"{self._path}: expected vehicles, found none in {len(head)} timesteps; "
                "record a time with traffic"
            )
        check_speeds(self._path, head)
        off_net = check_net(self._path, self._map_path, self.lanes, head)
        notices = lacks(head, self._types, self.lanes)
        doubts = () if off_net is None else (off_net,)
        return (*notices, *doubts), doubts

    def frames(self) -> Iterator[Frame]:
        """The frames, 0.1 s apart, empty ones where the file leaves moments without vehicles out.

        Raises:
            InputError: where the file is at fault, when that place is reached; at the beginning
                if positions do not fit the speeds or the net.
        """
        _ = self._checked
        return with_end(self._frames())

    def _frames(self) -> Iterator[Frame]:
        before: frozenset[str] = frozenset()
        for scene in self._scenes():
            present = frozenset(scene.ids)
            truth = Truth(
                routes=(None,) * len(scene.ids),
                departed=tuple(name for name in scene.ids if name not in before),
                arrived=tuple(sorted(before - present)),
            )
            yield Frame(scene, truth, done=False)
            before = present

    def _scenes(self) -> Iterator[Scene]:
        """The scenes, and empty ones in gaps."""
        next_index = 0
        for moment in self._moments():
            for missing in range(next_index, moment.index):
                back_s = DT_S * (moment.index - missing)
                yield _empty(round(moment.scene.time_s - back_s, 6), moment.scene)
            yield moment.scene
            next_index = moment.index + 1

    def _moments(self) -> Iterator[Moment]:
        """The scenes of the timesteps on the grid, and these."""
        reader = SceneReader(self._path, self._types)
        last: Moment | None = None
        for index, step in _on_grid(self._path, read_timesteps(self._path)):
            moment = Moment(index, step, reader.scene(step))
            if last is not None and index > last.index + 1:
                _check_gap(self._path, last, moment)
                check_pause(f"{self._path}: timestep {step.time}", index - last.index - 1)
            yield moment
            last = moment

    @cached_property
    def _types(self) -> dict[str, VehicleType]:
        return read_types((self._path.parent, self._map_path.parent))


def _on_grid(path: Path, steps: Iterator[Timestep]) -> Iterator[tuple[int, Timestep]]:
    """The timesteps at multiples of 0.1 s after the first, numbered so."""
    first_s: float | None = None
    before: Timestep | None = None
    for step in steps:
        if before is not None and step.time_s <= before.time_s:
            raise InputError(
                f"{path}: expected timesteps in rising order, found {step.time} after "
                f"{before.time}; record it anew with SUMO's --fcd-output"
            )
        before = step
        first_s = step.time_s if first_s is None else first_s
        index = round((step.time_s - first_s) / DT_S)
        if abs(step.time_s - first_s - index * DT_S) < GRID_TOLERANCE_S:
            yield index, step
    if before is None:
        raise InputError(f"{path}: expected timesteps with vehicles, found none; record it anew")


def _check_gap(path: Path, last: Moment, moment: Moment) -> None:
    """Moments without vehicles may be left out of a file; those with some may not."""
    both = sorted(set(last.scene.ids).intersection(moment.scene.ids))
    if both:
        raise InputError(
            f"{path}: expected a timestep every {DT_S:g} s, found {moment.step.time} after "
            f"{last.step.time} although {both[0]!r} is in both; record it anew with "
            f"--step-length {DT_S:g}"
        )


def _empty(time_s: float, like: Scene) -> Scene:
    """Nobody there, signals as in another scene."""
    return Scene(
        time_s=time_s,
        ids=(),
        xy_m=np.zeros((0, 2)),
        yaw_rad=np.zeros(0),
        speed_mps=np.zeros(0),
        size_m=np.zeros((0, 2)),
        kind=np.zeros(0, np.int64),
        colour=np.zeros((0, 3), np.int64),
        blinker=np.zeros(0, np.int64),
        signal_closed=like.signal_closed,
    )
