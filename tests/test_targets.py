"""What the weights that ship must reach on seeds they have never seen; minutes, so marked slow."""

from __future__ import annotations

import json
from collections.abc import Callable
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
