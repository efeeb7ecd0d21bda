"""Recorded tracks as a `Simulator`: what happened happens again, and takes no commands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hatn_sim.datatypes import DT_S, BranchFuture, Change, Command, Frame, Recording
from hatn_sim.errors import InputError, SimulatorError
from hatn_sim.road import Road


class RecordedSimulator:
    """Plays a recording from its beginning; the seed is without effect."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self._frames: Iterator[Frame] | None = None
        self._road: Road | None = None

    @property
    def name(self) -> str:
        return self.recording.name

    @property
    def notices(self) -> Sequence[str]:
        return self.recording.notices

    @property
    def dt_s(self) -> float:
        return DT_S

    @property
    def road(self) -> Road:
        if self._road is None:
            self._road = Road(self.recording.lanes)
        return self._road

    def reset(self, seed: int) -> Frame:
        """The first frame. Raises InputError where the recording is at fault or empty."""
        self.close()
        self._frames = self.recording.frames()
        return self.step()

    def step(self, commands: Sequence[Command] = ()) -> Frame:
        """The next frame. Raises InputError where the recording is at fault, or for commands."""
        if commands:
            raise InputError(
                f"{self.name}: {commands[0].ego_id!r} cannot be driven, its tracks are recorded; "
                "replay them inside SUMO to take a vehicle over"
            )
        if self._frames is None:
            raise SimulatorError("nothing is being played: call reset(seed) first")
        frame = next(self._frames, None)
        if frame is None:
            raise InputError(f"{self.name}: there is no further frame in the recording")
        return frame

    @property
    def cannot_branch(self) -> str:
        """Why `branch` raises InputError."""
        return "its tracks are recorded: there is one future, the one that came"

    def branch(self, futures: Sequence[Sequence[Change]], horizon_s: float) -> list[BranchFuture]:
        """Raises InputError: there are no branches here."""
        raise InputError(f"{self.name}: no branches: {self.cannot_branch}")

    def close(self) -> None:
        """Stops playing."""
        self._frames = None

    def __enter__(self) -> RecordedSimulator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
