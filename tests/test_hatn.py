"""The encoder-decoder network, and weight files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
import torch
from test_sgn import batch_of, network

from hatn_sim.errors import InputError
from hatn_sim.graph import CONTEXT, CONTEXT_SIZE
from hatn_sim.hatn import edn as edn_module
from hatn_sim.hatn import sgn as sgn_module
from hatn_sim.hatn import weights_io
from hatn_sim.hatn.edn import EdnSettings, EncoderDecoderNetwork, edn_loss, frozen
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.hatn.weights_io import card_of, load_weights, save_weights
from hatn_sim.resources import weights_dir


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
                p.with_suffix(".json").read_text().replace('"format": 2', '"format": 99')
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
        ("sgn", "heads", 0),
        ("sgn", "temporal", 1),
        ("sgn", "slots", "sigmoid"),
        ("sgn", "slots", True),
        ("edn", "dropout", "0.1"),
        ("edn", "width", None),
    ],
)
def test_settings_out_of_range_are_refused(
    tmp_path: Path, network_name: str, key: str, value: object
) -> None:
    said = refusal(untrained(tmp_path), lambda card: card[network_name].update({key: value}))
    assert f"w.json: {network_name}.{key}: expected " in said
    assert f"found {value!r}" in said


@pytest.mark.parametrize(
    "change",
    [
        lambda card: card["sgn"].pop("history_stride"),
        lambda card: card["sgn"].update(headz=4),
        lambda card: card.update(sgn=3),
        lambda card: card.pop("sgn"),
    ],
)
def test_settings_are_all_there_and_no_others(
    tmp_path: Path, change: Callable[[dict[str, Any]], object]
) -> None:
    said = refusal(untrained(tmp_path), change)
    assert "sgn: expected the settings width, components, temporal, attend_absolute, gra" in said


def test_the_card_names_what_the_networks_read(tmp_path: Path) -> None:
    card = json.loads(untrained(tmp_path).with_suffix(".json").read_text())
    assert card["format"] == 2
    assert tuple(card["features"]["context"]) == CONTEXT
    assert len(card["features"]["context_scale"]) == CONTEXT_SIZE
    assert card["features"]["feature_scale"] == [30.0, 10.0, 1.0, 30.0, 10.0, 1.0, 30.0]
    assert card["features"]["history_scale"] == [10.0, 1.0, 10.0, 1.0, 0.5, 1.0]


@pytest.mark.parametrize(
    ("module", "name", "value", "said"),
    [
        (weights_io, "CONTEXT", (CONTEXT[1], CONTEXT[0], *CONTEXT[2:]), "context differ"),
        (sgn_module, "FEATURE_SCALE", (1.0,) * 7, "feature_scale differ"),
        (sgn_module, "CONTEXT_SCALE", (1.0,) * CONTEXT_SIZE, "context_scale differ"),
        (edn_module, "HISTORY_SCALE", (1.0,) * 6, "history_scale differ"),
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
    assert (card["format"], card["seeds"], card["command"]) == (2, [1], "x")
    assert card["sgn"] == asdict(SgnSettings(width=16))
    assert card["edn"] == {"width": 8, "dropout": 0.0}
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
    assert weights.sgn.settings == SgnSettings()
    assert weights.edn.settings == EdnSettings()
    assert not set(weights.card["seeds"]) & set(weights.card["tune_seeds"])
    assert weights.card["command"].startswith("hatn-sim train ")
