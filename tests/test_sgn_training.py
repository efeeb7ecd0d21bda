"""Training of the graph network: temperatures that come back, figures by hand, and mirrors."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import torch
from test_sgn import batch_of

from hatn_sim.hatn.sgn import GraphBatch, SemanticGraphNetwork
from hatn_sim.hatn.sgn_settings import SgnSettings, best_sgn
from hatn_sim.learn.augment import mirror_graphs
from hatn_sim.learn.batches import graph_batch
from hatn_sim.learn.calibration import calibrate
from hatn_sim.learn.dataset import Samples
from hatn_sim.learn.sgn_training import (
    goal_share,
    predicted_profiles,
    sgn_batch_loss,
    sgn_figures,
)


def samples_of(batch: GraphBatch, **known: Any) -> Samples:
    """Samples of graphs: labels as told, or nothing known; what only the EDN reads is left out."""
    egos, nodes = batch.node_mask.shape
    of_graphs = {name: value.numpy() for name, value in vars(batch).items()}
    labels = {
        "goal_m": np.zeros((egos, nodes), np.float32),
        "goal_mask": np.zeros((egos, nodes), np.bool_),
        "profile_m": np.zeros((egos, nodes, 6), np.float32),
        "slot": np.full(egos, -1),
        "crossing_s": np.zeros(egos, np.float32),
        "crossing_mask": np.zeros(egos, np.bool_),
    }
    nothing = {one.name: np.zeros((egos, 0)) for one in fields(Samples)}
    return Samples(**(nothing | of_graphs | labels | known))


def sure_network() -> SemanticGraphNetwork:
    torch.manual_seed(2)
    model = SemanticGraphNetwork(SgnSettings(width=16)).eval()
    with torch.no_grad():
        model.race_head[2].weight *= 8.0
    return model


@pytest.mark.parametrize("temperature", [0.6, 1.0, 2.5])
def test_the_temperatures_that_made_the_samples_come_back(temperature: float) -> None:
    model, batch = sure_network(), batch_of(6000, 4, seed=5)
    batch.x[..., 4] = 20.0  # everybody moves: calibration asks no others how wide their goals are
    model.slot_temperature.fill_(temperature)
    model.goal_temperature.fill_(temperature)
    random = torch.Generator().manual_seed(0)
    with torch.no_grad():
        drawn_from = model(batch)
    slot = torch.multinomial(drawn_from.slot_logit.exp(), 1, generator=random)[:, 0]
    weight = drawn_from.goal_log_weight[:, 0].exp()
    component = torch.multinomial(weight, 1, generator=random)
    mean = drawn_from.goal_mean_m[:, 0].gather(1, component)[:, 0]
    std = drawn_from.goal_std_m[:, 0].gather(1, component)[:, 0]
    goal = torch.zeros(batch.node_mask.shape)
    goal[:, 0] = mean + std * torch.randn(len(mean), generator=random)
    samples = samples_of(
        batch, slot=slot.numpy(), goal_m=goal.numpy(), goal_mask=batch.node_mask.numpy()
    )
    calibrate(model, samples)
    assert float(model.slot_temperature) == pytest.approx(temperature, rel=0.15)
    assert float(model.goal_temperature) == pytest.approx(temperature, rel=0.1)


def test_a_temperature_changes_neither_the_choice_nor_the_mean() -> None:
    model, batch = sure_network(), batch_of(64)
    with torch.no_grad():
        before = model(batch)
        model.slot_temperature.fill_(3.0)
        model.goal_temperature.fill_(2.0)
        after = model(batch)
    assert torch.equal(before.slot_logit.argmax(-1), after.slot_logit.argmax(-1))
    assert torch.equal(before.goal_m(), after.goal_m())
    torch.testing.assert_close(after.goal_std_m, 2.0 * before.goal_std_m)
    np.testing.assert_allclose(after.slot_logit.exp().sum(-1), 1.0, atol=1e-5)
    assert (after.slot_logit.max(-1).values <= before.slot_logit.max(-1).values + 1e-6).all()


def test_too_few_samples_leave_the_temperatures_alone() -> None:
    model = sure_network()
    calibrate(model, samples_of(batch_of(8)))
    assert (float(model.slot_temperature), float(model.goal_temperature)) == (1.0, 1.0)


def test_the_figures_by_hand() -> None:
    model, batch = sure_network(), batch_of(40)
    with torch.no_grad():
        said = model(batch)
    goal = np.zeros((40, 5), np.float32)
    goal[:, 0] = said.goal_m()[:, 0].numpy()
    goal[:10, 0] += 2.0
    known = np.zeros((40, 5), np.bool_)
    known[:20, 0] = True
    slot = said.slot_logit.argmax(-1).numpy().copy()
    several = np.flatnonzero(batch.focus_mask.sum(-1).numpy() > 1)
    wrong = several[: len(several) // 2]
    slot[wrong] = np.where(slot[wrong] == 0, 1, 0)
    found = sgn_figures(model, samples_of(batch, goal_m=goal, goal_mask=known, slot=slot))
    assert found["goal_error_m"] == pytest.approx(1.0, abs=1e-5)
    assert found["slot_accuracy"] == pytest.approx(1 - len(wrong) / len(several))
    sure = said.slot_logit.exp().max(-1).values.double().numpy()[several]
    hit = np.isin(several, wrong, invert=True)
    bins = np.minimum((sure * 15).astype(int), 14)
    by_hand = sum(abs((sure - hit)[bins == k].sum()) for k in range(15)) / len(several)
    assert found["slot_ece"] == pytest.approx(by_hand, abs=1e-6)
    profiles = predicted_profiles(model, samples_of(batch))
    np.testing.assert_allclose(profiles[:, -1], said.goal_m()[:, 0], rtol=1e-5)


def test_goals_drawn_from_the_distribution_fall_evenly_into_it() -> None:
    model, batch = sure_network(), batch_of(4000, 3)
    with torch.no_grad():
        said = model(batch)
    random = torch.Generator().manual_seed(0)
    component = torch.multinomial(said.goal_log_weight[:, 0].exp(), 1, generator=random)
    mean, std = (v[:, 0].gather(1, component) for v in (said.goal_mean_m, said.goal_std_m))
    goal = (mean + std * torch.randn(mean.shape, generator=random))[:, 0]
    share = goal_share(said, goal.numpy())
    for level in (0.1, 0.25, 0.5, 0.9):
        assert (share < level).mean() == pytest.approx(level, abs=0.025)


def test_nothing_known_gives_no_figures() -> None:
    assert all(np.isnan(v) for v in sgn_figures(sure_network(), samples_of(batch_of(4))).values())


def test_a_batch_costs_something_that_falls() -> None:
    torch.manual_seed(3)
    batch = batch_of(64)
    goal = torch.full(batch.node_mask.shape, 12.0).numpy()
    samples = samples_of(
        batch,
        goal_m=goal,
        goal_mask=batch.node_mask.numpy(),
        profile_m=np.repeat(goal[..., None], 6, -1) * np.linspace(1 / 6, 1, 6, dtype=np.float32),
        slot=np.zeros(64, np.int64),
    )
    model = SemanticGraphNetwork(replace(best_sgn(), width=16)).train()
    optimiser = torch.optim.Adam(model.parameters(), 3e-3)
    costs = []
    for _ in range(40):
        cost = sgn_batch_loss(model, samples, np.arange(64))
        optimiser.zero_grad()
        cost.backward()
        optimiser.step()
        costs.append(float(cost.detach()))
    assert np.mean(costs[-5:]) < 0.7 * np.mean(costs[:5])


def test_a_mirror_turns_sides_and_nothing_else() -> None:
    batch = graph_batch(samples_of(batch_of(8)), np.arange(8))
    every = torch.ones(8, dtype=torch.bool)
    turned = mirror_graphs(batch, every)
    torch.testing.assert_close(turned.x[..., 5], -batch.x[..., 5])
    torch.testing.assert_close(turned.x[..., 3], batch.x[..., 3])
    torch.testing.assert_close(turned.context[..., 11:22], -batch.context[..., 11:22])
    back = mirror_graphs(turned, every)
    for name, value in vars(batch).items():
        assert torch.equal(getattr(back, name), value)
    assert all(
        torch.equal(getattr(mirror_graphs(batch, ~every), name), value)
        for name, value in vars(batch).items()
    )
