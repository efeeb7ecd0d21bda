"""The one loop that fits a network to samples: resumable, and the same every time.

AdamW under a one-cycle schedule, with a running average of the weights beside them; the epoch, and
the one of the two, that is best on the tuning samples is kept. A training that diverges is taken
back to the best weights and goes on at half the rate. All that is random is drawn from the seed and
the epoch, so a training that was killed and goes on ends with the same weights, bit for bit, as one
that was not.
"""

from __future__ import annotations

import copy
import io
import math
import zlib
from collections.abc import Callable, Mapping, Sized
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from hatn_sim.datatypes import IntArray
from hatn_sim.errors import HatnSimError, InputError
from hatn_sim.learn.watch import Nobody, Watch
from hatn_sim.whole_file import save_whole

LARGEST_GRADIENT: Final = 1.0
"""Gradients of a larger norm are scaled down to it."""
DIVERGED: Final = 3.0
"""An epoch whose figure is this many times the best has blown the weights up: at a high rate a few
odd samples can do so, and what follows does not come back from it."""
SLOWER: Final = 0.5
"""Of the learning rate, once a training has diverged."""
Figures = dict[str, float]


@dataclass(frozen=True)
class FitSettings:
    """How a network is fitted."""

    epochs: int = 20
    batch: int = 256
    learning_rate: float = 2e-3  # the highest of the schedule
    weight_decay: float = 0.01
    average: float = 0.998  # of the running average of weights, kept at each step
    patience: int = 10  # epochs without a better figure before it ends


@dataclass(frozen=True, eq=False)
class Workplace:
    """Where and under whose eyes a network is fitted."""

    seed: int = 0
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    progress: Path | None = None  # the folder of checkpoints
    form: str = ""  # of the networks, where several are trained: in lines and names of files
    watch: Watch = field(default_factory=Nobody)


class LossError(HatnSimError):
    """The loss is not finite. `model` holds its last good weights, those of `epoch`, if not 0."""

    def __init__(self, line: str, model: nn.Module, epoch: int, figures: Figures) -> None:
        super().__init__(line)
        self.model, self.epoch, self.figures = model, epoch, figures


@dataclass
class _State:
    """All that a checkpoint holds beside the weights of now, the optimiser and the schedule."""

    epoch: int = 0  # that are done
    step: int = 0
    best_epoch: int = 0
    best: Figures = field(default_factory=Figures)
    best_weights: dict[str, Any] = field(default_factory=dict[str, Any])


def fit(
    model: nn.Module,
    learn: Sized,
    loss_of: Callable[[Any, IntArray], Tensor],
    figures: Callable[[], Figures],
    judged_by: str,
    *,
    name: str,
    settings: FitSettings,
    place: Workplace,
) -> Figures:
    """Fit `model`, which then holds the best weights, is in evaluation mode and on the CPU.

    Args:
        model: on the CPU; `loss_of` and `figures` hold on to it too.
        learn: samples to learn from.
        loss_of: of the model on rows of `learn`.
        figures: of the model on the tuning samples.
        judged_by: one of the figures, the less the better.
        name: of the network, in lines and for the name of its checkpoint; chance hangs on it, and
            not on the form, so that a form is trained alike alone and beside another.
        settings: how long, how fast.
        place: seed, device and checkpoints.

    Returns:
        The figures of the best epoch.

    Raises:
        LossError: the loss is not finite; says at which step. Or the figure never was.
        InputError: a checkpoint cannot be written, or is of something else.
    """
    model.to(place.device)
    average = AveragedModel(model, multi_avg_fn=get_ema_multi_avg_fn(settings.average))
    optimiser = torch.optim.AdamW(
        model.parameters(),
        lr=settings.learning_rate,
        weight_decay=settings.weight_decay,
        fused=True,
    )
    total = settings.epochs * math.ceil(len(learn) / settings.batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.learning_rate, max(total, 2))
    parts = {"model": model, "average": average, "optimiser": optimiser, "schedule": schedule}
    called = f"{place.form} {name}".strip()
    state = _resume(place, called, parts)
    for epoch in range(state.epoch + 1, settings.epochs + 1):
        if epoch - 1 - state.best_epoch >= settings.patience:
            break
        order = _seed_epoch(place.seed, name, epoch).permutation(len(learn))
        model.train()
        loss_sum = 0.0
        for start in range(0, len(learn), settings.batch):
            rows = order[start : start + settings.batch]
            state.step += 1
            loss = loss_of(learn, rows)
            value = float(loss.detach())
            if not math.isfinite(value):
                _give_best(model, state)
                line = _not_finite(called, value, state)
                raise LossError(line, model, state.best_epoch, state.best)
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(model.parameters(), LARGEST_GRADIENT)
            optimiser.step()
            schedule.step()
            average.update_parameters(model)
            loss_sum += value * len(rows)
            place.watch.step(called, state.step, total, f"epoch {epoch}, loss {value:.3f}")
        state.epoch = epoch
        found = _judge(model, average, figures, judged_by, state)
        shown = ", ".join(f"{key} {value:.4f}" for key, value in state.best.items())
        place.watch.say(
            f"{called} epoch {epoch} of {settings.epochs}: loss {loss_sum / len(learn):.4f}, best "
            f"of epoch {state.best_epoch}: {shown}"
        )
        if state.best and not found <= DIVERGED * state.best[judged_by]:
            _take_back(model, average, optimiser, state)
            place.watch.say(
                f"{called} diverged in epoch {epoch} ({judged_by} {found:.4f}): back to the "
                f"weights of epoch {state.best_epoch}, at {SLOWER:g} of the learning rate"
            )
        _save(place, called, parts, state)
    _give_best(model, state)
    if not state.best:
        line = (
            f"training {called}: {judged_by} was never finite: train with a smaller learning_rate"
        )
        raise LossError(line, model, 0, state.best)
    return state.best


def _judge(
    model: nn.Module,
    average: AveragedModel,
    figures: Callable[[], Figures],
    judged_by: str,
    state: _State,
) -> float:
    """Keep the weights of now, or their average, if their figures are the best so far.

    Returns:
        What the weights of now are judged by.
    """
    model.eval()
    now = copy.deepcopy(model.state_dict())
    of_now = math.inf
    for weights in (average.module.state_dict(), now):
        model.load_state_dict(weights)
        with torch.no_grad():
            found = figures()
        judged = of_now = found[judged_by]
        if math.isfinite(judged) and (not state.best or judged < state.best[judged_by]):
            state.best, state.best_epoch = found, state.epoch
            state.best_weights = copy.deepcopy(weights)
    return of_now


def _take_back(
    model: nn.Module, average: AveragedModel, optimiser: torch.optim.Optimizer, state: _State
) -> None:
    """To the best weights, with nothing remembered of the steps since, and slower from there."""
    model.load_state_dict(state.best_weights)
    average.module.load_state_dict(state.best_weights)
    optimiser.state.clear()
    for group in optimiser.param_groups:
        for rate in ("initial_lr", "max_lr", "min_lr"):  # those the schedule goes by
            group[rate] *= SLOWER


def _give_best(model: nn.Module, state: _State) -> None:
    if state.best_weights:
        model.load_state_dict(state.best_weights)
    model.to("cpu").eval()


def _not_finite(name: str, value: float, state: _State) -> str:
    kept = f"the weights of epoch {state.best_epoch} are kept" if state.best else "none are good"
    return (
        f"training {name}: the loss became {value} at step {state.step}, in epoch "
        f"{state.epoch + 1}: train with a smaller learning_rate; {kept}"
    )


def _seed_epoch(seed: int, name: str, epoch: int) -> np.random.Generator:
    """Seed torch for an epoch, and a generator for the order of its samples."""
    sequence = np.random.SeedSequence((seed, zlib.crc32(name.encode()), epoch))
    torch.manual_seed(int(sequence.generate_state(1, np.uint64)[0]))
    return np.random.default_rng(sequence)


def _file(place: Workplace, name: str) -> Path | None:
    return (
        None if place.progress is None else place.progress / f"{name.lower().replace(' ', '-')}.pt"
    )


def _save(place: Workplace, name: str, parts: Mapping[str, Any], state: _State) -> None:
    path = _file(place, name)
    if path is None:
        return
    content = {key: part.state_dict() for key, part in parts.items()} | {"state": vars(state)}
    data = io.BytesIO()
    torch.save(content, data)
    again = f"make room and give the same command again, which goes on with epoch {state.epoch}"
    save_whole(path, data.getbuffer(), again)


def _resume(place: Workplace, name: str, parts: Mapping[str, Any]) -> _State:
    """Take up the checkpoint; begin where there is none, or none that can be read."""
    path = _file(place, name)
    if path is None or not path.is_file():
        return _State()
    try:
        content = torch.load(path, map_location=place.device, weights_only=True)
        for key, part in parts.items():
            part.load_state_dict(content[key])
        state = _State(**content["state"])
    except Exception as error:  # whatever a damaged file makes of the reader
        raise InputError(
            f"{path}: not a checkpoint of this training ({type(error).__name__}); remove the "
            "folder to begin anew"
        ) from None
    place.watch.say(f"{name}: {state.epoch} epochs are done already")
    return state
