"""Several moments as one batch for the networks, and what they said of it as parts again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields
from itertools import accumulate, pairwise
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from hatn_sim.hatn.inputs import VehicleInputs
from hatn_sim.hatn.sgn import GraphBatch, Intention, Repeats, SlotModes

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


def parts(counts: Sequence[int]) -> Iterator[slice]:
    """The rows of each, of several one after another."""
    return (slice(begin, end) for begin, end in pairwise((0, *accumulate(counts))))


def rows_of(tensors: Tensors, rows: slice) -> Tensors:
    """Some of them."""

    def cut(value: Any) -> Any:
        if value is None:
            return None
        return value[rows] if isinstance(value, Tensor) else rows_of(value, rows)

    return type(tensors)(*(cut(getattr(tensors, one.name)) for one in fields(tensors)))
