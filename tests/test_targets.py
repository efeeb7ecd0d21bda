"""What the weights that ship must reach on seeds they have never seen; minutes, so marked slow."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hatn_sim.cli import main
from hatn_sim.predictors.find import PREDICTORS

RULES = tuple(name for name in PREDICTORS if name != "constant_velocity")
COMMAND = "evaluate --seeds 601-605 --duration 120 --predictors hatn,{} --quiet --json --scenes {}"


@pytest.fixture
def value(capsys: pytest.CaptureFixture[str]) -> Callable[[str], Callable[..., float]]:
    """Evaluates a scene; gives its measures."""

    def of_scene(scene: str) -> Callable[..., float]:
        words = COMMAND.format(",".join(PREDICTORS), scene).split()
        assert main(words) == 0
        scores: list[dict[str, Any]] = json.loads(capsys.readouterr().out)

        def measure(name: str, predictor: str = "hatn", subset: str = "all") -> float:
            (found,) = (
                score["value"]
                for score in scores
                if (score["measure"], score["predictor"], score["subset"])
                == (name, predictor, subset)
            )
            return float(found)

        return measure

    return of_scene


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "of_constant_velocity", "of_best_rule"),
    [
        ("intersection5", 0.25, 0.5),
        ("intersection4_allway", 0.4, 0.6),
        ("tjunction", 0.4, 0.65),
        ("roundabout8", 0.4, 0.65),
        ("roundabout4_two_lane", 0.4, 0.75),
    ],
)
def test_accuracy_on_unseen_seeds(
    scene: str,
    of_constant_velocity: float,
    of_best_rule: float,
    value: Callable[[str], Callable[..., float]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    measure = value(scene)
    for subset in ("all", "moving"):
        error = measure("ade_3s", "hatn", subset)
        best = min(measure("ade_3s", rule, subset) for rule in RULES)
        assert error <= of_constant_velocity * measure("ade_3s", "constant_velocity", subset)
        assert error <= of_best_rule * best
        assert measure("ade_0s3", "hatn", subset) < min(
            measure("ade_0s3", rule, subset) for rule in RULES
        )
    assert measure("slot_accuracy") >= 0.905
    assert measure("slot_macro_f1") >= 0.8
    assert measure("slot_ece") <= 0.03
