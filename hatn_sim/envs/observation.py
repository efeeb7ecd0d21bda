"""A scene and what was made of it -> the arrays of an observation. Pure; see `features`.

All is relative to the ego and its conflicts, so that what is learnt in one place can be used in
another. What is not there is 0 and masked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import (
    MAX_NODES,
    BoolArray,
    FloatArray,
    IntArray,
    Lines,
    Prediction,
    Scene,
    SemanticGraphs,
)
from hatn_sim.envs.features import (
    EVERY_FRAMES,
    MODES,
    ON_ROAD,
    OTHER,
    OWN,
    POINTS,
    REACH_M,
    ROAD_AT_M,
    SLOT,
    TRAJECTORY_M,
    VEHICLES,
    clipped,
)
from hatn_sim.graph import AHEAD_AT_M, CONTEXT, FREE_M

Observation = dict[str, np.ndarray]
NO_LEADER_M: Final = 60.0
_COLUMN: Final = {name: column for column, name in enumerate(CONTEXT)}
_AT: Final = [AHEAD_AT_M.index(at) for at in ROAD_AT_M]


@dataclass(frozen=True, eq=False)
class Ego:
    """What the ego knows of itself."""

    row: int  # in the scene
    acceleration_mps2: float
    time_left: float  # share of the time limit


@dataclass(frozen=True, eq=False)
class Sight:
    """A prediction with the graphs and lines that it goes with, whoever made them."""

    prediction: Prediction
    graphs: SemanticGraphs
    lines: Lines

    def row_of(self, vehicle: int) -> int | None:
        """The graph of a vehicle; None: it is on no line."""
        found = np.flatnonzero(self.graphs.ego == vehicle)
        return int(found[0]) if len(found) else None


def observe_vehicles(scene: Scene, ego: Ego) -> Observation:
    """The form `vehicles`: the ego and its neighbours."""
    near = nearest_vehicles(scene, ego.row)
    return {"ego": clipped(_own(scene, ego), OWN), **_others(scene, ego.row, near, None)}


def observe_slots(scene: Scene, ego: Ego, sight: Sight) -> Observation:
    """The form `slots`: also the ego's line, its semantic graph, and what is predicted."""
    near = nearest_vehicles(scene, ego.row)
    row = sight.row_of(ego.row)
    own = np.concatenate((_own(scene, ego), _on_road(scene, ego.row, sight, row)))
    rear = None if row is None else sight.graphs.rear[row]
    slots, slot_mask = _slots(scene, ego.row, sight, row)
    paths, chances = _trajectories(scene, ego.row, near, sight.prediction)
    return {
        "ego": clipped(own, OWN + ON_ROAD),
        **_others(scene, ego.row, near, rear),
        "slots": slots,
        "slot_mask": slot_mask,
        "trajectories": paths,
        "mode_probability": chances,
    }


def admissible_slots(sight: Sight, vehicle: int) -> BoolArray:
    """The slots [M] that a vehicle can choose from: to yield always, to pass where it is at stake.

    At a red light there is nothing to choose.
    """
    mask = np.zeros(MAX_NODES, dtype=np.bool_)
    mask[0] = True
    row, graphs = sight.row_of(vehicle), sight.graphs
    if row is not None and graphs.has_conflict[row] and not graphs.ego_at_red[row]:
        mask |= graphs.focus_mask[row] & graphs.node_mask[row]
    return mask


def nearest_vehicles(scene: Scene, ego: int) -> IntArray:
    """The vehicles [<= VEHICLES] nearest to the ego within `REACH_M`, the nearest first."""
    away_m = np.hypot(*(scene.xy_m - scene.xy_m[ego]).T)
    away_m[ego] = np.inf
    order = np.argsort(away_m, kind="stable")[:VEHICLES]
    return order[away_m[order] <= REACH_M]


def in_frame_of(scene: Scene, ego: int, xy_m: FloatArray) -> FloatArray:
    """Positions [..., 2] as seen from the ego: x ahead, y left."""
    return _turned(scene, ego, xy_m - scene.xy_m[ego])


def _turned(scene: Scene, ego: int, vector: FloatArray) -> FloatArray:
    yaw_rad = float(scene.yaw_rad[ego])
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return vector @ np.array([[cos, -sin], [sin, cos]])


def _own(scene: Scene, ego: Ego) -> FloatArray:
    length, width = scene.size_m[ego.row]
    speed = scene.speed_mps[ego.row]
    return np.array([speed, ego.acceleration_mps2, length, width, ego.time_left])


def _on_road(scene: Scene, ego: int, sight: Sight, row: int | None) -> FloatArray:
    if row is None:
        return np.zeros(len(ON_ROAD))
    graphs, lines = sight.graphs, sight.lines
    context = graphs.context[row, 0]
    has_conflict, leader = bool(graphs.has_conflict[row]), int(graphs.leader[row])
    gate = "gate_m of the rear vehicle: stop line, give-way line or closed signal, up to FREE_M"
    return np.array(
        [
            1.0,
            lines.d_m[ego],
            lines.phi_rad[ego],
            *context[_AT],
            *context[len(AHEAD_AT_M) :][_AT],
            context[_COLUMN["waited_s of the ego"]],
            context[_COLUMN[gate]],
            has_conflict,
            graphs.ego_to_conflict_m[row, 0] if has_conflict else FREE_M,
            graphs.ego_at_red[row],
            leader >= 0,
            graphs.leader_gap_m[row] if leader >= 0 else NO_LEADER_M,
            scene.speed_mps[leader] if leader >= 0 else 0.0,
        ]
    )


def _others(scene: Scene, ego: int, near: IntArray, rear: IntArray | None) -> Observation:
    count = len(near)
    turned = scene.yaw_rad[near] - scene.yaw_rad[ego]
    speed, cos, sin = scene.speed_mps[near], np.cos(turned), np.sin(turned)
    values = np.zeros((count, len(OTHER)))
    values[:, 0:2] = in_frame_of(scene, ego, scene.xy_m[near])
    values[:, 2], values[:, 3] = cos, sin
    values[:, 4], values[:, 5] = speed * cos - scene.speed_mps[ego], speed * sin
    values[:, 6], values[:, 7:9] = speed, scene.size_m[near]
    if rear is not None:
        of_node = near[:, None] == rear[1:]
        values[:, 9] = np.where(of_node.any(axis=1), 1 + of_node.argmax(axis=1), 0)
    vehicles = np.zeros((VEHICLES, len(OTHER)), np.float32)
    vehicles[:count] = clipped(values, OTHER)
    return {"vehicles": vehicles, "vehicle_mask": _first(count, VEHICLES)}


def _slots(scene: Scene, ego: int, sight: Sight, row: int | None) -> tuple[np.ndarray, np.ndarray]:
    slots = np.zeros((MAX_NODES, len(SLOT)), np.float32)
    mask = np.zeros(MAX_NODES, np.float32)
    if row is None:
        return slots, mask
    graphs = sight.graphs
    there = np.flatnonzero(graphs.node_mask[row])
    context = graphs.context[row, there]
    chance = sight.prediction.slot_probability
    known = chance is not None and graphs.has_conflict[row]
    values = np.column_stack(
        (
            graphs.x[row, there, -1],
            graphs.ego_to_conflict_m[row, there],
            graphs.rear_to_conflict_m[row, there],
            in_frame_of(scene, ego, graphs.conflict_xy_m[row, there]),
            graphs.conflict_type[row, there],
            graphs.focus_mask[row, there],
            context[:, _COLUMN["earliest_s of the ego at the node's conflict, up to FAR_S"]],
            context[:, _COLUMN["earliest_s of the rear vehicle at the conflict, up to FAR_S"]],
            context[:, _COLUMN["waited_s of the rear vehicle"]],
            chance[row, there] if chance is not None and known else np.zeros(len(there)),
        )
    )
    slots[there] = clipped(values, SLOT)
    mask[there] = 1.0
    return slots, mask


def _trajectories(
    scene: Scene, ego: int, near: IntArray, prediction: Prediction
) -> tuple[np.ndarray, np.ndarray]:
    paths = np.zeros((VEHICLES + 1, MODES, POINTS, 2), np.float32)
    chances = np.zeros((VEHICLES + 1, MODES), np.float32)
    who = np.concatenate(([ego], near))
    chance = prediction.mode_probability[who]
    order = np.argsort(-chance, axis=1, kind="stable")[:, :MODES]
    chance = np.take_along_axis(chance, order, axis=1)
    points = prediction.xy_m[who[:, None], order, EVERY_FRAMES - 1 :: EVERY_FRAMES]
    seen = in_frame_of(scene, ego, points).astype(np.float32)
    is_there = chance > 0.0
    modes = order.shape[1]
    seen = np.clip(seen, -TRAJECTORY_M, TRAJECTORY_M)
    paths[: len(who), :modes] = np.where(is_there[..., None, None], seen, 0.0)
    chances[: len(who), :modes] = np.clip(chance, 0.0, 1.0)
    return paths, chances


def _first(count: int, whole: int) -> np.ndarray:
    return (np.arange(whole) < count).astype(np.float32)
