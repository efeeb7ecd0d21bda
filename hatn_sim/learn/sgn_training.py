"""The semantic graph network: what one batch costs, how good it is, and its training alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray
from hatn_sim.hatn.inputs import Float32Array
from hatn_sim.hatn.sgn import Intention, SemanticGraphNetwork
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.labels import MOVING_M
from hatn_sim.learn.augment import change_limits, mirror_graphs, random_scale, scale_graphs
from hatn_sim.learn.batches import batches, device_of, graph_batch, on
from hatn_sim.learn.calibration import calibrate
from hatn_sim.learn.dataset import Samples
from hatn_sim.learn.sgn_loss import sgn_loss, targets
from hatn_sim.score.intervals import expected_calibration_error

JUDGED_BY: Final = "goal_error_m"
"""The figure that chooses the epoch."""
MIRRORED: Final = 0.5
"""Share of samples learnt left for right."""
ECE_BINS: Final = 15


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
    learn: Samples,
    tune: Samples,
    settings: SgnSettings,
    fit: Fit,
    start: SemanticGraphNetwork | None = None,
) -> tuple[SemanticGraphNetwork, dict[str, float]]:
    """The semantic graph network, alone, and its figures on `tune`; it begins as `start`."""
    model = SemanticGraphNetwork(settings)
    if start is not None:
        model.load_state_dict(start.state_dict())
        model.slot_temperature.fill_(1.0)
        model.goal_temperature.fill_(1.0)

    def loss_of(samples: Samples, rows: IntArray) -> Tensor:
        return sgn_batch_loss(model, samples, rows)

    best = fit(model, learn, loss_of, lambda: sgn_figures(model, tune), JUDGED_BY)
    calibrate(model, tune)
    return model, best | sgn_figures(model, tune)


def sgn_batch_loss(model: SemanticGraphNetwork, samples: Samples, rows: IntArray) -> Tensor:
    """The loss of rows of the samples, drawn at other scales, mirrored, under other limits."""
    scale = random_scale(len(rows))
    batch = scale_graphs(change_limits(graph_batch(samples, rows)), scale)
    batch = mirror_graphs(batch, torch.rand(len(rows)) < MIRRORED)
    device = device_of(model)
    batch, truth = on(device, batch), on(device, targets(samples, rows, scale))
    parts = sgn_loss(model(batch), batch, truth, model.settings)
    return torch.stack(list(parts.values())).sum()


def sgn_figures(model: SemanticGraphNetwork, samples: Samples) -> dict[str, float]:
    """How good a network is on samples, see METHOD 1.8.

    The mean error of the egos' goals; the shares of moving egos' goals within the central 50 and
    90 % of their distributions; accuracy and calibration error of the slots, where there is a
    choice. nan where there is nothing to tell it from.
    """
    errors, shares, confidences, hits = [], [], [], []
    model.eval()
    for rows in batches(len(samples)):
        with torch.no_grad():
            found = model(on(device_of(model), graph_batch(samples, rows)))
        goal_m, known = samples.goal_m[rows, 0], samples.goal_mask[rows, 0]
        errors.append(np.abs(found.goal_m()[:, 0].cpu().numpy() - goal_m)[known])
        moves = known & (goal_m > MOVING_M)
        shares.append(goal_share(found, goal_m)[moves])
        slot = samples.slot[rows]
        several = (slot >= 0) & (samples.focus_mask[rows].sum(axis=1) > 1)
        confidence, chosen = found.slot_logit.exp().max(-1)
        confidences.append(confidence.cpu().double().numpy()[several])
        hits.append((chosen.cpu().numpy() == slot)[several])
    error, share = np.concatenate(errors), np.concatenate(shares)
    confidence, hit = np.concatenate(confidences), np.concatenate(hits).astype(np.float64)
    gaps = np.zeros((len(hit), ECE_BINS))
    in_bin = np.minimum((confidence * ECE_BINS).astype(np.int64), ECE_BINS - 1)
    gaps[np.arange(len(hit)), in_bin] = confidence - hit
    ece = expected_calibration_error(np.concatenate(([float(len(hit))], gaps.sum(axis=0))))
    return {
        "goal_error_m": _mean(error),
        "goals_in_50": _mean(np.abs(share - 0.5) < 0.25),
        "goals_in_90": _mean(np.abs(share - 0.5) < 0.45),
        "slot_accuracy": _mean(hit),
        "slot_ece": float(ece),
    }


def goal_share(found: Intention, goal_m: Float32Array) -> FloatArray:
    """Share [E] of every ego's goal distribution below a goal [E]: even on 0 ... 1 if right."""
    mean, std = found.goal_mean_m[:, 0], found.goal_std_m[:, 0]
    goal = torch.from_numpy(goal_m).to(mean.device).unsqueeze(-1)
    below = torch.special.ndtr((goal - mean) / std)
    share: FloatArray = (found.goal_log_weight[:, 0].exp() * below).sum(-1).cpu().double().numpy()
    return share


def _mean(values: FloatArray | BoolArray | Float32Array) -> float:
    return float(values.mean()) if len(values) else float("nan")


def predicted_profiles(model: SemanticGraphNetwork, samples: Samples) -> Float32Array:
    """The profile [S, P] of every ego by the trained SGN: what the EDN is trained on."""
    model.eval()
    found = []
    for rows in batches(len(samples)):
        with torch.no_grad():
            said = model(on(device_of(model), graph_batch(samples, rows)))
        found.append(said.profile_m[:, 0].cpu().numpy())
    return np.concatenate(found)
