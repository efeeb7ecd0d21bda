"""Which parameters of the EDN are each vehicle's own, and what they do to its positions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, Literal

import torch
from torch import Tensor

from hatn_sim.datatypes import DT_S, HISTORY_FRAMES, HORIZON_FRAMES
from hatn_sim.hatn.adaptation import linearise
from hatn_sim.hatn.edn import EncoderDecoderNetwork, Parameters, VehicleBatch
from hatn_sim.hatn.edn_last_layer import last_layer_lineariser
from hatn_sim.hatn.edn_program import frozen_edn
from hatn_sim.hatn.inputs import HISTORY, LINE_AT_M

Layer = Literal[
    "encoder_input",
    "encoder_hidden",
    "decoder_input",
    "decoder_hidden",
    "dense1",
    "dense2",
    "dense3",
]
LAYERS: Final[Mapping[Layer, tuple[str, str]]] = {
    "encoder_input": ("encoder.weight_ih_l0", "encoder.bias_ih_l0"),
    "encoder_hidden": ("encoder.weight_hh_l0", "encoder.bias_hh_l0"),
    "decoder_input": ("decoder.weight_ih", "decoder.bias_ih"),
    "decoder_hidden": ("decoder.weight_hh", "decoder.bias_hh"),
    "dense1": ("dense1.weight", "dense1.bias"),
    "dense2": ("dense2.weight", "dense2.bias"),
    "dense3": ("dense3.weight", "dense3.bias"),
}
"""Weight and bias of a layer, in the order that a signal meets them."""
LAST: Final[Layer] = "dense3"
"""The one that is adapted unless another is asked for; programs are made for it only."""
STEADY_MPS: Final = 8.0


def prior_of(network: EncoderDecoderNetwork, layer: Layer) -> Tensor:
    """The trained parameters [P] of a layer, weight and bias in one row."""
    weight, bias = (network.get_parameter(name).detach() for name in LAYERS[layer])
    return torch.cat((weight, bias[:, None]), 1).flatten()


def own_parameters(network: EncoderDecoderNetwork, layer: Layer, theta: Tensor) -> Parameters:
    """`theta` [B, P] as the parameters that the network takes for each vehicle."""
    weight, bias = LAYERS[layer]
    outputs, inputs = network.get_parameter(weight).shape
    rows = theta.view(-1, outputs, inputs + 1)
    return {weight: rows[..., :-1], bias: rows[..., -1]}


def positions_with(
    network: EncoderDecoderNetwork,
    layer: Layer,
    theta: Tensor,
    batch: VehicleBatch,
    goal_m: Tensor,
    steps: int,
) -> Tensor:
    """Positions [B, steps, 2] in metres with parameters `theta` [B, P], each vehicle's own."""
    own = own_parameters(network, layer, theta)
    out: Tensor = network(batch, goal_m, steps, own)
    return out


def decoder_of(
    network: EncoderDecoderNetwork, layer: Layer, as_program: bool
) -> Callable[[Tensor, VehicleBatch, Tensor], Tensor]:
    """The whole future [B, F, 2] from theta [B, P], batch and goals; see `positions_with`."""
    if not (as_program and layer == LAST):

        def decode(theta: Tensor, batch: VehicleBatch, goal_m: Tensor) -> Tensor:
            return positions_with(network, layer, theta, batch, goal_m, HORIZON_FRAMES)

        return decode
    program = frozen_edn(network, own_last_layer=True)
    weight, bias = LAYERS[layer]

    def run(theta: Tensor, batch: VehicleBatch, goal_m: Tensor) -> Tensor:
        own = own_parameters(network, layer, theta)
        return program(batch.history, batch.line, batch.at, goal_m, own[weight], own[bias])

    return run


class _Watched:
    """The weight of a layer [B, O, I] that takes note of what it reads, and may be pushed after."""

    def __init__(self, weight: Tensor) -> None:
        self.weight = weight
        self.read: list[Tensor] = []  # [B, I] at each step
        self.pushes: list[Tensor] = []  # [B, O, 1]

    def dim(self) -> int:
        return self.weight.dim()

    def __matmul__(self, x: Tensor) -> Tensor:
        out = self.weight @ x
        self.read.append(x.detach()[..., 0])
        self.pushes.append(torch.zeros_like(out, requires_grad=True))
        return out + self.pushes[-1]


def linearise_layer(
    network: EncoderDecoderNetwork,
    layer: Layer,
    theta: Tensor,
    batch: VehicleBatch,
    goal_m: Tensor,
    steps: int,
) -> tuple[Tensor, Tensor]:
    """`linearise` of `positions_with`, by what pushes on the layer's outputs do.

    The layer takes x_k to W x_k + b at step k, so dy/dW is the sum over steps of dy/d(W x_k + b)
    times x_k: much smaller than what is differentiated by otherwise.
    """
    weight, bias = LAYERS[layer]
    own = own_parameters(network, layer, theta)
    watched = _Watched(own[weight])
    with torch.enable_grad():
        pair: Any = {weight: watched, bias: own[bias]}
        out = network(batch, goal_m, steps, pair).flatten(1)
        each = torch.eye(out.shape[1], dtype=out.dtype)[:, None].expand(-1, *out.shape)
        pushed = torch.autograd.grad(out, watched.pushes, each, is_grads_batched=True)
    read = torch.stack(watched.read, 1)  # [B, K, I]
    inputs = torch.cat((read, torch.ones_like(read[..., :1])), -1)
    by_push = torch.cat(pushed, -1).transpose(0, 1)  # [B, D, O, K]
    jacobian = by_push.flatten(1, 2) @ inputs
    return out.detach(), jacobian.view(len(out), out.shape[1], -1)


def lineariser_of(
    network: EncoderDecoderNetwork, layer: Layer, steps: int, as_program: bool
) -> Callable[[Tensor, VehicleBatch, Tensor], tuple[Tensor, Tensor]]:
    """From theta [B, P], batch and goals: positions [B, steps x 2], their Jacobian [B, ., P]."""
    if layer != LAST:
        return lambda theta, batch, goal_m: linearise_layer(
            network, layer, theta, batch, goal_m, steps
        )
    by_pushes = last_layer_lineariser(network, steps, as_program)
    weight, bias = LAYERS[layer]

    def run(theta: Tensor, batch: VehicleBatch, goal_m: Tensor) -> tuple[Tensor, Tensor]:
        own = own_parameters(network, layer, theta)
        return by_pushes(own[weight], own[bias], batch, goal_m)

    return run


def sensitivity_m2(network: EncoderDecoderNetwork, layer: Layer, steps: int) -> float:
    """The mean of |dy/dtheta|^2 over the positions y of a vehicle that drives on steadily.

    What a variance of the parameters means in metres: layers and networks are of many sizes.
    """
    time_s = DT_S * torch.arange(1 - HISTORY_FRAMES, 1)
    columns = {
        "s_m since now along the own line": STEADY_MPS * time_s,
        "speed_mps along the line": torch.full_like(time_s, STEADY_MPS),
        "seen": torch.ones_like(time_s),
        "x_m in the vehicle's frame of now": STEADY_MPS * time_s,
        "speed_mps": torch.full_like(time_s, STEADY_MPS),
    }
    history = torch.stack([columns.get(name, torch.zeros_like(time_s)) for name in HISTORY], -1)
    ahead_m = torch.tensor(LINE_AT_M, dtype=torch.float32)
    line = torch.stack((ahead_m, torch.zeros_like(ahead_m)), -1)
    batch = VehicleBatch(history[None], line[None], torch.zeros(1, 5))
    count = network.settings.goal_steps
    goal_m = STEADY_MPS * 3.0 * torch.arange(1, count + 1)[None] / count
    _, jacobian = linearise(
        lambda theta: positions_with(network, layer, theta, batch, goal_m, steps).flatten(1),
        prior_of(network, layer)[None],
    )
    return float(jacobian.square().sum() / jacobian.shape[1])
