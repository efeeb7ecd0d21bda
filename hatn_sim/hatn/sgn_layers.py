"""The layers of the graph network that are more than torch's own."""

from __future__ import annotations

import torch
from torch import Tensor, nn


def dense(inputs: int, width: int) -> nn.Sequential:
    """A dense layer with tanh, as in the paper's table of layers."""
    return nn.Sequential(nn.Linear(inputs, width), nn.Tanh())


class Relations(nn.Module):
    """f_att and f^4_enc: what a node is told by all nodes, itself among them, and makes of it."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        # One dense layer on a concatenated pair is the sum of one on each of the two.
        self.attend_sender = nn.Linear(width, heads)
        self.attend_receiver = nn.Linear(width, heads, bias=False)
        self.evolve = dense((heads + 1) * width, width)

    def forward(self, told: Tensor, own: Tensor, mask: Tensor) -> Tensor:
        """[N, width] from what nodes tell and have [N, width] each; `mask` [E, M] of the nodes."""
        padded = told.new_zeros((*mask.shape, told.shape[-1]))
        padded[mask] = told
        receiver = self.attend_receiver(padded).permute(0, 2, 1).unsqueeze(-1)  # [E, heads, M, 1]
        sender = self.attend_sender(padded).permute(0, 2, 1).unsqueeze(-2)
        score = nn.functional.leaky_relu(receiver + sender, 0.2)  # [E, heads, receiver, sender]
        score = score.masked_fill(~mask[:, None, None], float("-inf"))
        heard = score.softmax(-1) @ padded.unsqueeze(1)
        related = heard.permute(0, 2, 1, 3).flatten(2)[mask]
        return self.evolve(torch.cat((related, own), -1))
