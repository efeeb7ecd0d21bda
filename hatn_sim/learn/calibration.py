"""How sure the semantic graph network may be: two temperatures, fitted after it has been trained.

A network is surer of what it was trained on than of anything else. One scalar flattens or sharpens
the probabilities of the slots (Guo et al. 2017, "On calibration of modern neural networks"), one
widens or narrows the mixture of the goals; neither changes what is most probable, nor the mean.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from torch import Tensor

from hatn_sim.hatn.sgn import Intention, SemanticGraphNetwork
from hatn_sim.hatn.slots import tempered
from hatn_sim.labels import MOVING_M
from hatn_sim.learn.batches import batches, device_of, graph_batch, on
from hatn_sim.learn.dataset import Samples

RANGE: Final = (0.2, 5.0)
"""Of a temperature: no tuning data may make a network sure, or unsure, of everything."""
FEWEST: Final = 50
"""Fewer samples than this say nothing; the temperature stays 1."""


def calibrate(model: SemanticGraphNetwork, samples: Samples) -> None:
    """Set the temperatures of a trained model to those under which `samples` are most likely."""
    model.slot_temperature.fill_(1.0)
    model.goal_temperature.fill_(1.0)
    logits, slots, goals, mixtures = [], [], [], []
    model.eval()
    for rows in batches(len(samples)):
        batch = on(device_of(model), graph_batch(samples, rows))
        with torch.no_grad():
            found: Intention = model(batch)
        slot = torch.from_numpy(samples.slot[rows]).to(batch.focus_mask.device)
        several = (slot >= 0) & (batch.focus_mask.sum(-1) > 1)
        logits.append(found.slot_logit[several])
        slots.append(slot[several])
        # Who stands is at 0 m for certain: it says nothing of how wide the others' goals are.
        goal = torch.from_numpy(samples.goal_m[rows, 0]).to(slot.device)
        known = torch.from_numpy(samples.goal_mask[rows, 0]).to(slot.device)
        moves = known & (goal > MOVING_M)
        goals.append(goal[moves])
        mixtures.append(
            torch.stack((found.goal_log_weight, found.goal_mean_m, found.goal_std_m))[:, moves, 0]
        )
    slot, goal = torch.cat(slots), torch.cat(goals)
    logit, (log_weight, mean, std) = torch.cat(logits), torch.cat(mixtures, 1)

    def slot_cost(temperature: float) -> Tensor:
        log_probability = tempered(logit, logit.new_tensor(temperature))
        return -log_probability.gather(1, slot[:, None]).mean()

    def goal_cost(temperature: float) -> Tensor:
        wide = std * temperature
        log_density = log_weight - wide.log() - 0.5 * ((goal[:, None] - mean) / wide) ** 2
        return -log_density.logsumexp(-1).mean()

    if len(slot) >= FEWEST:
        model.slot_temperature.fill_(_best(slot_cost))
    if len(goal) >= FEWEST:
        model.goal_temperature.fill_(_best(goal_cost))


def _best(cost: Callable[[float], Tensor]) -> float:
    found = minimize_scalar(
        lambda log_temperature: float(cost(float(np.exp(log_temperature)))),
        bounds=tuple(np.log(RANGE)),
        method="bounded",
    )
    return float(np.exp(found.x))
