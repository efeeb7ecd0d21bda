"""Samples against the simulation they were cut from, and a small training from end to end."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hatn_sim import cli
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Frame
from hatn_sim.errors import InputError
from hatn_sim.hatn.weights_io import load_weights
from hatn_sim.learn.augment import free_travel_m, scale_graphs
from hatn_sim.learn.batches import graph_batch
from hatn_sim.learn.dataset import Samples, concatenate, samples_of_run
from hatn_sim.learn.train import TrainingPlan, train
from hatn_sim.loop import warm_up
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator


@pytest.fixture(scope="module")
def traffic() -> tuple[Road, list[Frame]]:
    with SumoSimulator(load_scenario("intersection4_allway")) as simulator:
        frame = warm_up(simulator, simulator.reset(11), 300)
        frames = [frame, *(simulator.step() for _ in range(150))]
        return simulator.road, frames


@pytest.fixture(scope="module")
def cut(traffic: tuple[Road, list[Frame]]) -> Samples:
    return samples_of_run(*traffic, use_routes=True)


def test_there_is_a_row_for_every_vehicle_with_eleven_frames_behind_it(
    traffic: tuple[Road, list[Frame]], cut: Samples
) -> None:
    _, frames = traffic
    expected = 0
    for index in range(10, len(frames), 5):
        whole = set.intersection(*(set(f.scene.ids) for f in frames[index - 10 : index + 1]))
        expected += len(whole)
    assert len(cut) == expected


def test_goals_and_futures_are_what_the_simulator_then_did(
    traffic: tuple[Road, list[Frame]], cut: Samples
) -> None:
    """On one's own line the distance travelled is the advance along it, up to the corners cut."""
    known = cut.goal_mask[:, 0] & cut.future_mask.all(axis=1)
    assert known.mean() > 0.5
    advance = cut.future[known, -1, 0]
    np.testing.assert_allclose(cut.goal_m[known, 0], advance, atol=0.6)
    # SUMO drives v dt a step: the last increment is the speed 0.1 s before the end.
    speed = cut.history[known, -1, 2]
    first_step = cut.future[known, 0, 0]
    np.testing.assert_allclose(first_step, speed * 0.1, atol=0.12)
    assert np.abs(cut.future[known, :, 1]).max() < 1.5


def test_slots_are_labelled_for_egos_with_a_choice_only(cut: Samples) -> None:
    labelled = cut.slot >= 0
    assert labelled.any()
    rows = np.flatnonzero(labelled)
    assert cut.focus_mask[rows, cut.slot[rows]].all()
    assert (cut.focus_mask[rows].sum(axis=1) > 1).all()


def test_a_training_writes_weights_and_a_card_and_repeats_itself(tmp_path: Path) -> None:
    plan = TrainingPlan(
        scenes=("intersection4_allway",),
        seeds=(1,),
        tune_seeds=(2,),
        duration_s=20.0,
        sgn_epochs=1,
        edn_epochs=1,
        workers=1,
    )
    said: list[str] = []
    cards = []
    for name in ("a", "b"):
        out = tmp_path / f"{name}.safetensors"
        cards.append(train(plan, out, "hatn-sim train ...", said.append))
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    assert (
        cards[0]
        == cards[1]
        == {
            key: value
            for key, value in json.loads((tmp_path / "a.json").read_text()).items()
            if key in cards[0]
        }
    )
    assert cards[0]["seeds"] == [1]
    assert cards[0]["samples"] > 100
    assert any(line.startswith("EDN epoch 1 of 1") for line in said)
    weights = load_weights(tmp_path / "a.safetensors")
    assert all(torch.isfinite(value).all() for value in weights.sgn.state_dict().values())


def test_seeds_that_overlap_are_refused(tmp_path: Path) -> None:
    plan = TrainingPlan(("intersection5",), (1, 2), (2, 3), 10.0)
    with pytest.raises(InputError, match=r"--seeds and --tune share \[2\]"):
        train(plan, tmp_path / "w.safetensors", "", print)


SHORT = ("train", "--scenes", "intersection4_allway", "--seeds", "1", "--tune", "2", "--quiet")


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs `hatn-sim train`, which has to fail with exit code 2, and gives the one line it says."""

    def run(*words: object) -> str:
        assert cli.main([*SHORT, *map(str, words)]) == 2
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1
        return lines[0]

    return run


@pytest.fixture
def no_traffic(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is found before simulating must not need a simulation."""

    def simulate(*_: object) -> Samples:
        raise AssertionError("simulated")

    monkeypatch.setattr("hatn_sim.learn.train.collect", simulate)


@pytest.mark.usefixtures("no_traffic")
def test_a_place_that_cannot_be_written_is_found_before_simulating(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    (tmp_path / "file").touch()
    out = tmp_path / "file" / "x.safetensors"
    assert refused("--out", out).startswith(f"hatn-sim: weights {out}: cannot be written there: ")


@pytest.mark.usefixtures("no_traffic")
@pytest.mark.parametrize("taken", ["x.safetensors", "x.json"])
def test_nothing_is_overwritten(tmp_path: Path, refused: Callable[..., str], taken: str) -> None:
    (tmp_path / taken).touch()
    assert f"{taken} exists already" in refused("--out", tmp_path / "x.safetensors")


@pytest.mark.usefixtures("no_traffic")
@pytest.mark.parametrize("seed", [-1, 2**64])
def test_seeds_of_no_generator_are_refused(
    tmp_path: Path, refused: Callable[..., str], seed: int
) -> None:
    said = refused("--out", tmp_path / "x.safetensors", "--torch-seed", seed)
    assert said.startswith(f"hatn-sim: --torch-seed {seed}: expected 0 or more")


@pytest.mark.usefixtures("no_traffic")
def test_nothing_to_learn_from_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    assert "at least one of each" in refused("--out", tmp_path / "x.safetensors", "--risks", ",")


def test_traffic_too_short_for_a_sample_is_an_error(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    """Half a second is six frames; a history has eleven."""
    said = refused("--out", tmp_path / "x.safetensors", "--duration", "0.5", "--workers", "1")
    assert said == (
        "hatn-sim: --seeds: too little to learn from in 0.5 s a seed: 0 samples, 0 with a known "
        "goal, 0 with a whole path, 0 with a choice of slots; raise --duration"
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("missing", ["goal", "path", "slot"])
def test_samples_that_know_nothing_are_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: Samples, missing: str
) -> None:
    """Enough in --seeds, and then every label of one kind gone from --tune."""
    without = {
        "goal": replace(cut, goal_mask=np.zeros_like(cut.goal_mask)),
        "path": replace(cut, future_mask=np.zeros_like(cut.future_mask)),
        "slot": replace(cut, slot=np.full_like(cut.slot, -1)),
    }
    found = iter([cut, without[missing]])
    monkeypatch.setattr("hatn_sim.learn.train.collect", lambda *_: next(found))
    plan = TrainingPlan(("intersection4_allway",), (1,), (2,), 15.0)
    words = {"goal": "0 with a known", "path": "0 with a whole", "slot": "0 with a choice"}
    with pytest.raises(InputError, match=rf"--tune: .* {len(cut)} samples, .*{words[missing]}"):
        train(plan, tmp_path / "x.safetensors", "", print)


def test_a_run_without_a_vehicle_adds_no_sample(
    traffic: tuple[Road, list[Frame]], cut: Samples
) -> None:
    with SumoSimulator(load_scenario("intersection4_allway")) as simulator:
        frame = simulator.reset(11)
    assert len(frame.scene.ids) == 0
    none = samples_of_run(traffic[0], [frame])
    assert len(none) == 0
    both = concatenate([none, cut])
    np.testing.assert_array_equal(both.x, cut.x)
    assert both.x.dtype == cut.x.dtype and both.future.dtype == cut.future.dtype


def test_the_coarse_free_travel_is_that_of_the_graphs(cut: Samples) -> None:
    """Two implementations: from the whole line in NumPy, from its samples in torch."""
    rows = np.flatnonzero(cut.goal_mask[:, 0])[:400]
    batch = graph_batch(cut, rows)
    free = free_travel_m(batch.context[:, 0, :11], batch.context[:, 0, 11:22], batch.x[:, 0, -1, 4])
    difference = (free - batch.context[:, 0, 22]).abs()
    # Samples are 4 to 10 m apart: a bend's beginning is known to within that.
    assert float(difference.median()) < 0.5
    assert float(difference.quantile(0.9)) < 4.0


def test_scaling_keeps_times_and_scales_lengths(cut: Samples) -> None:
    rows = np.flatnonzero(cut.goal_mask[:, 0])[:50]
    batch = graph_batch(cut, rows)
    double = torch.full((len(rows),), 2.0)
    large = scale_graphs(batch, double)
    moving = batch.x[:, 0, -1, 4] > 1.0
    time_s = batch.x[moving, 0, -1, 3] / batch.x[moving, 0, -1, 4]
    torch.testing.assert_close(large.x[moving, 0, -1, 3] / large.x[moving, 0, -1, 4], time_s)
    torch.testing.assert_close(large.x[..., 2], batch.x[..., 2])
    torch.testing.assert_close(large.x[..., 6], large.x[..., 3] - large.x[..., 0])
    lateral = large.x[:, 0, -1, 4] ** 2 * large.context[:, 0, 11]
    torch.testing.assert_close(lateral, 2.0 * batch.x[:, 0, -1, 4] ** 2 * batch.context[:, 0, 11])
