"""SUMO as a `Simulator`: one worker process per run, frames over a pipe."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from hatn_sim.datatypes import (
    DT_S,
    Branch,
    Change,
    Command,
    Frame,
    Lane,
    Route,
)
from hatn_sim.errors import InputError, RunningError, SimulatorError, WindowClosedError
from hatn_sim.simulators.sumo_config import MAX_SEED, start_options
from hatn_sim.simulators.sumo_frames import frames_of
from hatn_sim.simulators.sumo_lanes import lanes_of
from hatn_sim.simulators.sumo_messages import (
    Advance,
    Advanced,
    AskFoes,
    AskLaneFoes,
    AwaitBranch,
    BranchEnded,
    BranchesStarted,
    Drawn,
    Failed,
    JunctionFoes,
    LaneFoes,
    Picture,
    RawFrame,
    Refused,
    Spawn,
    Spawned,
    StartBranches,
    Started,
    WindowClosed,
    accelerations,
)
from hatn_sim.simulators.sumo_process import SumoWorker, WorkerDiedError, Workers, one_line
from hatn_sim.simulators.sumo_window import START

if TYPE_CHECKING:
    from hatn_sim.config import Scenario
    from hatn_sim.road import Road


class SumoSimulator:
    """A SUMO scene at 0.1 s a step.

    Every `reset` starts SUMO in a fresh process, forked from one in which SUMO never ran, so that
    nothing of the run before is left: the same seed gives the same frames bit for bit. A context
    manager; `close` may be called again.

    A vehicle with a `Command` takes that acceleration exactly, whatever SUMO's own driver thinks
    of it (speed mode 32: no safe gap, no right of way, no limit of the vehicle's); lane changes
    stay SUMO's. In the first step without a command the vehicle is SUMO's again.

    `notices` are lines for the user on what was done to the scene's configuration to run it.
    """

    def __init__(self, scenario: Scenario, extra_options: Sequence[str] = ()) -> None:
        """`extra_options` are further words for SUMO's command line.

        Raises InputError where the scene's configuration is at fault.
        """
        self.scenario = scenario
        options, self.notices = start_options(scenario, has_window=START in extra_options)
        self._options = (*options, *extra_options)
        self._workers = Workers()
        self._worker: SumoWorker | None = None
        self._lanes: list[Lane] | None = None
        self._road: Road | None = None
        self._road_of = self
        self._routes: list[Route] = []
        self._seed = 0
        self._time_s = 0.0
        self._cannot_branch: str | None = None
        self.sumo_s = 0.0
        """Wall clock that SUMO itself took for the last step, reading and the pipe excepted."""

    def __getstate__(self) -> dict[str, Any]:
        self.check_at_rest()
        return self.__dict__

    def check_at_rest(self) -> None:
        """Raises RunningError where SUMO runs: it cannot be copied, nor be driven by two."""
        if self._worker is not None:
            raise RunningError(
                f"{self.name}: SUMO runs, and cannot be copied or pickled; expected it closed, or "
                "another environment, reset with the same seed and driven by the same actions"
            )

    @property
    def name(self) -> str:
        return self.scenario.name

    @property
    def dt_s(self) -> float:
        return DT_S

    @property
    def lanes(self) -> list[Lane]:
        """The lanes of the net, those for pedestrians only excepted."""
        if self._lanes is None:
            self.reset(0)
            self.close()
        assert self._lanes is not None
        return self._lanes

    @property
    def road(self) -> Road:
        """The road of the net. Asked for before the first `reset`, it takes a start of SUMO."""
        if self._road_of is not self:
            self._road_of._lanes = self._road_of._lanes or self.lanes
            return self._road_of.road
        if self._road is None:
            from hatn_sim.road import Road

            self._road = Road(self.lanes)
        return self._road

    def share_road(self, other: SumoSimulator) -> None:
        """From now on its road is that of another simulator of the same scene."""
        self._road_of = other

    @property
    def worker_pid(self) -> int | None:
        """The id of the process in which SUMO runs now."""
        return None if self._worker is None else self._worker.pid

    def reset(self, seed: int) -> Frame:
        """Starts anew at the scene's begin, before the first vehicle enters.

        Raises InputError where SUMO refuses the configuration, or where there is nothing to drive
        on or nobody to drive; SimulatorError where SUMO dies.
        """
        if not 0 <= seed <= MAX_SEED:
            raise InputError(f"seed: expected 0 to {MAX_SEED}, found {seed}")
        self._seed, self._time_s = seed, 0.0
        self._routes = []
        worker = self._begin_anew()
        answer = self._inquire((*self._options, "--seed", str(seed)))
        if isinstance(answer, Refused):
            reason = worker.complaint() or f"Error: {one_line(answer.reason)}"
            self.close()
            raise InputError(f"{self.scenario.config_path}: SUMO refuses it: {reason}")
        assert isinstance(answer, Started)
        if self._lanes is None:
            self._lanes = lanes_of(answer.lane_table)
        self._cannot_branch = answer.cannot_branch
        self._check_scene(answer.frame)
        return self._frames([answer.frame])[0]

    def step(self, commands: Sequence[Command] = ()) -> Frame:
        """Lets 0.1 s pass. Commands for vehicles not on the road are without effect.

        Raises SimulatorError where SUMO fails or dies; the simulator is closed then. InputError for
        a command that steers.
        """
        answer = self._inquire(accelerations(commands))
        assert isinstance(answer, RawFrame)
        return self._frames([answer])[0]

    def drive_on(
        self, commands: Sequence[Sequence[Command]], kept: int | None = None
    ) -> Callable[[], list[Frame]]:
        """Asks for one step for each of these lists of commands, or until the scene is done.

        SUMO drives on while others are asked; what is given back waits for the last `kept` frames,
        and is to be called before anything else is asked for. `kept` of None: all of them. They
        are to the last bit those that `step` gives, in less time. Raises as `step` does.
        """
        told = Advance(tuple(map(accelerations, commands)), len(commands) if kept is None else kept)
        self._tell(told)
        return self._driven

    def _driven(self) -> list[Frame]:
        answer = self._answer()
        assert isinstance(answer, Advanced)
        return self._frames(answer.frames) if answer.frames else []

    def spawn(self, name: str, like: str) -> None:
        """Lets one more vehicle in, as soon as there is room where `like`, on the road, came in.

        It is of the type of that vehicle and drives its whole route. Raises as `step` does.
        """
        answer = self._inquire(Spawn(name, like))
        assert isinstance(answer, Spawned)

    @property
    def cannot_branch(self) -> str | None:
        """Why `branch` raises InputError, known after `reset`; None where it does not."""
        return self._cannot_branch

    def branch(self, futures: Sequence[Sequence[Change]], horizon_s: float) -> list[SumoBranch]:
        """Starts one branch per set of changes, driven by children of SUMO's process.

        A branch without changes is, to the last bit, what the same number of `step()` without
        commands gives. A vehicle that a `Command` drives now is SUMO's in a branch, unless it has
        a `Plan` there. As many are driven at once as there are cores: with more, this waits.

        Raises:
            InputError: this scene or platform cannot be branched; or the horizon is under a tick.
            SimulatorError: as `step`.
        """
        if self._cannot_branch is not None:
            raise InputError(f"{self.name}: no branches: {self._cannot_branch}")
        steps = round(horizon_s / DT_S)
        if steps < 1:
            raise InputError(f"horizon_s: expected {DT_S:g} s or more, found {horizon_s:g}")
        answer = self._inquire(StartBranches(tuple(map(tuple, futures)), steps))
        assert isinstance(answer, BranchesStarted) and self._worker is not None
        return [SumoBranch(self, self._worker, number) for number in answer.numbers]

    def await_branch(self, worker: SumoWorker, number: int) -> Branch | None:
        """A branch that this worker has started; None where it or the worker is no more."""
        if worker is not self._worker:
            return None
        answer = self._inquire(AwaitBranch(number))
        assert isinstance(answer, BranchEnded)
        return None if answer.pickled is None else pickle.loads(answer.pickled)

    def draw(self, picture: Picture) -> Drawn:
        """Draws in SUMO's window, and tells what the user looks at there.

        No time passes, and the traffic is as it was. Raises as `step` does.
        """
        answer = self._inquire(picture)
        assert isinstance(answer, Drawn)
        return answer

    def junction_foes(self, reach_m: float) -> JunctionFoes:
        """SUMO's list of conflicts within `reach_m` ahead of every vehicle of the newest frame.

        An oracle for tests of ours, seen by no predictor. Raises as `step` does.
        """
        answer = self._inquire(AskFoes(reach_m))
        assert isinstance(answer, JunctionFoes)
        return answer

    def lane_foes(self) -> LaneFoes:
        """What SUMO's junctions hold against each other, whoever is there.

        Raises as `step` does.
        """
        answer = self._inquire(AskLaneFoes())
        assert isinstance(answer, LaneFoes)
        return answer

    def close(self) -> None:
        """Ends SUMO and its process."""
        try:
            self._end()
        finally:
            self._workers.close()

    def _begin_anew(self) -> SumoWorker:
        """Another worker in place of the last one, which leaves while the new one comes.

        It has left before the new one opens a file: both may write the same.
        """
        last, self._worker = self._worker, None
        try:
            if last is not None:
                last.dismiss()
            worker = self._worker = SumoWorker(self._workers)
        except WorkerDiedError as error:
            raise self._stopped(str(error)) from None
        finally:
            if last is not None:
                with self._closed_if_interrupted():
                    last.await_end()
        return worker

    def _end(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.close()

    def __enter__(self) -> SumoSimulator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _inquire(self, message: object) -> object:
        """The answer to a question after the start."""
        self._tell(message)
        return self._answer()

    def _tell(self, message: object) -> None:
        if self._worker is None:
            raise SimulatorError("SUMO is not running: call reset(seed) first")
        with self._closed_if_interrupted():
            self._worker.tell(message)

    def _answer(self) -> object:
        if self._worker is None:
            raise SimulatorError("SUMO is not running: call reset(seed) first")
        with self._closed_if_interrupted():
            answer = self._worker.hear()
        if isinstance(answer, WindowClosed):
            time_s = self._time_s
            self.close()
            raise WindowClosedError(f"SUMO's window was closed at {time_s:.1f} s")
        if isinstance(answer, Failed):
            reason = self._worker.complaint() or f"Error: {one_line(answer.reason)}"
            raise self._stopped(reason)
        return answer

    @contextmanager
    def _closed_if_interrupted(self) -> Generator[None, None, None]:
        try:
            yield
        except WorkerDiedError as error:
            raise self._stopped(str(error)) from None
        except BaseException:
            self.close()  # ctrl-C between question and answer: the pipe is out of step
            raise

    def _stopped(self, reason: str) -> SimulatorError:
        self.close()
        return SimulatorError(
            f"SUMO stopped in {self.scenario.name} at {self._time_s:.1f} s "
            f"(seed {self._seed}): {reason}"
        )

    def _check_scene(self, frame: RawFrame) -> None:
        assert self._lanes is not None
        fault = None
        if not any(lane.successors for lane in self._lanes):
            fault = "its net has no junction: expected lanes that lead to other lanes"
        elif frame.done and not frame.ids:
            fault = "it has no vehicles: expected some in its route files after its begin"
        if fault is not None:
            self.close()
            raise InputError(f"{self.scenario.config_path}: {fault}; correct the scene")

    def _frames(self, raw: Sequence[RawFrame]) -> list[Frame]:
        frames = frames_of(raw, self._routes)
        self._time_s, self.sumo_s = raw[-1].time_s, raw[-1].sumo_s
        return frames


class SumoBranch:
    """A branch that a child of SUMO's process drives. See `BranchFuture`."""

    def __init__(self, simulator: SumoSimulator, worker: SumoWorker, number: int) -> None:
        self._ask = partial(simulator.await_branch, worker, number)
        self._asked = False
        self._branch: Branch | None = None

    def result(self) -> Branch | None:
        """Waits for the branch; None where it was lost, or the simulator was closed or reset.

        Raises SimulatorError where SUMO itself, not the child, has died.
        """
        if not self._asked:
            self._asked = True
            self._branch = self._ask()
        return self._branch
