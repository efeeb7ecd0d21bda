"""HATN as a predictor: perception -> graphs -> SGN -> EDN, all vehicles in one batch."""

from __future__ import annotations

from collections.abc import Sequence
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
from hatn_sim.hatn.edn import EncoderDecoderNetwork
from hatn_sim.hatn.edn_program import frozen_edn
from hatn_sim.hatn.inputs import VehicleInputs, to_map_frame, vehicle_inputs
from hatn_sim.hatn.modes import modes_of
from hatn_sim.hatn.sgn import GraphBatch, Intention, Repeats
from hatn_sim.hatn.sgn_program import frozen_sgn
from hatn_sim.hatn.together import (
    batches_joined,
    inputs_joined,
    predictions_of_each,
    repeats_joined,
    rows_of,
)
from hatn_sim.hatn.weights_io import Weights, load_weights
from hatn_sim.perception import (
    Perception,
    PerceptionState,
    begin,
    perceive,
    perceive_all,
    perceptions_joined,
)
from hatn_sim.predictors.free_motion import fallback_motion
from hatn_sim.road import Road
from hatn_sim.worlds import Worlds, parts

Told = tuple[Intention, FloatArray, FloatArray]
"""What the networks say of vehicles [E]: the intention, and what `Hatn.drive` gives."""


class Hatn:
    """Hierarchical Adaptable and Transferable Network (Wang et al., arXiv 2202.05140)."""

    def __init__(self, weights: Weights | Path, name: str = "hatn") -> None:
        torch.set_num_threads(1)  # more threads are slower at this size
        self.name = name
        self.weights = load_weights(weights) if isinstance(weights, Path) else weights
        self._relate = frozen_sgn(self.weights.sgn)
        self._drive = frozen_edn(self.weights.edn)

    def init(self, road: Road) -> PerceptionState:
        return begin(road, self.weights.line_choice)

    def observe(
        self,
        state: PerceptionState,
        scene: Scene,
        routes: tuple[Route | None, ...] | None = None,
    ) -> PerceptionState:
        return perceive(state, scene, routes)

    def observe_all(
        self,
        states: Sequence[PerceptionState],
        scenes: Sequence[Scene],
        routes: Sequence[tuple[Route | None, ...]] | None = None,
    ) -> list[PerceptionState]:
        """What `observe` gives of each: in one go where all are on one road."""
        if len(states) > 1 and _share_road(states):
            return perceive_all(states, scenes, routes)
        known = [None] * len(states) if routes is None else routes
        return [self.observe(*one) for one in zip(states, scenes, known, strict=True)]

    def predict(self, state: PerceptionState) -> Prediction:
        return self.predict_graphs(state, build_graphs(state.road, state.seen))

    def predict_all(self, states: Sequence[PerceptionState]) -> list[Prediction]:
        """What `predict` says of each, but for rounding: each network is asked once for all.

        Where all are on one road, graphs are built of all at once, too.
        """
        if len(states) > 1 and _share_road(states):
            return self._of_worlds([state.seen for state in states])
        graphs = [build_graphs(state.road, state.seen) for state in states]
        told: list[Told | None] = [None] * len(states)
        some = [k for k, own in enumerate(graphs) if len(own.ego)]
        if some:
            told_some = self._tell([(states[k], graphs[k]) for k in some])
            for k, one in zip(some, told_some, strict=True):
                told[k] = one
        return [
            self._prediction(state.seen, own, one)
            for state, own, one in zip(states, graphs, told, strict=True)
        ]

    def _of_worlds(self, every: Sequence[Perception]) -> list[Prediction]:
        seen = perceptions_joined(every)
        graphs, told = build_graphs(seen.road, seen), None
        if len(graphs.ego):
            intention = self.intend(graphs)
            told = (intention, *self._drive_seen(seen, graphs.ego, intention))
        whole = self._prediction(seen, graphs, told)
        assert isinstance(seen.scene, Worlds)
        return predictions_of_each(whole, graphs, seen.scene, [one.lines for one in every])

    @torch.inference_mode()
    def _tell(self, moments: Sequence[tuple[PerceptionState, SemanticGraphs]]) -> list[Told]:
        every = [graphs for _, graphs in moments]
        intention = self._relate(
            batches_joined([graph_batch(graphs) for graphs in every]),
            repeats_joined([repeats_of(graphs) for graphs in every]),
        )
        inputs = [vehicle_inputs(state.road, state.seen, graphs.ego) for state, graphs in moments]
        now = [(state.seen.scene, graphs.ego) for state, graphs in moments]
        future, probability = self._driven(
            inputs_joined(inputs),
            np.concatenate([scene.xy_m[ego] for scene, ego in now]),
            np.concatenate([scene.yaw_rad[ego] for scene, ego in now]),
            intention,
        )
        return [
            (rows_of(intention, rows), future[rows], probability[rows])
            for rows in parts([len(graphs.ego) for graphs in every])
        ]

    def predict_graphs(
        self,
        state: PerceptionState,
        graphs: SemanticGraphs,
        intention: Intention | None = None,
    ) -> Prediction:
        """The prediction for one moment that has been perceived already.

        `intention` is what `intend` said of the graphs, if it was asked before.
        """
        if not len(graphs.ego):
            return self._prediction(state.seen, graphs, None)
        intention = intention or self.intend(graphs)
        told = (intention, *self.drive(state, graphs.ego, intention))
        return self._prediction(state.seen, graphs, told)

    def _prediction(
        self, seen: Perception, graphs: SemanticGraphs, told: Told | None
    ) -> Prediction:
        """Of those with a graph what the networks say; `told` is None where there is none."""
        count = len(seen.scene.ids)
        components = self.weights.sgn.settings.components
        fallback = np.ones(count, dtype=np.bool_)
        fallback[graphs.ego] = False
        physics = np.zeros((count, 1, HORIZON_FRAMES, 2))
        if fallback.any():
            physics = fallback_motion(seen.tracks)[:, None]
        xy, chance = physics, np.ones((count, 1))
        weight = np.full((count, components), 1.0 / components)
        mean = np.repeat(3.0 * seen.scene.speed_mps[:, None], components, axis=1)
        std = np.full((count, components), 3.0)
        slots = np.zeros(graphs.node_mask.shape)
        if told is not None:
            intention, future, probability = told
            xy = physics.repeat(future.shape[1], axis=1)
            chance = np.eye(1, future.shape[1]).repeat(count, axis=0)
            xy[graphs.ego], chance[graphs.ego] = future, probability
            slots = intention.slot_logit.double().softmax(-1).numpy()
            weight[graphs.ego], mean[graphs.ego], std[graphs.ego] = _ego_goals(intention)
        return Prediction(
            ids=seen.scene.ids,
            xy_m=xy,
            mode_probability=chance,
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
        return self._relate(graph_batch(graphs), repeats_of(graphs))

    def drive(
        self, state: PerceptionState, vehicle: IntArray, intention: Intention
    ) -> tuple[FloatArray, FloatArray]:
        """What the EDN makes of the intention of vehicles [E]: positions [E, K, F, 2] in the map,
        and the probability [E, K] of each mode; where that is 0, the first mode stands again.
        """
        return self._drive_seen(state.seen, vehicle, intention)

    @torch.inference_mode()
    def _drive_seen(
        self, seen: Perception, vehicle: IntArray, intention: Intention
    ) -> tuple[FloatArray, FloatArray]:
        inputs, scene = vehicle_inputs(seen.road, seen, vehicle), seen.scene
        return self._driven(inputs, scene.xy_m[vehicle], scene.yaw_rad[vehicle], intention)

    def _driven(
        self, inputs: VehicleInputs, xy_m: FloatArray, yaw_rad: FloatArray, intention: Intention
    ) -> tuple[FloatArray, FloatArray]:
        modes = modes_of(intention)
        probability = modes.probability.double().numpy()
        row, mode = np.nonzero(probability > 0.0)
        read = (torch.from_numpy(part[row]) for part in (inputs.history, inputs.line, inputs.at))
        goal_m = told_goal_m(self.weights.edn, modes.profile_m[row, mode])
        own = self._drive(*read, goal_m).double().numpy()
        first = own[np.searchsorted(row, np.arange(len(xy_m)))]
        future = first[:, None].repeat(probability.shape[1], axis=1)
        future[row, mode] = own
        return to_map_frame(future, xy_m, yaw_rad), probability


def _share_road(states: Sequence[PerceptionState]) -> bool:
    """Whether several can be seen as one: on one road, their lines chosen alike."""
    first = states[0]
    return all(one.road is first.road and one.choice is first.choice for one in states)


def told_goal_m(network: EncoderDecoderNetwork, profile_m: Tensor) -> Tensor:
    """What the EDN is told [B, G] of profiles [B, P]: all of them, or their ends."""
    return profile_m[:, -network.settings.goal_steps :]


def graph_batch(graphs: SemanticGraphs) -> GraphBatch:
    """The graphs as tensors for the network."""
    return GraphBatch(
        x=torch.from_numpy(graphs.x.astype(np.float32)),
        context=torch.from_numpy(graphs.context.astype(np.float32)),
        node_mask=torch.from_numpy(graphs.node_mask),
        focus_mask=torch.from_numpy(graphs.focus_mask),
        history_mask=torch.from_numpy(graphs.history_mask),
    )


def repeats_of(graphs: SemanticGraphs) -> Repeats:
    """Nodes with the same rear vehicle and conflict: they are of one history, in many graphs."""
    rear, to_conflict_m = (
        of_node[graphs.node_mask] for of_node in (graphs.rear, graphs.rear_to_conflict_m)
    )
    _, first, history = np.unique(rear + 1j * to_conflict_m, return_index=True, return_inverse=True)
    return Repeats(torch.from_numpy(first), torch.from_numpy(history))


def _ego_goals(intention: Intention) -> tuple[FloatArray, FloatArray, FloatArray]:
    return (
        intention.goal_log_weight[:, 0].exp().double().numpy(),
        intention.goal_mean_m[:, 0].double().numpy(),
        intention.goal_std_m[:, 0].double().numpy(),
    )
