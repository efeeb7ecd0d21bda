"""The semantic graph network, learnt alone: which slot, and how far in three seconds."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from hatn_sim.datatypes import IntArray
from hatn_sim.hatn.sgn import GraphBatch, Intention, SemanticGraphNetwork, SgnSettings, sgn_loss
from hatn_sim.learn.augment import change_limits, random_scale, scale_graphs
from hatn_sim.learn.dataset import Samples
from hatn_sim.learn.fit import Figures, FitSettings, Problem, Workplace, batches, fit


def train_sgn(
    learn: Samples, tune: Samples, settings: SgnSettings, how: FitSettings, place: Workplace
) -> tuple[SemanticGraphNetwork, Figures]:
    """A network fitted to `learn`, the epoch chosen on `tune`; raises as `fit` does."""
    torch.manual_seed(place.seed)
    model = SemanticGraphNetwork(settings)

    def loss(model: nn.Module, rows: IntArray) -> Tensor:
        scale = random_scale(len(rows))
        batch = scale_graphs(change_limits(graph_batch(learn, rows)), scale)
        batch = on_device(batch, place.device)
        intention: Intention = model(batch)
        regression, classes = sgn_loss(
            intention,
            batch,
            (torch.from_numpy(learn.goal_m[rows]) * scale[:, None]).to(place.device),
            torch.from_numpy(learn.goal_mask[rows]).to(place.device),
            torch.from_numpy(learn.slot[rows]).to(place.device),
            settings.class_weight,
        )
        return regression + classes

    def figures(model: nn.Module) -> Figures:
        return sgn_figures(model, tune, place.device)

    problem = Problem("SGN", len(learn), loss, figures, "goal_error_m")
    return model, fit(model, problem, how, place)


def sgn_figures(model: nn.Module, samples: Samples, device: torch.device) -> Figures:
    """Goal error of the ego in metres and slot accuracy on samples."""
    errors, right, several = [np.zeros(0)], 0, 0
    for rows in batches(len(samples)):
        intention: Intention = model(on_device(graph_batch(samples, rows), device))
        known = samples.goal_mask[rows, 0]
        goal_m = intention.goal_m()[:, 0].cpu().numpy()
        errors.append(np.abs(goal_m - samples.goal_m[rows, 0])[known])
        slot = samples.slot[rows]
        counts = (slot >= 0) & (samples.focus_mask[rows].sum(axis=1) > 1)
        chosen = intention.slot_logit.argmax(-1).cpu().numpy()
        right += int((chosen == slot)[counts].sum())
        several += int(counts.sum())
    return {
        "goal_error_m": float(np.concatenate(errors).mean()),
        "slot_accuracy": right / max(several, 1),
    }


def predicted_goals(
    model: SemanticGraphNetwork, samples: Samples
) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    """The goal [S] of every ego by the trained SGN: what the EDN is trained on."""
    model.eval()
    with torch.no_grad():
        goals = [
            model(graph_batch(samples, rows)).goal_m()[:, 0].numpy()
            for rows in batches(len(samples))
        ]
    return np.concatenate(goals)


def graph_batch(samples: Samples, rows: IntArray) -> GraphBatch:
    """Rows of the samples as tensors."""
    return GraphBatch(
        x=torch.from_numpy(samples.x[rows]),
        context=torch.from_numpy(samples.context[rows]),
        node_mask=torch.from_numpy(samples.node_mask[rows]),
        focus_mask=torch.from_numpy(samples.focus_mask[rows]),
        history_mask=torch.from_numpy(samples.history_mask[rows]),
    )


def on_device(batch: GraphBatch, device: torch.device) -> GraphBatch:
    """The same graphs on another device."""
    return GraphBatch(**{name: value.to(device) for name, value in vars(batch).items()})
