"""HATN with online adaptation as a predictor, and its study, in simulated traffic."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Frame
from hatn_sim.hatn.adaptation_memory import AdaptationSettings
from hatn_sim.hatn.adaptive import AdaptiveHatn
from hatn_sim.hatn.predictor import Hatn
from hatn_sim.learn.adaptation_rows import AdaptationRow, pooled, write_csv
from hatn_sim.learn.adaptation_study import vehicle_errors, watch
from hatn_sim.loop import check_prediction, warm_up
from hatn_sim.report.adaptation_figure import draw_layers, draw_steps
from hatn_sim.resources import weights_dir
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator

SETTINGS = AdaptationSettings(start_std_m=0.05)


@pytest.fixture(scope="module")
def traffic() -> tuple[Road, list[Frame]]:
    with SumoSimulator(load_scenario("intersection4_allway")) as simulator:
        frame = warm_up(simulator, simulator.reset(11), 300)
        return simulator.road, [frame, *(simulator.step() for _ in range(70))]


@pytest.fixture(scope="module")
def hatn() -> Hatn:
    return Hatn(weights_dir() / "hatn.safetensors")


def test_who_is_advised_is_predicted_as_without_adaptation(
    traffic: tuple[Road, list[Frame]],
) -> None:
    road, frames = traffic
    hatn = Hatn(weights_dir() / "hatn-paper.safetensors")  # it leaves more to be learnt
    ego = frames[30].scene.ids[0]
    adaptive = AdaptiveHatn(hatn, SETTINGS, frozenset({ego}))
    plain_state, state = hatn.init(road), adaptive.init(road)
    for frame in frames[:31]:
        plain_state = hatn.observe(plain_state, frame.scene)
        state = adaptive.observe(state, frame.scene)
    plain, prediction = hatn.predict(plain_state), adaptive.predict(state)
    check_prediction(adaptive.name, prediction, frames[30].scene)
    assert 0 < prediction.adapted.sum() < len(frames[30].scene.ids)
    assert not prediction.adapted[0]
    kept = ~prediction.adapted
    np.testing.assert_array_equal(prediction.xy_m[kept], plain.xy_m[kept])
    moved_m = np.linalg.norm(prediction.xy_m - plain.xy_m, axis=-1)[prediction.adapted]
    assert 1e-4 < moved_m.max() < 5.0


@pytest.mark.slow
def test_the_study_scores_what_the_predictor_says(
    traffic: tuple[Road, list[Frame]], hatn: Hatn, tmp_path: Path
) -> None:
    road, frames = traffic
    run = watch(hatn, road, frames)
    found = vehicle_errors(hatn.weights.edn, run, SETTINGS)
    n, changes = pooled([found])
    row = AdaptationRow("allway", "hatn", "mekf", "dense3", 3, n, changes)
    adaptive = AdaptiveHatn(hatn, SETTINGS)
    state = adaptive.init(road)
    at = [dict(zip(frame.scene.ids, frame.scene.xy_m, strict=True)) for frame in frames]
    errors: list[np.ndarray] = []
    for k, frame in enumerate(frames):
        state = adaptive.observe(state, frame.scene)
        if not run.scored[k].any():
            continue
        prediction = adaptive.predict(state)
        for name, scored in zip(run.moments[k].ids, run.scored[k], strict=True):
            if scored:
                truth = np.stack([at[k + ahead][name] for ahead in range(1, 31)])
                said = prediction.xy_m[frame.scene.ids.index(name), 0]
                errors.append(np.linalg.norm(said - truth, axis=-1))
    assert row.n == len(errors) > 10
    error = np.stack(errors)
    assert row.error_m("ade4", "adapted") == pytest.approx(error.mean(), rel=1e-3)
    assert row.error_m("ade2", "adapted") == pytest.approx(error[:, :3].mean(), rel=1e-2)
    assert row.error_m("fde", "adapted") == pytest.approx(error[:, -1].mean(), rel=1e-3)

    rows: list[AdaptationRow] = [row, replace(row, steps=5)]
    path = tmp_path / "rows.csv"
    write_csv(path, rows)
    table = path.read_text().splitlines()
    assert table[0].startswith("scene,network,method,layer,steps,measure,trained_m")
    assert table[7].split(",")[:6] == ["allway", "hatn", "mekf", "dense3", "5", "ade1"]
    for draw in (draw_steps, draw_layers):
        path = tmp_path / f"{draw.__name__}.png"
        draw({"a scene": rows}, [path])
        assert path.stat().st_size > 5000
