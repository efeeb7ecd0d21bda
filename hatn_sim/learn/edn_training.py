"""What the encoder-decoder network learns from samples, and how it is judged."""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from torch import Tensor

from hatn_sim.datatypes import HORIZON_FRAMES
from hatn_sim.hatn import edn_plain
from hatn_sim.hatn.edn import EncoderDecoderNetwork, VehicleBatch, edn_loss
from hatn_sim.hatn.inputs import Float32Array
from hatn_sim.learn.augment import (
    mirror_vehicles,
    random_scale,
    scale_vehicles,
    shake_vehicles,
    shift_vehicles,
    turn_vehicles,
)
from hatn_sim.learn.batches import device_of, on
from hatn_sim.learn.dataset import Samples

EARLY_WEIGHT: Final = 20.0
EARLY_FRAMES: Final = 3.0
"""Errors of the first frames are centimetres; adaptation and safety look at them."""
BY_STEP: Final = torch.from_numpy(
    (1.0 + EARLY_WEIGHT * np.exp(-np.arange(HORIZON_FRAMES) / EARLY_FRAMES)).astype(np.float32)
)
SOON_FRAMES: Final = 5
"""So long, who will leave the line for another one drives on it like anybody."""
MIRRORED: Final = 0.5
"""Share of samples seen in a mirror."""
CHANGED: Final = 0.3
"""Share of those that head elsewhere than they drive, that keep beside the line, and whose headings
are measured badly ..."""
TURN_STD_RAD: Final = 0.08
SHIFT_STD_M: Final = 0.5
SHAKE_STD_RAD: Final = 0.01
"""... by so much."""


def vehicle_batch(samples: Samples, rows: np.ndarray) -> VehicleBatch:
    """Rows of the samples as tensors."""
    return VehicleBatch(
        history=torch.from_numpy(samples.history[rows]),
        line=torch.from_numpy(samples.line[rows]),
        at=torch.from_numpy(samples.at[rows]),
    )


def goals_of(model: EncoderDecoderNetwork, profile_m: Float32Array) -> Float32Array:
    """Profiles [S, 6] in the form that the model takes: whole, or their last distance alone."""
    return profile_m[:, -model.settings.goal_steps :]


def training_loss(
    model: EncoderDecoderNetwork, samples: Samples, goals_m: Float32Array, rows: np.ndarray
) -> Tensor:
    """The loss on rows of samples; `goals_m` [S, goal_steps] is what the decoder is told."""
    settings, device = model.settings, device_of(model)
    batch = vehicle_batch(samples, rows)
    goal_m = torch.from_numpy(goals_m[rows])
    soon = np.arange(HORIZON_FRAMES) < SOON_FRAMES
    on_line = samples.on_line[rows, None] | (soon if settings.decoder == "kinematic" else False)
    mask = torch.from_numpy(samples.future_mask[rows] & on_line).float()
    mask = mask.to(device)
    if settings.decoder == "kinematic":
        future = torch.from_numpy(samples.future_xy[rows])
        scale = random_scale(len(rows))
        mirrored = torch.rand(len(rows)) < MIRRORED
        batch, future, goal_m = scale_vehicles(batch, future, goal_m, scale)
        batch, future = mirror_vehicles(batch, future, mirrored)
        batch, future = turn_vehicles(batch, future, _some(TURN_STD_RAD, len(rows)))
        batch = shift_vehicles(batch, _some(SHIFT_STD_M, len(rows)))
        batch = shake_vehicles(batch, _some(SHAKE_STD_RAD, len(rows)))
        said = model(on(device, batch), goal_m.to(device))
        return edn_loss(said, future.to(device), mask, BY_STEP.to(device))
    truth = edn_plain.targets(
        settings,
        batch.at,
        *(
            torch.from_numpy(values[rows])
            for values in (samples.future, samples.future_xy, samples.future_motion)
        ),
    )
    truth = truth.to(device)
    teacher = truth if settings.teacher_forcing and model.training else None
    said = model.native(on(device, batch), goal_m.to(device), teacher=teacher)
    return edn_loss(said, truth, mask, torch.ones(HORIZON_FRAMES, device=device))


def _some(std: float, samples: int) -> Tensor:
    """Numbers [S] of that deviation for a share of the samples, 0 for the others."""
    return std * torch.randn(samples) * (torch.rand(samples) < CHANGED)


@torch.no_grad()
def displacements_m(
    model: EncoderDecoderNetwork, samples: Samples, goals_m: Float32Array
) -> Float32Array:
    """Displacement [R, F] in the map at every step, of the rows whose future is wholly known."""
    model.eval()
    device = device_of(model)
    errors = [np.zeros((0, HORIZON_FRAMES), np.float32)]
    for rows in np.array_split(np.arange(len(samples)), len(samples) // 2048 + 1):
        known = rows[samples.future_mask[rows].all(axis=1)]
        if len(known):
            goal_m = torch.from_numpy(goals_m[known]).to(device)
            out = model(on(device, vehicle_batch(samples, known)), goal_m).cpu()
            errors.append(np.linalg.norm(out.numpy() - samples.future_xy[known], axis=-1))
    return np.concatenate(errors)


def figures(
    model: EncoderDecoderNetwork, samples: Samples, goals_m: Float32Array
) -> dict[str, float]:
    """ADE over 3 s and over 0.3 s in metres."""
    distance = displacements_m(model, samples, goals_m)
    return {"ade_3s_m": float(distance.mean()), "ade_0s3_m": float(distance[:, :3].mean())}
