"""HATN that learns from every vehicle while it watches: `Hatn` with online adaptation around it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hatn_sim.datatypes import Prediction, Route, Scene, SemanticGraphs
from hatn_sim.graph import build_graphs
from hatn_sim.hatn.adaptation_memory import (
    AdaptationSettings,
    AdaptationState,
    adapter_of,
    correction_m,
    default_settings,
    first,
    follow,
    moment_of,
)
from hatn_sim.hatn.inputs import to_map_frame, to_vehicle_frame
from hatn_sim.hatn.predictor import Hatn, told_goal_m
from hatn_sim.hatn.sgn import Intention
from hatn_sim.perception import PerceptionState
from hatn_sim.road import Road


@dataclass(frozen=True, eq=False)
class AdaptiveState:
    """What was perceived and made of it, and learnt; None where no vehicle is on a line."""

    perception: PerceptionState
    graphs: SemanticGraphs
    intention: Intention | None
    adaptation: AdaptationState | None


class AdaptiveHatn:
    """The predictions of `hatn`, corrected by what each vehicle did in the last tenths of a second.

    Goals are predicted at every frame, since the past is predicted again for the goal of then; a
    prediction that is asked for shares them. Vehicles of `unadapted` are predicted as `hatn` does.
    Without `settings`, those that suit the network.
    """

    def __init__(
        self,
        hatn: Hatn,
        settings: AdaptationSettings | None = None,
        unadapted: frozenset[str] = frozenset(),
    ) -> None:
        self.name = hatn.name
        self.weights = hatn.weights
        self._hatn = hatn
        self._adapter = adapter_of(
            hatn.weights.edn, settings or default_settings(hatn.weights.edn), as_program=True
        )
        self._unadapted = unadapted

    def init(self, road: Road) -> AdaptiveState:
        perception = self._hatn.init(road)
        return AdaptiveState(perception, build_graphs(road, perception.seen), None, None)

    def observe(
        self,
        state: AdaptiveState,
        scene: Scene,
        routes: tuple[Route | None, ...] | None = None,
    ) -> AdaptiveState:
        perception = self._hatn.observe(state.perception, scene, routes)
        graphs = build_graphs(perception.road, perception.seen)
        if not len(graphs.ego):
            return AdaptiveState(perception, graphs, None, None)
        intention = self._hatn.intend(graphs)
        after = self.learn(state.adaptation, perception, graphs, intention)
        return AdaptiveState(perception, graphs, intention, after)

    def predict(self, state: AdaptiveState) -> Prediction:
        prediction = self._hatn.predict_graphs(state.perception, state.graphs, state.intention)
        if state.adaptation is None:
            return prediction
        return self.correct(prediction, state.graphs, state.adaptation)

    def learn(
        self,
        before: AdaptationState | None,
        perception: PerceptionState,
        graphs: SemanticGraphs,
        intention: Intention,
    ) -> AdaptationState:
        """One frame on, with what was perceived of it and made of that; at least one graph."""
        # A copy: what is made for inference alone cannot be differentiated by.
        goal_m = told_goal_m(self._hatn.weights.edn, intention.profile_m[:, 0]).clone()
        moment = moment_of(perception.road, perception.seen, graphs.ego, goal_m)
        if before is None:
            return first(self._adapter, moment)
        return follow(self._adapter, before, moment, self._unadapted)

    def correct(
        self, prediction: Prediction, graphs: SemanticGraphs, adaptation: AdaptationState
    ) -> Prediction:
        """What the trained network says, corrected by what was learnt until now."""
        moment = adaptation.moment
        # Its first mode goes by the goal that the adaptation goes by.
        trained_m = to_vehicle_frame(prediction.xy_m[graphs.ego, 0], moment.xy_m, moment.yaw_rad)
        row, moved_m = correction_m(self._adapter, adaptation, trained_m)
        vehicle = graphs.ego[row]
        xy_m, adapted = prediction.xy_m.copy(), prediction.adapted.copy()
        nowhere = np.zeros((len(row), 2))
        xy_m[vehicle] += to_map_frame(moved_m, nowhere, moment.yaw_rad[row])[:, None]
        adapted[vehicle] = True
        return replace(prediction, xy_m=xy_m, adapted=adapted)
