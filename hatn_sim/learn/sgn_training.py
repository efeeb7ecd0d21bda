"""The semantic graph network, learnt alone: which slot, and how far in three seconds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from hatn_sim.datatypes import IntArray
from hatn_sim.hatn.inputs import Float32Array
from hatn_sim.hatn.sgn import GraphBatch, SemanticGraphNetwork, SgnSettings, sgn_loss
from hatn_sim.learn.augment import change_limits, random_scale, scale_graphs
from hatn_sim.learn.dataset import Samples

JUDGED_BY: Final = "goal_error_m"
"""The figure that chooses the epoch."""
JUDGED_AT_ONCE: Final = 2048


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
        scale = random_scale(len(rows))
        batch = scale_graphs(change_limits(graph_batch(samples, rows)), scale)
        regression, classes = sgn_loss(
            model(batch),
            batch,
            torch.from_numpy(samples.goal_m[rows]) * scale[:, None],
            torch.from_numpy(samples.goal_mask[rows]),
            torch.from_numpy(samples.slot[rows]),
            model.settings.class_weight,
        )
        return regression + classes

    best = fit(model, learn, loss_of, lambda: sgn_figures(model, tune), JUDGED_BY)
    return model, best


def sgn_figures(model: SemanticGraphNetwork, samples: Samples) -> dict[str, float]:
    """Goal error of the ego in metres and slot accuracy on samples."""
    errors, right, several = [np.zeros(0)], 0, 0
    for rows in _in_order(len(samples)):
        with torch.no_grad():
            intention = model(graph_batch(samples, rows))
        known = samples.goal_mask[rows, 0]
        errors.append(np.abs(intention.goal_m()[:, 0].numpy() - samples.goal_m[rows, 0])[known])
        slot = samples.slot[rows]
        counts = (slot >= 0) & (samples.focus_mask[rows].sum(axis=1) > 1)
        chosen = intention.slot_logit.argmax(-1).numpy()
        right += int((chosen == slot)[counts].sum())
        several += int(counts.sum())
    return {
        "goal_error_m": float(np.concatenate(errors).mean()),
        "slot_accuracy": right / max(several, 1),
    }


def predicted_profiles(model: SemanticGraphNetwork, samples: Samples) -> Float32Array:
    """How far every ego gets [S, P], the last column in 3 s, by the trained SGN."""
    model.eval()
    found: list[Float32Array] = []
    for rows in _in_order(len(samples)):
        with torch.no_grad():
            found.append(model(graph_batch(samples, rows)).goal_m()[:, :1].numpy())
    return np.concatenate(found)


def graph_batch(samples: Samples, rows: IntArray) -> GraphBatch:
    """Rows of the samples as tensors."""
    return GraphBatch(
        x=torch.from_numpy(samples.x[rows]),
        context=torch.from_numpy(samples.context[rows]),
        node_mask=torch.from_numpy(samples.node_mask[rows]),
        focus_mask=torch.from_numpy(samples.focus_mask[rows]),
        history_mask=torch.from_numpy(samples.history_mask[rows]),
    )


def _in_order(count: int) -> list[IntArray]:
    return np.array_split(np.arange(count), count // JUDGED_AT_ONCE + 1)
