"""`hatn-sim train`: simulate, cut samples, train the SGN alone, then the EDN on its goals."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

import hatn_sim
from hatn_sim.datatypes import Frame, IntArray
from hatn_sim.errors import HatnSimError, InputError
from hatn_sim.hatn.edn import EdnSettings, EncoderDecoderNetwork
from hatn_sim.hatn.sgn_settings import best_sgn
from hatn_sim.hatn.weights_io import make_folder, save_weights
from hatn_sim.learn import edn_training
from hatn_sim.learn.batches import batches
from hatn_sim.learn.dataset import Samples, concatenate, samples_of_run
from hatn_sim.learn.sgn_training import predicted_profiles, train_sgn
from hatn_sim.loop import warm_up

WEIGHT_DECAY = 0.01
WARM_UP_S = 60.0
"""Traffic builds up for this long before samples are taken."""
MAX_SEED = 2**64 - 1
"""The largest that torch takes."""
Say = Callable[[str], None]


@dataclass(frozen=True)
class TrainingPlan:
    """What `hatn-sim train` was asked to do; goes into the card."""

    scenes: tuple[str, ...]
    seeds: tuple[int, ...]
    tune_seeds: tuple[int, ...]
    duration_s: float
    risks: tuple[str, ...] = ("courteous",)
    density: str = "normal"
    sgn_epochs: int = 20
    edn_epochs: int = 20
    batch: int = 256
    learning_rate: float = 2e-3
    seed: int = 0
    workers: int = 2


@dataclass(frozen=True)
class RunOfTraffic:
    """One simulated run to learn from."""

    scene: str
    seed: int
    duration_s: float
    risk: str
    density: str


def simulate_samples(run: RunOfTraffic) -> Samples:
    """Simulate a run and cut its samples; a function of its own so that it can be sent away."""
    from hatn_sim.config import load_scenario
    from hatn_sim.simulators.sumo import SumoSimulator

    with SumoSimulator(load_scenario(run.scene, run.density, run.risk)) as simulator:
        first = warm_up(simulator, simulator.reset(run.seed), round(WARM_UP_S / simulator.dt_s))

        def frames() -> Iterator[Frame]:
            yield first
            for _ in range(round(run.duration_s / simulator.dt_s)):
                yield simulator.step()

        return samples_of_run(simulator.road, frames())


def collect(runs: Sequence[RunOfTraffic], workers: int, say: Say) -> Samples:
    """Samples of many runs, simulated side by side."""
    parts: list[Samples] = []
    started = time.monotonic()
    with ProcessPoolExecutor(max_workers=workers, mp_context=get_context("spawn")) as pool:
        for done, part in enumerate(pool.map(simulate_samples, runs), start=1):
            parts.append(part)
            seconds = time.monotonic() - started
            say(
                f"simulated {done} of {len(runs)} runs, {sum(map(len, parts)):,} samples, "
                f"{seconds:.0f} s"
            )
    return concatenate(parts)


def train(plan: TrainingPlan, out: Path, command: str, say: Say) -> dict[str, Any]:
    """Train both networks, write the weights and their card, and return the card.

    InputError, before anything is simulated, where the plan or the folder of `out` is unfit, and
    before anything is trained where the traffic gave too little to learn from.
    """
    _check_plan(plan)
    make_folder(out)
    torch.manual_seed(plan.seed)
    torch.set_num_threads(max(plan.workers, 1))
    learn = collect(_runs(plan, plan.seeds), plan.workers, say)
    tune = collect(_runs(plan, plan.tune_seeds), plan.workers, say)
    _check_samples("--seeds", learn, plan.duration_s)
    _check_samples("--tune", tune, plan.duration_s)

    def fit_sgn(
        model: nn.Module,
        learn: Samples,
        loss_of: Callable[[Samples, IntArray], Tensor],
        figures: Callable[[], dict[str, float]],
        judged_by: str,
    ) -> dict[str, float]:
        return _fit(model, learn, loss_of, figures, judged_by, plan.sgn_epochs, plan, "SGN", say)

    sgn, sgn_figures = train_sgn(learn, tune, best_sgn(), fit_sgn)
    goals, tune_goals = predicted_profiles(sgn, learn), predicted_profiles(sgn, tune)
    edn, edn_figures = train_edn(learn, tune, goals, tune_goals, plan, say)
    card = {
        "made_by": f"hatn-sim {hatn_sim.__version__}",
        "command": command,
        "scenes": list(plan.scenes),
        "seeds": list(plan.seeds),
        "tune_seeds": list(plan.tune_seeds),
        "duration_s": plan.duration_s,
        "warm_up_s": WARM_UP_S,
        "risk_profiles": list(plan.risks),
        "density": plan.density,
        "torch_seed": plan.seed,
        "samples": len(learn),
        "tune_samples": len(tune),
        "tune_figures": {**sgn_figures, **edn_figures},
    }
    save_weights(out, sgn, edn, card)
    return card


def _check_plan(plan: TrainingPlan) -> None:
    if not (plan.scenes and plan.risks and plan.seeds and plan.tune_seeds):
        raise InputError("--scenes, --risks, --seeds and --tune: expected at least one of each")
    shared = set(plan.seeds) & set(plan.tune_seeds)
    if shared:
        raise InputError(
            f"--seeds and --tune share {sorted(shared)}: the seeds that stop the training must be "
            "others than those it learns from"
        )
    if not 0 <= plan.seed <= MAX_SEED:
        raise InputError(f"--torch-seed {plan.seed}: expected 0 or more, and less than 2^64")


def _check_samples(option: str, samples: Samples, duration_s: float) -> None:
    """InputError unless there is something of every kind to learn from, and to judge by."""
    kinds = {
        "with a known goal": samples.goal_mask[:, 0],
        "with a whole path": samples.future_mask.all(axis=1),
        "with a choice of slots": (samples.slot >= 0) & (samples.focus_mask.sum(axis=1) > 1),
    }
    counts = {kind: int(rows.sum()) for kind, rows in kinds.items()}
    if not all(counts.values()):
        found = ", ".join(f"{count} {kind}" for kind, count in counts.items())
        raise InputError(
            f"{option}: too little to learn from in {duration_s:g} s a seed: {len(samples)} "
            f"samples, {found}; raise --duration"
        )


def _runs(plan: TrainingPlan, seeds: Sequence[int]) -> list[RunOfTraffic]:
    return [
        RunOfTraffic(scene, seed, plan.duration_s, plan.risks[k % len(plan.risks)], plan.density)
        for scene in plan.scenes
        for k, seed in enumerate(seeds)
    ]


def train_edn(
    learn: Samples,
    tune: Samples,
    goals: np.ndarray,
    tune_goals: np.ndarray,
    plan: TrainingPlan,
    say: Say,
) -> tuple[EncoderDecoderNetwork, dict[str, float]]:
    """The encoder-decoder network, on the goals [S, G] that the SGN predicts."""
    model = EncoderDecoderNetwork(EdnSettings(goal_steps=goals.shape[1]))

    def loss_of(samples: Samples, rows: np.ndarray) -> Tensor:
        return edn_training.training_loss(model, samples, goals, rows)

    def figures() -> dict[str, float]:
        return edn_training.figures(model, tune, tune_goals)

    best = _fit(model, learn, loss_of, figures, "ade_3s_m", plan.edn_epochs, plan, "EDN", say)
    return model, best


def _fit(
    model: nn.Module,
    learn: Samples,
    loss_of: Callable[[Samples, np.ndarray], Tensor],
    figures: Callable[[], dict[str, float]],
    judged_by: str,
    epochs: int,
    plan: TrainingPlan,
    name: str,
    say: Say,
) -> dict[str, float]:
    """Adam with a cosine schedule; the epoch that is best on the tuning seeds is kept."""
    random = np.random.default_rng(plan.seed)
    optimiser = torch.optim.AdamW(
        model.parameters(), lr=plan.learning_rate, weight_decay=WEIGHT_DECAY
    )
    steps = epochs * math.ceil(len(learn) / plan.batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, plan.learning_rate, max(steps, 2))
    best: dict[str, float] = {}
    best_state = copy.deepcopy(model.state_dict())
    started = time.monotonic()
    for epoch in range(1, epochs + 1):
        model.train()
        total = 0.0
        for rows in batches(len(learn), plan.batch, random):
            loss = loss_of(learn, rows)
            if not bool(torch.isfinite(loss)):
                model.load_state_dict(best_state)
                raise HatnSimError(
                    f"training {name}: the loss became {loss.item()} in epoch {epoch}"
                )
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimiser.step()
            schedule.step()
            total += float(loss.detach()) * len(rows)
        model.eval()
        now = figures()
        if not best or now[judged_by] < best[judged_by]:
            best, best_state = now, copy.deepcopy(model.state_dict())
        shown = ", ".join(f"{key} {value:.4f}" for key, value in now.items())
        say(
            f"{name} epoch {epoch} of {epochs}: loss {total / len(learn):.4f}, {shown}, "
            f"{time.monotonic() - started:.0f} s"
        )
    model.load_state_dict(best_state)
    model.eval()
    return best
