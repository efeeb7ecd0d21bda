"""A trajectory for each slot that an ego may plausibly take, weighted by its probability."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from hatn_sim.hatn.sgn import Intention

MAX_MODES: Final = 3
PLAUSIBLE: Final = 0.1
"""Slots less probable than this are given no trajectory, unless it is the most probable one."""


@dataclass(frozen=True, eq=False)
class Modes:
    """What egos are about to do, the most probable first; masked ones have probability 0."""

    probability: Tensor  # [E, K] sums to 1
    profile_m: Tensor  # [E, K, P] distance travelled


def modes_of(intention: Intention) -> Modes:
    """The modes of every ego: of its plausible slots, or the one it has where it has no choice.

    The most probable slot goes by the goal of all, which is learnt from every sample; the others by
    the goal of their slot.
    """
    every = intention.profile_m[:, :1]
    if intention.modes is None:
        return Modes(every.new_ones(every.shape[:2]), every)
    count = min(MAX_MODES, intention.slot_logit.shape[1])
    chance, slot = intention.slot_logit.exp().topk(count, dim=-1)
    chance = torch.where(chance >= PLAUSIBLE, chance, torch.zeros_like(chance))
    chance[:, :1] = chance[:, :1].clamp(min=PLAUSIBLE)
    pick = slot[:, 1:].unsqueeze(-1).expand(-1, -1, every.shape[-1])
    others = intention.modes.profile_m.gather(1, pick)
    return Modes(chance / chance.sum(-1, keepdim=True), torch.cat((every, others), 1))
