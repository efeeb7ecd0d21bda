"""HATN as a predictor: perception -> graphs -> SGN -> EDN, all vehicles in one batch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from hatn_sim.datatypes import (
    FloatArray,
    IntArray,
    Prediction,
    Route,
    Scene,
    SemanticGraphs,
)
from hatn_sim.graph import build_graphs
from hatn_sim.hatn.edn import frozen
from hatn_sim.hatn.inputs import to_map_frame, vehicle_inputs
from hatn_sim.hatn.sgn import GraphBatch, Intention
from hatn_sim.hatn.weights_io import Weights, load_weights
from hatn_sim.perception import PerceptionState, begin, perceive
from hatn_sim.predictors.free_motion import fallback_motion
from hatn_sim.road import Road


class Hatn:
    """Hierarchical Adaptable and Transferable Network (Wang et al., arXiv 2202.05140)."""

    def __init__(self, weights: Weights | Path, name: str = "hatn", adapt: str = "none") -> None:
        torch.set_num_threads(1)  # more threads are slower at this size
        self.name, self.adapt = name, adapt
        self.weights = load_weights(weights) if isinstance(weights, Path) else weights
        self._drive = frozen(self.weights.edn)

    def init(self, road: Road) -> PerceptionState:
        return begin(road)

    def observe(
        self,
        state: PerceptionState,
        scene: Scene,
        routes: tuple[Route | None, ...] | None = None,
    ) -> PerceptionState:
        return perceive(state, scene, routes)

    def predict(self, state: PerceptionState) -> Prediction:
        return self.predict_graphs(state, build_graphs(state.road, state.seen))

    def predict_graphs(self, state: PerceptionState, graphs: SemanticGraphs) -> Prediction:
        """The prediction for one moment that has been perceived already."""
        seen = state.seen
        count = len(seen.scene.ids)
        components = self.weights.sgn.settings.components
        fallback = np.ones(count, dtype=np.bool_)
        fallback[graphs.ego] = False
        xy = fallback_motion(seen.tracks)
        weight = np.full((count, components), 1.0 / components)
        mean = np.repeat(3.0 * seen.scene.speed_mps[:, None], components, axis=1)
        std = np.full((count, components), 3.0)
        slots = np.zeros(graphs.node_mask.shape)
        if len(graphs.ego):
            intention = self.intend(graphs)
            xy[graphs.ego] = self.decode(state, graphs.ego, intention.profile_m[:, 0])
            slots = intention.slot_logit.double().softmax(-1).numpy()
            weight[graphs.ego], mean[graphs.ego], std[graphs.ego] = _ego_goals(intention)
        return Prediction(
            ids=seen.scene.ids,
            xy_m=xy[:, None],
            mode_probability=np.ones((count, 1)),
            fallback=fallback,
            adapted=np.zeros(count, dtype=np.bool_),
            lines=seen.lines,
            graphs=graphs,
            slot_probability=slots,
            goal_weight=weight,
            goal_mean_m=mean,
            goal_std_m=std,
        )

    @torch.inference_mode()
    def intend(self, graphs: SemanticGraphs) -> Intention:
        """What the SGN says of all graphs; there must be one."""
        intention: Intention = self.weights.sgn(graph_batch(graphs))
        return intention

    @torch.inference_mode()
    def decode(self, state: PerceptionState, vehicle: IntArray, goal_m: Tensor) -> FloatArray:
        """What the EDN makes of profiles [B, P]: where vehicles [B] go in the map, [B, F, 2]."""
        seen = state.seen
        goal_m = goal_m[:, -self.weights.edn.settings.goal_steps :]
        inputs = vehicle_inputs(state.road, seen, vehicle)
        history, line, at = map(torch.from_numpy, (inputs.history, inputs.line, inputs.at))
        future = self._drive(history, line, at, goal_m).double().numpy()
        return to_map_frame(future, seen.scene.xy_m[vehicle], seen.scene.yaw_rad[vehicle])


def graph_batch(graphs: SemanticGraphs) -> GraphBatch:
    """The graphs as tensors for the network."""
    return GraphBatch(
        x=torch.from_numpy(graphs.x.astype(np.float32)),
        context=torch.from_numpy(graphs.context.astype(np.float32)),
        node_mask=torch.from_numpy(graphs.node_mask),
        focus_mask=torch.from_numpy(graphs.focus_mask),
        history_mask=torch.from_numpy(graphs.history_mask),
    )


def _ego_goals(intention: Intention) -> tuple[FloatArray, FloatArray, FloatArray]:
    return (
        intention.goal_log_weight[:, 0].exp().double().numpy(),
        intention.goal_mean_m[:, 0].double().numpy(),
        intention.goal_std_m[:, 0].double().numpy(),
    )
