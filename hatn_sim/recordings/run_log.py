"""The log of a run as a `Recording`: what was logged happens again, exactly."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

from hatn_sim.datatypes import DT_S, Frame, Lane
from hatn_sim.errors import InputError
from hatn_sim.log import read_run
from hatn_sim.log.road_file import ROAD_FILE, read_road
from hatn_sim.recordings.ending import with_end


class RunRecording:
    """The frames of a run, bit for bit, and their truth. With the same predictors and egos, the
    advice on them is that of the run.

    Tables are read part by part, anew for every iterator.
    """

    def __init__(self, path: Path) -> None:
        """Raises InputError where it is not the folder of a run, or one without a frame."""
        self._run = read_run(path)
        if not self._run.frame_count:
            raise InputError(f"{path}: expected frames, found a run without any; make it again")

    @property
    def name(self) -> str:
        """The scene's name."""
        return str(self._run.header.get("scene", self._run.path.name))

    @property
    def notices(self) -> tuple[str, ...]:
        if self._run.finished:
            return ()
        seconds = DT_S * self._run.frame_count
        return (f"{self._run.path} is of an unfinished run: its first {seconds:.1f} s are played",)

    @property
    def doubts(self) -> tuple[str, ...]:
        return tuple(self._run.header.get("settings", {}).get("doubts", ()))

    @property
    def ids_by(self) -> str:
        return self._run.ids_by

    @property
    def lanes(self) -> list[Lane]:
        return self._lanes

    @cached_property
    def _lanes(self) -> list[Lane]:
        return read_road(self._run.path / ROAD_FILE)

    def frames(self) -> Iterator[Frame]:
        """The frames as they were logged; the last one is marked `done`."""
        return with_end(self._run.frames())
