"""The wrapper for highway-env: against highway-env itself and against our own simulator of it."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import highway_env.road.road
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import Autoreset, TimeLimit

from hatn_sim.config import HighwaySource, Scenario
from hatn_sim.datatypes import DT_S
from hatn_sim.envs.errors import NeedsResetError, OptionError
from hatn_sim.envs.prediction_observation import OWN_KEY, PredictionObservation
from hatn_sim.envs.scene_env import SceneEnv
from hatn_sim.errors import InputError
from hatn_sim.simulators.highway_watched import Watched

CHEAP = "constant_velocity"


@pytest.fixture
def kept() -> Iterator[list[gymnasium.Env[Any, Any]]]:
    """Environments to be closed."""
    environments: list[gymnasium.Env[Any, Any]] = []
    yield environments
    for one in environments:
        one.close()


def steps_of(env: gymnasium.Env[Any, Any], seed: int, count: int) -> list[Any]:
    played: list[Any] = [env.reset(seed=seed)]
    env.action_space.seed(seed)  # highway-env makes a new space in its reset
    actions = [env.action_space.sample() for _ in range(count)]
    for action in actions:
        played.append(env.step(action))
        if played[-1][2] or played[-1][3]:
            played.append(env.reset())
    return played


@pytest.mark.parametrize(
    ("name", "config"),
    [
        ("intersection-v2", {}),
        ("roundabout-v1", {"observation": {"type": "OccupancyGrid"}}),
        ("merge-v1", {"duration": 20}),
        ("racetrack-v1", {}),
        ("highway-fast-v0", {"vehicles_count": 8}),
        ("intersection-multi-agent-v2", {}),
    ],
)
def test_what_the_environment_says_is_untouched(
    name: str, config: dict[str, Any], kept: list[Any]
) -> None:
    bare = gymnasium.make(name, config=config)
    wrapped = PredictionObservation(gymnasium.make(name, config=config), CHEAP)
    kept += [bare, wrapped]
    for alone, ours in zip(steps_of(bare, 3, 5), steps_of(wrapped, 3, 5), strict=True):
        assert ours[0] in wrapped.observation_space
        np.testing.assert_equal(ours[0][OWN_KEY], alone[0])
        seen = ours[-1].pop("seen")
        assert seen.ego_id == "ego" and seen.ego_id in seen.scene.ids
        if len(ours) > 2:  # what `reset` tells is of an action drawn without a seed
            np.testing.assert_equal(ours[1:], alone[1:])


def test_the_same_episode_in_our_own_simulator_is_observed_alike(kept: list[Any]) -> None:
    action = {"type": "ContinuousAction"}
    settings = {"action": action, "spawn_probability": 0.0}
    user = gymnasium.make(
        "intersection-v2", config=settings | {"simulation_frequency": 20, "policy_frequency": 5}
    )
    wrapped = PredictionObservation(user, "hatn")
    scenario = Scenario(
        name="intersection-v2",
        config_path=Path("intersection-v2"),
        title="",
        simulator="highway",
        highway=HighwaySource("intersection-v2", settings),
        is_user_config=True,
    )
    duration_s = user.unwrapped.config["duration"]  # type: ignore[attr-defined]
    ours = SceneEnv(
        scene=scenario, action="highway", frames_per_step=2, duration_s=duration_s, until="end"
    )
    kept += [wrapped, ours]
    theirs, mine = wrapped.reset(seed=1)[0], ours.reset(seed=1)[0]
    # After that, drivers yield to the ego otherwise: in our simulator it is a driver, too.
    for k in range(15):
        assert theirs.keys() - {OWN_KEY} == mine.keys()
        for key, value in mine.items():
            np.testing.assert_allclose(theirs[key], value, atol=2e-4, err_msg=f"{key} at {k}")
        action_now = np.array([0.4 * np.cos(k / 3), 0.0], np.float32)
        theirs, mine = wrapped.step(action_now)[0], ours.step(action_now)[0]
    assert mine["vehicle_mask"].sum() >= 3


def test_frames_lie_between_the_steps_of_highway_env(
    monkeypatch: pytest.MonkeyPatch, kept: list[Any]
) -> None:
    env = gymnasium.make("intersection-v2", config={"spawn_probability": 0.9})
    kept.append(env)
    spied: list[dict[Any, tuple[Any, ...]]] = []
    own_step = highway_env.road.road.Road.step

    def step(road: Any, dt: float) -> None:
        own_step(road, dt)
        spied.append({v: (*v.position, v.heading, v.speed) for v in road.vehicles})

    monkeypatch.setattr(highway_env.road.road.Road, "step", step)
    watched = Watched(env.unwrapped)
    env.reset(seed=5)
    first = watched.begin()
    assert first.scene.ids[-1] == "ego" and set(first.scene.ids[:-1]) == {
        f"v{k}" for k in range(1, len(first.scene.ids))
    }
    names: dict[Any, str] = {}
    last_time_s = 0.0
    for _ in range(4):
        spied.clear()
        env.step(1)
        frames = watched.frames()
        assert len(frames) == 10 and len(spied) == 15
        np.testing.assert_allclose(
            [one.scene.time_s for one in frames], last_time_s + DT_S * np.arange(1, 11)
        )
        last_time_s = frames[-1].scene.time_s
        now = env.unwrapped.road.vehicles  # type: ignore[attr-defined]
        names |= dict(zip(now, frames[-1].scene.ids, strict=True))
        # A frame at 1.5, 3, 4.5 ... steps of theirs; whoever has left since is not told apart here.
        for k in range(1, 9):
            low, high = spied[int(1.5 * (k + 1)) - 1], spied[int(np.ceil(1.5 * (k + 1))) - 1]
            scene = frames[k].scene
            for vehicle in now:
                if vehicle not in low:
                    continue
                row = scene.ids.index(names[vehicle])
                middle = 0.5 * (np.array(low[vehicle]) + np.array(high[vehicle]))
                assert scene.xy_m[row] == pytest.approx(middle[:2] * [1.0, -1.0])
                assert np.cos(scene.yaw_rad[row] + middle[2]) == pytest.approx(1.0)
                assert scene.speed_mps[row] == pytest.approx(middle[3])
    assert len(set(names.values())) == len(names) > len(first.scene.ids)


def test_check_env_says_no_more_than_of_the_bare_environment(kept: list[Any]) -> None:
    bare = gymnasium.make("merge-v1")
    wrapped = PredictionObservation(gymnasium.make("merge-v1"), CHEAP)
    kept += [bare, wrapped]
    said: list[set[str]] = []
    for env in (bare, wrapped):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            check_env(env, skip_render_check=True)
        # The names of both are in what is said of any wrapped environment.
        said.append({str(one.message).split("(<")[0] for one in caught})
    assert said[1] <= said[0]


def test_the_same_seed_gives_the_same_predictions(kept: list[Any]) -> None:
    one, other = (PredictionObservation(gymnasium.make("roundabout-v1"), "hatn") for _ in "ab")
    kept += [one, other]
    first = steps_of(one, 7, 4)
    for again in (steps_of(other, 7, 4), steps_of(one, 7, 4)):
        for before, after in zip(first, again, strict=True):
            np.testing.assert_equal(after[0], before[0])
            assert after[-1]["seen"] == before[-1]["seen"]


def test_many_at_once() -> None:
    envs = gymnasium.make_vec(
        "merge-v1",
        num_envs=2,
        vectorization_mode="sync",
        wrappers=[lambda env: PredictionObservation(env, CHEAP)],
    )
    observation, _ = envs.reset(seed=1)
    assert observation["trajectories"].shape[0] == 2
    observation, *_ = envs.step(envs.action_space.sample())
    assert observation["vehicle_mask"].any(axis=1).all()
    envs.close()


def test_a_copy_for_a_planner_that_looks_ahead_leaves_the_original_alone(kept: list[Any]) -> None:
    env = PredictionObservation(gymnasium.make("merge-v1"), CHEAP)
    kept.append(env)
    env.reset(seed=2)
    ahead = env.unwrapped.simplify()  # type: ignore[attr-defined]
    ahead.step(1)
    *_, info = env.step(1)
    assert info["seen"].scene.time_s == pytest.approx(1.0)


def test_what_is_refused(kept: list[Any]) -> None:
    pole = gymnasium.make("CartPole-v1")
    lot = gymnasium.make("parking-v0")
    odd = gymnasium.make("merge-v1", config={"policy_frequency": 2})
    good = gymnasium.make("merge-v1")
    kept += [pole, lot, odd, good]
    with pytest.raises(OptionError, match=r"an environment of highway-env.*CartPoleEnv"):
        PredictionObservation(pole, CHEAP)
    with pytest.raises(OptionError, match="ParkingEnv has no roads"):
        PredictionObservation(lot, CHEAP)
    with pytest.raises(OptionError, match=r"policy_frequency: 2 Hz .* steps of 0\.4667 s"):
        PredictionObservation(odd, CHEAP)
    with pytest.raises(OptionError, match="predictor: unknown predictor 'hatm'"):
        PredictionObservation(good, "hatm")
    wrapped = PredictionObservation(good, CHEAP)
    with pytest.raises(NeedsResetError):
        wrapped.step(1)
    wrapped.reset(seed=1)
    with pytest.raises(InputError, match="expected a multiple of"):
        wrapped.reset(options={"config": {"policy_frequency": 2}})


def test_a_wrapper_inside_may_begin_anew(kept: list[Any]) -> None:
    short = gymnasium.make("intersection-v2", config={"duration": 2})
    env = PredictionObservation(Autoreset(short), CHEAP)
    kept.append(env)
    env.reset(seed=1)
    told = [env.step(1) for _ in range(5)]
    times_s = [info["seen"].scene.time_s for *_, info in told]
    assert times_s == pytest.approx([1.0, 2.0, 0.0, 1.0, 2.0])
    assert [bool(one[2] or one[3]) for one in told] == [False, True, False, False, True]


def test_predictions_are_added_once(kept: list[Any]) -> None:
    env = PredictionObservation(gymnasium.make("intersection-v2"), CHEAP)
    kept.append(env)
    with pytest.raises(OptionError, match="has predictions already"):
        PredictionObservation(TimeLimit(env, 5), CHEAP)


def test_a_watched_road_can_be_pickled(kept: list[Any]) -> None:
    env = PredictionObservation(gymnasium.make("intersection-v2"), CHEAP)
    kept.append(env)
    env.reset(seed=1)
    road = env.unwrapped.road
    copied = pickle.loads(pickle.dumps(road))
    assert type(copied) is type(road) and isinstance(copied, highway_env.road.road.Road)
    road.step(0.1)
    copied.step(0.1)
    assert [v.speed for v in copied.vehicles] == [v.speed for v in road.vehicles]
    assert len(copied.seen) == len(road.seen) == 1
