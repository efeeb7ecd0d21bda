"""Fits the choice of lines to what drivers did: a conditional logit with a hidden layer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from hatn_sim.datatypes import BoolArray
from hatn_sim.errors import HatnSimError
from hatn_sim.learn.line_samples import FIT_M, TIED_M, WRONG_M, ChoiceSamples, least_of_cases
from hatn_sim.line_choice import LineChoice, squash
from hatn_sim.line_features import FEATURES, HAND_MADE

MEMBERS: Final = 4
"""Scorers that are learned side by side from different beginnings; the choice is their mean, which
is surer on roads of another kind than each of them."""
WIDTH: Final = 8
STEPS: Final = 400
RATE: Final = 0.02
PULL: Final = 2e-5
"""Weight of squared distances from where the fit began."""
SITE_PULL: Final = 1e-2
"""The same for one site, which shall not unlearn what holds elsewhere."""
NOISE: Final = 0.1
"""Added to the features, so that no single one is trusted too much."""
ECE_BINS: Final = 15
MOTION_NATS: Final = 30.0
"""Of motion no more nats than this are learned from; the rest would drown everything else."""


@dataclass(frozen=True, eq=False)
class _Cases:
    """Candidates as tensors, cases numbered without gaps."""

    features: Tensor  # [Q, F]
    squashed: Tensor  # [Q, F]
    right: Tensor  # [Q] bool
    log_share: Tensor  # [Q]
    case: Tensor  # [Q]
    count: int


def right_candidates(samples: ChoiceSamples) -> tuple[BoolArray, BoolArray]:
    """Which candidates [Q] fit what came after, and which cases [S] tell anything at all.

    A case tells nothing where no candidate fits, or where all do.
    """
    best_m = least_of_cases(samples, samples.fit_m)
    right = samples.fit_m <= best_m[samples.case] + TIED_M
    wrong_some = np.zeros(len(samples), dtype=np.bool_)
    wrong_some[samples.case[~right]] = True
    return right, wrong_some & (best_m <= FIT_M)


class ChoiceFigures(NamedTuple):
    """How well a choice does, over the cases that tell."""

    n: int
    wrong: float  # share whose line fits worse than the best by more than WRONG_M
    log_loss: float  # nats: mean -log probability of what is right
    ece: float  # of the probability of the chosen line, 15 bins

    def __str__(self) -> str:
        return (
            f"wrong {100.0 * self.wrong:5.1f} %, log loss {self.log_loss:.3f}, "
            f"ECE {self.ece:.3f} (n {self.n:,})"
        )


def choice_figures(samples: ChoiceSamples, choice: LineChoice) -> ChoiceFigures:
    """How well a choice does on samples, each case for itself: without hysteresis."""
    right, tells = right_candidates(samples)
    case, count, nats = samples.case, len(samples), choice.nats(samples.features)
    log_weight = samples.log_share - nats
    weight = np.exp(log_weight - -least_of_cases(samples, -log_weight)[case])
    probability = weight / np.bincount(case, weight, count)[case]
    best = np.flatnonzero(nats <= least_of_cases(samples, nats)[case])
    pick = best[np.unique(case[best], return_index=True)[1]]
    best_m = least_of_cases(samples, samples.fit_m)
    wrong = samples.fit_m[pick] > best_m + WRONG_M
    true = np.bincount(case, probability * right, count)
    like = np.abs(samples.fit_m - samples.fit_m[pick][case]) <= TIED_M
    sure = np.bincount(case, probability * like, count)[tells]
    bin_of = np.minimum((sure * ECE_BINS).astype(np.int64), ECE_BINS - 1)
    gap = np.bincount(bin_of, sure - right[pick][tells], ECE_BINS)
    return ChoiceFigures(
        n=int(tells.sum()),
        wrong=round(float(wrong[tells].mean()), 4),
        log_loss=round(float(-np.log(np.maximum(true[tells], 1e-9)).mean()), 4),
        ece=round(float(np.abs(gap).sum() / max(int(tells.sum()), 1)), 4),
    )


def fit_line_choice(
    samples: ChoiceSamples, start: LineChoice | None = None, seed: int = 0
) -> LineChoice:
    """The choice that makes what drivers did most likely. The same samples give the same choice.

    With `start` it is that choice, moved no further than the samples ask for: what a site has
    nothing to teach about stays as it was. Raises HatnSimError where no case tells candidates
    apart.
    """
    cases = _cases(samples)
    random = torch.Generator().manual_seed(seed)
    if start is None:
        now, origin, pull = _beginning(random), _beginning(random, spread=0.0), PULL
    else:
        now, origin, pull = _parameters(start), _parameters(start), SITE_PULL
    for one in now:
        one.requires_grad_(True)
    optimiser = torch.optim.Adam(now, lr=RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=STEPS)
    for _ in range(STEPS):
        optimiser.zero_grad()
        noise = torch.randn(cases.squashed.shape, generator=random)
        loss = _loss(cases, cases.squashed + NOISE * noise, now)
        away = sum(((one - then) ** 2).sum() for one, then in zip(now, origin, strict=True))
        (loss + pull * away).backward()
        optimiser.step()
        schedule.step()
    return _choice(now)


def _beginning(random: torch.Generator, spread: float = 1.0) -> list[Tensor]:
    """Parameters linear [K, F], hidden [K, F, W], bias [K, W], out [K, W] of K members."""
    features = len(FEATURES)
    linear = torch.zeros(MEMBERS, features)
    linear[:, : len(HAND_MADE)] = 0.7
    hidden = torch.randn(MEMBERS, features, WIDTH, generator=random)
    out = torch.randn(MEMBERS, WIDTH, generator=random)
    return [
        linear,
        spread * hidden * 0.5 / features**0.5,
        torch.zeros(MEMBERS, WIDTH),
        spread * out * 0.1,
    ]


def _parameters(choice: LineChoice) -> list[Tensor]:
    """A choice as one member."""
    parts = (choice.linear, choice.hidden, choice.bias, choice.out)
    return [torch.from_numpy(part).float()[None] for part in parts]


def _choice(parameters: list[Tensor]) -> LineChoice:
    """The mean of the members as one choice."""
    linear, hidden, bias, out = (one.detach().double().numpy() for one in parameters)
    members = len(linear)
    return LineChoice(
        linear=linear.mean(axis=0),
        hidden=np.concatenate(list(hidden), axis=1),
        bias=bias.ravel(),
        out=out.ravel() / members,
    )


def _loss(cases: _Cases, squashed: Tensor, parameters: list[Tensor]) -> Tensor:
    """Mean -log probability of the candidates that are right."""
    linear, hidden, bias, out = parameters
    members, features, width = hidden.shape
    flat = hidden.permute(1, 0, 2).reshape(features, members * width)
    units = torch.nn.functional.softsign(squashed @ flat + bias.reshape(-1))
    nats = cases.features @ linear.T + (units * out.reshape(-1)).reshape(-1, members, width).sum(2)
    log_weight = cases.log_share[:, None] - nats
    everything = _log_sum(log_weight, cases.case, cases.count)
    right = _log_sum(log_weight[cases.right], cases.case[cases.right], cases.count)
    return (everything - right).mean()


def _log_sum(values: Tensor, case: Tensor, count: int) -> Tensor:
    """log of the sum of exp of values [Q, K], case by case [S, K]."""
    index = case[:, None].expand_as(values)
    top = torch.full((count, values.shape[1]), -torch.inf)
    top = top.scatter_reduce(0, index, values.detach(), "amax")
    total = torch.zeros_like(top).index_add(0, case, torch.exp(values - top[case]))
    return torch.log(total) + top


def _cases(samples: ChoiceSamples) -> _Cases:
    right, tells = right_candidates(samples)
    keep = tells[samples.case]
    if not keep.any():
        raise HatnSimError(
            "fitting the choice of lines: no vehicle was seen where lines part; "
            "expected some, give more traffic"
        )
    features = samples.features[keep].copy()
    features[:, 0] = np.minimum(features[:, 0], MOTION_NATS)
    _, case = np.unique(samples.case[keep], return_inverse=True)
    # Lines that are not told apart count as one: they part far ahead only, and there are many.
    random = np.random.default_rng(0)
    print_of = np.round(features @ random.normal(size=len(FEATURES)), 6)
    key = np.stack((case, right[keep], print_of), axis=1)
    _, row, same = np.unique(key, axis=0, return_index=True, return_inverse=True)
    log_share = np.log(np.bincount(same, np.exp(samples.log_share[keep])))
    features = features[row]
    return _Cases(
        features=torch.from_numpy(features).float(),
        squashed=torch.from_numpy(squash(features)).float(),
        right=torch.from_numpy(right[keep][row]),
        log_share=torch.from_numpy(log_share).float(),
        case=torch.from_numpy(case[row]),
        count=int(case.max()) + 1,
    )
