"""How long each stage of a tick takes, all stages on the same frames, beside SUMO's bare step."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, ParamSpec, TypeVar

import numpy as np

from hatn_sim.bench_branch import BranchTiming, time_branches
from hatn_sim.config import Scenario
from hatn_sim.datatypes import Frame, Prediction, SemanticGraphs
from hatn_sim.errors import InputError
from hatn_sim.graph import build_graphs
from hatn_sim.hatn.adaptation_memory import AdaptationState, default_settings
from hatn_sim.hatn.adaptive import AdaptiveHatn
from hatn_sim.hatn.predictor import Hatn
from hatn_sim.hatn.sgn import Intention
from hatn_sim.log import RunWriter
from hatn_sim.loop import Adviser, advise, alerts_of, begin, moment_of, observe, suggestions_of
from hatn_sim.perception import PerceptionState
from hatn_sim.simulators.sumo import SumoSimulator

P = ParamSpec("P")
T = TypeVar("T")

STAGES: Final = {
    "sumo": "bare libsumo step",
    "simulator": "step, reading and pipe",
    "perceive": "tracks, lines, leaders",
    "graphs": "semantic graphs",
    "sgn": "SGN",
    "edn": "EDN",
    "predict": "whole predict: graphs, SGN, EDN, to the map",
    "adaptation_1": "online adaptation, 1 step looked back",
    "adaptation_3": "online adaptation, 3 steps",
    "assist": "suggestions and alerts",
    "suggestions": "  suggestions",
    "alerts": "  alerts",
    "log": "log",
    "tick": "whole tick",
}
"""Key -> what is timed. A tick is simulator + perceive + predict + assist + log.
Online adaptation is off unless asked for, and would come on top."""
ADAPTATION_STEPS: Final = (1, 3)
IN_A_TICK: Final = ("simulator", "perceive", "predict", "assist", "log")

SCALES: Final = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0)
"""Demands tried in turn, as multiples of the scene's own, until it holds enough vehicles."""
BUILD_UP_S: Final = 60.0
FILL_S: Final = 300.0
"""A demand is given up if the scene does not hold enough vehicles by then."""
UNTIMED_STEPS: Final = 50
"""Steps with everything switched on before the clock counts: histories fill, caches warm up."""


@dataclass(frozen=True)
class Timing:
    """A stage over the steps of a bench."""

    stage: str
    median_ms: float
    mean_ms: float  # the log writes in parts: what its median hides is here
    ratio: float  # of the medians, to the bare libsumo step


@dataclass(frozen=True)
class Bench:
    """All stages at one number of vehicles."""

    scene: str
    scale: float  # on the scene's own demand
    wanted: int
    vehicles: float  # mean number in view
    steps: int
    timings: tuple[Timing, ...]
    branch: BranchTiming | None  # None: this platform cannot branch
    peak_mb: float | None  # of this process, so far
    worker_peak_mb: float | None


class Stopwatch:
    """Collects wall-clock times by stage, [ms] a step."""

    def __init__(self) -> None:
        self.taken_ms: dict[str, list[float]] = {stage: [] for stage in STAGES}

    def time(self, stage: str, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Do the work and note how long it took."""
        started = time.perf_counter()
        result = work(*args, **kwargs)
        self.taken_ms[stage].append(1e3 * (time.perf_counter() - started))
        return result

    def timings(self) -> tuple[Timing, ...]:
        """Every stage, in the order of `STAGES`."""
        bare_ms = float(np.median(self.taken_ms["sumo"]))
        return tuple(
            Timing(stage, float(np.median(ms)), float(np.mean(ms)), float(np.median(ms)) / bare_ms)
            for stage, ms in self.taken_ms.items()
            if ms
        )


def bench(scenario: Scenario, predictor: Hatn, vehicles: int, steps: int, seed: int) -> Bench:
    """Time `steps` steps from when the scene holds `vehicles` vehicles for the first time.

    Raises InputError where it does not, whatever the demand.
    """
    most = 0
    for factor in SCALES:
        scale = factor * (scenario.scale or 1.0)
        with SumoSimulator(replace(scenario, scale=scale)) as simulator:
            frame, seen = _fill(simulator, seed, vehicles)
            most = max(most, seen)
            if seen >= vehicles:
                watch, mean_vehicles = _time_steps(simulator, predictor, frame, steps)
                worker_pid = simulator.worker_pid
                assert worker_pid is not None
                can_branch = simulator.cannot_branch is None
                return Bench(
                    scene=scenario.name,
                    scale=scale,
                    wanted=vehicles,
                    vehicles=mean_vehicles,
                    steps=steps,
                    timings=watch.timings(),
                    branch=time_branches(simulator) if can_branch else None,
                    peak_mb=peak_memory_mb("self"),
                    worker_peak_mb=peak_memory_mb(str(worker_pid)),
                )
    raise InputError(
        f"{scenario.name}: holds at most {most} vehicles at once, {vehicles} were asked for; "
        "choose fewer --vehicles or another --scene"
    )


def peak_memory_mb(process: str) -> float | None:
    """The most memory that a process held, from Linux's /proc; None elsewhere.

    `getrusage` will not do: a process begins there with the peak of the one that started it.
    """
    try:
        status = Path("/proc", process, "status").read_text(encoding="ascii")
    except OSError:
        return None
    kilobytes = next((line.split()[1] for line in status.splitlines() if "VmHWM" in line), None)
    return None if kilobytes is None else int(kilobytes) / 1024.0


def _fill(simulator: SumoSimulator, seed: int, vehicles: int) -> tuple[Frame, int]:
    """The first frame after the build-up with so many vehicles, or the last; and their number."""
    frame = simulator.reset(seed)
    for step in range(round(FILL_S / simulator.dt_s)):
        frame = simulator.step()
        built_up = step * simulator.dt_s >= BUILD_UP_S
        if frame.done or (built_up and len(frame.scene.ids) >= vehicles):
            break
    return frame, len(frame.scene.ids)


def _time_steps(
    simulator: SumoSimulator, predictor: Hatn, frame: Frame, steps: int
) -> tuple[Stopwatch, float]:
    """Run on, every stage by itself, and the mean number of vehicles in view."""
    watch, road = Stopwatch(), simulator.road
    adaptives = adaptives_of(predictor)
    learnt: dict[str, AdaptationState | None] = dict.fromkeys(adaptives)
    adviser = Adviser(predictor)
    state = begin(adviser, road)
    vehicles: list[int] = []
    with tempfile.TemporaryDirectory() as folder, RunWriter(Path(folder) / "log", {}) as writer:
        for index in range(UNTIMED_STEPS + steps):
            if index == UNTIMED_STEPS:
                watch = Stopwatch()
            frame = watch.time("simulator", simulator.step)
            watch.taken_ms["sumo"].append(1e3 * simulator.sumo_s)
            state = watch.time("perceive", observe, adviser, state, frame)
            prediction = watch.time("predict", predictor.predict, state.memory)
            # Once more, in pieces: after the whole, which then pays for what is cached.
            seen = state.memory.seen
            graphs = watch.time("graphs", build_graphs, road, seen)
            if len(graphs.ego):
                intention = watch.time("sgn", predictor.intend, graphs)
                watch.time("edn", predictor.drive, state.memory, graphs.ego, intention)
                for stage, adaptive in adaptives.items():
                    learnt[stage] = watch.time(
                        stage,
                        *(adapt, adaptive, learnt[stage], state.memory),
                        *(graphs, intention, prediction),
                    )
            before = state
            state, advice = watch.time("assist", advise, adviser, state, frame.scene, prediction)
            # Once more, in pieces.
            moment = moment_of(adviser, before, prediction)
            watch.time("suggestions", suggestions_of, adviser, before, moment)
            watch.time("alerts", alerts_of, adviser, before, moment)
            watch.time("log", writer.write, index, frame, {predictor.name: advice})
            watch.taken_ms["tick"].append(sum(watch.taken_ms[stage][-1] for stage in IN_A_TICK))
            vehicles.append(len(frame.scene.ids))
    return watch, float(np.mean(vehicles[UNTIMED_STEPS:]))


def adaptives_of(predictor: Hatn) -> dict[str, AdaptiveHatn]:
    """The predictor with online adaptation, by the stage that times it."""
    usual = default_settings(predictor.weights.edn)
    return {
        f"adaptation_{steps}": AdaptiveHatn(predictor, replace(usual, steps=steps))
        for steps in ADAPTATION_STEPS
    }


def adapt(
    adaptive: AdaptiveHatn,
    learnt: AdaptationState | None,
    perception: PerceptionState,
    graphs: SemanticGraphs,
    intention: Intention,
    prediction: Prediction,
) -> AdaptationState:
    """What adaptation does at a frame beside predicting: learn, and correct the prediction."""
    after = adaptive.learn(learnt, perception, graphs, intention)
    adaptive.correct(prediction, graphs, after)
    return after
