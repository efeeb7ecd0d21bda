"""The graph network as one program, for prediction only."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import torch
from torch import Tensor, nn

from hatn_sim.datatypes import HISTORY_FRAMES, MAX_NODES
from hatn_sim.graph import CONTEXT_SIZE
from hatn_sim.hatn.sgn import (
    FEATURE_SCALE,
    GraphBatch,
    Intention,
    SemanticGraphNetwork,
    SlotModes,
)


def frozen_sgn(network: SemanticGraphNetwork) -> Callable[[GraphBatch], Intention]:
    """The network for prediction only, as one program: the same numbers in less time.

    For any number of graphs with as many nodes and frames as `graph.build_graphs` makes.
    """
    graphs = GraphBatch(
        x=torch.zeros(2, MAX_NODES, HISTORY_FRAMES, len(FEATURE_SCALE)),
        context=torch.zeros(2, MAX_NODES, CONTEXT_SIZE),
        node_mask=torch.ones(2, MAX_NODES, dtype=torch.bool),
        focus_mask=torch.ones(2, MAX_NODES, dtype=torch.bool),
        history_mask=torch.ones(2, MAX_NODES, HISTORY_FRAMES, dtype=torch.bool),
    )
    with warnings.catch_warnings():
        # Deprecated in favour of a compiler that a user's machine may not have.
        warnings.simplefilter("ignore")
        program = torch.jit.freeze(torch.jit.trace(_AsTuples(network).eval(), _tensors(graphs)))

    def predict(batch: GraphBatch) -> Intention:
        *of_nodes, modes = program(*_tensors(batch))
        return Intention(*of_nodes, modes=SlotModes(*modes) if modes else None)

    return predict


class _AsTuples(nn.Module):
    """The network as a function of tensors, to be traced."""

    def __init__(self, network: SemanticGraphNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, *tensors: Tensor) -> tuple[Any, ...]:
        found = self.network(GraphBatch(*tensors))
        of_nodes = (getattr(found, one.name) for one in fields(found) if one.name != "modes")
        return *of_nodes, () if found.modes is None else _tensors(found.modes)


def _tensors(of: GraphBatch | SlotModes) -> tuple[Tensor, ...]:
    return tuple(getattr(of, one.name) for one in fields(of))
