"""What can be wrong with what driver assistance is given, as its user meets it."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from hatn_sim import cli
from hatn_sim.assist.settings import ORDERED, RANGES, AssistSettings
from hatn_sim.log import read_run
from hatn_sim.log.schema import ALERTS_FILE, COUNTERFACTUALS_FILE, SUGGESTIONS_FILE

QUIET = ["--no-picture", "--quiet", "--json"]
ROUNDABOUT = ["roundabout8", "--seed", "3", "--warm-up", "40", "--duration", "4", *QUIET]
ASSESS = ["--seeds", "301", "--duration", "3", "--warm-up", "10", "--workers", "1"]
NO_FORK = """import os
del os.fork
"""
DIES = """import os
import signal

fork, forks = os.fork, 0

def fork_and_kill():
    global forks
    forks += 1
    pid = fork()
    if pid == 0 and forks in {numbers}:
        os.kill(os.getpid(), signal.SIGKILL)
    return pid

os.fork = fork_and_kill
"""


@pytest.fixture(autouse=True, scope="module")
def nursery_that_stays() -> None:
    """None: what a process runs at first is said before it starts (`in_worker`)."""


@pytest.fixture
def in_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of Python that every process started from here runs at first."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    return folder / "sitecustomize.py"


# ---------------------------------------------------------------------------------------------
# Thresholds


SHIPPED = AssistSettings()
OUT_OF_ORDER = [
    (f"{small} = {high:g}\n{large} = {getattr(SHIPPED, large):g}", f"{small} = {high:g} is above")
    for small, large in ORDERED
    if (high := RANGES[small][1]) > getattr(SHIPPED, large)
]
IN_OTHER_UNITS = [
    (f"{key} = {1000.0 * high:g}", f"{key}: expected {low:g} to {high:g}")
    for key, (low, high) in RANGES.items()
]


@pytest.mark.parametrize("command", ["run", "assess"])
@pytest.mark.parametrize(
    ("text", "said"),
    [
        *OUT_OF_ORDER,
        *IN_OTHER_UNITS,
        ("alert_onset_kmh = 9", "unknown key 'alert_onset_kmh'; did you mean 'alert_onset"),
        (None, "cannot be read"),
    ],
)
def test_thresholds_out_of_order_or_of_another_unit(
    command: str, text: str | None, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings, out = tmp_path / "assist.toml", tmp_path / "out"
    if text is not None:
        settings.write_text(text, encoding="utf-8")
    scene = ["tjunction"] if command == "run" else ["--scenes", "tjunction"]
    given = ["--assist-settings", str(settings), "--out", str(out)]
    assert cli.main([command, *scene, *given]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"hatn-sim: {settings}: ") and said in told and told.count("\n") == 1
    assert not out.exists()


# ---------------------------------------------------------------------------------------------
# Egos


def test_an_ego_that_leaves_and_one_that_never_comes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first to leave of those that were advised, and somebody unheard of."""
    everybody, some = tmp_path / "everybody", tmp_path / "some"
    words = ["run", "intersection5", "--seed", "301", "--warm-up", "30", "--duration", "15"]
    assert cli.main([*words, *QUIET, "--out", str(everybody)]) == 0
    logged = read_run(everybody)
    *_, last = logged.scenes()
    ended = [one.ego_id for one in logged.suggestions if one.suggestion is None]
    # Of two who are told to yield to each other one is silent: that does depend on others.
    of_others = {"mutual", "said_otherwise"}
    told = [one.suggestion for one in logged.suggestions if one.suggestion is not None]
    restrained = {one.ego_id for one in told if one.reason in of_others}
    leaver = next(name for name in ended if name not in {*last.ids, *restrained})
    capsys.readouterr()
    egos = ["--assist", "--egos", f"{leaver},east_west.999", "--out", str(some)]
    assert cli.main([*words, *QUIET, *egos]) == 0
    assert capsys.readouterr().err == "hatn-sim: never seen in this run: --egos east_west.999\n"

    def lines(folder: Path) -> list[str]:
        return (folder / SUGGESTIONS_FILE).read_text(encoding="utf-8").splitlines()

    # What it is told does not depend on who else is told something; nothing after it has left.
    wanted = [line for line in lines(everybody) if json.loads(line)["ego_id"] == leaver]
    assert wanted and lines(some) == wanted
    assert json.loads(wanted[-1])["action"] is None


# ---------------------------------------------------------------------------------------------
# No events


def test_a_suite_without_events_has_no_recall(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["assess", "--suite", "no_warn", *ASSESS, "--rules", "hatn,never", "--out", str(out)]
    assert cli.main([*words, "--json"]) == 0
    told = capsys.readouterr()
    assert "no collision and no evasive braking in these runs: recall has no value" in told.err
    scores = json.loads(told.out)
    of_events = {"event_recall", "recall_1s5", "recall_in_time", "recall_t1", "lead_time_s"}
    found = [one for one in scores if one["measure"] in of_events]
    assert {one["measure"] for one in found} == of_events
    assert {(one["n"], one["value"], one["low"], one["high"]) for one in found} == {
        (0, None, None, None)
    }
    # Nor can a threshold be sought on them.
    words[words.index(str(out))] = str(tmp_path / "calibrated")
    words[words.index("301")] = "301-302"
    assert cli.main([*words, "--calibrate", "--quiet"]) == 1
    told = capsys.readouterr()
    said = "hatn-sim: no collision and no evasive braking in these runs: there is nothing to"
    assert told.err.startswith(said) and told.err.count("\n") == 1
    assert not (tmp_path / "calibrated" / "assist.toml").exists()


# ---------------------------------------------------------------------------------------------
# Branches


def test_without_fork_a_run_goes_without_branches(
    in_worker: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr(os, "fork")
    in_worker.write_text(NO_FORK)
    out = tmp_path / "run"
    words = ["run", *ROUNDABOUT, "--duration", "1", "--counterfactuals", "1"]
    assert cli.main([*words, "--out", str(out)]) == 0
    said = "run without counterfactuals: this platform cannot fork a running simulation; use Linux"
    assert capsys.readouterr().err == f"hatn-sim: {said} or macOS\n"
    assert not (out / COUNTERFACTUALS_FILE).exists() and read_run(out).counterfactuals is None


def test_without_fork_runs_are_assessed_without_branches(
    in_worker: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr(os, "fork")
    in_worker.write_text(NO_FORK)
    words = ["assess", "--scenes", "tjunction", "--risk", "courteous", *ASSESS, "--json"]
    words += ["--rules", "hatn", "--counterfactuals", "1", "--out", str(tmp_path / "out")]
    assert cli.main(words) == 0
    told = capsys.readouterr()
    assert "tjunction: without counterfactuals: this platform cannot fork" in told.err
    assert not {one["measure"] for one in json.loads(told.out)} & {"regret", "useful_share"}


def test_a_branch_whose_worker_dies_is_lost_and_counted(
    in_worker: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first branch is the future as it is, the second and so on are those of the slots."""
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    words = ["run", *ROUNDABOUT[:-1], "--counterfactuals", "1"]
    assert cli.main([*words, "--out", str(whole)]) == 0
    assert "a branch was lost" not in capsys.readouterr().out
    in_worker.write_text(DIES.format(numbers={2}))
    assert cli.main([*words, "--out", str(broken)]) == 0
    told = capsys.readouterr()
    assert told.err == "" and "\n1 not judged: a branch was lost\n" in told.out
    for name in (SUGGESTIONS_FILE, ALERTS_FILE):
        assert (broken / name).read_bytes() == (whole / name).read_bytes()
    before, after = (
        [json.loads(line) for line in (folder / COUNTERFACTUALS_FILE).read_text().splitlines()]
        for folder in (whole, broken)
    )
    assert len(before) == len(after) > 1
    assert [line["lost"] for line in after] == [True] + [False] * (len(after) - 1)
    assert after[1:] == before[1:]
    assert after[0].items() <= {**before[0], "lost": True}.items()
