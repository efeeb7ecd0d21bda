"""`hatn-sim compare` from end to end: pairs, resumption, what is lost, mistakes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from conftest import heed_ctrl_c

from hatn_sim.cli import main
from hatn_sim.commands import compare
from hatn_sim.config import load_scenario
from hatn_sim.errors import InputError
from hatn_sim.evaluation import closed_loop
from hatn_sim.evaluation import made_by as made_by_module
from hatn_sim.evaluation.closed_loop import SeedPlan, make_seed, row_path
from hatn_sim.evaluation.pool import Teller
from hatn_sim.score.closed_loop import UNITS
from hatn_sim.score.closed_loop_rows import DrivenEgo, DrivenRow, read_row

SHORT = ["--scenes", "intersection5", "--warm-up", "20", "--duration", "45", "--limit", "40"]
FAST = ["--agent", "constant_speed", "--predictors", "constant_velocity,idm"]
KILLS_ITSELF = """
import os, signal
class Agent:
    reads_suggestions = False
    def init(self, road): return None
    def step(self, state, ego_id, scene, advice):
        {what}
        return None, None
"""
STEADY = """
from hatn_sim.datatypes import Command
class Agent:
    '''Keeps its speed, whatever it is told; nobody knows that before.'''
    reads_suggestions = False
    def init(self, road): return None
    def step(self, state, ego_id, scene, advice):
        assert ego_id in advice.prediction.ids
        return None, Command(ego_id, 0.0)
"""
ITSELF = "os.kill(os.getpid(), signal.SIGKILL)"
CHILDREN = "open(f'/proc/{%s}/task/{%s}/children').read().split()"
ITS_SUMO = (
    "[os.kill(int(worker), signal.SIGKILL) "
    f"for nursery in {CHILDREN % ('os.getpid()', 'os.getpid()')} "
    f"for worker in {CHILDREN % ('nursery', 'nursery')}]"
)


def compared(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[list[dict[str, Any]], str]:
    assert main(["compare", *SHORT, "--json", *words]) == 0
    told = capsys.readouterr()
    return json.loads(told.out), told.err


def value(scores: list[dict[str, Any]], measure: str, predictor: str, subset: str) -> Any:
    (found,) = (
        one["value"]
        for one in scores
        if (one["measure"], one["predictor"], one["subset"]) == (measure, predictor, subset)
    )
    return found


def test_drives_are_made_kept_and_added_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = str(tmp_path / "out")
    words = [*FAST, "--seeds", "3", "--workers", "1", "--out", out]
    scores, told = compared(capsys, *words)
    assert "intersection5, seed 3" in told
    measures = {one["measure"] for one in scores}
    assert measures >= {*UNITS, "time_to_cross_change", "collisions_relative_change", "ade_3s"}
    assert all((one["value"] is None) == (one["n"] == 0) for one in scores)
    for name in ("scores.json", "closed_loop.png", "closed_loop.pdf"):
        assert (tmp_path / "out" / name).is_file()
    kept = sorted((tmp_path / "out" / "driven").rglob("*.json"))
    assert [path.stem for path in kept] == ["constant_velocity", "idm", "sumo_driver"]
    # An agent that reads no prediction drives the same with each.
    assert value(scores, "time_to_cross_change", "idm", "constant_speed") == 0.0
    # One predictor is lost and one is new: the others are not driven again, nor predict again.
    before = kept[0].stat().st_mtime_ns
    kept[1].unlink()
    again, told = compared(
        capsys, *words, "--quiet", "--predictors", "constant_velocity,idm,constant_acceleration"
    )
    assert told == "" and kept[0].stat().st_mtime_ns == before
    for one in scores:
        if one["measure"] not in ("spearman", "kendall"):
            assert one in again
    # Made otherwise: not mixed.
    assert main(["compare", *SHORT, *words, "--agent", "idm"]) == 2
    assert "was made otherwise: expected agent idm, found constant_speed" in capsys.readouterr().err
    assert main(["compare", *SHORT, *words, "--quiet"]) == 0
    told = capsys.readouterr().out
    assert "time and safety" in told and "no rank correlation" in told
    monkeypatch.setattr(made_by_module, "source_without", lambda _: "of tomorrow")
    assert main(["compare", *SHORT, *words, "--quiet"]) == 2
    told = capsys.readouterr().err
    assert "expected source of hatn_sim of tomorrow, found" in told and told.count("\n") == 1


def test_an_agent_that_decides_by_the_scene_alone_drives_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    teller, scene = Teller(lambda _: None, lambda: False), load_scenario("intersection5")
    names = ("constant_velocity", "idm", "constant_acceleration")

    def plan(agent: str, *predictors: str) -> SeedPlan:
        made_with: dict[str, dict[str, Any]] = {name: {} for name in ("sumo_driver", *predictors)}
        folder = tmp_path / agent.replace(":", "-")
        return SeedPlan(
            "seed 3", folder, scene, 3, agent, predictors, None, 1, 20.0, 45.0, 40.0, made_with
        )

    def rows(of: SeedPlan) -> list[DrivenRow]:
        assert make_seed(of, teller).lost == ()
        return [read_row(row_path(of, name)) for name in of.predictors]

    first, second = rows(plan("idm", *names[:2]))
    assert first.egos and first.egos == second.egos and first.open_loop != second.open_loop
    # Driven with the second one, it does drive the same.
    steps = closed_loop._Steps(teller)
    alone = [closed_loop._driven(plan("idm", "idm"), "idm", ego, steps) for ego in first.egos]
    assert alone == list(first.egos)

    drives: list[str] = []

    def driven(plan: SeedPlan, row: str, ego: DrivenEgo, steps: object) -> DrivenEgo:
        drives.append(row)
        return ego

    reference = closed_loop._Reference(list(first.egos), {})
    monkeypatch.setattr(closed_loop, "_reference", lambda *_: reference)
    monkeypatch.setattr(closed_loop, "_driven", driven)
    # A predictor that comes later takes the drive that is kept.
    assert rows(plan("idm", *names))[2].egos == first.egos and not drives
    rows(plan("ppo", *names))
    assert drives == [names[0]]
    # One that reads them drives with each, and so does one that only hears suggestions.
    rows(plan("mpc", *names))
    assert drives == [names[0], *names]
    (tmp_path / "heeding.py").write_text(STEADY.replace("suggestions", "predictions"))
    monkeypatch.chdir(tmp_path)
    rows(plan("heeding:Agent", *names))
    assert drives == [names[0], *names, *names]


def test_runs_are_the_reference_until_the_agent_acts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--agent", "sumo_driver", "--predictors", "constant_velocity", "--egos", "2"]
    scores, _ = compared(capsys, *words, "--seeds", "4", "--out", str(tmp_path / "out"))
    for measure in UNITS:
        ours = value(scores, measure, "constant_velocity", "sumo_driver")
        assert ours is not None
        assert ours == value(scores, measure, "sumo_driver", "sumo_driver")
    folder = tmp_path / "out" / "driven" / "intersection5-seed-4"
    rows = [json.loads((folder / f"{name}.json").read_text()) for name in
            ("sumo_driver", "constant_velocity")]  # fmt: skip
    assert rows[0]["egos"] == rows[1]["egos"] and len(rows[0]["egos"]) == 2


def test_the_oracle_drives_and_makes_no_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    (tmp_path / "steady.py").write_text(STEADY)
    words = ["--agent", "steady:Agent", "--predictors", "constant_velocity,oracle"]
    scores, told = compared(capsys, *words, "--seeds", "3", "--out", str(tmp_path / "out"))
    assert "reads no predictions" not in told
    assert value(scores, "ade_3s", "oracle", "all") == 0.0
    assert value(scores, "ade_3s", "constant_velocity", "all") > 0.0
    assert value(scores, "time_to_cross_change", "oracle", "steady:Agent") == 0.0


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="children are found in /proc")
@pytest.mark.parametrize(("what", "said"), [(ITSELF, "killed from outside"), (ITS_SUMO, "SUMO")])
def test_what_is_killed_is_counted(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    what: str,
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    module = f"killer_{'itself' if what == ITSELF else 'sumo'}"
    (tmp_path / f"{module}.py").write_text(KILLS_ITSELF.format(what=what))
    words = ["--agent", f"{module}:Agent", "--predictors", "constant_velocity", "--out", "out"]
    scores, told = compared(capsys, *words, "--seeds", "3-4", "--workers", "2", "--quiet")
    assert value(scores, "lost_seeds", "constant_velocity", f"{module}:Agent") == 2.0
    assert value(scores, "lost_seeds", "sumo_driver", "sumo_driver") == 0.0
    assert told.count("lost:") == 2 and said in told
    assert "makes them again" in told and "Traceback" not in told


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--predictors", "orakel"], "unknown predictor 'orakel'; did you mean 'oracle'?"),
        (["--predictors", "idm,sumo_driver"], "that row is always there"),
        (["--predictors", ","], "expected names, found none"),
        (["--agent", "mcp"], "unknown agent 'mcp'; did you mean 'mpc'?"),
        (["--scenes", "tjunktion"], "unknown scene 'tjunktion'; did you mean 'tjunction'"),
        (["--scenes", "recorded_sample"], "recorded traffic cannot react"),
    ],
)
def test_mistakes_are_one_line(
    capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    assert main(["compare", *SHORT, *FAST, *words]) == 2
    told = capsys.readouterr().err
    assert said in told and told.count("\n") == 1


@pytest.mark.parametrize(
    ("agent", "reads"),
    [
        ("idm", False),
        ("constant_speed", False),
        ("sumo_driver", False),
        ("ppo", False),
        ("mpc", True),
    ],
)
def test_rows_that_will_be_equal_are_told_before_the_drives(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    agent: str,
    reads: bool,
) -> None:
    def stopped(*_: object) -> None:
        raise InputError("the drives would begin here")

    monkeypatch.setattr(compare, "_driven_rows", stopped)
    words = ["compare", *SHORT, "--agent", agent, "--out", str(tmp_path / "out")]
    for predictors, told in (("constant_velocity,idm", not reads), ("idm", False)):
        assert main([*words, "--predictors", predictors]) == 2
        said = capsys.readouterr().err.splitlines()
        assert said[-1].endswith("the drives would begin here")
        assert any(f"{agent} reads no predictions" in line for line in said) == told


def test_an_agent_that_fails_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("clumsy.py").write_text(KILLS_ITSELF.format(what="raise ValueError('dropped it')"))
    words = ["--agent", "clumsy:Agent", "--predictors", "constant_velocity", "--seeds", "3"]
    assert main(["compare", *SHORT, *words, "--workers", "1", "--quiet"]) == 2
    told = capsys.readouterr().err
    assert "intersection5, seed 3: the agent of" in told and "dropped it" in told
    assert told.count("\n") == 1


def test_ctrl_c_ends_it_and_drives_stay(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "hatn_sim.cli", "compare", *SHORT, *FAST, "--seeds", "1-40"]
    with subprocess.Popen(
        [*words, "--workers", "2", "--out", "out"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        preexec_fn=heed_ctrl_c,
    ) as process:
        while process.poll() is None and not list((tmp_path / "out").rglob("*.json")):
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=60)
    assert process.returncode == 130, told
    assert "finished runs stay in out" in told and "Traceback" not in told
