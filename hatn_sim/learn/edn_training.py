"""The encoder-decoder network, learnt on the goals that a trained SGN predicts."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from hatn_sim.datatypes import IntArray
from hatn_sim.hatn.edn import EdnSettings, EncoderDecoderNetwork, edn_loss
from hatn_sim.hatn.sgn import SemanticGraphNetwork
from hatn_sim.learn.augment import random_scale, scale_future, scale_history
from hatn_sim.learn.dataset import Samples
from hatn_sim.learn.fit import Figures, FitSettings, Problem, Workplace, batches, fit
from hatn_sim.learn.sgn_training import predicted_goals

EARLY_FRAMES = 5
EARLY_WEIGHT = 3.0
"""Early frames are small in metres but they are what adaptation and safety look at."""


def train_edn(
    learn: Samples,
    tune: Samples,
    sgn: SemanticGraphNetwork,
    settings: EdnSettings,
    how: FitSettings,
    place: Workplace,
) -> tuple[EncoderDecoderNetwork, Figures]:
    """A network fitted to `learn`, the epoch chosen on `tune`; raises as `fit` does."""
    torch.manual_seed(place.seed)
    model = EncoderDecoderNetwork(settings)
    goals = predicted_goals(sgn, learn)
    tune_goals = predicted_goals(sgn, tune)
    early = np.arange(learn.future.shape[1]) < EARLY_FRAMES
    by_step = torch.from_numpy(np.where(early, EARLY_WEIGHT, 1.0).astype(np.float32))

    def loss(model: nn.Module, rows: IntArray) -> Tensor:
        scale = random_scale(len(rows))
        history = scale_history(torch.from_numpy(learn.history[rows]), scale)
        future = scale_future(torch.from_numpy(learn.future[rows]), scale)
        goal = torch.from_numpy(goals[rows]) * scale
        mask = torch.from_numpy(learn.future_mask[rows]).float() * by_step
        predicted = model(history.to(place.device), goal.to(place.device))
        return edn_loss(predicted, future.to(place.device), mask.to(place.device))

    def figures(model: nn.Module) -> Figures:
        return edn_figures(model, tune, tune_goals, place.device)

    problem = Problem("EDN", len(learn), loss, figures, "ade_3s_m")
    return model, fit(model, problem, how, place)


def edn_figures(
    model: nn.Module, samples: Samples, goals: np.ndarray, device: torch.device
) -> Figures:
    """Mean displacement along the line in metres over whole futures, all and the first 0.3 s."""
    errors: list[np.ndarray] = []
    for rows in batches(len(samples)):
        history = torch.from_numpy(samples.history[rows]).to(device)
        out: Tensor = model(history, torch.from_numpy(goals[rows]).to(device))
        distance = np.linalg.norm(out.cpu().numpy() - samples.future[rows], axis=-1)
        errors.append(distance[samples.future_mask[rows].all(axis=1)])
    distance = np.concatenate(errors)
    return {"ade_3s_m": float(distance.mean()), "ade_0s3_m": float(distance[:, :3].mean())}
