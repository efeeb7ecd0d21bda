"""What the parameters of the decoder's last layer do to the positions of its first steps.

The layer takes z_k to W z_k + b at step k. So what W does to a position is the sum over steps of
what a push on that step's output does to it, times z_k: there are as few pushes as outputs, and
they are followed forward from the step they are made at (`pushed`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from hatn_sim.hatn.edn import EncoderDecoderNetwork, VehicleBatch
from hatn_sim.hatn.edn_program import example_of, frozen
from hatn_sim.hatn.pushed import Pushed, push

Pushes = tuple[Tensor, Tensor, Tensor]
"""Positions [B, steps, 2], what pushes do to them [steps x O, B, steps, 2], z [B, steps, width]."""


class _Pushes(nn.Module):
    """Takes history, line, at, goal_m, weight [B, O, width] and bias [B, O]; gives `Pushes`."""

    def __init__(self, network: EncoderDecoderNetwork, steps: int) -> None:
        super().__init__()
        self.network, self.steps = network, steps
        # As if they were the vehicles' own: that way the decoder is made of plain operations.
        names = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
        self.shared = {f"decoder.{name}": getattr(network.decoder, name) for name in names}

    def forward(
        self,
        history: Tensor,
        line: Tensor,
        at: Tensor,
        goal_m: Tensor,
        weight: Tensor,
        bias: Tensor,
    ) -> Pushes:
        read: list[Tensor] = []

        def last_layer(z: Any) -> Any:
            if not isinstance(z, Pushed):
                read.append(z)
                return push((weight @ z[..., None])[..., 0] + bias)
            read.append(z.value)
            every = torch.cat((z.value[None], z.by)).permute(1, 2, 0)  # [B, width, 1 + J]
            out = (weight @ every).permute(2, 0, 1)
            return push(Pushed(out[0] + bias, out[1:]))

        batch = VehicleBatch(history, line, at)
        out = self.network(batch, goal_m, self.steps, self.shared, last_layer)
        return out.value, out.by, torch.stack(read, 1)


def last_layer_lineariser(
    network: EncoderDecoderNetwork, steps: int, as_program: bool
) -> Callable[[Tensor, Tensor, VehicleBatch, Tensor], tuple[Tensor, Tensor]]:
    """A function of weight [B, O, width], bias [B, O], batch and goals.

    It gives positions [B, steps x 2] and their Jacobian [B, steps x 2, O x (width + 1)] by the rows
    of weight and bias. `as_program`: traced at once, and faster from then.
    """
    module = _Pushes(network, steps).eval()
    run: Callable[..., Pushes] = module
    if as_program:
        outputs, width = network.dense3.weight.shape
        own = (torch.randn(3, outputs, width), torch.randn(3, outputs))
        run = frozen(module, (*example_of(network), *own))

    def linearise(
        weight: Tensor, bias: Tensor, batch: VehicleBatch, goal_m: Tensor
    ) -> tuple[Tensor, Tensor]:
        with torch.no_grad():
            said, by, read = run(batch.history, batch.line, batch.at, goal_m, weight, bias)
            inputs = torch.cat((read, torch.ones_like(read[..., :1])), -1)
            by = by.view(steps, bias.shape[1], len(bias), -1).permute(2, 3, 1, 0)
            jacobian = by.flatten(1, 2) @ inputs  # [B, steps x 2 x O, width + 1]
            return said.flatten(1), jacobian.view(len(bias), 2 * steps, -1)

    return linearise
