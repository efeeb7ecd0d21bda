"""Many runs side by side: against answers by hand, `run` itself, interruptions and mistakes."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import heed_ctrl_c
from pool_work import die, double, wait_for_others

from hatn_sim import cli
from hatn_sim.commands.chosen_predictors import load_predictors
from hatn_sim.datatypes import HORIZON_FRAMES
from hatn_sim.errors import HatnSimError, InputError
from hatn_sim.evaluation.pool import work_on
from hatn_sim.log import read_run
from hatn_sim.predictors.find import weights_of
from hatn_sim.resources import scenarios_dir, weights_dir

RULES = ("--predictors", "constant_velocity,idm")
SHORT = ("--scenes", "tjunction", "--duration", "8", "--warm-up", "30", "--quiet")
ONE = ("--workers", "1")
MINE = """
from hatn_sim.predictors.constant_velocity import ConstantVelocity

made = []

class Fails(ConstantVelocity):
    name = "fails"

    def __init__(self):
        made.append(self)

    def predict(self, state):
        if len(made) > 2 and state.time_s > 33.0:  # of the second run
            raise RuntimeError("lost")
        return super().predict(state)
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p not in ("", str(tmp_path))])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    yield tmp_path
    sys.modules.pop("my_evaluated", None)


def evaluate(*words: object) -> int:
    try:
        return cli.main(["evaluate", *(str(word) for word in words)])
    except SystemExit as leaving:
        assert isinstance(leaving.code, int)
        return leaving.code


def scores(text: str) -> dict[tuple[str, str, str], dict[str, Any]]:
    return {(s["predictor"], s["measure"], s["subset"]): s for s in json.loads(text)}


# ---------------------------------------------------------------------------------------------
# What comes out


def constant_velocity_errors_m(folder: Path) -> np.ndarray:
    """[S, F] errors of constant velocity in a run, vehicle by vehicle, from nothing but tracks."""
    tracks = read_run(folder).tracks
    errors = []
    for vehicle in np.unique(tracks.vehicle):
        rows = np.flatnonzero(tracks.vehicle == vehicle)
        frame = tracks.frame[rows]
        assert (np.diff(frame) == 1).all()
        for now in range(10, len(rows) - HORIZON_FRAMES):
            if frame[now] % 5:
                continue
            at = rows[now]
            yaw, speed = tracks.yaw_rad[at], tracks.speed_mps[at]
            after_s = 0.1 * np.arange(1, HORIZON_FRAMES + 1)[:, None]
            said = tracks.xy_m[at] + after_s * speed * np.array([np.cos(yaw), np.sin(yaw)])
            happened = tracks.xy_m[rows[now + 1 : now + 1 + HORIZON_FRAMES]]
            errors.append(np.hypot(*(said - happened).T))
    return np.array(errors)


def test_two_runs_are_pooled(capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(*SHORT, *RULES, *ONE, "--seeds", "3-4", "--out", "out", "--json") == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    found = scores(printed.out)
    runs = sorted(Path("out/runs").iterdir())
    assert [path.name for path in runs] == ["tjunction-seed-3", "tjunction-seed-4"]
    error_m = np.concatenate([constant_velocity_errors_m(path) for path in runs])
    assert len(error_m) > 20
    by_hand = {
        "ade_3s": error_m.mean(axis=1),
        "ade_0s3": error_m[:, :3].mean(axis=1),
        "fde_3s": error_m[:, -1],
        "miss_rate_2m": error_m[:, -1] > 2.0,
    }
    for measure, values in by_hand.items():
        score = found["constant_velocity", measure, "all"]
        assert score["n"] == len(values)
        assert score["value"] == pytest.approx(values.mean(), abs=1e-6)
        assert score["std"] == pytest.approx(values.std(), abs=1e-6)
    with Path("out/steps.csv").open(newline="") as file:
        rows = [
            row
            for row in csv.DictReader(file)
            if (row["predictor"], row["subset"]) == ("constant_velocity", "all")
        ]
    assert [float(row["mean_m"]) for row in rows] == pytest.approx(error_m.mean(axis=0), abs=1e-6)
    assert json.loads(Path("out/scores.json").read_text()) == list(found.values())
    assert Path("out/steps.png").is_file() and Path("out/steps.pdf").is_file()


def test_the_form_and_the_figures_are_those_of_run(capsys: pytest.CaptureFixture[str]) -> None:
    names = ("--predictors", "hatn,constant_velocity")
    assert evaluate(*SHORT, *names, *ONE, "--seeds", "5", "--json") == 0
    evaluated = json.loads(capsys.readouterr().out)
    words = ["tjunction", "--duration", "8", "--warm-up", "30", "--seed", "5", "--quiet"]
    compared = ["--compare", "constant_velocity", "--json", "--no-picture", "--out", "run"]
    assert cli.main(["run", *words, *compared]) == 0
    run = json.loads(capsys.readouterr().out)
    assert run[: len(evaluated)] == evaluated
    assert {score["measure"] for score in run[len(evaluated) :]} == {
        "steps_per_second",
        "real_time_factor",
    }
    header = read_run(Path("runs/evaluate-1/runs/tjunction-seed-5")).header
    assert header["command"].startswith("hatn-sim run tjunction --seed 5 --duration 8 --warm-up 30")
    assert header["command"].endswith(
        "--compare constant_velocity --density normal --risk courteous"
    )
    assert header["predicted_every_frames"] == 5
    assert header["weights_sha256"] == read_run(Path("run")).header["weights_sha256"]


def test_every_recording_is_a_run_on_cores_side_by_side(capsys: pytest.CaptureFixture[str]) -> None:
    sample = scenarios_dir() / "recorded_sample"
    data = (sample / "vehicle_tracks_000.csv").read_bytes()
    # The same vehicles in files that are no copies of each other, which would draw no lines.
    for number, content in enumerate((data, data.rstrip(), data.replace(b"\n", b"\r\n"))):
        Path(f"vehicle_tracks_{number:03d}.csv").write_bytes(content)
    tracks = ("--tracks", "vehicle_tracks_*.csv", "--map", sample / "map.osm", *RULES)
    end = ("--duration", 9, "--out", "out")
    words = (*tracks, "--recordings", "001-002", *end)
    assert evaluate(*words, "--workers", "2", "--json") == 0
    printed = capsys.readouterr()
    *progress, notice = (
        line for line in printed.err.splitlines() if not line.startswith("reference lines from")
    )
    assert {line.rpartition(", ")[0] for line in progress} == {
        f"{Path.cwd().name}, {name}: 90 steps" for name in ("001", "002")
    }
    # Each has the third and the other one's thirteen vehicles: too few to draw lines from.
    assert "along the lanes of the map: found 26 vehicles in 2 other recordings" in notice
    both = scores(printed.out)
    assert evaluate(*tracks, "--recordings", 1, *ONE, "--duration", 9, "--json", "--quiet") == 0
    one = scores(capsys.readouterr().out)
    for key, score in both.items():
        assert score["n"] == 2 * one[key]["n"]
        assert score["value"] == pytest.approx(one[key]["value"])
        assert score["scene"] == Path.cwd().name
    assert evaluate(*words) == 0, "a table, of the runs that are there"
    printed = capsys.readouterr()
    assert "2 of 2 runs are in out/runs already" in printed.err
    assert "errors in metres" in printed.out and "bootstrapped over vehicles" in printed.out


def test_the_papers_form_has_weights_beside_the_others(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shipped = weights_dir() / "hatn.safetensors"
    for name in ("w", "w-paper"):
        for suffix in (".safetensors", ".json"):
            shutil.copy(shipped.with_suffix(suffix), here / f"{name}{suffix}")
    weights = Path("w.safetensors")
    assert weights_of("hatn", weights) == weights
    assert weights_of("hatn-paper", weights) == Path("w-paper.safetensors")
    assert weights_of("hatn", None) == shipped
    both = load_predictors(("hatn", "hatn-paper"), weights, "none", False)
    assert [predictor.name for predictor in both] == ["hatn", "hatn-paper"]
    assert capsys.readouterr().err == ""
    Path("w-paper.safetensors").unlink()
    assert weights_of("hatn-paper", weights) == shipped.with_name("hatn-paper.safetensors")
    with suppress(InputError):  # where none ship
        load_predictors(("hatn", "hatn-paper"), weights, "none", False)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("hatn-sim: hatn-paper: w-paper.safetensors is not beside w.safetensors")


@pytest.mark.parametrize(
    ("given", "advice"),
    [("w.safetensors", "leave --weights out"), ("w-paper.safetensors", "name w.safetensors")],
)
def test_weights_that_the_papers_form_alone_would_not_read(given: str, advice: str) -> None:
    with pytest.raises(InputError, match=rf"--weights {given}: expected .*-paper.*; {advice}"):
        load_predictors(("hatn-paper", "idm"), Path(given), "none", False)


# ---------------------------------------------------------------------------------------------
# Going on


def test_finished_runs_are_used_again_and_others_made_anew(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = (*SHORT, *RULES, *ONE, "--out", "out")
    assert evaluate(*words, "--seeds", "1-2", "--json") == 0
    first = capsys.readouterr().out
    heads = [Path(f"out/runs/tjunction-seed-{seed}/run.json") for seed in (1, 2)]
    made_at = [head.stat().st_mtime_ns for head in heads]
    broken = json.loads(heads[1].read_text()) | {"finished": False}
    heads[1].write_text(json.dumps(broken))
    shutil.rmtree(heads[1].parent / "frames")  # as where it was to be made again, and that was cut
    assert evaluate(*words, "--seeds", "1-2", "--json") == 0
    assert capsys.readouterr().out == first
    assert heads[0].stat().st_mtime_ns == made_at[0]
    assert heads[1].stat().st_mtime_ns > made_at[1]
    assert evaluate(*words, "--seeds", "1-3", "--json") == 0
    assert heads[0].stat().st_mtime_ns == made_at[0]
    capsys.readouterr()
    for other, expected in (
        (("--predictors", "idm"), "--predictors (constant_velocity there, idm here)"),
        (("--duration", 7), "--duration (8.0 there, 7.0 here)"),
        (("--risk", "assertive"), "--risk (courteous there, assertive here)"),
    ):
        assert evaluate(*words, "--seeds", "1-2", *other) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line == (
            f"hatn-sim: out/runs/tjunction-seed-1: was made with other {expected}; choose another "
            "--out, or remove the run"
        )


def test_a_run_that_fails_leaves_the_others(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "my_evaluated.py").write_text(MINE)
    words = (*SHORT, "--predictors", "my_evaluated:Fails", "--seeds", "1-3", "--out", "out", *ONE)
    assert evaluate(*words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("hatn-sim: tjunction, seed 2: ")
    assert "predictor 'fails' failed at 33." in line and "RuntimeError: lost" in line
    assert line.endswith(
        "; finished runs stay in out, and the same command with --out out uses them"
    )
    runs = [read_run(path) for path in sorted(Path("out/runs").iterdir())]
    assert [run.finished for run in runs] == [True, False]


def test_ctrl_c_leaves_what_is_there(here: Path) -> None:
    words = ["--scenes", "tjunction", "--seeds", "1-4", "--warm-up", "0", "--duration", "3000"]
    words += ["--predictors", "constant_velocity", "--workers", "2", "--out", "out"]
    process = subprocess.Popen(
        [sys.executable, "-m", "hatn_sim.cli", "evaluate", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=heed_ctrl_c,
        env=os.environ | {"PYTHONPATH": str(Path(cli.__file__).parents[1])},
    )
    part = here / "out" / "runs" / "tjunction-seed-1" / "frames" / "part-00000.parquet"
    for _ in range(600):
        if part.exists() or process.poll() is not None:
            break
        time.sleep(0.1)
    assert process.poll() is None
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all processes
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, "")
    assert err.splitlines() == [
        "hatn-sim: finished runs stay in out, and the same command with --out out uses them",
        "hatn-sim: interrupted",
    ]
    logged = read_run(here / "out" / "runs" / "tjunction-seed-1")
    assert not logged.finished and logged.frame_count >= 300


# ---------------------------------------------------------------------------------------------
# Work side by side


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_with_their_numbers(workers: int) -> None:
    told: list[tuple[int, int]] = []
    found = work_on(double, [5, 6, 7], workers, lambda number, steps: told.append((number, steps)))
    assert dict(found) == {0: 10, 1: 12, 2: 14}
    assert set(told) <= {(0, 5), (1, 6), (2, 7)} and told
    assert list(work_on(double, [], workers, lambda number, steps: None)) == []
    with pytest.raises(InputError, match="thirteen"):
        list(work_on(double, [13, 13], workers, lambda number, steps: None))


def test_an_error_stops_the_others() -> None:
    with pytest.raises(InputError, match="one"):
        list(work_on(wait_for_others, [0, 1], 2, lambda number, steps: None))
    assert Path("stopped").exists()


def test_a_process_that_is_killed_is_one_line() -> None:
    with pytest.raises(HatnSimError, match="killed from outside, perhaps for lack of memory"):
        list(work_on(die, [1, 2], 2, lambda number, steps: None))


# ---------------------------------------------------------------------------------------------
# Mistakes


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--scenes", "tjunktion"), "unknown scene 'tjunktion'; did you mean 'tjunction'?"),
        (("--predictors", "idn"), "unknown predictor 'idn'; did you mean 'idm'?"),
        (("--map", "a.osm"), "--map a.osm goes with --tracks; leave it out"),
        (("--scenes", "recorded_sample", "--seeds", "1"), "--seeds: recorded traffic has no seed"),
        (("--scenes", "recorded_sample", "--lines", "route"), "--lines route: recorded tracks kn"),
        (("--weights", "w.safetensors"), "--weights w.safetensors: constant_velocity, idm cannot"),
        (("--weights", ".", "--predictors", "hatn"), "weights .: expected a .safetensors file"),
        (("--out", "file"), "file: expected a folder, found a file; choose another --out"),
        (("--adapt", "kalman"), "argument --adapt: invalid choice: 'kalman'"),
        (("--workers", "0"), "argument --workers: expected a whole number above 0, found '0'"),
    ],
)
def test_mistakes_are_one_line(
    words: tuple[str, ...], expected: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "file").touch()
    assert evaluate(*RULES, *words) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = printed.err.splitlines()
    assert line.startswith(f"hatn-sim: {expected}")
    assert [path.name for path in here.iterdir()] == ["file"]


def test_a_predictor_named_twice_is_taken_once(capsys: pytest.CaptureFixture[str]) -> None:
    found = load_predictors(("idm", "constant_velocity", "idm"), None, "none", quiet=False)
    assert [one.name for one in found] == ["idm", "constant_velocity"]
    assert capsys.readouterr().err == "hatn-sim: idm: named twice, taken once\n"


def test_something_else_in_the_place_of_a_run(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = here / "out" / "runs" / "tjunction-seed-1"
    place.mkdir(parents=True)
    (place / "letter.txt").touch()
    assert evaluate(*SHORT, *RULES, *ONE, "--seeds", "1", "--out", "out") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("expected a run of this evaluation; choose another --out")
    assert (place / "letter.txt").exists()
