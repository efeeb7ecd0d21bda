"""GRUs for prediction only, with what they read in columns: torch's numbers in less time.

What a step reads is one block of rows: the hidden state, a row of ones, which the biases are
multiplied by, and the inputs. One product with the block gives all gates, and the hidden state is
changed in place. Letters: B sequences, T steps, I inputs, H width, R = H + 1 + I.

Torch takes three times as long for a tanh as for a sigmoid. tanh x is 2 sigmoid(2 x) - 1, so what
stands here in place of a value h that came of a tanh is its half, (h + 1) / 2, and the weights of
whoever reads it allow for that (`reading_halves`). A GRU's new state is a mean of values, weighted
by a gate: the half of it is the same mean of halves.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn


class LastState(nn.Module):
    """The last hidden state of a GRU as it is now: [B, T, I] -> [H, B]."""

    def __init__(self, gru: nn.GRU) -> None:
        super().__init__()
        of = {name: value.detach() for name, value in gru.named_parameters()}
        no_ones = nn.functional.pad(of["weight_ih_l0"], (1, 0))
        self.weight = gates(no_ones, of["bias_ih_l0"], of["weight_hh_l0"], of["bias_hh_l0"])

    def forward(self, read: Tensor) -> Tensor:
        width = self.weight.shape[0] // 4
        block = read.new_full((self.weight.shape[1], read.shape[0]), 0.5)
        block[width].fill_(1.0)
        cell, inputs = Cell(self.weight, block), block[width + 1 :]
        for frame in read.permute(1, 2, 0).contiguous().unbind(0):
            inputs.copy_(frame)
            cell.step()
        return 2.0 * cell.hidden - 1.0


class Cell:
    """A GRU that reads a block [R, B] and changes its first rows, its state's half, in place."""

    def __init__(self, weight: Tensor, block: Tensor) -> None:
        width = weight.shape[0] // 4
        self.weight, self.block, self.hidden = weight, block, block[:width]
        self.gates = block.new_empty((4 * width, block.shape[1]))
        self.reset_and_update = self.gates[: 2 * width]
        self.reset, self.update, self.new, self.heard = self.gates.split(width)

    def step(self) -> None:
        """The hidden state after what the block says now."""
        torch.mm(self.weight, self.block, out=self.gates)
        self.reset_and_update.sigmoid_()
        self.new.addcmul_(self.reset, self.heard).sigmoid_()
        torch.lerp(self.new, self.hidden, self.update, out=self.hidden)


def gates(weight_ih: Tensor, bias_ih: Tensor, weight_hh: Tensor, bias_hh: Tensor) -> Tensor:
    """The weights of a GRU for a block: reset, update, new without what it heard, what it heard.

    [4 H, R] from `weight_ih` [3 H, R - H], whose first column is of the row of ones, and the others
    as torch has them. The new state hears of the old one through its gate: so it stands apart.
    """
    width = weight_hh.shape[1]
    by_input, by_hidden = weight_ih.clone(), torch.zeros_like(weight_ih)
    by_input[:, 0] += bias_ih
    by_hidden[:, 0] += bias_hh
    both = torch.cat((weight_hh, by_input + by_hidden), 1)[: 2 * width]
    new = torch.cat((torch.zeros_like(weight_hh), by_input), 1)[2 * width :]
    heard = torch.cat((weight_hh, by_hidden), 1)[2 * width :]
    # Of the new state the half is wanted, a sigmoid of twice as much.
    return reading_halves(torch.cat((both, 2.0 * new, 2.0 * heard)), width)


def reading_halves(weight: Tensor, width: int) -> Tensor:
    """Weights [O, R] for a block whose first `width` rows are halves; the next is of ones."""
    of_halves = weight.clone()
    of_halves[:, :width] *= 2.0
    of_halves[:, width] -= weight[:, :width].sum(1)
    return of_halves
