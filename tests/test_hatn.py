"""The networks: composition of the race by enumeration, gradients, masks, dynamics."""

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
from hatn_sim.hatn import edn_kinematic, weights_io
from hatn_sim.hatn import sgn as sgn_module
from hatn_sim.hatn.edn import EncoderDecoderNetwork
from hatn_sim.hatn.edn_settings import EdnSettings
from hatn_sim.hatn.inputs import HISTORY
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.hatn.weights_io import card_of, load_weights, save_weights
from hatn_sim.learn.split_file import read_split
from hatn_sim.resources import scenes_to_test_on, weights_dir


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
                p.with_suffix(".json").read_text().replace('"format": 4', '"format": 99')
            ),
            "format 99",
        ),
        (
            lambda p: p.with_suffix(".json").write_text(
                p.with_suffix(".json").read_text().replace('"width": 16', '"width": 24')
            ),
            "cannot be read as the networks of its card",
        ),
        (lambda p: said(p, split=["seeds 1-12"]), "split: expected lists of traffic by part"),
        (lambda p: said(p, split={"train": {"seeds": [1]}}), "split: expected lists of traffic"),
        (lambda p: said(p, split={"tune": ["seed 1"]}), "split: expected lists of traffic"),
        (lambda p: said(p, split={"train": [{"seeds": 1}]}), "split: expected lists of traffic"),
        (lambda p: said(p, split={"train": [{"recordings": [7]}]}), "split: expected lists"),
        (lambda p: said(p, start="shipped"), "start: expected null or what .* found 'shipped'"),
        (lambda p: said(p, start={"split": 3}), "start.split: expected lists of traffic"),
    ],
)
def test_damaged_weights_say_what_is_wrong(
    tmp_path: Path, damage: Callable[[Path], object], words: str
) -> None:
    path = untrained(tmp_path)
    damage(path)
    with pytest.raises(InputError, match=words):
        load_weights(path)


def said(path: Path, **more: object) -> None:
    """Edit a card by hand."""
    card = path.with_suffix(".json")
    card.write_text(json.dumps({**json.loads(card.read_text()), **more}))


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
        lambda card: card["sgn"].update(hands=4),
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
    assert card["format"] == 4
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
        (edn_kinematic, "MAX_SLOPE", 1.0, "kinematic_limits differ"),
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
    assert (card["format"], card["seeds"], card["command"]) == (4, [1], "x")
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


@pytest.mark.parametrize("name", ["hatn", "hatn-paper"])
def test_the_weights_that_ship_are_for_this_version(name: str) -> None:
    """Their card names the split that ships beside them; but for two scenes all is `learn_...`."""
    weights = load_weights(weights_dir() / f"{name}.safetensors")
    assert weights.card["command"].startswith("hatn-sim train ")
    split = read_split(weights_dir() / f"{name}.split.toml")
    assert split.card() == weights.card["split"]
    scenes = {one["scene"] for part in weights.card["split"].values() for one in part}
    assert scenes & set(scenes_to_test_on()) <= {"intersection5", "highway_merge"}
    assert (weights_dir() / f"{name}.safetensors").stat().st_size < 2_000_000
