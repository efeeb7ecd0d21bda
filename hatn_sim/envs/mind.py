"""What the ego makes of the frames: advice by the one `tick()`, and how a slot is taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from hatn_sim.assist.at_signals import choice_of
from hatn_sim.assist.likely import first_of_others
from hatn_sim.assist.outlook import look_ahead
from hatn_sim.assist.suggest import SuggestionState, slot_profiles, stopped_at_line
from hatn_sim.datatypes import Advice, FloatArray, Frame, Prediction, Predictor, Route, Scene
from hatn_sim.envs.errors import OptionError, in_python
from hatn_sim.envs.observation import Sight
from hatn_sim.errors import InputError
from hatn_sim.graph import build_graphs
from hatn_sim.loop import (
    Adviser,
    AdviserState,
    LineSource,
    advise,
    begin,
    check_prediction,
    foresee,
    observe,
    predictors_fault,
    recall,
    routes_told,
    taken_in,
)
from hatn_sim.predictors.find import load_predictor
from hatn_sim.road import Road

NEAREST_FIRST: Final = 0.01
"""Stands in for probabilities where a predictor gives none: whoever is sooner there goes first."""


@runtime_checkable
class BatchPredictor(Predictor, Protocol):
    """A predictor that is faster for several memories at once than for one after another."""

    def observe_all(
        self,
        states: Sequence[Any],
        scenes: Sequence[Scene],
        routes: Sequence[tuple[Route | None, ...]] | None = None,
    ) -> Sequence[Any]:
        """What `observe` gives of each."""
        ...

    def predict_all(self, states: Sequence[Any]) -> list[Prediction]:
        """What `predict` says of each, but for rounding."""
        ...


@dataclass(frozen=True, eq=False)
class Mind:
    """The memory of an ego's adviser. Handed in and out."""

    adviser: Adviser
    road: Road
    state: AdviserState
    advises: bool = True
    stopped: frozenset[str] = frozenset()  # who has stood at the stop line ahead


@dataclass(frozen=True, eq=False)
class Thought:
    """What came of a frame."""

    advice: Advice
    sight: Sight


Asked = tuple[Mind, Sequence[Frame]]
"""A mind that wants a prediction, and the frames up to now that it has not taken in yet."""
Foreseen = tuple[Mind, Prediction]
"""The mind when it has taken them in, and what is predicted."""


def predictor_of(named: str | Predictor | None) -> Predictor | None:
    """The predictor that an option names, or is. Raises OptionError where there is none such."""
    if not isinstance(named, str):
        return named
    try:
        return load_predictor(named)
    except InputError as error:
        raise OptionError(f"predictor: {in_python(error)}") from None


def open_mind(
    predictor: Predictor,
    lines: LineSource,
    ego_id: str | frozenset[str],
    road: Road,
    before: Sequence[Frame] = (),
    *,
    advises: bool = True,
) -> Mind:
    """Nothing seen yet but the frames `before`.

    Advice is for the ego, or for several of them, alone, or for nobody.
    """
    egos = frozenset({ego_id}) if isinstance(ego_id, str) else ego_id
    adviser = Adviser(predictor, lines, egos)
    return Mind(adviser, road, recall(adviser, begin(adviser, road), before), advises)


def glance(mind: Mind, frame: Frame) -> Mind:
    """Take in a frame on which nothing is decided."""
    return replace(mind, state=observe(mind.adviser, mind.state, frame))


def think(mind: Mind, frame: Frame) -> tuple[Mind, Thought]:
    """Take in a frame and be advised: the one `tick()`, in the parts that it has."""
    mind, prediction = _foreseen((mind, (frame,)))
    return conclude(mind, frame.scene, prediction)


def _foreseen(asked: Asked) -> Foreseen:
    mind, frames = asked
    for frame in frames:
        mind = glance(mind, frame)
    return mind, foresee(mind.adviser, mind.state, frames[-1].scene)


def foresee_all(asked: Sequence[Asked]) -> list[Foreseen]:
    """Predictions of one predictor for several minds, each with frames to take in before.

    In one batch where the predictor makes one; else as each alone.
    """
    if not asked:
        return []
    predictor = asked[0][0].adviser.predictor
    if not isinstance(predictor, BatchPredictor):
        return [_foreseen(one) for one in asked]
    minds = _glanced_together(predictor, asked)
    with predictors_fault(predictor, asked[0][1][-1].scene):
        predictions = predictor.predict_all([mind.state.memory for mind in minds])
    for (_, frames), prediction in zip(asked, predictions, strict=True):
        check_prediction(predictor.name, prediction, frames[-1].scene)
    return list(zip(minds, predictions, strict=True))


def _glanced_together(predictor: BatchPredictor, asked: Sequence[Asked]) -> list[Mind]:
    """The minds with all their frames taken in, each frame by all who have one more."""
    minds = [mind for mind, _ in asked]
    for number in range(max(len(frames) for _, frames in asked)):
        some = {k: frames[number] for k, (_, frames) in enumerate(asked) if number < len(frames)}
        told = [routes_told(minds[k].adviser, frame) for k, frame in some.items()]
        routes = [own for own in told if own is not None] or None  # all have one set of options
        scenes = [frame.scene for frame in some.values()]
        with predictors_fault(predictor, scenes[0]):
            memories = predictor.observe_all([minds[k].state.memory for k in some], scenes, routes)
        for (k, frame), memory in zip(some.items(), memories, strict=True):
            state = taken_in(minds[k].adviser, minds[k].state, frame, memory)
            minds[k] = replace(minds[k], state=state)
    return minds


def conclude(mind: Mind, scene: Scene, prediction: Prediction) -> tuple[Mind, Thought]:
    """What to make of a prediction. Graphs are built here where the predictor has none."""
    state, advice = mind.state, Advice(prediction, (), ())
    if mind.advises:
        state, advice = advise(mind.adviser, state, scene, prediction)
    seen = state.perception.seen
    graphs, lines = prediction.graphs, prediction.lines
    if graphs is None or lines is None:
        graphs, lines = build_graphs(mind.road, seen), seen.lines
        prediction = replace(prediction, graphs=graphs, lines=lines, slot_probability=None)
    stopped = stopped_at_line(mind.stopped, scene, graphs)
    after = replace(mind, state=state, stopped=stopped)
    return after, Thought(advice, Sight(prediction, graphs, lines))


def slot_profile(
    mind: Mind, sight: Sight, scene: Scene, vehicle: int, slot: int
) -> Sequence[float]:
    """Speeds at the end of each tick of a vehicle that takes a slot; none if it is on no line."""
    row = sight.row_of(vehicle)
    if row is None:
        return ()
    rows = np.array([row])
    prediction = choice_of(mind.road, scene, sight.prediction)
    outlook = look_ahead(mind.road, scene, prediction)
    chances = prediction.slot_probability
    if chances is None:
        chances = _sooner_first(outlook.enter_s)
    told = SuggestionState(stopped=mind.stopped)
    first = first_of_others(outlook.graphs.focus_mask[rows], chances[rows])
    profiles = slot_profiles(told, outlook, rows, np.array([slot]), first)
    speeds: list[float] = profiles.tick_speed_mps()[0].tolist()
    return speeds


def _sooner_first(enter_s: FloatArray) -> FloatArray:
    return 1.0 / (1.0 + NEAREST_FIRST * enter_s)
