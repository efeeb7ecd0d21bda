"""tick() and run(): the only loop. A frame in, advice out, commands back."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from hatn_sim.assist.agree import agreeing
from hatn_sim.assist.alert import AlertState, alert
from hatn_sim.assist.danger import hatn_rule
from hatn_sim.assist.evade import warn
from hatn_sim.assist.moment import Moment, Recent
from hatn_sim.assist.settings import AssistSettings
from hatn_sim.assist.suggest import SuggestionState, suggest
from hatn_sim.datatypes import (
    HORIZON_FRAMES,
    Advice,
    Agent,
    Alert,
    Command,
    Frame,
    Guided,
    Prediction,
    Predictor,
    Route,
    Scene,
    Simulator,
    Suggestion,
)
from hatn_sim.errors import HatnSimError, InputError
from hatn_sim.labels import SAMPLE_EVERY_FRAMES
from hatn_sim.perception import PerceptionState, perceive
from hatn_sim.perception import begin as begin_to_perceive
from hatn_sim.perception import recall as recall_scenes
from hatn_sim.plugins import SHIPPED_AGENTS
from hatn_sim.road import Road

LineSource = Literal["inferred", "route"]
MAIN: Final = 0
"""The first adviser is the one whose advice is shown and acted on; the others are compared."""
RELEASE_FRAMES: Final = 300
KEPT_LINES: Final = 4000
"""With more reference lines than this, those that nobody was near for so long are let go: long runs
in cities stay small."""
ROUNDING_S: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Adviser:
    """A predictor and what is made of it."""

    predictor: Predictor
    lines: LineSource = "inferred"
    egos: frozenset[str] | None = None  # who gets suggestions and alerts; None: all; empty: none
    settings: AssistSettings = field(default_factory=AssistSettings)
    alerts: bool = True  # False: suggestions only

    @property
    def advises(self) -> bool:
        return self.egos is None or bool(self.egos)


@dataclass(frozen=True, eq=False)
class Driver:
    """An agent, and the scene's time from which it is asked; None: from the beginning."""

    agent: Agent
    from_s: float | None = None


@dataclass(frozen=True, eq=False)
class AdviserState:
    memory: Any
    perception: PerceptionState  # what alerts see; a predictor of ours shares it
    suggestions: SuggestionState
    alerts: AlertState
    recent: Recent  # predictions


def begin(adviser: Adviser, road: Road) -> AdviserState:
    """Nothing seen yet."""
    memory = adviser.predictor.init(road)
    seen = _perceived(memory) or begin_to_perceive(road)
    return AdviserState(memory, seen, SuggestionState(), AlertState(), Recent())


def _perceived(memory: Any) -> PerceptionState | None:
    """What a predictor of this package perceived; None: the memory is somebody else's."""
    perceived = getattr(memory, "perception", memory)
    return perceived if isinstance(perceived, PerceptionState) else None


def observe(adviser: Adviser, state: AdviserState, frame: Frame) -> AdviserState:
    """Take in a frame for which no advice is wanted."""
    routes = routes_told(adviser, frame)
    with predictors_fault(adviser.predictor, frame.scene):
        memory = adviser.predictor.observe(state.memory, frame.scene, routes)
    return taken_in(adviser, state, frame, memory)


def recall(adviser: Adviser, state: AdviserState, frames: Sequence[Frame]) -> AdviserState:
    """Take in what was before anybody looked, as history: see `perception.recall`.

    A predictor whose memory is more than what it perceived observes frame by frame.
    """
    shared = _perceived(state.memory)
    if shared is not None and shared is not state.memory:
        for frame in frames:
            state = observe(adviser, state, frame)
        return state
    perception = recall_scenes(state.perception, [frame.scene for frame in frames])
    if shared is not None:
        return replace(state, memory=perception, perception=perception)
    memory = state.memory
    for frame in frames:
        with predictors_fault(adviser.predictor, frame.scene):
            memory = adviser.predictor.observe(memory, frame.scene, routes_told(adviser, frame))
    return replace(state, memory=memory, perception=perception)


def routes_told(adviser: Adviser, frame: Frame) -> tuple[Route | None, ...] | None:
    """The routes that the predictor is told of; None where lines are inferred."""
    return frame.truth.routes if adviser.lines == "route" else None


def taken_in(adviser: Adviser, state: AdviserState, frame: Frame, memory: Any) -> AdviserState:
    """The state once the predictor's memory has a frame; perceived here where it perceives none."""
    seen = _perceived(memory)
    if seen is None and adviser.advises:
        seen = perceive(state.perception, frame.scene, routes_told(adviser, frame))
    return replace(state, memory=memory, perception=seen or state.perception)


def tick(adviser: Adviser, state: AdviserState, frame: Frame) -> tuple[AdviserState, Advice]:
    """Take in a frame and give advice: prediction, suggestions, alerts."""
    state = observe(adviser, state, frame)
    return advise(adviser, state, frame.scene, foresee(adviser, state, frame.scene))


def foresee(adviser: Adviser, state: AdviserState, scene: Scene) -> Prediction:
    """The prediction from what was observed, the newest of it a scene; checked."""
    with predictors_fault(adviser.predictor, scene):
        prediction = adviser.predictor.predict(state.memory)
    check_prediction(adviser.predictor.name, prediction, scene)
    return prediction


def predictors_fault(predictor: Predictor, scene: Scene) -> AbstractContextManager[None]:
    """An exception of somebody's own predictor becomes one line that says where."""
    return _named(f"predictor {predictor.name!r}", predictor, scene)


@contextmanager
def _named(what: str, plugged_in: object, scene: Scene) -> Generator[None, None, None]:
    """An exception of somebody's own predictor or agent becomes one line that says where.

    Those of the ones that ship are this package's bugs: they keep their traceback.
    """
    try:
        yield
    except HatnSimError:
        raise
    except Exception as error:
        if type(plugged_in).__module__.startswith(("hatn_sim.", SHIPPED_AGENTS)):
            raise
        last = traceback.extract_tb(error.__traceback__)[-1]
        raise InputError(
            f"{what} failed at {scene.time_s:.1f} s: "
            f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})"
        ) from error


def check_prediction(name: str, prediction: Prediction, scene: Scene) -> None:
    """InputError where a prediction is not of this scene, not of its shape or not finite."""
    if not isinstance(prediction, Prediction):
        raise InputError(
            f"predictor {name!r}: predict returned {type(prediction).__name__}, "
            "expected hatn_sim.datatypes.Prediction"
        )
    count, modes = len(scene.ids), prediction.mode_probability.shape[-1]
    shapes = {
        "xy_m": (prediction.xy_m, (count, modes, HORIZON_FRAMES, 2)),
        "mode_probability": (prediction.mode_probability, (count, modes)),
        "fallback": (prediction.fallback, (count,)),
        "adapted": (prediction.adapted, (count,)),
    }
    where = f"predictor {name!r} at {scene.time_s:.1f} s"
    if prediction.ids != scene.ids:
        raise InputError(f"{where}: ids are not those of the scene, in its order; predict for all")
    for part, (value, shape) in shapes.items():
        if value.shape != shape:
            raise InputError(f"{where}: {part} has shape {value.shape}, expected {shape}")
    bad = ~np.isfinite(prediction.xy_m).all(axis=(1, 2, 3))
    bad |= ~np.isfinite(prediction.mode_probability).all(axis=1)
    if bad.any():
        first = scene.ids[int(np.argmax(bad))]
        raise InputError(f"{where}: the prediction for {first!r} is not finite; mend the predictor")


def begin_to_drive(agent: Agent, ego_id: str, road: Road, scene: Scene) -> Any:
    """The agent's first memory. InputError where somebody's own agent fails."""
    with _named(f"the agent of {ego_id!r}", agent, scene):
        return agent.init(road)


def decide(
    agent: Agent, state: Any, ego_id: str, frame: Frame, advice: Advice
) -> tuple[Any, Command | None]:
    """Ask an agent once. InputError where somebody's own agent fails, or commands nonsense."""
    scene = frame.scene
    with _named(f"the agent of {ego_id!r}", agent, scene):
        told = guided(agent, state, ego_id, frame)
        state, command = agent.step(told, ego_id, scene, advice)
    if command is not None:
        check_command(command, ego_id, scene)
    return state, command


def guided(agent: Agent, state: Any, ego_id: str, frame: Frame) -> Any:
    """The memory of an agent that has been told the way it is to drive, if it asks for that."""
    if not isinstance(agent, Guided) or ego_id not in frame.scene.ids:
        return state
    return agent.guide(state, frame.truth.routes[frame.scene.ids.index(ego_id)])


def check_command(command: Command, ego_id: str, scene: Scene) -> None:
    """InputError where an agent's command is none, not of its vehicle or not finite."""
    where = f"the agent of {ego_id!r} at {scene.time_s:.1f} s"
    if not isinstance(command, Command):
        raise InputError(
            f"{where}: step returned {type(command).__name__} as its command, "
            "expected hatn_sim.datatypes.Command or None"
        )
    if command.ego_id != ego_id:
        raise InputError(f"{where}: it commands {command.ego_id!r}; expected its own vehicle")
    if not np.isfinite(command.acceleration_mps2):
        raise InputError(f"{where}: its acceleration is not finite; mend the agent")


def advise(
    adviser: Adviser, state: AdviserState, scene: Scene, prediction: Prediction
) -> tuple[AdviserState, Advice]:
    """What to make of a prediction: suggestions and alerts (if asked for), where it has slots."""
    needed = prediction.graphs, prediction.slot_probability, prediction.lines
    if not adviser.advises or any(part is None for part in needed):
        return state, Advice(prediction, (), ())
    moment = moment_of(adviser, state, prediction)
    state, suggestions = suggestions_of(adviser, state, moment)
    if not adviser.alerts:
        return state, Advice(prediction, suggestions, ())
    state, alerts = alerts_of(adviser, state, moment)
    told = state.alerts.told(scene.time_s, adviser.settings)
    return state, Advice(prediction, agreeing(suggestions, told, scene), alerts)


def moment_of(adviser: Adviser, state: AdviserState, prediction: Prediction) -> Moment:
    """All that suggestions and alerts go by."""
    seen = state.perception.seen
    earlier = state.recent.earlier(seen.scene.time_s)
    return Moment(state.perception.road, seen, prediction, earlier, adviser.settings)


def suggestions_of(
    adviser: Adviser, state: AdviserState, moment: Moment
) -> tuple[AdviserState, tuple[Suggestion, ...]]:
    """One half of what `advise` does."""
    told, suggestions = suggest(
        state.suggestions,
        moment.road,
        moment.scene,
        moment.prediction,
        adviser.egos,
        moment.pairs,
    )
    return replace(state, suggestions=told), suggestions


def alerts_of(
    adviser: Adviser, state: AdviserState, moment: Moment
) -> tuple[AdviserState, tuple[Alert, ...]]:
    """The other half."""
    scene = moment.scene
    warned, alerts = state.alerts, ()
    if warned.looks(scene.time_s):
        dangers = hatn_rule(moment)
        warned, alerts = alert(
            warned, scene, dangers, adviser.settings, adviser.egos, partial(warn, moment)
        )
    recent = state.recent.with_newest(scene.time_s, moment.prediction)
    return replace(state, alerts=warned, recent=recent), alerts


def warm_up(simulator: Simulator, frame: Frame, frames: int) -> Frame:
    """Let traffic build up with nobody looking; `frame` is what `simulator.reset` gave."""
    for _ in range(frames):
        if frame.done:
            break
        frame = simulator.step()
    return frame


def run(
    simulator: Simulator,
    advisers: Sequence[Adviser],
    frame: Frame,
    frames: int,
    write: Callable[[int, Frame, Mapping[str, Advice]], None],
    drivers: Mapping[str, Driver] | None = None,
    every_frames: int = 1,
) -> int:
    """Advise a whole run and hand every frame with its advice to `write`; returns the frames done.

    `frame` is the first of them. The first adviser predicts on every frame, or on every
    `every_frames`-th, the others on those that are scored. `drivers` drive the vehicles of their
    ids, and need advice on every frame.
    """
    drivers = drivers or {}
    if drivers and every_frames != 1:
        raise ValueError("drivers need advice on every frame")
    road = simulator.road
    states = [begin(adviser, road) for adviser in advisers]
    driver_states = {
        ego_id: begin_to_drive(driver.agent, ego_id, road, frame.scene)
        for ego_id, driver in drivers.items()
    }
    done = 0
    for index in range(frames):
        advice: dict[str, Advice] = {}
        for k, adviser in enumerate(advisers):
            if index % (every_frames if k == MAIN else SAMPLE_EVERY_FRAMES) == 0:
                states[k], advice[adviser.predictor.name] = tick(adviser, states[k], frame)
            else:
                states[k] = observe(adviser, states[k], frame)
        write(index, frame, advice)
        if index % RELEASE_FRAMES == 0:
            road.release(RELEASE_FRAMES, KEPT_LINES)
        done = index + 1
        if frame.done or done == frames:
            break
        commands: list[Command] = []
        for ego_id, driver in drivers.items():
            shown = advice[advisers[MAIN].predictor.name]
            if driver.from_s is not None and frame.scene.time_s < driver.from_s - ROUNDING_S:
                continue
            driver_states[ego_id], command = decide(
                driver.agent, driver_states[ego_id], ego_id, frame, shown
            )
            if command is not None:
                commands.append(command)
        frame = simulator.step(commands)
    return done
