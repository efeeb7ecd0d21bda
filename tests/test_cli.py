"""The command line as its user sees it: exit codes, one clear line for every fault, logs, JSON."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from conftest import heed_ctrl_c

from hatn_sim import cli
from hatn_sim.commands import scenarios
from hatn_sim.commands.rate_text import rate_text
from hatn_sim.commands.run_simulated import said_of_density
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Frame, Score
from hatn_sim.log import read_run
from hatn_sim.resources import SUITES, find_scenarios, scenes_of_suite, scenes_to_test_on
from hatn_sim.simulators.sumo import SumoSimulator

NETS = Path(__file__).parent / "nets"
HEAVY = ("torch", "libsumo", "pyarrow", "matplotlib", "scipy")
SCENE = """name = "street"
title = "A street"
description = "Three junctions in a row."
simulator = "sumo"
config = "street.sumocfg"
"""
CV = ("--predictor", "constant_velocity")
SHORT = ("--duration", "2", "--no-picture", "--quiet")


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder of every command here: an empty one."""
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """A scene of one's own: a folder with a scenario.toml."""
    folder = tmp_path / "street"
    folder.mkdir()
    for name in ("street.net.xml", "street.rou.xml", "street.sumocfg"):
        shutil.copy(NETS / name, folder)
    (folder / "scenario.toml").write_text(SCENE)
    return folder


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """Networks that have learned nothing."""
    import torch

    from hatn_sim.hatn.edn import EncoderDecoderNetwork
    from hatn_sim.hatn.edn_settings import EdnSettings
    from hatn_sim.hatn.sgn import SemanticGraphNetwork
    from hatn_sim.hatn.sgn_settings import SgnSettings
    from hatn_sim.hatn.weights_io import save_weights

    torch.manual_seed(0)
    path = tmp_path / "weights" / "raw.safetensors"
    sgn, edn = SemanticGraphNetwork(SgnSettings(width=8)), EncoderDecoderNetwork(EdnSettings(8))
    save_weights(path, sgn, edn, {})
    return path


def code_of(*words: object) -> int:
    """The exit code of `hatn-sim WORDS`."""
    try:
        return cli.main([str(word) for word in words])
    except SystemExit as leaving:
        assert isinstance(leaving.code, int)
        return leaving.code


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str], elsewhere: Path) -> Callable[..., str]:
    """Runs a command that has to fail with exit code 2 and one line, and gives that line."""

    def run(*words: object) -> str:
        capsys.readouterr()
        assert code_of(*words) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        lines = printed.err.splitlines()
        assert len(lines) == 1, printed.err
        assert lines[0].startswith("hatn-sim: ")
        assert list(elsewhere.iterdir()) == [], "something was left behind"
        return lines[0].removeprefix("hatn-sim: ")

    return run


def refuse_run(refused: Callable[..., str], scene: object, *words: object) -> str:
    """`hatn-sim run SCENE` into a folder that must not be there afterwards."""
    return refused("run", scene, *CV, "--out", "out", *words)


# ---------------------------------------------------------------------------------------------
# Words


def test_an_unknown_verb_or_none(
    refused: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused("rnu", "intersection5") == (
        "unknown verb 'rnu'; did you mean 'run' or 'train'?; see `hatn-sim --help`"
    )
    assert code_of() == 0
    assert "Begin with: hatn-sim run intersection5" in capsys.readouterr().out


def test_an_unknown_scene_names_the_nearest(refused: Callable[..., str]) -> None:
    expected = "unknown scene 'roundabot8'; did you mean 'roundabout8'"
    for words in (("run", *CV), ("scenarios",)):
        assert refused(*words, "roundabot8").startswith(expected)
    assert refused("bench", "--scene", "roundabot8").startswith(expected)
    assert refused("train", "--scenes", "roundabot8", "--out", "w.safetensors").startswith(expected)
    for name in find_scenarios():
        assert name in refuse_run(refused, "zzzzzz")


@pytest.mark.parametrize("value", ["0", "-5", "nan", "inf", "soon"])
def test_a_duration_that_is_none(refused: Callable[..., str], value: str) -> None:
    line = refuse_run(refused, "intersection5", "--duration", value)
    assert line.startswith("argument --duration: expected ")
    assert repr(value) in line
    assert line.endswith("see `hatn-sim run --help`")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("run",), "name a SCENE, or give --tracks FILE --map FILE"),
        (("run", "intersection5", "--sede", "1"), "unknown option --sede; did you mean --seed?"),
        (("evaluate", "--wieghts=a"), "unknown option --wieghts; did you mean --weights?; see `"),
        (("run", "intersection5", "--zzz"), "unknown option --zzz; see `hatn-sim run --help`"),
        (("run", "intersection5", "--seed", "one"), "argument --seed: invalid int value: 'one'"),
        (("run", "intersection5", *CV, "--seed", "-1"), "seed: expected 0 to 2147483647, found -1"),
        (("run", "intersection5", *CV, "--warm-up", "-1"), "argument --warm-up: expected seconds,"),
        (("run", "intersection5", *CV, "--lines", "seen"), "argument --lines: invalid choice"),
        (("run", "intersection5", *CV, "--density", "dnse"), "{toml}: unknown density 'dnse'; did"),
        (("run", "intersection5", *CV, "--risk", "asertive"), "{toml}: unknown risk 'asertive'; "),
        (("run", "intersection5", "--predictor", "hatm"), "unknown predictor 'hatm'; did you mean"),
        (("run", "intersection5", *CV, "--compare", "idn"), "unknown predictor 'idn'; did you mea"),
        (("run", "intersection5", "--predictor", "nowhere:Mine"), "predictor 'nowhere:Mine': No m"),
        (("run", "intersection5", "--predictor", "json:Mine"), "predictor 'json:Mine': module 'js"),
        (("run", "intersection5", "--predictor", "json:JSONDecoder"), "predictor 'json:JSONDecod"),
        (("scenarios", "--seeds", "4-1"), "argument --seeds: expected seeds in rising order, foun"),
        (("scenarios", "--workers", "0"), "argument --workers: expected a whole number above 0, f"),
        (("bench", "--vehicles", "10,none"), "argument --vehicles: expected a whole number above"),
        (("bench", "--steps", "0"), "argument --steps: expected a whole number above 0, found '0'"),
        (("train", "--out", "weights"), "--out weights: expected a name that ends in .safetensors"),
        (("train", "--out", "w.safetensors", "--seeds", "1-5", "--tune", "5"), "--seeds and --tu"),
        (("score", "nothing"), "nothing: expected the folder of a run, found no run.json in it; "),
        (("report", "nothing"), "nothing: expected the folder of a run, found no run.json in it; "),
    ],
)
def test_words_that_are_wrong(
    refused: Callable[..., str], words: Sequence[str], expected: str
) -> None:
    toml = find_scenarios()["intersection5"]
    assert refused(*words).startswith(expected.format(toml=toml))


# ---------------------------------------------------------------------------------------------
# Files


def test_a_missing_or_malformed_scenario_toml(refused: Callable[..., str], street: Path) -> None:
    toml = street / "scenario.toml"
    toml.write_text(SCENE + 'colour = "red"\n')
    assert refuse_run(refused, street).startswith(f"{toml}: unknown key 'colour'")
    toml.write_text(SCENE.replace('"A street"', "A street"))
    assert refuse_run(refused, street).startswith(f"{toml}:2: not valid TOML: ")
    toml.write_text(SCENE.replace('title = "A street"\n', ""))
    assert refuse_run(refused, street) == f"{toml}: key 'title' is missing: add a text"
    toml.unlink()
    assert refuse_run(refused, toml).startswith(f"{toml}: cannot be read: No such file")
    expected = f"{street}: expected the folder of a scene (with a scenario.toml) or of a run "
    assert refuse_run(refused, street).startswith(expected)


@pytest.mark.parametrize(
    ("option", "name"), [("net-file", "street.net.xml"), ("route-files", "street.rou.xml")]
)
def test_a_missing_or_malformed_net_or_route_file(
    refused: Callable[..., str], street: Path, option: str, name: str
) -> None:
    file, config = street / name, street / "street.sumocfg"
    content = file.read_text()
    file.write_text(content[: len(content) // 2])
    line = refuse_run(refused, street)
    assert line.startswith(f"{config}: SUMO refuses it: Error: ")
    assert f"In file '{file}'" in line
    file.unlink()
    for scene in (street, config):
        assert refuse_run(refused, scene).startswith(
            f"{config}: {option}: there is no file {file}; "
        )


def test_a_sumocfg_that_sumo_refuses(refused: Callable[..., str], street: Path) -> None:
    config = street / "street.sumocfg"
    content = config.read_text()
    config.write_text(content.replace("</time>", '</time><speling value="1"/>'))
    assert refuse_run(refused, config).startswith(
        f"{config}: SUMO refuses it: Error: No option with the name 'speling' exists"
    )
    config.write_text(content.replace("</time>", ""))
    assert refuse_run(refused, config).startswith(f"{config}:12: not well-formed XML: ")
    config.unlink()
    assert refuse_run(refused, config).startswith(f"{config}: cannot be read: No such file")


def test_a_scene_without_vehicles_or_junctions(refused: Callable[..., str], street: Path) -> None:
    config = street / "street.sumocfg"
    (street / "street.rou.xml").write_text("<routes/>")
    assert refuse_run(refused, config).startswith(f"{config}: it has no vehicles: expected some")
    (street / "street.rou.xml").write_text(
        '<routes><vehicle id="a" depart="0"><route edges="only"/></vehicle></routes>'
    )
    (street / "street.net.xml").write_text(
        """<net version="1.20"><location netOffset="0,0" convBoundary="0,0,50,0"
        origBoundary="0,0,50,0" projParameter="!"/>
        <edge id="only" from="a" to="b" priority="1">
        <lane id="only_0" index="0" speed="10" length="50" shape="0,0 50,0"/></edge>
        <junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,1"/>
        <junction id="b" type="dead_end" x="50" y="0" incLanes="only_0" intLanes=""
        shape="50,0 50,1"/></net>"""
    )
    assert refuse_run(refused, config).startswith(f"{config}: its net has no junction: expected ")


def test_an_output_folder_that_exists_or_cannot_be_made(
    refused: Callable[..., str], tmp_path: Path
) -> None:
    there = tmp_path / "there"
    there.mkdir()
    (there / "mine").touch()
    run = ("run", "intersection5", *CV, *SHORT, "--out")
    assert refused(*run, there).startswith(f"{there}: exists already; expected a new folder")
    assert [path.name for path in there.iterdir()] == ["mine"]
    below = there / "mine" / "run"
    assert refused(*run, below).startswith(f"{below}: the output folder cannot be made (Not a dir")


def test_weights_of_another_version_missing_or_corrupt(
    refused: Callable[..., str], weights: Path
) -> None:
    def line() -> str:
        given = ("--weights", weights, "--out", "out")
        said = refused("run", "intersection5", *given)
        assert refused("bench", *given[:2]) == said
        return said

    card, content = weights.with_suffix(".json"), weights.read_bytes()
    written = card.read_text()
    card.write_text(json.dumps(json.loads(written) | {"format": 99}))
    assert line().startswith(f"weights {weights}: format 99, this version reads format 4; train")
    card.write_text(written.replace('"width": 8', '"width": 9', 1))
    assert line().startswith(f"weights {weights}: cannot be read as the networks of its card (")
    card.write_text(written[:20])
    assert line().startswith(f"weights card {card}: not a card (")
    card.write_text(written)
    weights.write_bytes(content[:-100])
    assert line().startswith(f"weights {weights}: cannot be read as the networks of its card (")
    weights.unlink()
    assert line().startswith(f"weights {weights}: no file raw.safetensors there; give a .safetens")


def test_two_predictors_of_one_name(
    refused: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "my_predictor.py").write_text(
        "from hatn_sim.predictors.constant_velocity import ConstantVelocity as Mine\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    line = refuse_run(refused, "intersection5", "--compare", "my_predictor:Mine")
    assert line.startswith("two predictors call themselves 'constant_velocity'; ")


# ---------------------------------------------------------------------------------------------
# Runs that work


def files_of(folder: Path) -> dict[str, bytes]:
    """What is in a log, timings aside."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "timing.json"
    }


@pytest.mark.usefixtures("networks_frozen_anew")
def test_a_seed_gives_the_same_log_byte_for_byte_and_another_gives_another(
    street: Path, weights: Path
) -> None:
    def log(out: str, seed: int) -> dict[str, bytes]:
        words = ("--weights", weights, "--compare", "idm", "--seed", seed, "--warm-up", "20")
        assert code_of("run", street, *words, *SHORT, "--duration", "5", "--out", out) == 0
        assert json.loads((Path(out) / "timing.json").read_text())["frames"] == 50
        return files_of(Path(out))

    first, again, other = log("first", 1), log("again", 1), log("other", 2)
    assert {"run.json", "scores.json", "suggestions.jsonl", "alerts.jsonl", "road.json.gz"} <= set(
        first
    )
    assert first == again
    tracks = "tracks/part-00000.parquet"
    assert first[tracks] != other[tracks]
    assert first["road.json.gz"] == other["road.json.gz"]


def test_json_of_run_and_score_is_the_list_of_scores_and_the_rate_of_the_run(
    street: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--warm-up", "20", "--compare", "idm", "--out", "run", "--json", "--duration", "8")
    assert code_of("run", street, *CV, *SHORT[2:], *words) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    *scores, rate, factor = json.loads(printed.out)
    assert [(row["measure"], row["unit"]) for row in (rate, factor)] == [
        ("steps_per_second", "1/s"),
        ("real_time_factor", "x"),
    ]
    for row in (rate, factor):
        assert (row["predictor"], row["scene"], row["subset"], row["n"], row["low"]) == (
            *("constant_velocity", "street", "all", 80, None),
        )
    assert factor["value"] == pytest.approx(0.1 * rate["value"]) and rate["value"] > 0.0
    assert code_of("score", "run", "--json") == 0
    assert json.loads(capsys.readouterr().out) == scores
    assert json.loads(Path("run/scores.json").read_text()) == scores
    keys = (
        "measure", "predictor", "scene", "subset", "adapt", "value", "unit", "n", "low", "high",
        "std",
    )  # fmt: skip
    # Of recorded tracks it says what lines follow, and of what was trained on that it was.
    assert tuple(field.name for field in fields(Score)) == (*keys, "lines", "seen")
    assert all(tuple(score) == keys for score in [*scores, rate, factor])
    found = {(score["predictor"], score["measure"], score["subset"]): score for score in scores}
    for predictor in ("constant_velocity", "idm"):
        for measure in ("ade_3s", "fde_3s", "ade_0s3", "fde_0s3"):
            score = found[predictor, measure, "all"]
            assert score["n"] > 0 and score["unit"] == "m" and score["scene"] == "street"
            assert score["low"] <= score["value"] <= score["high"]
        assert found[predictor, "ade_3s", "moving"]["n"] > 0
        slots = found[predictor, "slot_accuracy", "all"]
        assert (slots["value"], slots["low"], slots["high"], slots["n"]) == (None, None, None, 0)


@pytest.mark.parametrize(
    ("rate", "text"),
    [(0.0, "0"), (0.0437, "0.044"), (0.5, "0.5"), (1.04, "1.0"), (9.6, "9.6"), (37.6, "38")],
)
def test_rates_have_digits_that_say_something(rate: float, text: str) -> None:
    assert rate_text(rate) == text


def test_a_run_ends_with_its_table_its_rate_and_its_place(
    street: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--warm-up", "20", "--no-picture", "--duration", "4", "--egos", "a.0,a.999")
    assert code_of("run", street / "street.sumocfg", *CV, *words) == 0
    printed = capsys.readouterr()
    assert "street: errors in metres, all samples" in printed.out
    assert "40 steps of 0.1 s" in printed.out
    assert "times real time" in printed.out
    assert printed.out.splitlines()[-1] == "log and scores in runs/street-1"
    never = [line for line in printed.err.splitlines() if "never" in line]
    assert never == ["hatn-sim: never seen in this run: --egos a.999"]
    # The next run takes the next free folder, and score reads both.
    assert code_of("run", street, *CV, *SHORT, "--warm-up", "20") == 0
    assert capsys.readouterr().out.splitlines()[-1] == "log and scores in runs/street-2"
    assert code_of("score", "runs/street-1", "runs/street-2") == 0
    assert capsys.readouterr().out.startswith("street: errors in metres, all samples")


def test_notices_about_the_scene_are_given_and_can_be_silenced(
    street: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = street / "street.sumocfg"
    config.write_text(config.read_text().replace('<step-length value="0.1"/>', ""))
    words = ("run", config, *CV, "--duration", "1", "--no-picture")
    assert code_of(*words) == 0
    said = "hatn-sim: step-length 1 s (default) in street.sumocfg: run at 0.1 s with 1 s as action"
    assert said in capsys.readouterr().err
    assert code_of(*words, "--quiet") == 0
    assert capsys.readouterr().err == ""


def test_a_picture_with_the_run_or_afterwards(
    street: Path, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("run", street, "--weights", weights, "--warm-up", "20", "--duration")
    assert code_of(*words, "4", *SHORT[2:], "--out", "run") == 0
    assert not list(Path("run").glob("moment.*"))
    capsys.readouterr()
    assert code_of("report", "run", "--no-animation", "--time", "20.5") == 0
    assert capsys.readouterr().out == "run/report.html\nrun/moment.png\n"
    assert Path("run/moment.png").read_bytes().startswith(b"\x89PNG")
    for wrong, said in (
        (("--time", "900"), "run: no time 900 s; expected 20.0 to 23.9 s"),
        (("--ego", "nobody"), "run: no vehicle 'nobody'; known: "),
    ):
        assert code_of("report", "run", *wrong) == 2
        assert capsys.readouterr().err.startswith(f"hatn-sim: {said}")
    # Too short a run for a picture is a run nevertheless, and so is one whose scene is over.
    assert code_of(*words, "1", "--out", "short") == 0
    printed = capsys.readouterr()
    assert "hatn-sim: no picture: short: nobody is in view for 3 s" in printed.err
    assert printed.out.splitlines()[-1] == "log and scores in short"
    assert code_of("run", street, *CV, "--warm-up", "599", "--duration", "20", "--out", "end") == 0
    assert "hatn-sim: the scene was over after 11 of 200 steps" in capsys.readouterr().err


# ---------------------------------------------------------------------------------------------
# Runs that do not end well


def test_a_worker_killed_in_the_middle_leaves_a_readable_log(
    street: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    step, steps = SumoSimulator.step, iter(range(1000))

    def step_and_kill(self: SumoSimulator, *commands: Any) -> Frame:
        if next(steps) == 330:
            assert self.worker_pid is not None
            os.kill(self.worker_pid, signal.SIGKILL)
        return step(self, *commands)

    words = ["run", str(street), *CV, "--seed", "7", "--warm-up", "2", "--duration", "60"]
    with monkeypatch.context() as patch:
        patch.setattr(SumoSimulator, "step", step_and_kill)
        assert code_of(*words, *SHORT[2:], "--out", "out") == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("hatn-sim: SUMO stopped in street at 33.0 s (seed 7): its process ")
    assert lines[0].endswith("; the log up to here is in out")
    logged = read_run(Path("out"))
    assert not logged.finished
    assert logged.frame_count == 330 - 20 + 1  # the frame of the reset is one of them
    assert sum(1 for _ in logged.frames()) == logged.frame_count
    # The command it names repeats the run.
    command = shlex.split(lines[0].split("`")[1])
    assert command[0] == "hatn-sim"
    assert code_of(*command[1:], *SHORT[2:], "--duration", "31.1", "--out", "again") == 0
    capsys.readouterr()
    tracks = "tracks/part-00001.parquet"
    assert files_of(Path("again"))[tracks] == files_of(Path("out"))[tracks]
    assert code_of("score", "out") == 0
    printed = capsys.readouterr()
    # 311 frames
    assert printed.err == ("hatn-sim: out is of an unfinished run: its first 31.1 s were written\n")
    assert "street: errors in metres" in printed.out


def test_ctrl_c_leaves_a_readable_log_and_names_its_place(elsewhere: Path) -> None:
    command = [sys.executable, "-m", "hatn_sim.cli", "run", "tjunction", *CV, "--duration", "9000"]
    process = subprocess.Popen(
        [*command, "--no-picture", "--out", "out"],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=heed_ctrl_c,
        env=os.environ | {"PYTHONPATH": str(Path(cli.__file__).parents[1])},
    )
    part = elsewhere / "out" / "frames" / "part-00000.parquet"
    while not part.exists() and process.poll() is None:  # however slow the machine is now
        time.sleep(0.1)
    assert process.poll() is None
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the worker as well
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.endswith("hatn-sim: interrupted; the log up to here is in out\n"), err
    assert "Traceback" not in err
    logged = read_run(elsewhere / "out")
    assert not logged.finished
    assert logged.frame_count >= 300
    assert sum(1 for _ in logged.scenes()) == logged.frame_count


# ---------------------------------------------------------------------------------------------
# Help, scenes, doctor


def test_help_of_every_verb_answers_without_heavy_imports() -> None:
    program = f"""
import sys
from hatn_sim import cli
for words in ([], *([verb] for verb in cli.VERBS)):
    try:
        cli.main([*words, "--help"])
    except SystemExit as leaving:
        assert leaving.code == 0
print("heavy:", [name for name in {HEAVY!r} if name in sys.modules])
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(Path(cli.__file__).parents[1])},
    )
    assert done.stdout.splitlines()[-1] == "heavy: []"
    for verb in cli.VERBS:
        assert f"usage: hatn-sim {verb}" in done.stdout
    assert done.stdout.count("\nexample") == len(cli.VERBS)


def test_scenarios_lists_every_scene_with_its_card(capsys: pytest.CaptureFixture[str]) -> None:
    assert code_of("scenarios", "--json") == 0
    listed = json.loads(capsys.readouterr().out)
    names = [scene["name"] for scene in listed]
    assert sorted(names) == sorted(find_scenarios())
    tested = scenes_to_test_on()
    suites = [name for suite in SUITES for name in scenes_of_suite(suite)]
    to_learn_on = names[len(tested) : -len(suites)]
    assert names == [*tested, *to_learn_on, *suites]
    assert all(name.startswith("learn_") for name in to_learn_on)
    for scene in listed:
        assert scene["title"] and scene["description"]
        if scene["name"] in suites:
            assert scene["density"] == scene["risk"] == {}
            ((suite, of_one),) = scene["suite"].items()
            assert scene["name"] in scenes_of_suite(suite)
            assert set(of_one["card"]) == set(scenarios.SUITE_TITLES)
            assert of_one["measured"] is None
            continue
        assert scene["suite"] == {}
        if load_scenario(scene["name"]).simulator == "recorded":
            assert scene["density"] == scene["risk"] == {}  # what happened, happened
            continue
        by_sumo = load_scenario(scene["name"]).simulator == "sumo"
        if scene["name"].startswith("learn_racetrack"):
            assert scene["density"] == scene["risk"] == {}  # a closed way: nobody comes in
            continue
        assert list(scene["density"]) == ["light", "normal", "dense"]
        risks = {"courteous", "assertive", "inattentive"} if by_sumo else set[str]()
        assert set(scene["risk"]) == risks
        for table, titles in (
            ("density", scenarios.DENSITY_TITLES),
            ("risk", scenarios.RISK_TITLES),
        ):
            for of_one in scene[table].values():
                assert set(of_one["card"]) == set(titles)
                unknown = {key for key, value in of_one["card"].items() if value is None}
                assert unknown == (set() if by_sumo else {"mean_delay_s"})
                assert of_one["measured"] is None
    assert code_of("scenarios", "no_warn_crossing", "learn_tee3", "tjunction") == 0
    table = capsys.readouterr().out
    order = ("tjunction", "To learn on", "learn_tee3", "Suite no_warn", "no_warn_crossing")
    places = [table.index(word) for word in order]
    assert places == sorted(places)
    assert code_of("scenarios", "roundabout8") == 0
    table = capsys.readouterr().out
    assert table.startswith("roundabout8  ")
    assert "intersection5" not in table
    normal = next(scene for scene in listed if scene["name"] == "roundabout8")["density"]["normal"]
    row = next(line for line in table.splitlines() if line.startswith("normal"))
    assert row.split()[1] == f"{normal['card']['vehicles_at_once']:.1f}"


def test_scenarios_measured_anew_stand_beside_the_card(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scenarios, "WARM_UP_S", 50.0)  # bounds are wide
    words = ("scenarios", "tjunction", "--measure", "--seeds", "1", "--duration", "20")
    assert code_of(*words, "--json") == 0
    printed = capsys.readouterr()
    # courteous at normal density is measured once for both tables
    assert [line.split(":")[1] for line in printed.err.splitlines()] == [
        f" measured {done} of 5" for done in range(1, 6)
    ]
    (scene,) = json.loads(printed.out)
    for name in ("light", "normal", "dense"):
        measured, card = (scene["density"][name][key] for key in ("measured", "card"))
        assert measured.keys() == card.keys()
        assert 0.2 < measured["vehicles_at_once"] / card["vehicles_at_once"] < 5.0
    assert scene["risk"]["courteous"]["measured"]["collisions_per_1000"] == 0.0


def test_scenarios_of_a_folder_without_a_card(
    street: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drivers = find_scenarios()["intersection5"].parents[1] / "drivers" / "courteous.add.xml"
    (street / "scenario.toml").write_text(
        f'{SCENE}[density]\nnormal = 1\n[risk]\ncourteous = "{drivers}"\n[card]\ndensity = 3\n'
    )
    assert code_of("scenarios", street) == 0
    assert capsys.readouterr().out.count(" -") == 7


def test_doctor_finds_what_the_core_needs(capsys: pytest.CaptureFixture[str]) -> None:
    code = code_of("doctor", "--json")
    checks = {check["name"]: check for check in json.loads(capsys.readouterr().out)}
    assert code == int(not all(check["ok"] for check in checks.values() if check["needed"]))
    assert checks["SUMO worker"]["ok"] and checks["scenes, agents"]["ok"]
    assert checks["libsumo"]["found"].startswith("1.28")
    assert code_of("doctor") == code
    assert "SUMO worker" in capsys.readouterr().out


def test_a_density_that_is_not_there_yet_is_told() -> None:
    dense = load_scenario("roundabout8", "dense")  # its card: 81.8 vehicles at once
    assert said_of_density(dense, 40, 60.0) == (
        "roundabout8 fills up slowly: after 60 s of warm-up 40 vehicles are there, of about 82 "
        "later on in dense traffic; for more of them --warm-up 300 or longer"
    )
    assert said_of_density(dense, 41, 60.0) is None
    assert said_of_density(dense, 0, 300.0) is None
    assert said_of_density(load_scenario("roundabout8"), 8, 60.0) is None
    assert said_of_density(load_scenario(str(NETS / "street.sumocfg")), 0, 60.0) is None
