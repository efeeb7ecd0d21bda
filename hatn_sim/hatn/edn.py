"""The encoder-decoder network (the paper's section 5): how a vehicle drives to its goal.

History and future are along the vehicle's own reference line, aligned to where it is now. The
decoder is given the goal and the step; it emits the change of the last increment, bounded by what
tyres can do, so that a prediction starts from the exact present motion (METHOD section 3).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from hatn_sim.datatypes import DT_S, HISTORY_FRAMES, HORIZON_FRAMES

HISTORY_FEATURES = 6  # s - s_t, d, v_s, v_d, phi, seen
HISTORY_SCALE = (10.0, 1.0, 10.0, 1.0, 0.5, 1.0)
GOAL_SCALE_M = 10.0
INCREMENT_SCALE_M = 1.0
MAX_ACCELERATION_MPS2 = 8.0
MAX_LATERAL_MPS2 = 4.0


@dataclass(frozen=True)
class EdnSettings:
    """The shape of the network, stored in the card of its weights."""

    width: int = 64
    dropout: float = 0.0


class EncoderDecoderNetwork(nn.Module):
    """GRU encoder, GRU decoder with three dense layers."""

    history_scale: Tensor

    def __init__(self, settings: EdnSettings) -> None:
        super().__init__()
        width = settings.width
        self.settings = settings
        self.register_buffer("history_scale", torch.tensor(HISTORY_SCALE), persistent=False)
        self.encoder = nn.GRU(HISTORY_FEATURES, width, batch_first=True)
        self.decoder = nn.GRUCell(5, width)
        self.dense1 = nn.Linear(width, width)
        self.dense2 = nn.Linear(width, width)
        self.dense3 = nn.Linear(width, 2)
        self.dropout = nn.Dropout(settings.dropout)

    def forward(self, history: Tensor, goal_m: Tensor) -> Tensor:
        """Future (s - s_t, d - d_t) in metres [B, F, 2].

        `history` [B, T, HISTORY_FEATURES] unscaled, aligned to now; `goal_m` [B]: distance
        travelled in three seconds.
        """
        _, h = self.encoder(history / self.history_scale)
        hidden = h[0]
        now = history[:, -1]
        # The motion of now, from the last two frames: speed along and across the line.
        increment = now[:, 2:4] * DT_S
        position = torch.zeros_like(increment)
        goal = (goal_m / GOAL_SCALE_M).unsqueeze(-1)
        limit = increment.new_tensor([MAX_ACCELERATION_MPS2, MAX_LATERAL_MPS2]) * DT_S * DT_S
        out = []
        for step in range(HORIZON_FRAMES):
            left = goal - position[:, :1] / GOAL_SCALE_M
            clock = torch.full_like(goal, step / HORIZON_FRAMES)
            read = torch.cat((increment / INCREMENT_SCALE_M, goal, left, clock), -1)
            hidden = self.decoder(read, hidden)
            deep = self.dropout(torch.tanh(self.dense1(hidden)))
            deep = self.dropout(torch.tanh(self.dense2(deep)))
            increment = increment + limit * torch.tanh(self.dense3(deep))
            # Vehicles do not drive backwards on the road.
            increment = torch.cat((increment[:, :1].clamp(min=0.0), increment[:, 1:]), -1)
            position = position + increment
            out.append(position)
        return torch.stack(out, 1)


def frozen(network: EncoderDecoderNetwork) -> Callable[[Tensor, Tensor], Tensor]:
    """The network for prediction only: the thirty steps as one program, in half the time.

    Takes and gives what `EncoderDecoderNetwork.forward` does, for any number of vehicles, and the
    same to the last bit.
    """
    example = torch.zeros(2, HISTORY_FRAMES, HISTORY_FEATURES), torch.zeros(2)
    with warnings.catch_warnings():
        # Deprecated in favour of a compiler that a user's machine may not have.
        warnings.simplefilter("ignore")
        program: Callable[[Tensor, Tensor], Tensor] = torch.jit.freeze(
            torch.jit.trace(network.eval(), example)
        )
    return program


def edn_loss(predicted: Tensor, future: Tensor, mask: Tensor) -> Tensor:
    """Mean l2 distance in metres over the frames `mask` [B, F] of futures [B, F, 2]."""
    square = ((predicted - future) ** 2).sum(-1)
    distance = (square + 1e-6).sqrt()
    return (distance * mask).sum() / mask.sum().clamp(min=1.0)
