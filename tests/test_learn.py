"""Samples against the simulation they were cut from, and a small training from end to end."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from hatn_sim import cli
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Frame
from hatn_sim.errors import HatnSimError, InputError
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.hatn.weights_io import load_weights
from hatn_sim.learn.augment import free_travel_m, scale_graphs
from hatn_sim.learn.batches import graph_batch
from hatn_sim.learn.cache import SampleCache
from hatn_sim.learn.dataset import Samples, concatenate, samples_of_run
from hatn_sim.learn.fit import FitSettings
from hatn_sim.learn.settings import FORMS, TrainingSettings
from hatn_sim.learn.split import Split, make_split, traffic_of_scenes
from hatn_sim.learn.train import TrainingPlan, train
from hatn_sim.learn.watch import Nobody
from hatn_sim.loop import warm_up
from hatn_sim.resources import scenarios_dir
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


@pytest.fixture(scope="module")
def split() -> Split:
    """Of names alone: `few_samples` stands in for its traffic."""
    parts = {
        "train": traffic_of_scenes(["intersection4_allway"], [1]),
        "tune": traffic_of_scenes(["intersection4_allway"], [2]),
    }
    return make_split(parts)


@pytest.fixture
def few_samples(monkeypatch: pytest.MonkeyPatch, cut: Samples) -> None:
    monkeypatch.setattr("hatn_sim.learn.train.gather", lambda *_: cut)


QUICK = FitSettings(epochs=2, batch=16)
SMALL = TrainingSettings(
    SgnSettings(width=8), replace(FORMS["hatn"].edn, width=8), sgn_fit=QUICK, edn_fit=QUICK
)


class Stopping(Nobody):
    """Interrupts a training at a step of a network."""

    def __init__(self, name: str, step: int) -> None:
        self._name, self._step = name, step

    def step(self, stage: str, done: int, total: int, words: str) -> None:
        if (stage, done) == (self._name, self._step):
            raise KeyboardInterrupt


def make_plan(split: Split, form: str = "hatn", **more: Any) -> TrainingPlan:
    return TrainingPlan(split, {form: SMALL}, command="hatn-sim train ...", **more)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, split: Split, cut: Samples) -> Path:
    """The weights of `make_plan(split)`, trained without a stop, alone in a folder."""
    out = tmp_path_factory.mktemp("trained") / "a.safetensors"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hatn_sim.learn.train.gather", lambda *_: cut)
        train(make_plan(split), out)
    return out


@pytest.mark.usefixtures("few_samples")
def test_a_training_writes_weights_and_a_card_and_repeats_itself(
    tmp_path: Path, split: Split, cut: Samples, trained: Path
) -> None:
    card = train(make_plan(split), tmp_path / "a.safetensors")["hatn"]
    for again in tmp_path.iterdir():
        assert again.read_bytes() == trained.with_name(again.name).read_bytes()
    written = json.loads((tmp_path / "a.json").read_text())
    assert card == {key: written[key] for key in card}
    assert card["split"]["tune"][0]["seeds"] == [2]
    assert card["samples"] == len(cut)
    assert set(card["tune_figures"]) >= {"goal_error_m", "ade_3s_m"}
    weights = load_weights(tmp_path / "a.safetensors")
    assert all(torch.isfinite(value).all() for value in weights.sgn.state_dict().values())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "a.safetensors"]


@pytest.mark.usefixtures("few_samples")
def test_a_training_begins_with_the_weights_it_is_given(
    tmp_path: Path, split: Split, trained: Path
) -> None:
    """At a rate of next to nothing it ends with them, too; and the card names them."""
    start = load_weights(trained)
    still = FitSettings(epochs=1, batch=16, learning_rate=1e-9, weight_decay=0.0)
    settings = replace(SMALL, sgn_fit=still, edn_fit=still)
    plan = replace(make_plan(split), forms={"hatn": settings}, start=start)
    cards = train(plan, tmp_path / "second.safetensors")
    assert cards["hatn"]["start"]["sha256"] == start.sha256
    assert cards["hatn"]["start"]["split"] == cards["hatn"]["split"] == start.card["split"]
    after = load_weights(tmp_path / "second.safetensors")
    for network in ("sgn", "edn"):
        found = getattr(after, network).state_dict()
        for name, value in getattr(start, network).state_dict().items():
            torch.testing.assert_close(found[name], value, atol=1e-4, rtol=1e-3)
    train(replace(plan, start=None), tmp_path / "third.safetensors")
    other = load_weights(tmp_path / "third.safetensors")
    moved = (other.edn.dense2.weight - start.edn.dense2.weight).abs().max()
    assert float(moved.detach()) > 0.01, "begun with chance, it is another network"


@pytest.mark.usefixtures("few_samples")
@pytest.mark.parametrize(
    "stopped",
    [
        ("SGN", 3),
        pytest.param(("SGN", 15), marks=pytest.mark.slow),
        pytest.param(("EDN", 1), marks=pytest.mark.slow),
        ("EDN", 15),
    ],
)
def test_a_training_that_was_stopped_goes_on_to_the_same_weights(
    tmp_path: Path, split: Split, cut: Samples, trained: Path, stopped: tuple[str, int]
) -> None:
    assert 10 <= -(-len(cut) // QUICK.batch) < 15
    out = tmp_path / "w.safetensors"
    with pytest.raises(KeyboardInterrupt):
        train(make_plan(split), out, Stopping(*stopped))
    assert not out.exists()
    with pytest.raises(InputError, match=r"w\.progress: is of a training with other torch_seed; "):
        train(make_plan(split, seed=5), out)
    train(make_plan(split), out)
    assert out.read_bytes() == trained.read_bytes()
    assert not (tmp_path / "w.progress").exists()


@pytest.mark.usefixtures("few_samples")
def test_both_forms_and_the_one_that_is_there_already_is_kept(tmp_path: Path, split: Split) -> None:
    paper = replace(SMALL, edn=replace(FORMS["paper"].edn, width=8))
    plan = replace(make_plan(split), forms={"hatn": SMALL, "paper": paper})
    out = tmp_path / "w.safetensors"
    with pytest.raises(KeyboardInterrupt):
        train(plan, out, Stopping("paper SGN", 1))
    first = out.stat().st_mtime_ns
    cards = train(plan, out)
    assert out.stat().st_mtime_ns == first
    assert [card["form"] for card in cards.values()] == ["hatn", "paper"]
    assert load_weights(tmp_path / "w-paper.safetensors").edn.settings.decoder == "plain"


@pytest.mark.usefixtures("few_samples")
def test_a_form_is_trained_alike_alone_and_beside_another(tmp_path: Path, split: Split) -> None:
    forms = {"hatn": SMALL, "paper": SMALL}
    cache = SampleCache(tmp_path / "kept")
    train(TrainingPlan(split, forms, seed=3, cache=cache), tmp_path / "both.safetensors")
    for form, ending in (("hatn", ""), ("paper", "-paper")):
        name = f"alone{ending}.safetensors"
        plan = TrainingPlan(split, {form: SMALL}, seed=3, cache=cache)
        train(plan, tmp_path / "alone.safetensors")
        together = tmp_path / f"both{ending}.safetensors"
        assert (tmp_path / name).read_bytes() == together.read_bytes()


@pytest.mark.usefixtures("few_samples")
@pytest.mark.parametrize("network", ["sgn", "edn"])
def test_the_last_good_weights_are_written_where_a_loss_is_lost(
    tmp_path: Path, split: Split, cut: Samples, monkeypatch: pytest.MonkeyPatch, network: str
) -> None:
    """The goals, or the futures, of the samples turn to nonsense in the second epoch."""
    calls = 0
    steps = -(-len(cut) // QUICK.batch)
    module = "sgn_training.random_scale" if network == "sgn" else "edn_training.random_scale"

    def spoiled(count: int) -> torch.Tensor:
        nonlocal calls
        calls += 1
        return torch.full((count,), float("nan") if calls == steps + 2 else 1.0)

    monkeypatch.setattr(f"hatn_sim.learn.{module}", spoiled)
    out = tmp_path / "w.safetensors"
    with pytest.raises(HatnSimError) as lost:
        train(make_plan(split), out)
    kept = out if network == "edn" else tmp_path / "w.progress" / "w-sgn.safetensors"
    assert str(lost.value) == (
        f"training {network.upper()}: the loss became nan at step {steps + 2}, in epoch 2: train "
        f"with a smaller learning_rate; the weights of epoch 1 are kept, in {kept}"
    )
    assert all(torch.isfinite(value).all() for value in load_file(kept).values())
    if network == "edn":
        assert load_weights(out).card["stopped"].startswith("training EDN: the loss became nan")
        calls = steps  # the second epoch alone is trained again, and lost again
        with pytest.raises(HatnSimError, match=r"^training EDN: the loss became nan at step"):
            train(make_plan(split), out)


def run_train(*words: object) -> int:
    return cli.main(["train", "--quiet", "--cache", "none", *map(str, words)])


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs `hatn-sim train`, which has to fail with exit code 2, and gives the one line it says."""

    def run(*words: object) -> str:
        assert run_train(*words) == 2
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1
        return lines[0].removeprefix("hatn-sim: ")

    return run


SHORT = ("--scenes", "intersection4_allway", "--seeds", "1", "--tune", "2")


@pytest.fixture
def no_traffic(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is found before simulating must not need a simulation."""

    def simulate(*_: object) -> Samples:
        raise AssertionError("simulated")

    monkeypatch.setattr("hatn_sim.learn.train.gather", simulate)


@pytest.mark.usefixtures("no_traffic")
def test_a_place_that_cannot_be_written_is_found_before_simulating(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    (tmp_path / "file").touch()
    out = tmp_path / "file" / "x.safetensors"
    assert refused(*SHORT, "--out", out).startswith(f"weights {out}: cannot be written there: ")
    sweep = tmp_path / "sweep.toml"
    sweep.write_text("[sgn]\nwidth = [8]\n")
    said = refused(*SHORT, "--sweep", sweep, "--out", out)
    assert "x.sweep.jsonl: cannot be written there: " in said


@pytest.mark.usefixtures("no_traffic")
@pytest.mark.parametrize("text", ["{", "[]", "{}"])
def test_a_damaged_plan_is_one_line(tmp_path: Path, refused: Callable[..., str], text: str) -> None:
    (tmp_path / "x.progress").mkdir()
    (tmp_path / "x.progress" / "plan.json").write_text(text)
    said = refused(*SHORT, "--out", tmp_path / "x.safetensors")
    assert said.startswith(f"{tmp_path / 'x.progress'}: is of a training with other traffic, ")


@pytest.mark.usefixtures("no_traffic")
@pytest.mark.parametrize("taken", ["x.safetensors", "x.json", "x-paper.safetensors"])
def test_nothing_is_overwritten(tmp_path: Path, refused: Callable[..., str], taken: str) -> None:
    (tmp_path / taken).touch()
    out = tmp_path / "x.safetensors"
    assert f"{taken} exists already" in refused(*SHORT, "--form", "both", "--out", out)


MORE = ("--tracks", "{tmp}/vehicle_tracks_*.csv", "--map", "{sample}/map.osm")
MISSING = "--tracks: expected recordings to learn from and others to tune on; "
TRACKS = ("--tracks", "{sample}/vehicle_tracks_000.csv", "--map", "{sample}/map.osm")


@pytest.mark.usefixtures("no_traffic")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--torch-seed", "-1"), "--torch-seed -1: expected 0 or more"),
        (("--torch-seed", str(2**64)), f"--torch-seed {2**64}: expected 0 or more"),
        (("--risks", ","), "--scenes, --risks, --seeds and --tune: expected at least one of each"),
        (("--seeds", "1-3", "--tune", "3"), "--seeds and --tune share seed 3 of intersection5: "),
        (("--seeds", "x"), "--seeds: expected seeds like 7, 1-12 or 1-4,9, found 'x'"),
        (("--seeds", ""), "--seeds: expected seeds like 7, 1-12 or 1-4,9, found ''"),
        (("--seeds", "5-1"), "--seeds: expected seeds in rising order, found '5-1'"),
        (("--tune", f"1-{10**12}"), "--tune: expected at most 100,000 seeds, found '1-1000"),
        (("--lines-from", "tracks"), "--lines-from tracks goes with --tracks; leave it out"),
        (("--split", "no.toml", "--lines-from", "lanes"), "--lines-from lanes goes with --tracks"),
        (("--recordings", "000"), "--recordings goes with --tracks; leave it out"),
        ((*TRACKS, "--seeds", "1"), "--seeds is for scenes; leave it out with --tracks"),
        (
            TRACKS,
            "--tracks: expected recordings to learn from and others to tune on, found 1; name",
        ),
        ((*MORE, "--recordings", "000-002"), MISSING + "add --tune 003-004"),
        ((*MORE, "--tune", "000"), MISSING + "add --recordings 001-010"),
        ((*MORE, "--recordings", "000-010"), MISSING + "say --recordings 000-008 --tune 009-010"),
        (
            (*TRACKS, "--recordings", "0", "--tune", "000"),
            "--recordings and --tune share {sample}/vehicle_tracks_000.csv: what is learnt from",
        ),
        (("--split", "no.toml"), "no.toml: cannot be read: No such file or directory"),
        (("--split", "no.toml", "--tune", "1"), "--tune: --split names all traffic; leave one of"),
        (("--settings", "{tmp}/a.toml"), "{tmp}/a.toml: unknown setting 'sgn.widht'; did you mean"),
        (("--settings", "{tmp}/b.toml"), "{tmp}/b.toml: edn.width: expected a whole number from"),
        (("--settings", "{tmp}/c.toml"), "{tmp}/c.toml: unknown table 'fit'; did you mean '"),
        (("--sweep", "{tmp}/d.toml", "--torch-seed", "-1"), "--torch-seed -1: expected 0 or more"),
        (("--sweep", "{tmp}/a.toml"), "{tmp}/a.toml: unknown setting 'sgn.widht'; did you mean "),
        (("--start-from", "shipped", "--form", "paper"), "--start-from: the paper's form begins "),
        (("--start-from", "shipped", "--sweep", "d.toml"), "--start-from: a sweep begins with "),
        (("--start-from", "shipped", "--settings", "{tmp}/e.toml"), "--start-from shipped: its "),
        (("--start-from", "no.safetensors"), "weights no.safetensors: no file no.safetensors"),
    ],
)
def test_words_that_are_wrong(
    tmp_path: Path, refused: Callable[..., str], words: tuple[str, ...], expected: str
) -> None:
    (tmp_path / "a.toml").write_text("[sgn]\nwidht = [3]\n")
    for k in range(11):
        (tmp_path / f"vehicle_tracks_{k:03d}.csv").touch()
    (tmp_path / "e.toml").write_text("[sgn]\nwidth = 32\n")
    (tmp_path / "b.toml").write_text("[edn]\nwidth = 0.5\n")
    (tmp_path / "c.toml").write_text("[fit]\nbatch = 1\n")
    (tmp_path / "d.toml").write_text("[sgn]\nwidth = [8]\n")
    places = {"tmp": tmp_path, "sample": scenarios_dir() / "recorded_sample"}
    said = refused(*(word.format(**places) for word in words), "--out", tmp_path / "x.safetensors")
    assert said.startswith(expected.format(**places))
    assert not (tmp_path / "x.progress").exists()


@pytest.mark.usefixtures("no_traffic")
@pytest.mark.skipif(torch.cuda.is_available(), reason="there is such a device")
def test_a_device_that_is_not_there(tmp_path: Path, refused: Callable[..., str]) -> None:
    said = refused(*SHORT, "--device", "cuda", "--out", tmp_path / "x.safetensors")
    assert said == "--device cuda: torch finds no such device here; leave it out"


def test_traffic_too_short_for_a_sample_is_an_error(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    """Half a second is six frames; a history has eleven."""
    out = tmp_path / "x.safetensors"
    assert refused(*SHORT, "--out", out, "--duration", "0.5", "--workers", "1") == (
        "traffic to train: too little to learn from: 0 samples, 0 with a known goal, 0 with a "
        "whole path, 0 with a choice of slots, in 1 piece of traffic; give longer ones or more"
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("missing", ["goal", "path", "slot"])
def test_samples_that_know_nothing_are_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: Samples, split: Split, missing: str
) -> None:
    """Enough to learn from, and then every label of one kind gone from what tunes."""
    without = {
        "goal": replace(cut, goal_mask=np.zeros_like(cut.goal_mask)),
        "path": replace(cut, future_mask=np.zeros_like(cut.future_mask)),
        "slot": replace(cut, slot=np.full_like(cut.slot, -1)),
    }
    found = iter([cut, without[missing]])
    monkeypatch.setattr("hatn_sim.learn.train.gather", lambda *_: next(found))
    words = {"goal": "0 with a known", "path": "0 with a whole", "slot": "0 with a choice"}
    with pytest.raises(InputError, match=rf"to tune: .* {len(cut)} samples, .*{words[missing]}"):
        train(make_plan(split), tmp_path / "x.safetensors")


def test_the_whole_command_on_recorded_tracks_and_scenes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A split file of both kinds; the card says how, and of nobody's folders."""
    path = tmp_path / "split.toml"
    site = scenarios_dir() / "recorded_sample"
    path.write_text(
        f"[[train]]\ntracks = '{site}/vehicle_tracks_*.csv'\nmap = '{site}/map.osm'\n"
        "recordings = '000'\n[[tune]]\nscenes = 'intersection4_allway'\nseeds = 2\n"
        "duration_s = 15\n"
    )
    out = tmp_path / "w.safetensors"
    assert run_train("--split", path, "--epochs", "1", "--out", out) == 0
    assert capsys.readouterr().out.startswith(f"{out}: ")
    text = (tmp_path / "w.json").read_text()
    card = json.loads(text)
    (entry,) = card["split"]["train"]
    assert entry["site"] == "recorded_sample" and entry["lines"] == "lanes"
    assert entry["recordings"] == ["vehicle_tracks_000.csv"] and entry["map"] == "map.osm"
    assert "folders are left out" in card["command_of_files"]
    assert "--split split.toml --epochs 1" in card["command"]
    assert str(tmp_path) not in text and str(site) not in text


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
