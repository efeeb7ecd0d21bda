"""Predictors by name, somebody's own beside them, and one line for whatever goes wrong there."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import crossing_lanes, scene_of

from hatn_sim import cli
from hatn_sim.datatypes import Frame, Truth
from hatn_sim.errors import InputError
from hatn_sim.loop import Adviser, begin, check_prediction, tick
from hatn_sim.predictors.constant_velocity import ConstantVelocity
from hatn_sim.predictors.find import PREDICTORS, READS_WEIGHTS, load_predictor
from hatn_sim.road import Road

MINE = """
from hatn_sim.predictors.constant_velocity import ConstantVelocity

class Mine(ConstantVelocity):
    name = "mine"

class Wants(Mine):
    def __init__(self, what):
        self.what = what

class Raises(Mine):
    def __init__(self):
        raise OSError("no such\\nfile of mine")

class Empty:
    name = "empty"

number = 3
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working directory with modules of one's own, which sys.path does not name."""
    (tmp_path / "my_predictors.py").write_text(MINE)
    (tmp_path / "my_broken.py").write_text("def (")
    (tmp_path / "my_division.py").write_text("1 / 0")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p not in ("", str(tmp_path))])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("my_")]:
        del sys.modules[name]


@pytest.mark.parametrize("name", [name for name in PREDICTORS if name not in READS_WEIGHTS])
def test_shipped_predictors_by_name(name: str) -> None:
    assert load_predictor(name).name == name


def test_a_module_in_the_working_directory_is_found() -> None:
    assert load_predictor("my_predictors:Mine").name == "mine"
    before = list(sys.path)
    load_predictor("my_predictors:Mine")
    assert sys.path == before, "the directory is put there once"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (":X", "Empty module name (ValueError)"),
        ("..x:Y", "(TypeError)"),
        ("my_predictors:", "(AttributeError)"),
        ("my_predictors:Mien", "module 'my_predictors' has no attribute 'Mien' (AttributeError)"),
        ("my_predictors:number", "'int' object is not callable (TypeError)"),
        ("my_predictors:Wants", "missing 1 required positional argument: 'what'"),
        ("my_predictors:Raises", "no such file of mine (OSError)"),
        ("my_predictors:Empty", "has no 'init', see datatypes.Predictor"),
        ("my_broken:X", "(SyntaxError)"),
        ("my_division:X", "division by zero (ZeroDivisionError)"),
        ("my_missing:X", "No module named 'my_missing' (ModuleNotFoundError)"),
        ("argparse:Action", "(TypeError)"),
    ],
)
def test_what_goes_wrong_is_one_line(name: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        load_predictor(name)
    text = str(caught.value)
    assert text.startswith(f"predictor {name!r}: ")
    assert said in text
    assert "\n" not in text


def test_unknown_names() -> None:
    with pytest.raises(InputError, match=r"unknown predictor 'idn'; did you mean 'idm'\?"):
        load_predictor("idn")


@pytest.mark.parametrize("compare", [(), ("--compare", "my_predictors:Mine")])
def test_weights_that_nobody_reads_are_refused(
    here: Path, capsys: pytest.CaptureFixture[str], compare: tuple[str, ...]
) -> None:
    words = ["run", "tjunction", "--predictor", "idm", *compare, "--weights", "w.safetensors"]
    assert cli.main([*words, "--out", str(here / "out")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("hatn-sim: --weights w.safetensors: idm")
    assert "cannot use it; leave it out, or add hatn" in said
    assert not (here / "out").exists()


class _Raises:
    name = "raises"

    def init(self, road: object) -> None:
        return None

    def observe(self, state: object, scene: object, routes: object = None) -> None:
        raise KeyError("x")

    def predict(self, state: object) -> int:
        return 3


class _WrongType(_Raises):
    def observe(self, state: object, scene: object, routes: object = None) -> None:
        return None


@pytest.mark.parametrize(
    ("predictor", "words"),
    [
        (_Raises(), r"'raises' failed at 0.3 s: KeyError: 'x' \(test_predictors.py:\d+\)"),
        (_WrongType(), "'raises': predict returned int, expected hatn_sim.datatypes.Prediction"),
    ],
)
def test_a_predictor_that_fails_is_named(predictor: object, words: str) -> None:
    adviser = Adviser(predictor)  # type: ignore[arg-type]
    road = Road(crossing_lanes())
    scene = scene_of(0.3, {"a": (30.0, 0.0, 0.0, 5.0)})
    frame = Frame(scene, Truth(routes=(None,)), done=False)
    with pytest.raises(InputError, match=words):
        tick(adviser, begin(adviser, road), frame)


def test_a_prediction_of_another_shape_or_not_finite_is_refused() -> None:
    scene = scene_of(0.0, {"a": (0.0, 0.0, 0.0, 5.0), "b": (30.0, 0.0, 0.0, 5.0)})
    good = ConstantVelocity().predict(scene)
    check_prediction("mine", good, scene)
    short = replace(good, xy_m=good.xy_m[:, :, :20])
    with pytest.raises(InputError, match=r"xy_m has shape \(2, 1, 20, 2\), expected"):
        check_prediction("mine", short, scene)
    holes = replace(good, xy_m=np.where(np.arange(2)[:, None, None, None] == 1, np.nan, good.xy_m))
    with pytest.raises(InputError, match="the prediction for 'b' is not finite"):
        check_prediction("mine", holes, scene)
    with pytest.raises(InputError, match="ids are not those of the scene"):
        check_prediction("mine", replace(good, ids=("b", "a")), scene)
