"""The networks: composition of the race by enumeration, gradients, masks, dynamics."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hatn_sim.errors import InputError
from hatn_sim.graph import CONTEXT_SIZE
from hatn_sim.hatn.edn import EdnSettings, EncoderDecoderNetwork, edn_loss, frozen
from hatn_sim.hatn.sgn import (
    GraphBatch,
    SemanticGraphNetwork,
    SgnSettings,
    race_log_probability,
    sgn_loss,
)
from hatn_sim.hatn.weights_io import load_weights, save_weights


def batch_of(egos: int = 4, nodes: int = 5, seed: int = 0) -> GraphBatch:
    random = torch.Generator().manual_seed(seed)
    node_mask = torch.rand((egos, nodes), generator=random) < 0.7
    node_mask[:, 0] = True
    focus = node_mask & (torch.rand((egos, nodes), generator=random) < 0.7)
    focus[:, 0] = True
    return GraphBatch(
        x=torch.randn((egos, nodes, 11, 7), generator=random) * 10 * node_mask[:, :, None, None],
        context=torch.rand((egos, nodes, CONTEXT_SIZE), generator=random) * node_mask[..., None],
        node_mask=node_mask,
        focus_mask=focus,
        history_mask=node_mask[:, :, None].expand(-1, -1, 11),
    )


def network() -> SemanticGraphNetwork:
    torch.manual_seed(1)
    return SemanticGraphNetwork(SgnSettings(width=16)).eval()


@given(st.lists(st.floats(-4.0, 4.0), min_size=2, max_size=5))
def test_the_race_by_enumeration(utilities: list[float]) -> None:
    """Plackett and Luce: draw the order one by one; sum over all orders of crossing."""
    weight = np.exp(utilities)
    expected = np.zeros(len(utilities))
    for order in permutations(range(len(utilities))):
        chance, left = 1.0, weight.sum()
        for runner in order:
            chance *= weight[runner] / left
            left -= weight[runner]
        expected[0 if order[0] != 0 else order[1]] += chance
    mask = torch.ones((1, len(utilities)), dtype=torch.bool)
    found = race_log_probability(torch.tensor([utilities], dtype=torch.float64), mask).exp()
    np.testing.assert_allclose(found[0], expected, atol=1e-9)


def test_slots_outside_the_focus_have_no_probability_and_the_rest_sums_to_one() -> None:
    batch = batch_of(64)
    with torch.no_grad():
        chance = network()(batch).slot_logit.exp()
    assert (chance[~batch.focus_mask] == 0).all()
    np.testing.assert_allclose(chance.sum(-1), 1.0, atol=1e-5)
    alone = batch.focus_mask.sum(-1) == 1
    assert alone.any()
    assert (chance[alone, 0] == 1).all()


def test_padding_and_the_order_of_nodes_do_not_matter() -> None:
    batch = batch_of(32)
    model = network()
    order = torch.tensor([0, 3, 1, 4, 2])
    shuffled = GraphBatch(**{name: value[:, order] for name, value in vars(batch).items()})
    wider = GraphBatch(
        **{
            name: torch.cat((value, torch.zeros_like(value[:, :2])), 1)
            for name, value in vars(batch).items()
        }
    )
    with torch.no_grad():
        plain, mixed, padded = model(batch), model(shuffled), model(wider)
    torch.testing.assert_close(mixed.slot_logit, plain.slot_logit[:, order])
    torch.testing.assert_close(mixed.goal_m(), plain.goal_m()[:, order])
    torch.testing.assert_close(padded.slot_logit[:, :5], plain.slot_logit)
    torch.testing.assert_close(padded.goal_m()[:, :5], plain.goal_m())


def test_the_loss_by_hand() -> None:
    """One ego, one component: the density of a normal distribution and -log p of the slot."""
    batch = batch_of(1, 2, seed=3)
    batch.node_mask[:] = batch.focus_mask[:] = True
    with torch.no_grad():
        model = SemanticGraphNetwork(SgnSettings(width=8, components=1)).eval()
        intention = model(batch)
        goal = torch.tensor([[5.0, 7.0]])
        known = torch.tensor([[True, False]])
        regression, classes = sgn_loss(intention, batch, goal, known, torch.tensor([1]), 2.0)
    mean = float(intention.goal_mean_m[0, 0, 0])
    std = float(intention.goal_std_m[0, 0, 0])
    density = -0.5 * ((5.0 - mean) / std) ** 2 - np.log(std)
    assert float(regression) == pytest.approx(abs(5.0 - mean) * 0.4 - density, rel=1e-4)
    assert float(classes) == pytest.approx(-2.0 * float(intention.slot_logit[0, 1]), rel=1e-5)


def test_no_gradient_is_lost_or_infinite_where_nodes_are_masked() -> None:
    batch = batch_of(16)
    model = network().train()
    intention = model(batch)
    slot = torch.zeros(16, dtype=torch.int64)
    losses = sgn_loss(intention, batch, torch.ones(16, 5), batch.node_mask, slot, 1.0)
    sum(losses).backward()  # type: ignore[union-attr]
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name


def test_the_decoder_starts_from_the_present_motion_and_obeys_tyres() -> None:
    torch.manual_seed(0)
    model = EncoderDecoderNetwork(EdnSettings(width=8)).eval()
    speed = torch.tensor([0.0, 3.0, 12.0])
    history = torch.zeros((3, 11, 6))
    history[:, :, 2] = speed[:, None]
    history[:, :, 0] = speed[:, None] * torch.arange(-10, 1) * 0.1
    with torch.no_grad():
        future = model(history, torch.tensor([1.0, 30.0, 0.0]))
    path = torch.cat((torch.zeros(3, 1), future[..., 0]), 1)
    step = torch.diff(path, dim=1)
    assert (step >= 0).all(), "nobody drives backwards"
    before = torch.cat((speed[:, None] * 0.1, step[:, :-1]), 1)
    assert (torch.diff(torch.cat((speed[:, None] * 0.1, step), 1)).abs() <= 0.0801).all()
    assert (step[:, 0] - before[:, 0]).abs().max() <= 0.0801


@pytest.mark.parametrize("vehicles", [1, 7, 40])
def test_the_frozen_decoder_is_the_decoder(vehicles: int) -> None:
    torch.manual_seed(0)
    model = EncoderDecoderNetwork(EdnSettings(width=16)).eval()
    history, goal = torch.randn(vehicles, 11, 6), torch.rand(vehicles) * 20
    with torch.inference_mode():
        assert torch.equal(frozen(model)(history, goal), model(history, goal))


def test_the_path_loss_is_the_mean_distance() -> None:
    predicted = torch.zeros(1, 2, 2)
    future = torch.tensor([[[3.0, 4.0], [100.0, 0.0]]])
    mask = torch.tensor([[1.0, 0.0]])
    assert float(edn_loss(predicted, future, mask)) == pytest.approx(5.0, rel=1e-5)


def test_weights_come_back_bit_for_bit(tmp_path: Path) -> None:
    sgn, edn = network(), EncoderDecoderNetwork(EdnSettings(width=8)).eval()
    path = tmp_path / "w.safetensors"
    save_weights(path, sgn, edn, {"samples": 3})
    found = load_weights(path)
    assert found.card["samples"] == 3
    for name, value in sgn.state_dict().items():
        assert torch.equal(found.sgn.state_dict()[name], value)
    batch = batch_of()
    with torch.no_grad():
        assert torch.equal(found.sgn(batch).slot_logit, sgn(batch).slot_logit)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda p: p.write_bytes(p.read_bytes()[:200]), "cannot be read"),
        (lambda p: p.unlink(), "no file w.safetensors"),
        (lambda p: p.with_suffix(".json").unlink(), "no file w.json"),
        (lambda p: p.with_suffix(".json").write_text("{"), "not a card"),
        (
            lambda p: p.with_suffix(".json").write_text(
                p.with_suffix(".json").read_text().replace('"format": 1', '"format": 99')
            ),
            "format 99",
        ),
        (
            lambda p: p.with_suffix(".json").write_text(
                p.with_suffix(".json").read_text().replace('"width": 16', '"width": 24')
            ),
            "cannot be read as the networks of its card",
        ),
    ],
)
def test_damaged_weights_say_what_is_wrong(tmp_path: Path, damage: object, words: str) -> None:
    path = tmp_path / "w.safetensors"
    save_weights(path, network(), EncoderDecoderNetwork(EdnSettings(width=8)), {})
    damage(path)  # type: ignore[operator]
    with pytest.raises(InputError, match=words):
        load_weights(path)
