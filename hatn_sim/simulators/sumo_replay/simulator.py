"""A recording replayed inside SUMO, where any of its vehicles can be taken over."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.datatypes import (
    DT_S,
    BranchFuture,
    Change,
    Command,
    Frame,
    Gate,
    Kind,
    Lane,
    Recording,
    Route,
    Scene,
)
from hatn_sim.errors import InputError, SimulatorError
from hatn_sim.road import Road
from hatn_sim.simulators.sumo_config import MAX_SEED
from hatn_sim.simulators.sumo_lanes import lanes_of
from hatn_sim.simulators.sumo_messages import Failed, Refused, ReplayFrame, ReplayStep, Started
from hatn_sim.simulators.sumo_process import SumoWorker, WorkerDiedError, Workers, one_line
from hatn_sim.simulators.sumo_replay.figures import (
    Divergence,
    DivergenceCount,
    Fidelity,
    FidelityCount,
    Overlap,
)
from hatn_sim.simulators.sumo_replay.frame import overlaps_of, shown_scene, shown_truth
from hatn_sim.simulators.sumo_replay.match import LaneMatcher
from hatn_sim.simulators.sumo_replay.plan import Cast
from hatn_sim.simulators.sumo_replay.survey import BESIDE_SHARE, Survey, survey
from hatn_sim.simulators.sumo_replay.take_over import parse_take_over
from hatn_sim.simulators.sumo_replay.vehicle_types import vehicle_types

WORKER: Final = "hatn_sim.simulators.sumo_replay.worker"


class SumoReplay:
    """Recorded vehicles move along their recordings in a SUMO net of the same place.

    Those taken over are driven by SUMO's own driver along the edges that they were recorded on,
    or, with a `Command`, exactly as commanded (as in `SumoSimulator`). SUMO's drivers see the
    recorded vehicles as leaders and foes. The recording stays the truth: a `Frame` shows recorded
    vehicles as recorded, whatever SUMO made of them, and the others as they drive. A vehicle that
    was recorded beside every lane, and a pedestrian, is shown but not seen by SUMO's drivers.

    The run ends with the recording. `fidelity` and `divergence` say how far to trust it; both
    begin anew at every `reset`. The net's own signals run by their programme, in phase with the
    recording's clock if it is of fixed times; where nobody is taken over and the recording knows
    the signals of this net, a `Frame` shows them as recorded. A context manager.
    """

    def __init__(
        self,
        recording: Recording,
        net_path: Path,
        take_over: Mapping[str, float | None] | None = None,
        react_from_s: float | None = None,
    ) -> None:
        """Nothing is read or started before it is asked for.

        Args:
            recording: read twice, once for where its vehicles drive in the net.
            net_path: a SUMO net in the frame of the recording.
            take_over: vehicle -> the recording's time in seconds from which it is driven, None:
                from its appearance on.
            react_from_s: from this time on every vehicle with a way in the net is driven.

        Raises:
            InputError: there is no such net.
        """
        if not net_path.is_file():
            raise InputError(f"{net_path}: there is no such file; give the net of the recording")
        self.recording = recording
        self.net_path = net_path
        self._take_over = dict(take_over or {})
        self._react_from_s = react_from_s
        self._workers = Workers(WORKER)
        self._worker: SumoWorker | None = None
        self._frames: Iterator[Frame] = iter(())
        self._lanes: list[Lane] | None = None
        self._road: Road | None = None
        self._survey: Survey | None = None
        self._lanes_are_recorded = False  # the recording's routes are of the net's lanes
        self._signals_are_recorded = False  # and so are its signals
        self._start_anew()

    def _start_anew(self) -> None:
        self._index = 0
        self._shown: Scene | None = None
        self._cast: Cast | None = None
        self._routes: list[Route] = []
        self._fidelity = FidelityCount()
        self._divergence = DivergenceCount()

    @property
    def name(self) -> str:
        return self.recording.name

    @property
    def notices(self) -> Sequence[str]:
        """The recording's, and from the first `reset` on what the net makes of it."""
        return (*self.recording.notices, *self._own_notices())

    @property
    def dt_s(self) -> float:
        return DT_S

    @property
    def road(self) -> Road:
        """The road of the net. Asked for before the first `reset`, it takes a start of SUMO."""
        if self._road is None:
            if self._lanes is None:
                self._start(seed=0, begin_s=0.0)
                self.close()
            assert self._lanes is not None
            self._road = Road(self._lanes)
        return self._road

    @property
    def fidelity(self) -> Fidelity:
        """What SUMO made of the vehicles placed since the last `reset`."""
        return self._fidelity.figures()

    @property
    def divergence(self) -> Divergence:
        """What came of the vehicles taken over since the last `reset`."""
        return self._divergence.figures(tuple(self._cast.kept) if self._cast else ())

    def drivable(self, least_s: float) -> tuple[str, ...]:
        """Those recorded for so long with a way in the net; known from the first `reset` on."""
        stays = {} if self._survey is None else self._survey.stays
        return tuple(
            name
            for name, (first, *_) in stays.items()
            if first.match is not None and first.last_s - first.first_s >= least_s
        )

    def take_over(self, vehicles: Mapping[str, float | None]) -> None:
        """From the next `reset` on, whom to drive and since when, instead of those named before."""
        self._take_over = dict(vehicles)

    def reset(self, seed: int) -> Frame:
        """The recording's first frame; the seed is of SUMO's drivers.

        Raises InputError where SUMO refuses the net, the recording is at fault or does not fit the
        net, or a vehicle to be taken over is not in it; SimulatorError where SUMO dies.
        """
        if not 0 <= seed <= MAX_SEED:
            raise InputError(f"seed: expected 0 to {MAX_SEED}, found {seed}")
        self._end()
        self._start_anew()
        self._frames = self.recording.frames()
        first = next(self._frames, None)
        if first is None:
            raise InputError(f"{self.name}: there is no frame in the recording")
        self._start(seed, max(first.scene.time_s - DT_S, 0.0))
        try:
            if self._survey is None:
                assert self._lanes is not None
                self._survey = survey(self.recording, LaneMatcher(self._lanes), self.net_path)
                known = {lane.id: lane.signals for lane in self._lanes}
                lanes = self.recording.lanes
                self._lanes_are_recorded = all(lane.id in known for lane in lanes)
                self._signals_are_recorded = all(
                    lane.id in known and lane.signals == known[lane.id] for lane in lanes
                )
            self._cast = Cast(self.name, self._survey, self._take_over, self._react_from_s)
        except BaseException:
            self.close()
            raise
        return self._advance(first, ())

    def step(self, commands: Sequence[Command] = ()) -> Frame:
        """The next frame. Commands for vehicles not taken over yet are without effect.

        Raises InputError where the recording is at fault or over, for a command to a vehicle that
        is never taken over, and where one to be taken over has no way in the net; SimulatorError
        where SUMO fails or dies.
        """
        if self._worker is None:
            raise SimulatorError("nothing is being replayed: call reset(seed) first")
        frame = next(self._frames, None)
        if frame is None:
            raise InputError(f"{self.name}: there is no further frame in the recording")
        self._index += 1
        return self._advance(frame, commands)

    @property
    def cannot_branch(self) -> str:
        """Why `branch` raises InputError."""
        return "its tracks are recorded: there is one future, the one that came"

    def branch(self, futures: Sequence[Sequence[Change]], horizon_s: float) -> list[BranchFuture]:
        """Raises InputError: there are no branches here."""
        raise InputError(f"{self.name}: no branches: {self.cannot_branch}")

    def close(self) -> None:
        """Ends SUMO and its process; the figures stay."""
        try:
            self._end()
        finally:
            self._workers.close()

    def _end(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.close()

    def __enter__(self) -> SumoReplay:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _keeps_signals(self) -> bool:
        """Nobody drives who would heed SUMO's signals, and the recorded ones are of this net."""
        nobody_drives = not self._take_over and self._react_from_s is None
        return nobody_drives and self._signals_are_recorded

    def _own_notices(self) -> list[str]:
        notices: list[str] = []
        if self._survey is not None and (strays := self._survey.without_way()):
            notices.append(
                f"{strays:,} of {len(self._survey.stays):,} recorded vehicles are near no lane of "
                f"{self.net_path.name} that they may use: they can only be shown as recorded"
            )
        if self._survey is not None and self._survey.beside_share > BESIDE_SHARE:
            notices.append(
                f"{100.0 * self._survey.beside_share:.0f} % of the recorded positions are beside "
                f"every lane of {self.net_path.name}: check that it is the net of this place, "
                "netOffset in its <location> included"
            )
        has_signals = any(lane.gate is Gate.SIGNAL for lane in self._lanes or ())
        if has_signals and not self._keeps_signals:
            notices.append(
                f"signals of {self.net_path.name} run by their own programme, by the recording's "
                "clock: recorded vehicles do not heed them, released ones do"
            )
        return notices

    def _start(self, seed: int, begin_s: float) -> None:
        """Starts SUMO with nobody on the road."""
        with tempfile.TemporaryDirectory() as folder:
            types_path = Path(folder) / "types.add.xml"
            types_path.write_text(vehicle_types(), encoding="utf-8")
            options = {
                "net-file": str(self.net_path),
                "additional-files": str(types_path),
                "begin": f"{begin_s:.1f}",
                "step-length": f"{DT_S:g}",
                "seed": str(seed),
                "collision.action": "none",  # outlines are compared here
                "time-to-teleport": "-1",
                "no-warnings": "true",
                "no-step-log": "true",
                "duration-log.disable": "true",
            }
            words = tuple(word for key, value in options.items() for word in (f"--{key}", value))
            try:
                self._worker = SumoWorker(self._workers)
                answer = self._worker.ask(words)
            except WorkerDiedError as error:  # SUMO crashes on some nets that are not whole
                answer = Refused(str(error))
            except BaseException:
                self.close()
                raise
        if isinstance(answer, Refused):
            said = self._worker.complaint() if self._worker else None
            reason = said or f"Error: {answer.reason}"
            self.close()
            raise InputError(
                f"{self.net_path}: SUMO refuses the net: {one_line(reason)} "
                "(`hatn-sim net MAP` builds one from a map)"
            )
        assert isinstance(answer, Started)
        if self._lanes is None:
            self._lanes = lanes_of(answer.lane_table)
        if not self._lanes:
            self.close()
            raise InputError(f"{self.net_path}: the net has no lane for vehicles; give another")

    def _advance(self, recorded: Frame, commands: Sequence[Command]) -> Frame:
        assert self._cast is not None and self._worker is not None
        scene = recorded.scene
        step = self._cast.plan(self._index, scene, self._shown, commands)
        answer = self._ask(step)
        if isinstance(answer, Failed):
            reason = self._worker.complaint() or f"Error: {answer.reason}"
            raise self._stopped(one_line(reason))
        assert isinstance(answer, ReplayFrame)
        left = self._cast.take(answer)
        raw = answer.driven
        self._routes.extend(raw.new_routes)
        cast = self._cast
        instead = cast.driven | cast.gone | cast.held.keys()
        shown = shown_scene(scene, raw, instead, cast.looks)
        overlaps = self._count(scene, step, answer, shown)
        truth = shown_truth(
            recorded,
            raw,
            instead,
            driven_routes=tuple(self._routes[i] if i >= 0 else None for i in raw.routes),
            overlaps=overlaps,
            left=left,
        )
        if not self._lanes_are_recorded:
            truth = replace(truth, routes=(None,) * len(shown.ids))
        frame = Frame(shown, truth, recorded.done)
        if self._keeps_signals:
            frame = replace(frame, scene=replace(shown, signal_closed=scene.signal_closed))
        self._shown = frame.scene
        return frame

    def _count(
        self, scene: Scene, step: ReplayStep, answer: ReplayFrame, shown: Scene
    ) -> list[Overlap]:
        """Adds the frame to the figures; returns the outlines of driven vehicles that touch."""
        assert self._cast is not None
        survey, driven = self._cast.survey, self._cast.driven
        moved = np.array([name not in step.driven for name in step.placed], dtype=np.bool_)
        lane_is_right = [
            lane in match.lanes_at(self._index)
            for name, lane, counts in zip(
                step.placed, answer.lanes, moved & step.on_lane, strict=True
            )
            if counts and (match := survey.match_at(name, self._index)) is not None
        ]
        self._fidelity.add(step.poses[moved], answer.placed[moved], step.on_lane[moved])
        self._fidelity.add_lanes(lane_is_right)
        self._fidelity.add_centre_line(survey.matcher.distance_m(step.poses[moved, :2])[0])
        self._fidelity.not_placed += int(np.count_nonzero(scene.kind == Kind.PEDESTRIAN))
        overlaps = overlaps_of(shown, driven)
        self._divergence.add(shown, driven, scene, self._cast.held.keys(), overlaps)
        return overlaps

    def _ask(self, message: object) -> object:
        assert self._worker is not None
        try:
            return self._worker.ask(message)
        except WorkerDiedError as error:
            raise self._stopped(str(error)) from None
        except BaseException:
            self.close()  # ctrl-C between question and answer: the pipe is out of step
            raise

    def _stopped(self, reason: str) -> SimulatorError:
        self.close()
        return SimulatorError(
            f"SUMO stopped in the replay of {self.name} at frame {self._index}: {reason}"
        )


def open_replay(
    recording: Recording, net_path: Path, take_over: str = "", react_from_s: float | None = None
) -> SumoReplay:
    """A replay as the command line asks for it; `take_over` is `ID[@S],ID[@S]...`.

    Raises InputError where that cannot be read or there is no such net.
    """
    return SumoReplay(recording, net_path, parse_take_over(take_over), react_from_s)
