"""What the weights that ship must reach on seeds they have never seen; minutes, so marked slow."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from hatn_sim.cli import main
from hatn_sim.predictors.find import PREDICTORS

RULES = tuple(name for name in PREDICTORS if name != "constant_velocity")
COMMAND = (
    "evaluate --seeds 601-605 --duration 120 --predictors hatn,{} --quiet --scenes {} --out {}"
)
SCENES = (
    "intersection5",
    "intersection4_allway",
    "tjunction",
    "roundabout8",
    "roundabout4_two_lane",
)
OF_HIGHWAY_ENV = ("highway_intersection", "highway_roundabout")


@cache
def values(scene: str, lines: str = "inferred") -> dict[tuple[str, str, str], float]:
    """The measures of a scene, evaluated once for all tests, by measure, predictor and subset."""
    with TemporaryDirectory() as folder:
        out = Path(folder) / scene
        words = COMMAND.format(",".join(PREDICTORS), scene, out).split()
        assert main([*words, "--lines", lines]) == 0
        scores = json.loads((out / "scores.json").read_text())
    return {(s["measure"], s["predictor"], s["subset"]): s["value"] for s in scores}


def missed(scene: str, reached: str) -> object:
    """A target that these weights do not reach; strict, so that reaching it is noticed."""
    why = f"{reached} of the best rule's error, 0.6 is wanted"
    return pytest.param(scene, 0.6, marks=pytest.mark.xfail(strict=True, reason=why))


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_accuracy_on_unseen_seeds(scene: str) -> None:
    value = values(scene)
    share = 0.25 if scene == "intersection5" else 0.4
    for subset in ("all", "moving"):
        baseline = value["ade_3s", "constant_velocity", subset]
        assert value["ade_3s", "hatn", subset] <= share * baseline
    assert value["slot_accuracy", "hatn", "all"] >= 0.905
    assert value["slot_macro_f1", "hatn", "all"] >= 0.8
    assert value["slot_ece", "hatn", "all"] <= 0.03


@pytest.mark.slow
@pytest.mark.parametrize("scene", (*SCENES, *OF_HIGHWAY_ENV))
def test_the_first_tenths_are_better_than_any_rule(scene: str) -> None:
    value = values(scene)
    for subset in ("all", "moving"):
        best = min(value["ade_0s3", rule, subset] for rule in RULES)
        assert value["ade_0s3", "hatn", subset] < best


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "share"),
    [
        ("intersection5", 0.5),
        ("intersection4_allway", 0.6),
        missed("tjunction", "0.603"),
        ("roundabout8", 0.6),
        missed("roundabout4_two_lane", "0.594, of moving samples 0.609,"),
        missed("highway_intersection", "0.684"),
        missed("highway_roundabout", "0.898"),
    ],
)
def test_error_against_the_best_rule(scene: str, share: float) -> None:
    value = values(scene)
    for subset in ("all", "moving"):
        best = min(value["ade_3s", rule, subset] for rule in RULES)
        assert value["ade_3s", "hatn", subset] <= share * best


@pytest.mark.slow
@pytest.mark.parametrize("scene", OF_HIGHWAY_ENV)
def test_drivers_who_signal_nothing_are_predicted_well_where_their_way_is_known(scene: str) -> None:
    """What the targets missed above owe to the way; those who drive along lines know it too."""
    value = values(scene, "route")
    for subset in ("all", "moving"):
        rules = [
            error
            for (measure, name, of), error in value.items()
            if measure == "ade_3s" and of == subset and not name.startswith("hatn")
        ]
        assert value["ade_3s", "hatn+route", subset] <= 0.6 * min(rules)
