"""`hatn-sim assess` from end to end: runs, resumption, JSON, calibration, mistakes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from hatn_sim.assist.settings import read_assist_settings
from hatn_sim.cli import main
from hatn_sim.config import load_scenario
from hatn_sim.evaluation import made_by as made_by_module
from hatn_sim.evaluation.made_by import made_by

NETS = Path(__file__).parent / "nets"
SHORT = ["--duration", "6", "--warm-up", "20", "--workers", "1", "--quiet"]
WANTED = ["--scenes", "tjunction", "--risk", "courteous,inattentive", "--seeds", "301"]


def test_runs_are_made_scored_and_used_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    words = ["assess", *WANTED, *SHORT, "--out", str(out)]
    assert main([*words, "--json"]) == 0
    told = capsys.readouterr().out
    scores = json.loads(told)
    # Nothing happens in these seconds: there is nothing to choose thresholds of other rules by.
    assert {one["predictor"] for one in scores} == {"hatn", "oracle", "always", "never"}
    assert {one["subset"] for one in scores} == {"courteous", "inattentive", "all"}
    measures = {one["measure"] for one in scores}
    assert measures >= {"event_recall", "recall_1s5", "precision", "false_alarms_per_hour"}
    assert measures >= {"lead_time_s", "suggestion_agreement"}
    assert all((one["value"] is None) == (one["n"] == 0) for one in scores)
    for name in ("scores.json", "curves.csv", "curves.png", "curves.pdf"):
        assert (out / name).is_file()
    made = sorted((out / "assessed").iterdir())
    assert len(made) == 2
    # One run is lost, the other is kept; the same comes out.
    before = made[1].stat().st_mtime_ns
    made[0].unlink()
    assert main([*words, "--json"]) == 0
    assert capsys.readouterr().out == told
    assert made[1].stat().st_mtime_ns == before
    # Made otherwise: not mixed.
    assert main([*words, "--rules", "hatn,never"]) == 2
    assert "was made otherwise: expected rules" in capsys.readouterr().err
    assert main(words) == 0
    assert "suggestions" in capsys.readouterr().out
    monkeypatch.setattr(made_by_module, "source_without", lambda _: "of tomorrow")
    assert main(words) == 2
    told = capsys.readouterr().err
    assert "was made otherwise: expected source of hatn_sim of tomorrow, found" in told
    assert told.count("\n") == 1 and "choose another --out" in told


def test_runs_of_other_files_are_other_runs(tmp_path: Path) -> None:
    for name in ("street.net.xml", "street.rou.xml", "street.sumocfg"):
        shutil.copy(NETS / name, tmp_path)
    scenario = load_scenario(str(tmp_path / "street.sumocfg"))
    before = made_by(scenario)
    routes = tmp_path / "street.rou.xml"
    text = routes.read_text(encoding="utf-8")
    routes.write_text(f"{text}<!-- drawn otherwise -->\n", encoding="utf-8")
    changed = made_by(scenario)
    assert {key for key in before if before[key] != changed[key]} == {"files of the scene"}
    routes.write_text(text, encoding="utf-8")
    assert made_by(scenario) == before


@pytest.mark.slow
def test_a_threshold_is_sought_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["assess", "--suite", "do_warn", "--seeds", "301-302", *SHORT, "--duration", "20"]
    asked = ["--calibrate", "--false-alarms", "1000", "--warm-up", "0"]
    code = main([*words, *asked, "--out", str(out)])
    assert code == 0, capsys.readouterr().err
    assert "settings in" in capsys.readouterr().out
    settings = read_assist_settings(out / "assist.toml")
    assert 0.0 < settings.alert_end < settings.alert_onset < 1.0
    assert settings.danger_network == str(out / "danger.json")
    # What was found can be used, and is not mixed with what ships.
    used = ["--assist-settings", str(out / "assist.toml"), "--out", str(tmp_path / "used")]
    assert main([*words, "--warm-up", "0", *used]) == 0
    assert main([*words, "--warm-up", "0", *used[2:]]) == 2
    assert "was made otherwise" in capsys.readouterr().err


def test_a_threshold_is_not_sought_where_there_is_nothing_to_seek_it_by(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["assess", "--scenes", "tjunction", "--risk", "courteous", *SHORT, "--calibrate"]
    assert main([*words, "--seeds", "301", "--out", str(tmp_path / "one")]) == 2
    assert "expected two --seeds or more" in capsys.readouterr().err
    assert main([*words, "--seeds", "301-302", "--out", str(tmp_path / "none")]) != 0
    assert "there is nothing to calibrate by" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "name scenes with --scenes"),
        (["--scenes", "tjunction", "--suite", "do_warn"], "drop one"),
        (["--scenes", "tjunction", "--rules", "hat"], "did you mean 'hatn'"),
        (
            ["--scenes", "tjunction", "--rules", "time_to_collision,never"],
            "expected hatn among them",
        ),
        (["--scenes", "tjunction", "--risk", "couteous"], "did you mean 'courteous'"),
        (["--scenes", "recorded_sample"], "recorded traffic has no seeds"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["assess", *words, "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert expected in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()
