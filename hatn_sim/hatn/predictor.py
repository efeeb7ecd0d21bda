"""HATN as a predictor: perception -> graphs -> SGN -> EDN, all vehicles in one batch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from hatn_sim.datatypes import (
    HORIZON_FRAMES,
    FloatArray,
    IntArray,
    Prediction,
    Route,
    Scene,
    SemanticGraphs,
)
from hatn_sim.graph import build_graphs
from hatn_sim.hatn.edn import frozen
from hatn_sim.hatn.inputs import vehicle_history
from hatn_sim.hatn.sgn import GraphBatch, Intention
from hatn_sim.hatn.weights_io import Weights, load_weights
from hatn_sim.perception import Perception, PerceptionState, begin, perceive
from hatn_sim.predictors.constant_velocity import extrapolate
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
        road, seen = state.road, state.seen
        count = len(seen.scene.ids)
        components = self.weights.sgn.settings.components
        fallback = np.ones(count, dtype=np.bool_)
        fallback[graphs.ego] = False
        xy = extrapolate(seen.scene)
        weight = np.full((count, components), 1.0 / components)
        mean = np.repeat(3.0 * seen.scene.speed_mps[:, None], components, axis=1)
        std = np.full((count, components), 3.0)
        slots = np.zeros(graphs.node_mask.shape)
        if len(graphs.ego):
            intention = self.intend(graphs)
            future = self.decode(seen, graphs.ego, intention.goal_m()[:, 0])
            xy[graphs.ego] = _to_map(road, seen, graphs, future)
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
    def decode(self, seen: Perception, vehicle: IntArray, goal_m: Tensor) -> FloatArray:
        """What the EDN makes of goals [B]: the future (s - s_t, d - d_t) [B, F, 2] of vehicles."""
        history = torch.from_numpy(vehicle_history(seen, vehicle))
        future: FloatArray = self._drive(history, goal_m).double().numpy()
        return future


def graph_batch(graphs: SemanticGraphs) -> GraphBatch:
    """The graphs as tensors for the network."""
    return GraphBatch(
        x=torch.from_numpy(graphs.x.astype(np.float32)),
        context=torch.from_numpy(graphs.context.astype(np.float32)),
        node_mask=torch.from_numpy(graphs.node_mask),
        focus_mask=torch.from_numpy(graphs.focus_mask),
        history_mask=torch.from_numpy(graphs.history_mask),
    )


def _to_map(road: Road, seen: Perception, graphs: SemanticGraphs, future: FloatArray) -> FloatArray:
    """Positions [E, F, 2] of (s - s_t, d - d_t) [E, F, 2]; shifted so that now is exactly now."""
    line = seen.lines.line[graphs.ego]
    s, d = seen.lines.s_m[graphs.ego], seen.lines.d_m[graphs.ego]
    now = road.locate(line, s, d)
    at = road.locate(line, s[:, None] + future[..., 0], d[:, None] + future[..., 1])
    shift = seen.scene.xy_m[graphs.ego] - now
    return at + shift[:, None].repeat(HORIZON_FRAMES, axis=1)


def _ego_goals(intention: Intention) -> tuple[FloatArray, FloatArray, FloatArray]:
    return (
        intention.goal_log_weight[:, 0].exp().double().numpy(),
        intention.goal_mean_m[:, 0].double().numpy(),
        intention.goal_std_m[:, 0].double().numpy(),
    )
