"""Recordings of one's own: lines from others of them, a choice of lines fitted to the site."""

from __future__ import annotations

import hashlib
import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from conftest import crossing_lanes
from safetensors.torch import save as tensor_bytes
from test_track_lines import traffic as drivers
from test_track_lines import write_recording

from hatn_sim import cli, perception
from hatn_sim.config import load_tracks
from hatn_sim.datatypes import DT_S
from hatn_sim.errors import InputError
from hatn_sim.evaluation.seen import was_seen
from hatn_sim.hatn.edn import EncoderDecoderNetwork
from hatn_sim.hatn.edn_settings import EdnSettings
from hatn_sim.hatn.predictor import Hatn
from hatn_sim.hatn.sgn import SemanticGraphNetwork
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.hatn.weights_io import choice_tensors, load_weights, save_weights
from hatn_sim.learn import train as training
from hatn_sim.learn.cache import SampleCache, key_of
from hatn_sim.learn.fit import FitSettings
from hatn_sim.learn.line_choice import choice_figures
from hatn_sim.learn.line_samples import choice_samples, joined
from hatn_sim.learn.map_doubts import with_doubts
from hatn_sim.learn.settings import FORMS, TrainingSettings
from hatn_sim.learn.site_lines import SiteChoice, fit_to_sites
from hatn_sim.learn.sources import played
from hatn_sim.learn.split import Split, make_split, traffic_of_scenes, traffic_of_tracks
from hatn_sim.learn.train import TrainingPlan, described, progress_folder, train
from hatn_sim.learn.watch import Nobody
from hatn_sim.line_choice import HAND_MADE_CHOICE, LineChoice, shipped_line_choice
from hatn_sim.log import Run, read_run
from hatn_sim.perception import PerceptionState
from hatn_sim.recordings.each import each_recording
from hatn_sim.recordings.lanelet2.writer import write_lanelet2
from hatn_sim.report import moment
from hatn_sim.road import Road

RECORDINGS = 7


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of a crossing where turns are cut by metres, five vehicles on each way."""
    folder = tmp_path_factory.mktemp("site")
    write_lanelet2(folder / "map.osm", crossing_lanes())
    for k in range(RECORDINGS):
        write_recording(folder, f"{k:03d}", drivers(5, seed=k))
    return folder


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def tracks(site: Path) -> list[str]:
    return ["--tracks", str(site / "vehicle_tracks_*.csv"), "--map", str(site / "map.osm")]


def evaluate(site: Path, *words: object) -> int:
    fixed = ["--predictors", "constant_velocity", "--workers", "1", "--duration", "8"]
    return cli.main(["evaluate", *tracks(site), *fixed, *map(str, words)])


def log(out: str, recording: str) -> Run:
    (path,) = Path(out, "runs").glob(f"*-{recording}")
    return read_run(path)


# -- evaluate -----------------------------------------------------------------------------------


def test_every_recording_is_judged_on_lines_of_others(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = ("--out", "out", "--choice-from", "weights")
    assert evaluate(site, *plain, "--json") == 0
    printed = capsys.readouterr()
    assert "drawn from 75 vehicles of 5 other recordings" in printed.err
    scores = json.loads(printed.out)
    assert all(score["n"] > 100 for score in scores if score["measure"] == "ade_3s")
    every = {f"{k:03d}" for k in range(RECORDINGS)}
    for k, name in enumerate(sorted(every)):
        about = log("out", name).header["settings"]["lines_from"]
        # Dealt into five groups: 000 and 005 are of one, 001 and 006.
        group = {f"{j:03d}" for j in range(k % 5, RECORDINGS, 5)}
        assert about["source"] == "tracks" and set(about["recordings"]) == every - group
        assert about["vehicles"] == 15 * len(every - group)
    assert evaluate(site, *plain) == 0
    assert "7 of 7 runs are in" in capsys.readouterr().err
    assert evaluate(site, *plain, "--lines-from", "lanes", "--quiet") == 2
    assert "was made with other --lines-from, or other recordings" in capsys.readouterr().err


def test_a_copy_under_another_name_has_no_part_in_the_lines(site: Path, tmp_path: Path) -> None:
    shutil.copytree(site, tmp_path / "copied")
    shutil.copy(site / "vehicle_tracks_001.csv", tmp_path / "copied" / "vehicle_tracks_900.csv")
    scenes = each_recording(
        load_tracks([str(tmp_path / "copied" / "*.csv")], tmp_path / "copied" / "map.osm"), "tracks"
    )
    by = {name: one.recorded.drawn.recordings for name, one in scenes.items()}  # type: ignore[union-attr]
    assert "900" not in by["001"] and "001" not in by["900"]
    assert {"001", "900"} <= set(by["000"])


def test_a_doubt_about_a_map_is_told_before_samples_are_cut(
    site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the card too, with the map; recordings that were learnt from are known under any name."""
    moved = tmp_path / "moved.osm"
    write_lanelet2(moved, crossing_lanes(shift_m=(0.0, 4.0)))  # south to north lies as it did

    def cut(*_: object) -> None:
        assert "is moved.osm the map of this place, and whole?" in capsys.readouterr().err
        raise InputError("enough")

    with monkeypatch.context() as patch:
        patch.setattr("hatn_sim.learn.train.gather", cut)
        words = ["--tracks", str(site / "vehicle_tracks_*.csv"), "--map", str(moved)]
        words += ["--recordings", "000", "--tune", "001", "--lines-from", "lanes"]
        words += ["--cache", "none", "--out", str(tmp_path / "w.safetensors")]
        assert cli.main(["train", *words]) == 2
    assert capsys.readouterr().err.endswith("hatn-sim: enough\n")
    parts = {
        part: traffic_of_tracks([str(site / "*.csv")], moved, name, "lanes")
        for part, name in (("train", "000"), ("tune", "001"))
    }
    split = with_doubts(make_split(parts), Nobody())
    (entry,) = split.card()["train"]
    assert entry["map"] == "moved.osm"
    assert entry["map_sha256"] == hashlib.sha256(moved.read_bytes()).hexdigest()
    (doubt,) = entry["doubts"]
    assert doubt.startswith("vehicle_tracks_000.csv: only ")
    shutil.copy(site / "vehicle_tracks_000.csv", tmp_path / "another.csv")
    shutil.copy(site / "vehicle_tracks_002.csv", tmp_path / "third.csv")
    card = {"split": split.card()}
    for name, seen in (("another", True), ("third", False)):
        assert was_seen(card, load_tracks([str(tmp_path / f"{name}.csv")], moved), None) == seen


@pytest.mark.slow
def test_the_command_in_a_log_makes_the_same_run(site: Path) -> None:
    assert evaluate(site, "--recordings", "001-002", "--out", "out", "--quiet") == 0
    evaluated = log("out", "001")
    words = shlex.split(str(evaluated.header["command"]))
    assert words[:2] == ["hatn-sim", "run"]
    assert cli.main([*words[1:], "--out", "again", "--quiet", "--no-picture"]) == 0
    again = read_run(Path("again"))
    assert again.header["settings"] == evaluated.header["settings"]
    mine, theirs = (one.predictions("constant_velocity", 5) for one in (again, evaluated))
    assert len(mine.frame) > 10
    np.testing.assert_array_equal(mine.xy_m, theirs.xy_m)


def test_lines_are_asked_for_with_tracks_alone(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("evaluate", "--scenes", "tjunction", "--lines-from", "lanes")
    assert cli.main([*words]) == 2
    assert "--lines-from lanes goes with --tracks; leave it out" in capsys.readouterr().err
    alone = ["--tracks", str(site / "vehicle_tracks_000.csv"), "--map", str(site / "map.osm")]
    told = ["evaluate", *alone, "--lines-from", "tracks"]
    assert cli.main([*told, "--predictors", "constant_velocity"]) == 2
    assert "found 0 vehicles in 0 other recordings" in capsys.readouterr().err


# -- the choice of lines ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def split(site: Path) -> Split:
    def part(recordings: str) -> Any:
        return traffic_of_tracks([str(site / "vehicle_tracks_*.csv")], site / "map.osm", recordings)

    return make_split({"train": part("000-002"), "tune": part("003-004")})


@pytest.fixture(scope="module")
def fitted(split: Split) -> SiteChoice | None:
    torch.set_num_threads(1)
    return fit_to_sites(split, 1, Nobody())


class Told(Nobody):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, line: str) -> None:
        self.lines.append(line)


def test_a_choice_is_fitted_to_the_site_and_better_there(
    split: Split, fitted: SiteChoice | None
) -> None:
    """Held against choices that are cut from the tuning recordings here."""
    assert fitted is not None
    cases = []
    for one in split.tune:
        with played(one) as (simulator, frames):
            cases.append(choice_samples(simulator.road, frames, shipped_line_choice()))
    before = choice_figures(joined(cases), shipped_line_choice())
    after = choice_figures(joined(cases), fitted.choice)
    assert after.n == before.n > 50
    assert after.log_loss < before.log_loss and after.wrong <= before.wrong
    assert fitted.card["tune"] == after._asdict()
    assert fitted.card["tune_shipped"] == before._asdict()


def test_a_worse_choice_is_not_taken(split: Split, monkeypatch: pytest.MonkeyPatch) -> None:
    by_hand = HAND_MADE_CHOICE.to_arrays()
    worse = LineChoice.from_arrays({**by_hand, "linear": -by_hand["linear"]})
    told = Told()
    monkeypatch.setattr("hatn_sim.learn.site_lines.fit_line_choice", lambda *_: worse)
    assert fit_to_sites(split, 1, told) is None
    assert told.lines[-1].endswith("the shipped one is taken")


def test_simulated_scenes_need_no_choice_of_their_own() -> None:
    scenes = {
        part: traffic_of_scenes(["tjunction"], [seed]) for part, seed in (("train", 1), ("tune", 2))
    }
    assert fit_to_sites(make_split(scenes), 1, Nobody()) is None


def test_samples_hang_on_the_choice_that_they_were_cut_with(split: Split) -> None:
    own = split.with_choice(shipped_line_choice())
    again = split.with_choice(LineChoice.from_arrays(shipped_line_choice().to_arrays()))
    keys = [[key_of(one) for one in each.train] for each in (split, own, again)]
    assert keys[1] == keys[2]
    assert not set(keys[0]) & set(keys[1])


@pytest.fixture
def networks() -> tuple[SemanticGraphNetwork, EncoderDecoderNetwork]:
    torch.manual_seed(0)
    sgn = SemanticGraphNetwork(SgnSettings(width=8))
    return sgn, EncoderDecoderNetwork(EdnSettings(width=8))


def moved(by: float) -> LineChoice:
    arrays = shipped_line_choice().to_arrays()
    return LineChoice.from_arrays({**arrays, "linear": arrays["linear"] + by})


def test_a_choice_goes_with_the_weights_and_is_shared(
    tmp_path: Path, networks: tuple[SemanticGraphNetwork, EncoderDecoderNetwork]
) -> None:
    for name, by in (("a", 0.1), ("b", 0.1), ("c", 0.2)):
        save_weights(tmp_path / f"{name}.safetensors", *networks, {}, moved(by))
    a, b, c = (load_weights(tmp_path / f"{name}.safetensors") for name in "abc")
    assert a.line_choice is not None and a.line_choice is b.line_choice is not c.line_choice
    for name, values in moved(0.1).to_arrays().items():
        np.testing.assert_array_equal(a.line_choice.to_arrays()[name], values)
    road = Road(crossing_lanes())
    one, two, three = (Hatn(weights, "hatn").init(road) for weights in (a, b, c))
    assert one.choice is a.line_choice and one is two is not three
    card = tmp_path / "c.json"
    content = json.loads(card.read_text())
    card.write_text(json.dumps({**content, "line_features": ["another"]}))
    with pytest.raises(InputError, match="made for other features of lines"):
        load_weights(tmp_path / "c.safetensors")
    save_weights(tmp_path / "d.safetensors", *networks, {})
    assert load_weights(tmp_path / "d.safetensors").line_choice is None


@pytest.mark.parametrize("command", ["run", "evaluate"])
def test_a_run_is_drawn_with_the_lines_it_was_made_with(
    site: Path,
    networks: tuple[SemanticGraphNetwork, EncoderDecoderNetwork],
    monkeypatch: pytest.MonkeyPatch,
    command: str,
) -> None:
    choice, one = moved(0.1), ["--recordings", "000", "--duration", "2"]
    save_weights(Path("w.safetensors"), *networks, {}, choice)
    words = ["--weights", "w.safetensors", "--out", "out", "--quiet"]
    if command == "run":
        assert cli.main(["run", *tracks(site), *one, *words, "--no-picture"]) == 0
        logged = read_run(Path("out"))
    else:
        words += ["--predictors", "hatn,idm", "--workers", "1", "--choice-from", "weights"]
        assert cli.main(["evaluate", *tracks(site), *one, *words]) == 0
        logged = log("out", "000")
    begun: list[LineChoice | None] = []

    def begin(road: Road, choice: LineChoice | None = None) -> PerceptionState:
        begun.append(choice)
        return perception.begin(road, choice)

    monkeypatch.setattr(moment, "begin", begin)
    moment.moment_at(logged, 0, logged.ids[0])
    (found,) = begun
    assert found is not None
    for name, values in choice.to_arrays().items():
        np.testing.assert_allclose(found.to_arrays()[name], values, atol=1e-6)


class Stopping(Nobody):
    def step(self, stage: str, done: int, total: int, words: str) -> None:
        if (stage, done) == ("EDN", 2):
            raise KeyboardInterrupt


def test_the_choice_that_a_training_began_with_is_read_back(tmp_path: Path, split: Split) -> None:
    plan, site = TrainingPlan(split, {}, workers=1), SiteChoice(moved(0.1), {"recordings": 2})
    for out, begun in ((tmp_path / "with", site), (tmp_path / "without", None)):
        progress_folder(out).mkdir(parents=True)
        training._begin(plan, out, begun)  # pyright: ignore[reportPrivateUsage]
        kept = training._kept_choice(out)  # pyright: ignore[reportPrivateUsage]
        assert (kept is None) == (begun is None)
        if kept is not None:
            assert kept.card == site.card and kept.choice.sha256 == site.choice.sha256


@pytest.mark.slow  # `test_learn` resumes trainings, the test above reads the choice of one
def test_a_training_on_recordings_keeps_its_choice(
    tmp_path: Path, split: Split, fitted: SiteChoice | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped and gone on with, it does not fit again and ends in the same weights."""
    assert fitted is not None
    fits: list[Split] = []

    def fit(split: Split, *_: object) -> SiteChoice:
        fits.append(split)
        return fitted

    monkeypatch.setattr("hatn_sim.learn.train.fit_to_sites", fit)
    quick = FitSettings(epochs=1, batch=64)
    edn = replace(FORMS["hatn"].edn, width=8)
    settings = TrainingSettings(SgnSettings(width=8), edn, sgn_fit=quick, edn_fit=quick)
    small = replace(split, train=split.train[:1], tune=split.tune[:1])
    cache = SampleCache(tmp_path / "cache")
    plan = TrainingPlan(small, {"hatn": settings}, workers=1, cache=cache)
    (card,) = train(plan, tmp_path / "whole.safetensors").values()
    assert card["line_choice"] == dict(fitted.card)
    out = tmp_path / "w.safetensors"
    with pytest.raises(KeyboardInterrupt):
        train(plan, out, Stopping())
    train(plan, out)
    assert len(fits) == 2
    assert out.read_bytes() == (tmp_path / "whole.safetensors").read_bytes()
    found = load_weights(out).line_choice
    assert found is not None and found.sha256 == fitted.choice.sha256


# -- adaptation ---------------------------------------------------------------------------------


@pytest.mark.parametrize("damage", ["lost", "torn", "other"])
def test_a_training_whose_choice_is_lost_ends_in_one_line(
    split: Split, damage: str, tmp_path: Path
) -> None:
    plan = TrainingPlan(split, {"hatn": FORMS["hatn"]}, workers=1)
    folder = tmp_path / "x.progress"
    folder.mkdir()
    (folder / "plan.json").write_text(json.dumps({**described(plan), "line_choice": {"cases": 9}}))
    path = folder / "line_choice.safetensors"
    if damage != "lost":
        data = tensor_bytes(choice_tensors(shipped_line_choice()))
        other = tensor_bytes({"line_choice.linear": torch.zeros(3)})
        path.write_bytes(data[:50] if damage == "torn" else other)
    with pytest.raises(InputError) as refused:
        train(plan, tmp_path / "x.safetensors")
    said = str(refused.value)
    assert said.startswith(f"{path}: not the choice of lines of this training (")
    assert said.endswith("; remove the folder to begin anew") and "\n" not in said


@pytest.mark.parametrize(
    "who", [("--drive", "ego", "--agent", "constant_speed"), ("--egos", "ego")]
)
def test_who_is_driven_or_advised_is_not_adapted(
    tmp_path: Path,
    networks: tuple[SemanticGraphNetwork, EncoderDecoderNetwork],
    who: tuple[str, ...],
) -> None:
    path = tmp_path / "w.safetensors"
    save_weights(path, *networks, {})
    words = ["run", "highway_intersection", "--duration", "2.2", "--warm-up", "0", "--quiet"]
    words += ["--weights", str(path), "--adapt", "mekf", "--no-picture", "--out", "run", *who]
    assert cli.main(words) == 0
    logged = read_run(Path("run"))
    said = logged.predictions("hatn")
    ego = said.vehicle == logged.ids.index("ego")
    late = said.frame > round(1.5 / DT_S)
    assert not said.adapted[ego].any()
    assert said.adapted[late & ~ego].any()
    assert logged.header["weights_sha256"] == {"hatn": load_weights(path).sha256}


@pytest.mark.parametrize("trained_on", [pytest.param("tracks", marks=pytest.mark.slow), "lanes"])
def test_a_run_has_the_lines_that_its_weights_were_trained_on(
    site: Path,
    networks: tuple[SemanticGraphNetwork, EncoderDecoderNetwork],
    capsys: pytest.CaptureFixture[str],
    trained_on: str,
) -> None:
    card = {"split": {"train": [{"site": "crossing", "lines": trained_on}], "tune": []}}
    save_weights(Path("own.safetensors"), *networks, card)
    words = ["run", *tracks(site), "--recordings", "002", "--weights", "own.safetensors"]
    words += ["--duration", "8", "--no-picture", "--out"]
    assert cli.main([*words, "plain"]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "reference lines" in line]
    header = read_run(Path("plain")).header
    assert header["settings"]["lines_from"]["source"] == trained_on
    if trained_on == "lanes":
        assert said == [
            "hatn-sim: reference lines along the lanes of the map; choice among them as in the "
            "weights; own.safetensors was not trained on lines from tracks (otherwise: "
            "--lines-from, --choice-from)"
        ]
        assert "--lines-from lanes --choice-from weights" in header["command"]
        return
    assert len(said) == 1 and "drawn from 90 vehicles of 6 other recordings; " in said[0]
    assert "own.safetensors was trained on lines from tracks (otherwise: " in said[0]
    assert evaluate(
        site,
        *("--recordings", "002", "--weights", "own.safetensors", "--predictors", "hatn"),
        *("--out", "evaluated", "--quiet"),
    ) == 0  # fmt: skip
    evaluated = log("evaluated", "002")
    for key in ("lines_from", "choice_from"):
        assert header["settings"][key] == evaluated.header["settings"][key]
    mine, theirs = (one.predictions("hatn", 5) for one in (read_run(Path("plain")), evaluated))
    assert len(mine.frame) > 10
    np.testing.assert_array_equal(mine.xy_m, theirs.xy_m)
    assert cli.main([*words, "asked", "--lines-from", "lanes", "--choice-from", "weights"]) == 0
    assert "; choice among them as in the weights; as asked for" in capsys.readouterr().err
    asked = read_run(Path("asked")).header
    assert asked["settings"]["lines_from"] == {"source": "lanes"}
