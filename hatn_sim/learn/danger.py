"""Fitting danger networks to runs: which signs went before collisions and evasive braking.

A pair's row is an example of danger if a T1 or T2 event of the pair begins within the next
`WITHIN_S`, and of none if no event of the pair is near; rows before events that are not severe say
little, rows after a severe one nothing. Rows long before count less: few of them show anything yet.

Each row has the weight that it has in the traffic, but for those named and for the quiet rows of
scripted scenes: so that what is fitted ranks dangers, and is near a probability, but is none.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch

from hatn_sim.assist.alert import WITHIN_S
from hatn_sim.assist.danger_network import DangerNetwork
from hatn_sim.datatypes import BoolArray, FloatArray, IntArray
from hatn_sim.resources import SUITES, scenes_of_suite
from hatn_sim.score.assessed import AssessedRun
from hatn_sim.score.assistance import is_close
from hatn_sim.score.events import BRIEF
from hatn_sim.score.matching import SEVERE

NETWORKS: Final = 4
"""Fitted from as many beginnings; their mean logit is one network of all their units."""
UNITS: Final = 24
EPOCHS: Final = 6
LEAST_STEPS: Final = 400
BATCH: Final = 1024
DANGEROUS_SHARE: Final = 0.2
"""Of a batch: events are rare."""
RATE: Final = 1e-2
DECAY: Final = 0.3
NEAR_WEIGHT: Final = 0.1
SCRIPTED_WEIGHT: Final = 10.0
"""Of rows without danger in the scenes of suites: violations are frequent there."""
EARLY_S: Final = 4.0
EARLY_WEIGHT: Final = 0.2
LEAST_SCALE: Final = 1e-2


def fit_danger(runs: Sequence[AssessedRun], rule: str, seed: int = 0) -> DangerNetwork | None:
    """The network of a rule whose signs the runs have; None: no event went before which any was."""
    if not runs:
        return None
    signs, dangerous, weight = examples(runs, rule)
    if not dangerous.any() or dangerous.all():
        return None
    mean, scale = signs.mean(axis=0), signs.std(axis=0) + LEAST_SCALE
    x = torch.tensor((signs - mean) / scale, dtype=torch.float32)
    t = torch.tensor(dangerous, dtype=torch.float32)
    w = torch.tensor(weight, dtype=torch.float32)
    fitted = [_fit_one(x, t, w, seed + k) for k in range(NETWORKS)]
    parts = [[p.detach().double().numpy() for p in one.parameters()] for one in fitted]
    return DangerNetwork(
        mean=mean,
        scale=scale,
        hidden=np.concatenate([part[0].T for part in parts], axis=1),
        hidden_bias=np.concatenate([part[1] for part in parts]),
        out=np.concatenate([part[2][0] for part in parts]) / NETWORKS,
        out_bias=float(np.mean([part[3][0] for part in parts])) + _rarity(t),
    )


def _fit_one(
    x: torch.Tensor, dangerous: torch.Tensor, weight: torch.Tensor, seed: int
) -> torch.nn.Module:
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = torch.nn.Sequential(
            torch.nn.Linear(x.shape[1], UNITS), torch.nn.Tanh(), torch.nn.Linear(UNITS, 1)
        )
    many = round(BATCH * DANGEROUS_SHARE)
    steps = max(EPOCHS * len(x) // BATCH, LEAST_STEPS)
    optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    rates = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps + 1)
    kinds = torch.where(dangerous > 0)[0], torch.where(dangerous == 0)[0]
    for _ in range(steps):
        of_batch = torch.cat(
            [
                kind[torch.randint(len(kind), (count,), generator=generator)]
                for kind, count in zip(kinds, (many, BATCH - many), strict=True)
            ]
        )
        logit = network(x[of_batch])[:, 0]
        each = torch.nn.functional.binary_cross_entropy_with_logits(
            logit, dangerous[of_batch], reduction="none"
        )
        loss = (each * weight[of_batch]).sum() / weight[of_batch].sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        rates.step()
    return network


def _rarity(dangerous: torch.Tensor) -> float:
    """What the logit is less in traffic than in batches, where events are not rare."""
    share = float(dangerous.mean())
    return float(np.log(share / (1.0 - share)) - np.log(DANGEROUS_SHARE / (1.0 - DANGEROUS_SHARE)))


def examples(runs: Sequence[AssessedRun], rule: str) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Signs [D, S] of all runs, whether they are of danger [D], and their weights [D]."""
    scripted = {name for suite in SUITES for name in scenes_of_suite(suite)}
    found = [_examples_of(run, rule, run.scene in scripted) for run in runs]
    signs, dangerous, weight = (np.concatenate(parts) for parts in zip(*found, strict=True))
    some = weight > 0.0
    return signs[some], dangerous[some], weight[some]


def _examples_of(
    run: AssessedRun, rule: str, is_scripted: bool
) -> tuple[FloatArray, BoolArray, FloatArray]:
    trace = run.signs[rule]
    pairs = trace.pairs
    signs = trace.signs[pairs.danger.astype(np.int64)].astype(np.float64)
    to_event_s = np.full(len(signs), np.inf)
    is_near, is_after = np.zeros((2, len(signs)), dtype=np.bool_)
    place = {name: number for number, name in enumerate(pairs.ids)}
    for event in run.events:
        if event.second_id is None:
            continue
        rows = _rows_of(pairs.first, pairs.second, place, event.first_id, event.second_id)
        ahead_s = event.start_s - pairs.time_s[rows]
        if event.tier in SEVERE:
            before = (ahead_s > 0.01) & (ahead_s <= WITHIN_S)
            to_event_s[rows[before]] = np.minimum(to_event_s[rows[before]], ahead_s[before])
            is_after[rows[(ahead_s <= 0.01) & (ahead_s > -WITHIN_S)]] = True
        elif event.tier == BRIEF or is_close(event):
            is_near[rows[np.abs(ahead_s) <= WITHIN_S]] = True
    dangerous = np.isfinite(to_event_s)
    weight = np.where(is_near, NEAR_WEIGHT, 1.0) * (SCRIPTED_WEIGHT if is_scripted else 1.0)
    weight = np.where(is_after, 0.0, weight)
    weight = np.where(dangerous, np.where(to_event_s > EARLY_S, EARLY_WEIGHT, 1.0), weight)
    return signs, dangerous, weight


def _rows_of(
    first: IntArray, second: IntArray, place: dict[str, int], one: str, other: str
) -> IntArray:
    a, b = sorted((place.get(one, -1), place.get(other, -1)))
    return np.flatnonzero((first == a) & (second == b))
