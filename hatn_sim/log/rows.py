"""One frame -> its rows in the tables of `schema`. Vehicles are indices into all ids so far."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hatn_sim.datatypes import Frame, Prediction, Scene
from hatn_sim.log import schema
from hatn_sim.log.parts import Array, Ragged


def frame_rows(frame_index: int, frame: Frame) -> dict[str, Array | Ragged]:
    closed = frame.scene.signal_closed
    return {
        "frame": np.array([frame_index]),
        "time_s": np.array([frame.scene.time_s]),
        "done": np.array([frame.done]),
        "signal_closed": (closed, np.array([len(closed)])),
    }


def track_rows(frame_index: int, scene: Scene, vehicles: Array) -> dict[str, Array | Ragged]:
    count = len(scene.ids)
    return {
        "frame": np.full(count, frame_index),
        "time_s": np.full(count, scene.time_s),
        "id": vehicles,
        "x_m": scene.xy_m[:, 0],
        "y_m": scene.xy_m[:, 1],
        "yaw_rad": scene.yaw_rad,
        "speed_mps": scene.speed_mps,
        "length_m": scene.size_m[:, 0],
        "width_m": scene.size_m[:, 1],
        "kind": scene.kind,
        "red": scene.colour[:, 0],
        "green": scene.colour[:, 1],
        "blue": scene.colour[:, 2],
        "blinker": scene.blinker,
    }


def truth_rows(
    frame_index: int, vehicles: Array, routes: Sequence[int]
) -> dict[str, Array | Ragged]:
    return {
        "frame": np.full(len(vehicles), frame_index),
        "id": vehicles,
        "route": np.array(routes, dtype=np.int64),
    }


def prediction_rows(
    frame_index: int, scene: Scene, prediction: Prediction, vehicles: Array
) -> dict[str, Array | Ragged]:
    count, modes, frames, _ = prediction.xy_m.shape
    on_line = np.zeros(count, dtype=bool)
    line_probability = np.zeros(count)
    if prediction.lines is not None:
        on_line = prediction.lines.line >= 0
        line_probability = np.where(on_line, prediction.lines.probability, 0.0)
    return {
        "frame": np.full(count, frame_index),
        "id": vehicles,
        "fallback": prediction.fallback,
        "adapted": prediction.adapted,
        "on_line": on_line,
        "line_probability": line_probability,
        "mode_probability": _lists(prediction.mode_probability, count),
        "offset_xy_m": (
            (prediction.xy_m - scene.xy_m[:, None, None]).ravel(),
            np.full(count, modes * frames * 2),
        ),
        "goal_weight": _lists(prediction.goal_weight, count),
        "goal_mean_m": _lists(prediction.goal_mean_m, count),
        "goal_std_m": _lists(prediction.goal_std_m, count),
        **_slot_rows(prediction, count, vehicles),
    }


def _lists(rows: Array | None, count: int) -> Ragged:
    """A list of equal length for each row, an empty one where there is nothing."""
    if rows is None:
        return np.zeros(0), np.zeros(count, dtype=np.int64)
    return rows.ravel(), np.full(count, rows.shape[1])


def _slot_rows(prediction: Prediction, count: int, vehicles: Array) -> dict[str, Array | Ragged]:
    """The nodes of every vehicle's own graph, in the order of vehicles; none: empty lists."""
    graphs = prediction.graphs
    has_conflict = np.zeros(count, dtype=bool)
    if graphs is None:
        nothing = dict.fromkeys(schema.SLOT_COLUMNS, _lists(None, count))
        return {"has_conflict": has_conflict, **nothing}
    lengths = np.zeros(count, dtype=np.int64)
    by_vehicle = np.argsort(graphs.ego, kind="stable")
    mask = graphs.node_mask[by_vehicle]
    lengths[graphs.ego] = graphs.node_mask.sum(axis=1)
    has_conflict[graphs.ego] = graphs.has_conflict

    def nodes(values: Array) -> Ragged:
        return values[by_vehicle][mask], lengths

    probability = prediction.slot_probability
    return {
        "has_conflict": has_conflict,
        "slot_id": (vehicles[graphs.rear[by_vehicle][mask]], lengths),
        "slot_probability": _lists(None, count) if probability is None else nodes(probability),
        "slot_in_focus": nodes(graphs.focus_mask),
        "ego_to_conflict_m": nodes(graphs.ego_to_conflict_m),
        "rear_to_conflict_m": nodes(graphs.rear_to_conflict_m),
        "conflict_x_m": nodes(graphs.conflict_xy_m[..., 0]),
        "conflict_y_m": nodes(graphs.conflict_xy_m[..., 1]),
        "conflict_type": nodes(graphs.conflict_type),
        "slot_length_m": nodes(graphs.x[:, :, -1, 6]),
    }
