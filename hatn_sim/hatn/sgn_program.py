"""The graph network as one program, for prediction only."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from copy import deepcopy
from dataclasses import fields
from typing import Any

import torch
from torch import Tensor, nn

from hatn_sim.datatypes import HISTORY_FRAMES, MAX_NODES
from hatn_sim.graph import CONTEXT_SIZE
from hatn_sim.hatn.gru_columns import LastState
from hatn_sim.hatn.sgn import (
    FEATURE_SCALE,
    GraphBatch,
    Intention,
    Repeats,
    SemanticGraphNetwork,
    SlotModes,
)


def frozen_sgn(
    network: SemanticGraphNetwork,
) -> Callable[..., Intention]:
    """The network for prediction only, as one program: the same numbers in less time.

    For any number of graphs with as many nodes and frames as `graph.build_graphs` makes, and which
    of their histories are the same, if that is known; goals are of egos only.
    """
    graphs = GraphBatch(
        x=torch.zeros(2, MAX_NODES, HISTORY_FRAMES, len(FEATURE_SCALE)),
        context=torch.zeros(2, MAX_NODES, CONTEXT_SIZE),
        node_mask=torch.ones(2, MAX_NODES, dtype=torch.bool),
        focus_mask=torch.ones(2, MAX_NODES, dtype=torch.bool),
        history_mask=torch.ones(2, MAX_NODES, HISTORY_FRAMES, dtype=torch.bool),
    )
    example = (*_tensors(graphs), *_tensors(_no_repeats(graphs)))
    with warnings.catch_warnings():
        # Deprecated in favour of a compiler that a user's machine may not have.
        warnings.simplefilter("ignore")
        # Tests hold it against the network; to trace it again and compare takes most of the time.
        program = torch.jit.freeze(
            torch.jit.trace(_AsTuples(_with_columns(network)).eval(), example, check_trace=False)
        )

    def predict(batch: GraphBatch, repeats: Repeats | None = None) -> Intention:
        repeats = repeats or _no_repeats(batch)
        *of_nodes, modes = program(*_tensors(batch), *_tensors(repeats))
        return Intention(*of_nodes, modes=SlotModes(*modes) if modes else None)

    return predict


class _Columns(nn.Module):
    """Stands in for a GRU of which only the last state is asked."""

    def __init__(self, gru: nn.GRU) -> None:
        super().__init__()
        self.last = LastState(gru)

    def forward(self, read: Tensor) -> tuple[None, Tensor]:
        return None, self.last(read).T.unsqueeze(0)


def _with_columns(network: SemanticGraphNetwork) -> SemanticGraphNetwork:
    """A copy whose GRUs over histories are the faster ones."""
    copy = deepcopy(network)
    if not network.settings.sequential:
        copy.add_module("absolute_gru", _Columns(network.absolute_gru))
        copy.add_module("relative_gru", _Columns(network.relative_gru))
    return copy


class _AsTuples(nn.Module):
    """The network as a function of tensors, to be traced."""

    def __init__(self, network: SemanticGraphNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, *tensors: Tensor) -> tuple[Any, ...]:
        batch, repeats = GraphBatch(*tensors[:-2]), Repeats(*tensors[-2:])
        found = self.network(batch, repeats, egos_only=True)
        of_nodes = (getattr(found, one.name) for one in fields(found) if one.name != "modes")
        return *of_nodes, () if found.modes is None else _tensors(found.modes)


def _no_repeats(batch: GraphBatch) -> Repeats:
    every = torch.arange(int(batch.node_mask.sum()))
    return Repeats(every, every)


def _tensors(of: GraphBatch | Repeats | SlotModes) -> tuple[Tensor, ...]:
    return tuple(getattr(of, one.name) for one in fields(of))
