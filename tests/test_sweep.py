"""Settings tried out: what is tried, what is kept, and how it goes on."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hatn_sim import cli
from hatn_sim.errors import HatnSimError, InputError
from hatn_sim.learn import sweep as sweep_module
from hatn_sim.learn import train as train_module
from hatn_sim.learn.dataset import Samples
from hatn_sim.learn.fit import FitSettings, LossError, Workplace
from hatn_sim.learn.settings import (
    FORMS,
    TrainingSettings,
    changed,
    read_settings,
    settings_toml,
)
from hatn_sim.learn.site_lines import SiteChoice
from hatn_sim.learn.split import make_split, traffic_of_scenes
from hatn_sim.learn.sweep import Trial, best_trial, read_sweep, run_sweep, trials
from hatn_sim.learn.train import TrainingPlan
from hatn_sim.learn.watch import Nobody
from hatn_sim.line_choice import HAND_MADE_CHOICE

BASIS = FORMS["hatn"]
GRID = """
[sgn]
width = [8, 16]
[edn_fit]
learning_rate = [0.001, 0.002, 0.01]
"""


def sweep_of(folder: Path, text: str) -> Path:
    path = folder / "sweep.toml"
    path.write_text(text)
    return path


def test_a_grid_is_every_combination(tmp_path: Path) -> None:
    tried = list(trials(read_sweep(sweep_of(tmp_path, GRID), BASIS)))
    assert len(tried) == 6
    assert {(one["sgn.width"], one["edn_fit.learning_rate"]) for one in tried} == {
        (width, rate) for width in (8, 16) for rate in (0.001, 0.002, 0.01)
    }


def test_draws_are_even_in_the_logarithm_and_the_same_each_time(tmp_path: Path) -> None:
    text = "draws = 2000\nseed = 3\n[sgn]\nwidth = [8, 16]\n[edn_fit]\n"
    path = sweep_of(tmp_path, text + "learning_rate = { from = 1e-4, to = 1e-2 }\n")
    sweep = read_sweep(path, BASIS)
    tried = list(trials(sweep))
    assert tried == list(trials(sweep))
    rate = np.log10([one["edn_fit.learning_rate"] for one in tried])
    assert rate.min() >= -4.0 and rate.max() <= -2.0
    # Even on [-4, -2]: the mean is -3 and the variance 4 / 12.
    assert abs(rate.mean() + 3.0) < 0.05 and abs(rate.var() - 1.0 / 3.0) < 0.03
    assert abs(np.mean([one["sgn.width"] == 8 for one in tried]) - 0.5) < 0.05


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[sgn]\nwidht = [8]\n", "unknown setting 'sgn.widht'; did you mean 'sgn.width'"),
        ("[sng]\nwidth = [8]\n", "unknown key 'sng'; did you mean 'sgn'"),
        ("drws = 3\n" + GRID, "unknown key 'drws'; did you mean 'draws'?"),
        ("draws = 0\n" + GRID, "draws: expected a whole number from 1, found 0"),
        ("judged_by = 'ade'\n" + GRID, "judged_by: unknown 'ade'; did you mean 'ade_"),
        ("[sgn]\nwidth = [8, 0]\n", "sgn.width: expected a whole number from 1 to 4096, found 0"),
        ("[sgn]\nwidth = 8\n", "sgn.width: expected a list of values or {from = A, to = B}"),
        ("[sgn]\nwidth = []\n", "sgn.width: expected a list of values or {from = A, to = B}"),
        ("[sgn]\nwidth = {from = 8, to = 9}\n", "a span is drawn from: add draws = N, or name"),
        ("draws = 2\n[edn_fit]\nlearning_rate = {from = 0, to = 1}\n", "expected a span of numbe"),
        ("[edn]\ndecoder = ['fast']\n", "edn.decoder: expected one of kinematic, plain, found 'f"),
        ("[edn]\ngoal_steps = [4]\n", "edn.goal_steps: expected one of 1, 6, found 4"),
        ("[edn]\ngoal_steps = [6.0]\n", "edn.goal_steps: expected one of 1, 6, found 6.0"),
        ("draws = 2\n", "expected settings to try in sgn, edn, sgn_fit, edn_fit, found none"),
    ],
)
def test_a_file_at_fault_is_one_line(tmp_path: Path, text: str, expected: str) -> None:
    path = sweep_of(tmp_path, text)
    with pytest.raises(InputError) as wrong:
        read_sweep(path, BASIS)
    assert str(wrong.value).startswith(str(path)) and expected in str(wrong.value)
    assert "\n" not in str(wrong.value)


def test_settings_come_back_from_their_file(tmp_path: Path) -> None:
    values = {"sgn.width": 48, "edn.attention": True, "edn_fit.learning_rate": 1e-5}
    settings = changed(FORMS["paper"], "x", values)
    path = tmp_path / "settings.toml"
    path.write_text(settings_toml(settings))
    assert read_settings(path, BASIS) == settings != BASIS


@pytest.fixture
def plan(monkeypatch: pytest.MonkeyPatch) -> TrainingPlan:
    """Traffic that is not played: figures come from the settings, by a formula."""
    parts = {
        name: traffic_of_scenes(["tjunction"], [k]) for k, name in enumerate(("train", "tune"))
    }
    monkeypatch.setattr(sweep_module, "collect", lambda *_: (None, None))
    return TrainingPlan(make_split(parts), {"hatn": BASIS})


class Fitted:
    """In place of both networks: counts what is fitted, and loses the loss of the fastest."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.sgn: list[int] = []
        self.edn: list[float] = []
        self.stop_after = 1000
        monkeypatch.setattr(sweep_module, "fit_sgn", self._fit_sgn)
        monkeypatch.setattr(sweep_module, "fit_edn", self._fit_edn)

    def _fit_sgn(
        self, learn: Samples, tune: Samples, settings: TrainingSettings, place: Workplace
    ) -> tuple[int, dict[str, float]]:
        self.sgn.append(settings.sgn.width)
        return settings.sgn.width, {"goal_error_m": 1.0 / settings.sgn.width}

    def _fit_edn(
        self, learn: Samples, tune: Samples, sgn: int, settings: TrainingSettings, place: Workplace
    ) -> tuple[None, dict[str, float]]:
        if len(self.edn) == self.stop_after:
            raise KeyboardInterrupt
        rate = settings.edn_fit.learning_rate
        self.edn.append(rate)
        if rate == 0.01:
            raise LossError("the loss became nan", None, 0, {})  # type: ignore[arg-type]
        return None, {"ade_3s_m": 1.0 / sgn - rate}


def test_a_sweep_that_was_stopped_goes_on_behind_the_last_trial(
    tmp_path: Path, plan: TrainingPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep, done = read_sweep(sweep_of(tmp_path, GRID), BASIS), tmp_path / "w.sweep.jsonl"
    fitted = Fitted(monkeypatch)
    fitted.stop_after = 4
    with pytest.raises(KeyboardInterrupt):
        run_sweep(plan, sweep, BASIS, done, Nobody())
    assert fitted.sgn == [8, 16]  # one for all rates of its width
    with done.open("a") as file:
        file.write('\n{"sweep": "cut o')
    fitted.stop_after = 1000
    found = run_sweep(plan, sweep, BASIS, done, Nobody())
    assert len(fitted.edn) == 6
    assert [one.figures.get("ade_3s_m") for one in found] == [
        1 / 8 - 0.001, 1 / 8 - 0.002, None, 1 / 16 - 0.001, 1 / 16 - 0.002, None
    ]  # fmt: skip
    best = best_trial(found, sweep.judged_by)
    assert best.values == {"sgn.width": 16, "edn_fit.learning_rate": 0.002}
    assert run_sweep(plan, sweep, BASIS, done, Nobody()) == found and len(fitted.edn) == 6
    other = changed(BASIS, "x", {"edn_fit.epochs": 3})
    with pytest.raises(InputError, match="is of a sweep over other traffic or by another version"):
        run_sweep(plan, sweep, other, done, Nobody())


def test_a_sweep_over_goals_alone_fits_no_second_network(
    tmp_path: Path, plan: TrainingPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "judged_by = 'goal_error_m'\n[sgn]\nwidth = [8, 16]\n"
    sweep, fitted = read_sweep(sweep_of(tmp_path, text), BASIS), Fitted(monkeypatch)
    found = run_sweep(plan, sweep, BASIS, tmp_path / "w.sweep.jsonl", Nobody())
    assert fitted.edn == [] and best_trial(found, "goal_error_m").values == {"sgn.width": 16}


def test_a_sweep_works_on_the_device_that_was_asked_for(
    tmp_path: Path, plan: TrainingPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr(sweep_module, "fit_edn", lambda *_: (None, {"ade_3s_m": 1.0}))
    places: list[Workplace] = []

    def fit_sgn(*words: object) -> tuple[None, dict[str, float]]:
        places.extend(word for word in words if isinstance(word, Workplace))
        return None, {}

    monkeypatch.setattr(sweep_module, "fit_sgn", fit_sgn)
    sweep = read_sweep(sweep_of(tmp_path, "[sgn]\nwidth = [8]\n"), BASIS)
    path = tmp_path / "made" / "w.sweep.jsonl"
    run_sweep(replace(plan, device="cuda"), sweep, BASIS, path, Nobody())
    assert [place.device.type for place in places] == ["cuda"] and path.is_file()


def test_where_every_loss_is_lost() -> None:
    with pytest.raises(HatnSimError, match="every loss was lost"):
        best_trial([Trial({"sgn.width": 8}, {}, "nan")], "ade_3s_m")


def test_the_command_leaves_settings_that_train_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = ["--scenes", "intersection4_allway", "--seeds", "1", "--tune", "2", "--duration", "10"]
    words = ["train", *scene, "--quiet", "--cache", str(tmp_path / "kept")]
    out = tmp_path / "w.safetensors"
    path = sweep_of(tmp_path, "[sgn]\nwidth = [8, 16]\n[edn]\nwidth = [8]\n")
    sweep = [*words, "--sweep", str(path), "--epochs", "1", "--out", str(out)]
    assert cli.main(sweep) == 0
    printed = capsys.readouterr().out
    settings = tmp_path / "w.settings.toml"
    assert "sgn.width" in printed and f"train with --settings {settings}" in printed
    found = [json.loads(line) for line in (tmp_path / "w.sweep.jsonl").open() if line.strip()]
    best = min(found, key=lambda one: one["figures"]["ade_3s_m"])["values"]["sgn.width"]
    assert read_settings(settings, TrainingSettings(sgn_fit=FitSettings())).sgn.width == best
    assert cli.main([*words, "--settings", str(settings), "--out", str(out)]) == 0
    card = json.loads((tmp_path / "w.json").read_text())
    assert card["sgn"]["width"] == best and card["fit"]["edn"]["epochs"] == 1


def test_a_sweep_cuts_samples_with_the_choice_of_lines_that_a_training_fits(
    tmp_path: Path, plan: TrainingPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    Fitted(monkeypatch)
    fitted, cut = SiteChoice(HAND_MADE_CHOICE, {}), list[TrainingPlan]()
    monkeypatch.setattr(train_module, "fit_to_sites", lambda *_: fitted)
    monkeypatch.setattr(sweep_module, "collect", lambda plan, _: cut.append(plan) or (None, None))
    sweep = read_sweep(sweep_of(tmp_path, GRID), BASIS)
    run_sweep(plan, sweep, BASIS, tmp_path / "w.sweep.jsonl", Nobody())
    (used,) = cut
    assert [one.choice for name in ("train", "tune") for one in used.split.part(name)] == [
        HAND_MADE_CHOICE, HAND_MADE_CHOICE
    ]  # fmt: skip
