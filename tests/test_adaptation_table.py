"""`--table adaptation`: pooling by hand, and the command from end to end on untrained networks."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from hatn_sim import cli
from hatn_sim.hatn.edn import EncoderDecoderNetwork
from hatn_sim.hatn.edn_settings import PAPER, EdnSettings
from hatn_sim.hatn.sgn import SemanticGraphNetwork
from hatn_sim.hatn.sgn_settings import SgnSettings
from hatn_sim.hatn.weights_io import save_weights
from hatn_sim.learn import adaptation_trials
from hatn_sim.learn.adaptation_rows import pooled
from hatn_sim.learn.adaptation_study import MEASURES, VehicleErrors
from hatn_sim.learn.adaptation_trials import LAYER_STEPS, STEPS, TRIALS, Trial


def errors(trained: list[float], adapted: list[float], n: list[int]) -> VehicleErrors:
    """Sums of every vehicle, the same for all measures."""
    sums = np.stack((trained, adapted), 1)[..., None].repeat(len(MEASURES), axis=2)
    return VehicleErrors(sums, np.array(n))


def test_changes_by_hand() -> None:
    """Two runs: 0.6 m over 3 predictions become 0.3 m; every vehicle that counts is halved."""
    runs = [errors([0.2, 0.0], [0.1, 0.0], [1, 0]), errors([0.4], [0.2], [2])]
    n, changes = pooled(runs)
    assert n == 3 and list(changes) == list(MEASURES)
    change = changes["ade2"]
    assert change.trained_m == pytest.approx(0.2) and change.adapted_m == pytest.approx(0.1)
    assert change.share == pytest.approx(-0.5)
    # Paired: whoever is drawn, the change is the same.
    assert (change.low, change.high) == (pytest.approx(-0.5), pytest.approx(-0.5))


def test_runs_are_the_clusters_where_there_are_enough() -> None:
    """Within each of five runs one vehicle gains what another loses: runs do not differ."""
    run = errors([1.0, 1.0], [0.5, 1.1], [1, 1])
    five, four = (pooled([run] * count)[1]["ade1"] for count in (5, 4))
    assert five.share == four.share == pytest.approx(-0.2)
    assert five.low == five.high == pytest.approx(-0.2)
    assert four.low is not None and four.high is not None and four.low < -0.25 < -0.1 < four.high


def test_nothing_predicted_has_no_change() -> None:
    assert pooled([errors([0.0], [0.0], [0])]) == (0, {})


def test_every_step_every_layer_and_every_method_is_tried() -> None:
    whole = [trial for trial in TRIALS if trial.frames is None]
    assert [t.steps for t in whole if t.method == "mekf"] == list(STEPS) == list(range(1, 11))
    assert {t.method for t in whole if t.steps == 3} == {"mekf", "sgd", "rls"}
    assert len(TRIALS) - len(whole) == 7 * len(LAYER_STEPS)
    assert len(set(TRIALS)) == len(TRIALS)


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    for name, settings in (("raw", EdnSettings(8)), ("raw-paper", PAPER)):
        sgn = SemanticGraphNetwork(SgnSettings(width=8))
        save_weights(tmp_path / f"{name}.safetensors", sgn, EncoderDecoderNetwork(settings), {})
    return tmp_path / "raw.safetensors"


@pytest.mark.slow
def test_the_command(
    weights: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    some = (
        Trial("mekf", "dense3", 1),
        Trial("mekf", "dense3", 3),
        Trial("sgd", "dense3", 3),
        Trial("mekf", "dense2", 3, 25),
    )
    monkeypatch.setattr(adaptation_trials, "TRIALS", some)
    out = tmp_path / "out"
    words = ["evaluate", "--table", "adaptation", "--scenes", "tjunction", "--seeds", "101"]
    words += ["--duration", "6", "--weights", str(weights), "--workers", "1", "--out", str(out)]
    assert cli.main([*words, "--quiet"]) == 0
    told = capsys.readouterr().out
    assert "hatn-paper in tjunction" in told and "hatn in tjunction" in told
    assert "paper: ADE 2 -20.5 % in its intersection and -28.7 % in its roundabout" in told
    assert all(len(line) <= 100 for line in told.splitlines() if str(out) not in line)
    for name in ("steps-hatn", "layers-hatn", "steps-hatn-paper", "layers-hatn-paper"):
        assert (out / f"{name}.png").stat().st_size > 5000
        assert (out / f"{name}.pdf").stat().st_size > 1000
    rows = list(csv.DictReader((out / "adaptation.csv").open()))
    assert len(rows) == 2 * len(some) * len(MEASURES)
    for row in rows:
        ratio = float(row["adapted_m"]) / float(row["trained_m"])
        assert float(row["change"]) == pytest.approx(ratio - 1.0, abs=1e-3)
        assert int(row["n"]) > 0

    # Once more: nothing is tried again, and the numbers are the same.
    monkeypatch.setattr(adaptation_trials, "_do", None)
    assert cli.main([*words, "--json"]) == 0
    captured = capsys.readouterr()
    assert "2 of 2 runs were tried already" in captured.err
    again = json.loads(captured.out)
    assert [str(row["change"]) for row in again] == [row["change"] for row in rows]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--predictors", "idm"], "--predictors idm: cannot be adapted; expected hatn-paper or"),
        (["--rows", "x.json"], "--rows is of no use to --table adaptation; leave it out"),
        (["--scenes", "nowhere"], "nowhere"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["evaluate", "--table", "adaptation", *words]) == 2
    line = capsys.readouterr().err
    assert expected in line and line.count("\n") == 1
