"""Weights that are judged on what they were trained on."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from hatn_sim import cli
from hatn_sim.evaluation.seen import was_seen
from hatn_sim.hatn.edn import EncoderDecoderNetwork
from hatn_sim.hatn.edn_settings import EdnSettings
from hatn_sim.hatn.sgn import SemanticGraphNetwork
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.hatn.weights_io import save_weights
from hatn_sim.learn.split import make_split, traffic_of_scenes, traffic_of_tracks
from hatn_sim.resources import scenarios_dir

SAMPLE = scenarios_dir() / "recorded_sample"


def test_a_card_tells_the_seeds_of_its_scenes() -> None:
    traffic = {
        "train": traffic_of_scenes(["tjunction", "roundabout8"], [1, 2]),
        "tune": traffic_of_scenes(["tjunction"], [3]),
        "test": traffic_of_scenes(["tjunction"], [4]),
    }
    card = {"split": make_split(traffic).card()}
    tjunction = traffic["tune"][0].scenario
    assert [was_seen(card, tjunction, seed) for seed in range(6)] == [
        False, True, True, True, False, False
    ]  # fmt: skip
    assert not was_seen(card, traffic["train"][-1].scenario, 3)
    assert not was_seen({}, tjunction, 1)
    begun = {"split": {"train": []}, "start": {**card, "start": None}}
    assert was_seen(begun, tjunction, 1) and not was_seen(begun, tjunction, 4)


def test_a_card_tells_the_recordings_of_its_sites(tmp_path: Path) -> None:
    shutil.copy(SAMPLE / "map.osm", tmp_path)
    text = (SAMPLE / "vehicle_tracks_000.csv").read_text()
    for name in ("000", "001", "002"):
        # Three recordings that differ: lines at the end are left out.
        lines = text.splitlines(keepends=True)[: 300 + int(name)]
        (tmp_path / f"vehicle_tracks_{name}.csv").write_text("".join(lines))
    train, tune, other = (
        traffic_of_tracks([f"{tmp_path}/*.csv"], tmp_path / "map.osm", name, "lanes")
        for name in ("000", "001", "002")
    )
    card = {"split": make_split({"train": train, "tune": tune}).card()}
    seen = [was_seen(card, one.scenario, None) for (one,) in (train, tune, other)]
    assert seen == [True, True, False]


@pytest.mark.parametrize(("seed", "said"), [("1", True), ("601", False)])
def test_the_command_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], seed: str, said: bool
) -> None:
    sgn, edn = (
        SemanticGraphNetwork(SgnSettings(width=8)),
        EncoderDecoderNetwork(EdnSettings(width=8)),
    )
    split = {"tune": [{"scene": "intersection5", "seeds": [1]}]}
    path = tmp_path / "w.safetensors"
    save_weights(path, sgn, edn, {"split": split})
    words = [
        "--weights",
        str(path),
        "--scenes",
        "intersection5",
        "--seeds",
        seed,
        "--duration",
        "2",
    ]
    out = [
        "--warm-up",
        "0",
        "--predictors",
        "hatn",
        "--workers",
        "1",
        "--out",
        str(tmp_path / "out"),
        "--json",
    ]
    assert cli.main(["evaluate", *words, *out]) == 0
    line = "hatn was trained or tuned on 1 of 1 runs (intersection5, seed 1): its errors there are"
    printed = capsys.readouterr()
    assert (line in printed.err) == said
    kept = json.loads((tmp_path / "out" / "scores.json").read_text())
    assert kept == json.loads(printed.out)
    assert all(("seen" in score) == said for score in kept)
    assert cli.main(["evaluate", *words, *out[:-1], "--quiet"]) == 0
    printed = capsys.readouterr()
    assert printed.err == "" and ("intersection5: hatn was trained" in printed.out) == said
