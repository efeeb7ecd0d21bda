"""The semantic graph network: what one batch costs, how good it is, and its training alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from hatn_sim.datatypes import IntArray
from hatn_sim.hatn.inputs import Float32Array
from hatn_sim.hatn.sgn import SemanticGraphNetwork
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.learn.augment import change_limits, random_scale, scale_graphs
from hatn_sim.learn.batches import batches, device_of, graph_batch, on
from hatn_sim.learn.dataset import Samples
from hatn_sim.learn.sgn_loss import sgn_loss, targets

JUDGED_BY: Final = "goal_error_m"
"""The figure that chooses the epoch."""


class Fit(Protocol):
    """Fits a model to samples by a loss, judged by figures; see `learn.fit`."""

    def __call__(
        self,
        model: nn.Module,
        learn: Samples,
        loss_of: Callable[[Samples, IntArray], Tensor],
        figures: Callable[[], dict[str, float]],
        judged_by: str,
    ) -> dict[str, float]: ...


def train_sgn(
    learn: Samples, tune: Samples, settings: SgnSettings, fit: Fit
) -> tuple[SemanticGraphNetwork, dict[str, float]]:
    """The semantic graph network, alone, and its figures on `tune`."""
    model = SemanticGraphNetwork(settings)

    def loss_of(samples: Samples, rows: IntArray) -> Tensor:
        return sgn_batch_loss(model, samples, rows)

    best = fit(model, learn, loss_of, lambda: sgn_figures(model, tune), JUDGED_BY)
    return model, best


def sgn_batch_loss(model: SemanticGraphNetwork, samples: Samples, rows: IntArray) -> Tensor:
    """The loss of rows of the samples, drawn at other scales and under other speed limits."""
    scale = random_scale(len(rows))
    batch = scale_graphs(change_limits(graph_batch(samples, rows)), scale)
    device = device_of(model)
    batch, truth = on(device, batch), on(device, targets(samples, rows, scale))
    parts = sgn_loss(model(batch), batch, truth, model.settings)
    return torch.stack(list(parts.values())).sum()


def sgn_figures(model: SemanticGraphNetwork, samples: Samples) -> dict[str, float]:
    """Goal error of the ego in metres and slot accuracy on samples."""
    errors, right, several = [], 0, 0
    for rows in batches(len(samples)):
        batch = on(device_of(model), graph_batch(samples, rows))
        with torch.no_grad():
            intention = model(batch)
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


def predicted_profiles(model: SemanticGraphNetwork, samples: Samples) -> Float32Array:
    """The profile [S, P] of every ego by the trained SGN: what the EDN is trained on."""
    model.eval()
    found = []
    for rows in batches(len(samples)):
        with torch.no_grad():
            found.append(model(graph_batch(samples, rows)).profile_m[:, 0].numpy())
    return np.concatenate(found)
