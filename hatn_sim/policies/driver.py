"""A policy as an agent: it observes what the environment would, and drives what it would drive."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from hatn_sim.datatypes import DT_S, Advice, Command, Route, Scene
from hatn_sim.envs.observation import Ego, Observation, Sight, observe_slots
from hatn_sim.graph import build_graphs
from hatn_sim.perception import PerceptionState, perceive
from hatn_sim.perception import begin as begin_to_perceive
from hatn_sim.planning.situation import on_route, situation_of
from hatn_sim.policies.inputs import Moment, inputs_of
from hatn_sim.policies.law import HOLDS_FRAMES, lawful_mps2, level_mps2
from hatn_sim.policies.network import Network, load_network
from hatn_sim.policies.timing import Speeds, gains_mps2, of_nearest, speeds_of
from hatn_sim.road import Road

NO_LIMIT: Final = 1.0
"""Of the time limit of an episode all is left; policies do not look at it."""


@dataclass(frozen=True, eq=False)
class Memory:
    """Of one drive. Handed in and out."""

    perception: PerceptionState  # used where a predictor brings no graphs
    route: Route | None = None  # its own
    frames: int = 0
    speed_mps: float | None = None  # a frame ago
    stood: bool = False  # at the stop line ahead
    before: Speeds = field(default_factory=dict)  # a decision ago
    command_mps2: float = 0.0  # holds until the next decision


class PolicyAgent:
    """Decides every `HOLDS_FRAMES` frames."""

    reads_suggestions = False

    def __init__(self, weights: Path | str) -> None:
        """Raises InputError where the weights cannot be read."""
        self.network: Network = load_network(Path(weights))

    @property
    def reads_predictions(self) -> bool:
        """Whether it was trained to see them."""
        return self.network.layout.sees_predictions

    def init(self, road: Road) -> Memory:
        """Nothing seen yet."""
        return Memory(begin_to_perceive(road))

    def guide(self, state: Memory, route: Route | None) -> Memory:
        """The way that the vehicle is to drive; None: to be inferred like anybody's."""
        return replace(state, route=route)

    def step(
        self, state: Memory, ego_id: str, scene: Scene, advice: Advice
    ) -> tuple[Memory, Command | None]:
        """The command of this frame; None where the vehicle is not there."""
        if ego_id not in scene.ids:
            return state, None
        row = scene.ids.index(ego_id)
        if advice.prediction.graphs is None or advice.prediction.lines is None:
            state = replace(state, perception=perceive(state.perception, scene, None))
        if state.frames % HOLDS_FRAMES == 0:
            state = self._decided(state, row, scene, advice)
        after = replace(state, frames=state.frames + 1, speed_mps=float(scene.speed_mps[row]))
        return after, Command(ego_id, state.command_mps2)

    def _decided(self, state: Memory, row: int, scene: Scene, advice: Advice) -> Memory:
        sight = sight_of(state, advice)
        gains = gains_mps2(scene, state.before, HOLDS_FRAMES)
        road = state.perception.road
        lines = on_route(road, scene, sight.lines, row, state.route)
        now = situation_of(road, scene, lines, row, state.stood)
        lawful, stood = lawful_mps2(now, gains), now is not None and now.has_stopped
        observation = observed(state, row, scene, sight)
        moment = Moment(observation, of_nearest(scene, row, gains), lawful, stood)
        level = self.network.best(inputs_of(self.network.layout, moment))
        command_mps2 = level_mps2(level, lawful)
        return replace(state, stood=stood, before=speeds_of(scene), command_mps2=command_mps2)


def sight_of(state: Memory, advice: Advice) -> Sight:
    """The prediction of an advice with its graphs, or those made of what was perceived."""
    prediction, seen = advice.prediction, state.perception.seen
    if prediction.graphs is not None and prediction.lines is not None:
        return Sight(prediction, prediction.graphs, prediction.lines)
    graphs, lines = build_graphs(state.perception.road, seen), seen.lines
    prediction = replace(prediction, graphs=graphs, lines=lines, slot_probability=None)
    return Sight(prediction, graphs, lines)


def observed(state: Memory, row: int, scene: Scene, sight: Sight) -> Observation:
    """What the environment lets the vehicle in this row of the scene observe."""
    speed_mps = float(scene.speed_mps[row])
    before_mps = speed_mps if state.speed_mps is None else state.speed_mps
    return observe_slots(scene, Ego(row, (speed_mps - before_mps) / DT_S, NO_LIMIT), sight)
