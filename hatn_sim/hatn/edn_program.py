"""The encoder-decoder network as one program, for prediction only."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from hatn_sim.datatypes import HISTORY_FRAMES
from hatn_sim.hatn.edn import EncoderDecoderNetwork, VehicleBatch
from hatn_sim.hatn.edn_columns import ColumnDecoder, has_columns
from hatn_sim.hatn.inputs import HISTORY, LINE_AT_M


class _Program(nn.Module):
    """A network as a function of tensors only, to be traced."""

    def __init__(self, network: EncoderDecoderNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, history: Tensor, line: Tensor, at: Tensor, goal_m: Tensor) -> Tensor:
        out: Tensor = self.network(VehicleBatch(history, line, at), goal_m)
        return out


class _OwnProgram(_Program):
    """The same with a last layer for each vehicle."""

    def forward(  # type: ignore[override]
        self,
        history: Tensor,
        line: Tensor,
        at: Tensor,
        goal_m: Tensor,
        weight: Tensor,
        bias: Tensor,
    ) -> Tensor:
        own = {"dense3.weight": weight, "dense3.bias": bias}
        out: Tensor = self.network(VehicleBatch(history, line, at), goal_m, own=own)
        return out


def frozen_edn(
    network: EncoderDecoderNetwork, own_last_layer: bool = False
) -> Callable[..., Tensor]:
    """The network for prediction only: the thirty steps as one program, in half the time.

    Takes history, line, at and goal_m, and with `own_last_layer` a weight [B, O, width] and a bias
    [B, O] for each vehicle; gives what `EncoderDecoderNetwork.forward` does.
    """
    program: nn.Module = _OwnProgram(network) if own_last_layer else _Program(network)
    if has_columns(network.settings):
        program = ColumnDecoder(network)
    if not own_last_layer:
        return frozen(program, example_of(network))
    outputs, width = network.dense3.weight.shape
    own = (torch.randn(3, outputs, width), torch.randn(3, outputs))
    return frozen(program, (*example_of(network), *own))


def example_of(network: EncoderDecoderNetwork) -> tuple[Tensor, ...]:
    """History, line, at and goal_m of three vehicles, to trace a program by."""
    return (
        torch.randn(3, HISTORY_FRAMES, len(HISTORY)),
        torch.randn(3, len(LINE_AT_M), 2).cumsum(1),
        torch.randn(3, 5),
        torch.rand(3, network.settings.goal_steps).cumsum(-1),
    )


def frozen(program: nn.Module, example: tuple[Tensor, ...]) -> Callable[..., Any]:
    """A module as one program for prediction only, traced by what it does to an example."""
    with warnings.catch_warnings(), torch.no_grad():
        # Deprecated in favour of a compiler that a user's machine may not have.
        warnings.simplefilter("ignore")
        traced: Callable[..., Any] = torch.jit.freeze(
            torch.jit.trace(program.eval(), example, check_trace=False)
        )
    return traced
