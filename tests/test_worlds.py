"""Several worlds on one road, seen and predicted at once: what each is alone."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Lines, Scene, SemanticGraphs, Tracks
from hatn_sim.envs.scene_env import SceneEnv
from hatn_sim.envs.vector_env import SceneVectorEnv
from hatn_sim.hatn.predictor import Hatn
from hatn_sim.loop import RELEASE_FRAMES
from hatn_sim.perception import PerceptionState, begin, perceive, perceive_all
from hatn_sim.resources import weights_dir
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.worlds import is_closed, near_pairs, worlds_joined

Runs = tuple[Road, list[list[Scene]]]
SHIPPED = Path(weights_dir() / "hatn.safetensors")


@pytest.fixture(scope="module")
def runs() -> Runs:
    """The same twelve frames of three seeds, of which one has nobody yet in the first."""
    scenes: list[list[Scene]] = []
    with SumoSimulator(load_scenario("intersection4_allway")) as simulator:
        for seed, waited in ((1, 500), (2, 700), (3, 0)):
            first = simulator.reset(seed)
            before = simulator.drive_on([()] * waited, kept=1)() if waited else [first]
            frames = [before[-1], *simulator.drive_on([()] * 30)()]
            scenes.append([frame.scene for frame in frames])
        return simulator.road, scenes


def test_seen_at_once_as_one_by_one(runs: Runs) -> None:
    road, scenes = runs
    together = alone = [begin(road)] * len(scenes)
    counts: set[int] = set()
    for now in zip(*scenes, strict=True):
        together = perceive_all(together, now, None)
        alone = [perceive(one, scene, None) for one, scene in zip(alone, now, strict=True)]
        for one, other in zip(together, alone, strict=True):
            _assert_same(one, other)
            counts.add(len(one.seen.scene.ids))
    assert min(counts) == 0 and max(counts) > 5


def _assert_same(one: PerceptionState, other: PerceptionState) -> None:
    assert one.seen.scene is other.seen.scene and one.seen.tracks.ids == other.seen.tracks.ids
    for name in (part.name for part in fields(Tracks)):
        np.testing.assert_array_equal(
            getattr(one.seen.tracks, name), getattr(other.seen.tracks, name)
        )
    for name in (part.name for part in fields(Lines)):
        found, expected = getattr(one.seen.lines, name), getattr(other.seen.lines, name)
        np.testing.assert_allclose(found, expected, atol=1e-12, err_msg=name)
    for name in ("line", "chosen", "doubted", "renewed", "rest", "inside"):
        found, expected = getattr(one.line_state, name), getattr(other.line_state, name)
        np.testing.assert_array_equal(found, expected, err_msg=name)
    learnt, known = one.line_state.habits, other.line_state.habits
    assert learnt is not None and known is not None
    np.testing.assert_array_equal(learnt.taken, known.taken)
    assert (learnt.signalled, learnt.turned) == (known.signalled, known.turned)


def test_predicted_at_once_as_one_by_one(runs: Runs) -> None:
    road, scenes = runs
    hatn = Hatn(SHIPPED)
    states = [hatn.init(road)] * len(scenes)
    for now in zip(*scenes, strict=True):
        states = hatn.observe_all(states, now)
    for found, state in zip(hatn.predict_all(states), states, strict=True):
        expected = hatn.predict(state)
        assert found.ids == expected.ids and found.lines is state.seen.lines
        np.testing.assert_allclose(found.xy_m, expected.xy_m, atol=1e-3)
        np.testing.assert_allclose(found.mode_probability, expected.mode_probability, atol=1e-5)
        assert found.graphs is not None and expected.graphs is not None
        assert found.slot_probability is not None and expected.slot_probability is not None
        np.testing.assert_allclose(found.slot_probability, expected.slot_probability, atol=1e-5)
        assert found.graphs.ids == expected.graphs.ids
        for name in (part.name for part in fields(SemanticGraphs) if part.name != "ids"):
            np.testing.assert_allclose(
                getattr(found.graphs, name), getattr(expected.graphs, name), atol=1e-9, err_msg=name
            )


def test_lines_of_those_side_by_side_stay_while_one_of_them_has_them() -> None:
    """Reset one again and again: the lines that another is on are not let go of meanwhile."""
    options = {"scene": "intersection4_allway", "frames_per_step": 1, "warm_up_s": 20.0}
    vector = SceneVectorEnv(2, advice=False, masked_action="yield", **options)
    try:
        vector.reset(seed=1)
        one, other = (env.unwrapped for env in vector.envs)
        assert isinstance(one, SceneEnv) and isinstance(other, SceneEnv)
        road = one._simulator.road
        assert road is other._simulator.road
        assert other._episode is not None and other._episode.mind is not None
        held = other._episode.mind.state.perception.line_state.line
        for _ in range(RELEASE_FRAMES):
            road.touch(np.zeros(0, dtype=np.int64))
        one._release_lines()
        road.release(RELEASE_FRAMES, keep=0)
        assert set(held[held >= 0].tolist()).isdisjoint(road._free) and len(held)
    finally:
        vector.close()


def test_nobody_meets_anybody_of_another_world(runs: Runs) -> None:
    first, second = runs[1][0][0], runs[1][1][0]
    worlds = worlds_joined([first, second])
    rows = np.arange(len(worlds.ids))
    pairs = {tuple(sorted(pair)) for pair in near_pairs(worlds, rows, 40.0).tolist()}
    expected: set[tuple[int, int]] = set()
    for scene, rows_of in zip((first, second), worlds.rows, strict=True):
        for i in range(len(scene.ids)):
            for j in range(i + 1, len(scene.ids)):
                if np.hypot(*(scene.xy_m[i] - scene.xy_m[j])) <= 40.0:
                    expected.add((rows_of.start + i, rows_of.start + j))
    assert pairs == expected and expected


def test_signals_are_those_of_the_own_world(runs: Runs) -> None:
    scene = runs[1][0][0]
    one = replace(scene, signal_closed=np.array([True, False]))
    other = replace(scene, signal_closed=np.array([False, True]))
    signal = np.tile([[0, 1, -1, 2]], (2 * len(scene.ids), 1))
    closed = is_closed(worlds_joined([one, other]), signal)
    assert (closed[: len(scene.ids)] == [True, False, False, False]).all()
    assert (closed[len(scene.ids) :] == [False, True, False, False]).all()
    assert not is_closed(replace(scene, signal_closed=np.zeros(0, np.bool_)), signal[:1]).any()
