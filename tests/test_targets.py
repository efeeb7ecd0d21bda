"""What the weights that ship must reach on seeds they have never seen; minutes, so marked slow."""

from __future__ import annotations

from pathlib import Path

import pytest

from hatn_sim.cli import main
from hatn_sim.datatypes import Score
from hatn_sim.log import read_run
from hatn_sim.score.prediction import score_runs

SEEDS = (601, 602, 603, 604, 605)


def scores_of(scene: str, folder: Path) -> dict[tuple[str, str, str], Score]:
    runs = []
    for seed in SEEDS:
        out = folder / f"{scene}-{seed}"
        words = f"run {scene} --seed {seed} --duration 120 --compare constant_velocity,idm"
        assert main([*words.split(), "--no-picture", "--quiet", "--json", "--out", str(out)]) == 0
        runs.append(read_run(out))
    return {(s.measure, s.predictor, s.subset): s for s in score_runs(runs)}


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "share"), [("intersection5", 0.35), ("roundabout8", 0.55)])
def test_accuracy_on_unseen_seeds(scene: str, share: float, tmp_path: Path) -> None:
    scores = scores_of(scene, tmp_path)

    def value(measure: str, predictor: str = "hatn", subset: str = "all") -> float:
        found = scores[measure, predictor, subset].value
        assert found is not None
        return found

    for subset in ("all", "moving"):
        assert value("ade_3s", "hatn", subset) <= share * value(
            "ade_3s", "constant_velocity", subset
        )
        assert value("ade_3s", "hatn", subset) < value("ade_3s", "idm", subset)
    assert value("ade_0s3") <= value("ade_0s3", "constant_velocity")
    assert value("slot_accuracy") >= 0.9
    assert value("slot_macro_f1") >= 0.75
