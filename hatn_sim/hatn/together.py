"""Several moments as one batch for the networks, and what they said of it as parts again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import accumulate, pairwise
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from hatn_sim.datatypes import IntArray, Lines, Prediction, SemanticGraphs
from hatn_sim.hatn.inputs import VehicleInputs
from hatn_sim.hatn.sgn import GraphBatch, Intention, Repeats, SlotModes
from hatn_sim.worlds import Worlds, part

Tensors = TypeVar("Tensors", GraphBatch, Intention, SlotModes)


def batches_joined(batches: Sequence[GraphBatch]) -> GraphBatch:
    """Graphs one after another."""
    names = [one.name for one in fields(GraphBatch)]
    return GraphBatch(*(torch.cat([getattr(one, name) for one in batches]) for name in names))


def repeats_joined(repeats: Sequence[Repeats]) -> Repeats:
    """Those of `batches_joined`: of different moments no history is the same."""
    nodes = [0, *accumulate(len(one.history) for one in repeats)]
    histories = [0, *accumulate(len(one.first) for one in repeats)]
    return Repeats(
        torch.cat([one.first + before for one, before in zip(repeats, nodes, strict=False)]),
        torch.cat([one.history + before for one, before in zip(repeats, histories, strict=False)]),
    )


def inputs_joined(inputs: Sequence[VehicleInputs]) -> VehicleInputs:
    """Vehicles one after another."""
    names = [one.name for one in fields(VehicleInputs)]
    return VehicleInputs(
        *(np.concatenate([getattr(one, name) for one in inputs]) for name in names)
    )


def predictions_of_each(
    whole: Prediction, graphs: SemanticGraphs, scene: Worlds, lines: Sequence[Lines]
) -> list[Prediction]:
    """What was predicted for all worlds of a scene as predictions for each, with its own lines."""
    starts = np.array([rows.start for rows in scene.rows])
    before = starts[scene.world[graphs.ego]]
    own = replace(
        graphs,
        ego=graphs.ego - before,
        leader=_counted_from(graphs.leader, before),
        rear=_counted_from(graphs.rear, before[:, None]),
        front=_counted_from(graphs.front, before[:, None]),
    )
    egos = pairwise((*np.searchsorted(graphs.ego, starts).tolist(), len(graphs.ego)))
    slots = whole.slot_probability
    each: list[Prediction] = []
    for one, rows, of_one, ends in zip(scene.scenes, scene.rows, lines, egos, strict=True):
        # Where nobody is on a line, there are no modes to choose from.
        modes = slice(None) if ends[0] < ends[1] else slice(1)
        prediction = part(
            whole,
            rows,
            ids=one.ids,
            xy_m=whole.xy_m[rows, modes],
            mode_probability=whole.mode_probability[rows, modes],
            lines=of_one,
            graphs=part(own, slice(*ends), ids=one.ids),
            slot_probability=None if slots is None else slots[slice(*ends)],
        )
        each.append(prediction)
    return each


def _counted_from(vehicle: IntArray, first: IntArray) -> IntArray:
    """Numbers of vehicles within their own world; -1 stays."""
    return np.where(vehicle >= 0, vehicle - first, vehicle)


def rows_of(tensors: Tensors, rows: slice) -> Tensors:
    """Some of them."""

    def cut(value: Any) -> Any:
        if value is None:
            return None
        return value[rows] if isinstance(value, Tensor) else rows_of(value, rows)

    return type(tensors)(*(cut(getattr(tensors, one.name)) for one in fields(tensors)))
