"""The examples run, and say what they promise."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from hatn_sim.datatypes import MAX_NODES
from hatn_sim.envs.features import SLOT

EXAMPLES = Path(__file__).parent.parent / "examples"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_first_look(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    example = load("drive_a_crossing")
    env = example.crossing(warm_up_s=20.0, duration_s=2.0)
    observation, _ = env.reset(seed=1)
    example.describe(observation)
    end, took_s, _ = example.drive(env, example.as_expected, 1)
    env.close()
    assert (end, took_s) == ("time", pytest.approx(2.0))
    said = capsys.readouterr().out
    assert "others in view" in said and "yield: a human would with probability" in said
    example.record(example.patient, 1, tmp_path / "a.gif", most_steps=2)
    with Image.open(tmp_path / "a.gif") as video:
        assert video.size == (720, 480) and getattr(video, "n_frames", 1) == 3


def test_the_slot_that_is_expected() -> None:
    slots = np.zeros((MAX_NODES, len(SLOT)), np.float32)
    slots[:3, -1] = [0.2, 0.3, 0.5]
    mask = np.array([1, 1, 0, 0, 0, 0, 0, 0], np.float32)
    assert load("drive_a_crossing").as_expected({"slots": slots, "action_mask": mask}) == 1


def test_several_drive(capsys: pytest.CaptureFixture[str]) -> None:
    load("drive_several").main(egos=2)
    assert "left: []" in capsys.readouterr().out


def test_highway_env_with_predictions(capsys: pytest.CaptureFixture[str]) -> None:
    load("predict_in_highway_env").main(seeds=(4,), predictor="idm")
    assert capsys.readouterr().out.startswith("seed 4: crashed after ")
