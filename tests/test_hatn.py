"""The networks: composition of the race by enumeration, gradients, masks, dynamics."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hatn_sim.errors import InputError
from hatn_sim.graph import CONTEXT, CONTEXT_SIZE
from hatn_sim.hatn import edn as edn_module
from hatn_sim.hatn import sgn as sgn_module
from hatn_sim.hatn import weights_io
from hatn_sim.hatn.edn import EdnSettings, EncoderDecoderNetwork
from hatn_sim.hatn.inputs import HISTORY
from hatn_sim.hatn.sgn import (
    GraphBatch,
    SemanticGraphNetwork,
    SgnSettings,
    race_log_probability,
    sgn_loss,
)
from hatn_sim.hatn.weights_io import card_of, load_weights, save_weights
from hatn_sim.resources import weights_dir


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
    log_p = intention.slot_logit[0].numpy()
    assert float(classes) == pytest.approx(-2.0 * (0.95 * log_p[1] + 0.05 * log_p.mean()), rel=1e-5)


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
                p.with_suffix(".json").read_text().replace('"format": 3', '"format": 99')
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
def test_damaged_weights_say_what_is_wrong(
    tmp_path: Path, damage: Callable[[Path], object], words: str
) -> None:
    path = untrained(tmp_path)
    damage(path)
    with pytest.raises(InputError, match=words):
        load_weights(path)


def untrained(folder: Path) -> Path:
    path = folder / "w.safetensors"
    save_weights(path, network(), EncoderDecoderNetwork(EdnSettings(width=8)), {})
    return path


def refusal(path: Path, change: Callable[[dict[str, Any]], object]) -> str:
    """What loading says after the card has been changed."""
    card_path = path.with_suffix(".json")
    card = json.loads(card_path.read_text())
    change(card)
    card_path.write_text(json.dumps(card))
    with pytest.raises(InputError) as caught:
        load_weights(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("network_name", "key", "value"),
    [
        ("sgn", "width", 0),
        ("sgn", "width", 16.0),
        ("sgn", "width", True),
        ("sgn", "width", 10**12),
        ("sgn", "components", -1),
        ("sgn", "history_stride", 0),
        ("sgn", "history_stride", 12),
        ("sgn", "class_weight", float("nan")),
        ("sgn", "dropout", 5),
        ("edn", "dropout", "0.1"),
        ("edn", "width", None),
    ],
)
def test_settings_out_of_range_are_refused(
    tmp_path: Path, network_name: str, key: str, value: object
) -> None:
    said = refusal(untrained(tmp_path), lambda card: card[network_name].update({key: value}))
    assert f"w.json: {network_name}.{key}: expected a" in said
    assert f"found {value!r}" in said


@pytest.mark.parametrize(
    "change",
    [
        lambda card: card["sgn"].pop("history_stride"),
        lambda card: card["sgn"].update(heads=4),
        lambda card: card.update(sgn=3),
        lambda card: card.pop("sgn"),
    ],
)
def test_settings_are_all_there_and_no_others(
    tmp_path: Path, change: Callable[[dict[str, Any]], object]
) -> None:
    said = refusal(untrained(tmp_path), change)
    assert "sgn: expected the settings width, components, class_weight, dropout, race" in said


def test_the_card_names_what_the_networks_read(tmp_path: Path) -> None:
    card = json.loads(untrained(tmp_path).with_suffix(".json").read_text())
    assert card["format"] == 3
    assert tuple(card["features"]["context"]) == CONTEXT
    assert len(card["features"]["context_scale"]) == CONTEXT_SIZE
    assert card["features"]["feature_scale"] == [30.0, 10.0, 1.0, 30.0, 10.0, 1.0, 30.0]
    assert tuple(card["features"]["history"]) == HISTORY


@pytest.mark.parametrize(
    ("module", "name", "value", "said"),
    [
        (weights_io, "CONTEXT", (CONTEXT[1], CONTEXT[0], *CONTEXT[2:]), "context differ"),
        (sgn_module, "FEATURE_SCALE", (1.0,) * 7, "feature_scale differ"),
        (sgn_module, "CONTEXT_SCALE", (1.0,) * CONTEXT_SIZE, "context_scale differ"),
        (weights_io, "HISTORY", HISTORY[::-1], "history differ"),
        (edn_module, "MAX_SLOPE", 1.0, "kinematic_limits differ"),
        (edn_module, "GOAL_SCALE_M", 5.0, "goal_scale_m differ"),
    ],
)
def test_weights_for_other_features_are_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    module: object,
    name: str,
    value: object,
    said: str,
) -> None:
    """The same shapes with another meaning load without a word unless the card is compared."""
    path = untrained(tmp_path)
    load_weights(path)
    monkeypatch.setattr(module, name, value)
    with pytest.raises(InputError, match=rf"made for other features .*\({said}\)"):
        load_weights(path)


def test_a_card_without_features_is_refused(tmp_path: Path) -> None:
    said = refusal(untrained(tmp_path), lambda card: card.pop("features"))
    assert "made for other features" in said


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_tensors_that_are_not_finite_are_refused(tmp_path: Path, value: float) -> None:
    sgn = network()
    with torch.no_grad():
        sgn.combine.weight[0, 0] = value
    path = tmp_path / "w.safetensors"
    save_weights(path, sgn, EncoderDecoderNetwork(EdnSettings(width=8)), {})
    with pytest.raises(InputError, match=r"sgn\.combine\.weight is not finite"):
        load_weights(path)


def test_a_card_is_rebuilt_from_an_old_one() -> None:
    old = {
        "format": 1,
        "sgn": {"width": 999},
        "edn": {},
        "features": 0,
        "seeds": [1],
        "command": "x",
    }
    card = card_of(network(), EncoderDecoderNetwork(EdnSettings(width=8)), old)
    assert (card["format"], card["seeds"], card["command"]) == (3, [1], "x")
    assert card["sgn"] == asdict(SgnSettings(width=16))
    assert card["edn"] == asdict(EdnSettings(width=8))
    assert json.loads(json.dumps(card)) == card


def test_a_save_leaves_two_files_that_others_may_read(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        path = untrained(tmp_path / "new" / "folder")
    finally:
        os.umask(before)
    files = sorted(path.parent.iterdir())
    assert [file.name for file in files] == ["w.json", "w.safetensors"]
    assert [file.stat().st_mode & 0o777 for file in files] == [0o644, 0o644]


def test_a_save_that_fails_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = untrained(tmp_path)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}

    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[:10])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match="cannot be written: No space left on device"):
        save_weights(path, network(), EncoderDecoderNetwork(EdnSettings(width=8)), {"seeds": [1]})
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_the_weights_that_ship_are_for_this_version() -> None:
    weights = load_weights(weights_dir() / "hatn.safetensors")
    assert not set(weights.card["seeds"]) & set(weights.card["tune_seeds"])
    assert weights.card["command"].startswith("hatn-sim train ")
