"""What the semantic graph network is learnt by (the paper's equation 11, and more if set)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn

from hatn_sim.datatypes import IntArray
from hatn_sim.hatn.sgn import GOAL_SCALE_M, GraphBatch, Intention, SlotModes
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.learn.dataset import Samples

PROFILE_PER_M: Final = 0.4
GOAL_PER_M: Final = 0.4
CROSSING_PER_S: Final = 0.2
"""Weights of the losses beyond the paper's, beside one nat of likelihood."""
ROBUST_M: Final = 0.3
ROBUST_S: Final = 0.3
"""Deviations count squared up to these and linearly beyond."""


@dataclass(frozen=True, eq=False)
class Targets:
    """What really happened, for the graphs of a batch."""

    goal_m: Tensor  # [E, M]
    goal_mask: Tensor  # [E, M]
    profile_m: Tensor  # [E, M, P] where the goal is known
    slot: Tensor  # [E] -1: none to learn from
    crossing_s: Tensor  # [E]
    crossing_mask: Tensor  # [E]


def targets(samples: Samples, rows: IntArray, scale: Tensor | None = None) -> Targets:
    """Of rows of the samples; lengths grow by `scale` [E], times stay."""
    by = torch.ones(len(rows)) if scale is None else scale
    return Targets(
        goal_m=torch.from_numpy(samples.goal_m[rows]) * by[:, None],
        goal_mask=torch.from_numpy(samples.goal_mask[rows]),
        profile_m=torch.from_numpy(samples.profile_m[rows]) * by[:, None, None],
        slot=torch.from_numpy(samples.slot[rows]),
        crossing_s=torch.from_numpy(samples.crossing_s[rows]),
        crossing_mask=torch.from_numpy(samples.crossing_mask[rows]),
    )


def sgn_loss(
    intention: Intention, batch: GraphBatch, truth: Targets, settings: SgnSettings
) -> dict[str, Tensor]:
    """The parts of the loss, to be added up: `goal` and `slot`, `profile` and `modes` if set."""
    weight = truth.goal_mask * 1.0
    weight[:, 0] = weight[:, 0] * settings.ego_weight
    if settings.ego_only:
        weight[:, 1:] = 0.0
    parts = {"goal": _goal_loss(intention, truth, weight, settings.goal_l1_weight)}
    several = (truth.slot >= 0) & (batch.focus_mask.sum(-1) > 1)
    parts["slot"] = settings.class_weight * _slot_loss(
        intention.slot_logit[several],
        truth.slot[several],
        batch.focus_mask[several],
        settings.label_smoothing,
    )
    if settings.profile:
        away = _robust(intention.profile_m - truth.profile_m, ROBUST_M).mean(-1)
        parts["profile"] = PROFILE_PER_M * _mean(away, weight)
    if intention.modes is not None:
        parts["modes"] = _mode_loss(intention.modes, truth, several)
    return parts


def _goal_loss(intention: Intention, truth: Targets, weight: Tensor, l1_weight: float) -> Tensor:
    """Negative log likelihood of the goals, and the error of their means."""
    deviation = (truth.goal_m.unsqueeze(-1) - intention.goal_mean_m) / intention.goal_std_m
    log_density = intention.goal_log_weight - intention.goal_std_m.log() - 0.5 * deviation**2
    error = (truth.goal_m - intention.goal_m()).abs() / GOAL_SCALE_M
    return _mean(l1_weight * error - log_density.logsumexp(-1), weight)


def _slot_loss(
    log_probability: Tensor, slot: Tensor, open_slots: Tensor, smoothing: float
) -> Tensor:
    """Cross-entropy of the slots taken, a little of every slot that was open among them."""
    if not len(slot):
        return log_probability.new_zeros(())
    taken = nn.functional.nll_loss(log_probability, slot)
    spread = -log_probability.masked_fill(~open_slots, 0.0).sum(-1) / open_slots.sum(-1)
    return (1.0 - smoothing) * taken + smoothing * spread.mean()


def _mode_loss(modes: SlotModes, truth: Targets, several: Tensor) -> Tensor:
    """Of the slots taken: how far, on what way, and when the ego crosses its focus."""
    ego = several.nonzero()[:, 0]
    slot, known = truth.slot[ego], truth.goal_mask[ego, 0]
    far = (modes.goal_m[ego, slot] - truth.goal_m[ego, 0]).abs()
    travelled = _robust(modes.profile_m[ego, slot] - truth.profile_m[ego, 0], ROBUST_M).mean(-1)
    crossing = _robust(modes.crossing_s[ego, slot] - truth.crossing_s[ego], ROBUST_S)
    return _mean(GOAL_PER_M * far + PROFILE_PER_M * travelled, known) + (
        CROSSING_PER_S * _mean(crossing, truth.crossing_mask[ego])
    )


def _robust(deviation: Tensor, squared_up_to: float) -> Tensor:
    return (
        nn.functional.huber_loss(
            deviation, torch.zeros_like(deviation), reduction="none", delta=squared_up_to
        )
        / squared_up_to
    )


def _mean(values: Tensor, weight: Tensor) -> Tensor:
    return (values * weight).sum() / weight.sum().clamp(min=1.0)
