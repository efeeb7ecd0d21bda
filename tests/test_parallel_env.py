"""Several egos at once: against PettingZoo's own check, and against the environment of one ego."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest
import shapely
import shapely.affinity
from pettingzoo.test import parallel_api_test

from hatn_sim.config import HighwaySource, Scenario, load_scenario
from hatn_sim.datatypes import Command, Frame, Scene
from hatn_sim.envs import parallel_env
from hatn_sim.envs.driving import driven
from hatn_sim.envs.ego import begin_together
from hatn_sim.envs.errors import (
    ActionError,
    ActionShapeError,
    ActionTypeError,
    EpisodeOverError,
    MaskedActionError,
    MissingPackageError,
    NeedsResetError,
    OptionError,
)
from hatn_sim.envs.parallel_env import SceneParallelEnv
from hatn_sim.envs.scene_env import SceneEnv
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator

CROSSING = {"scene": "intersection5", "predictor": "constant_velocity", "warm_up_s": 8.0}
BARE = {"scene": "intersection5", "predictor": None, "warm_up_s": 8.0}


@pytest.fixture
def make() -> Iterator[Callable[..., SceneParallelEnv]]:
    made: list[SceneParallelEnv] = []

    def open_one(**options: Any) -> SceneParallelEnv:
        made.append(SceneParallelEnv(**options))
        return made[-1]

    yield open_one
    for one in made:
        one.close()


def two_of_highway_env() -> Scenario:
    config = load_scenario("highway_merge")
    source = HighwaySource("intersection-v2", {"controlled_vehicles": 2, "spawn_probability": 0.3})
    return Scenario("two", config.config_path, "two", "highway", highway=source)


def accelerate(env: SceneParallelEnv, share: float) -> dict[str, Any]:
    return {name: np.array([share], np.float32) for name in env.agents}


@pytest.mark.parametrize(
    "options",
    [
        CROSSING | {"egos": 3, "duration_s": 6.0},
        BARE | {"egos": 4, "duration_s": 15.0},
        CROSSING | {"scene": "roundabout8", "egos": 2, "duration_s": 4.0},
        {"predictor": "constant_velocity", "egos": 2, "duration_s": 6.0},
    ],
    ids=["slots", "accelerations", "roundabout", "highway-env"],
)
def test_what_pettingzoo_checks(options: dict[str, Any], make: Any) -> None:
    options = {"scene": two_of_highway_env()} | options
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(make(**options), num_cycles=60)


def test_alone_an_agent_has_what_the_environment_of_one_ego_gives(make: Any) -> None:
    many = make(**CROSSING, egos=1, duration_s=30.0)
    one = SceneEnv(**CROSSING, duration_s=30.0)
    try:
        (theirs, their_info), (mine, info) = many.reset(seed=4), one.reset(seed=4)
        for k in range(60):
            np.testing.assert_equal(theirs["ego"], mine)
            assert their_info["ego"].keys() == info.keys()
            assert their_info["ego"]["seen"] == info["seen"]
            assert (info["end"] == "") == (many.agents == ["ego"])
            if info["end"]:
                break
            choice = np.flatnonzero(info["action_mask"])[-1] if k % 2 else 0
            theirs, reward, terminated, truncated, their_info = many.step({"ego": choice})
            mine, *rest, info = one.step(choice)
            assert [reward["ego"], terminated["ego"], truncated["ego"]] == rest
        assert info["end"]
    finally:
        one.close()


class Played:
    """Frames that were, as a simulator that obeys nobody."""

    name, dt_s, notices = "played", 0.1, ()

    def __init__(self, frames: Sequence[Frame], road: Road) -> None:
        self.frames, self.road, self.next = frames, road, 0

    def reset(self, seed: int) -> Frame:
        self.next = 0
        return self.step()

    def step(self, commands: Sequence[Command] = ()) -> Frame:
        self.next += 1
        return self.frames[self.next - 1]

    def close(self) -> None:
        pass


@pytest.mark.parametrize("predictor", ["hatn", "idm"])
def test_every_agent_observes_what_a_single_ego_would_in_its_place(
    predictor: str, make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames: list[Frame] = []

    def begin(*given: Any) -> tuple[tuple[str, ...], list[Frame]]:
        names, first = begin_together(*given)
        frames.extend(first)
        return names, first

    def drive(*given: Any) -> Callable[[], list[Frame]]:
        later = list(driven(*given)())
        frames.extend(later)
        return lambda: later

    monkeypatch.setattr(parallel_env, "begin_together", begin)
    monkeypatch.setattr(parallel_env, "driven", drive)
    options = CROSSING | {"predictor": predictor, "action": "acceleration"}
    many = make(**options, egos=3)
    observed, infos = many.reset(seed=4)
    steps = [observed]
    for k in range(4):
        observed, *_, infos = many.step(accelerate(many, 0.2 * np.sin(k)))
        steps.append(observed)
    assert set(observed) == {"ego", "ego2", "ego3"} and not any(i["end"] for i in infos.values())
    for name in many.possible_agents:
        single = SceneEnv(**options | {"warm_up_s": 0.0}, ego="taken_over")
        single._simulator = Played(frames, Road(many._simulator.lanes))
        monkeypatch.setattr(
            "hatn_sim.envs.scene_env.begin_episode",
            lambda simulator, *_, name=name: (name, [simulator.step() for _ in range(11)]),
        )
        alone, _ = single.reset(seed=0)
        for k, of_step in enumerate(steps):
            for key, value in alone.items():
                np.testing.assert_allclose(
                    of_step[name][key], value, atol=1e-5, err_msg=f"{name} {key} {k}"
                )
            if k < len(steps) - 1:
                alone, *_ = single.step(np.zeros(1, np.float32))


@pytest.mark.parametrize("warm_up_frames", [80, 600])
def test_egos_come_by_different_ways_as_far_as_there_are_such(warm_up_frames: int) -> None:
    with SumoSimulator(load_scenario("intersection5")) as simulator:
        random = np.random.default_rng(0)
        names, frames = begin_together(simulator, 2, 4, warm_up_frames, random)
        assert names == ("ego", "ego2", "ego3", "ego4") and len(frames) == 11
        frame = frames[-1]
        entries = {
            name: route[0]
            for name, route in zip(frame.scene.ids, frame.truth.routes, strict=True)
            if route
        }
        others = {entry for name, entry in entries.items() if name not in names}
        assert len({entries[name] for name in names}) == min(len(others), 4) > 1


def test_egos_leave_one_by_one(make: Any) -> None:
    env = make(**BARE, egos=4, duration_s=60.0)
    env.reset(seed=2)
    left: set[str] = set()
    while env.agents:
        before = set(env.agents)
        _, rewards, terminated, truncated, infos = env.step(accelerate(env, 0.4))
        assert set(rewards) == set(terminated) == set(truncated) == set(infos) == before
        gone = {name for name in before if terminated[name] or truncated[name]}
        assert gone == {name for name in before if infos[name]["end"]} == before - set(env.agents)
        for name in gone:
            touched = infos[name]["end"] == "collision"
            assert (infos[name]["reward_terms"]["collision"] < 0.0) == touched
        left |= gone
    assert left == set(env.possible_agents)
    with pytest.raises(EpisodeOverError, match="all agents have left"):
        env.step({})


def outline(scene: Scene, row: int) -> shapely.Polygon:
    length, width = scene.size_m[row]
    turned = shapely.affinity.rotate(
        shapely.box(-length / 2, -width / 2, length / 2, width / 2),
        float(scene.yaw_rad[row]),
        origin=(0.0, 0.0),
        use_radians=True,
    )
    return shapely.affinity.translate(turned, *scene.xy_m[row])


def test_those_who_touch_each_other_leave_together(make: Any) -> None:
    env = make(**BARE, egos=5, duration_s=40.0, frames_per_step=1)
    collided = 0
    for seed in range(4):
        env.reset(seed=seed)
        while env.agents:
            # Full speed ahead into the crossing.
            *_, infos = env.step(accelerate(env, 1.0))
            scene = next(iter(infos.values()))["seen"].scene
            outlines = {name: outline(scene, row) for row, name in enumerate(scene.ids)}
            for name in (name for name, info in infos.items() if info["end"] == "collision"):
                touched = [
                    other
                    for other, shape in outlines.items()
                    if other != name and shape.distance(outlines[name]) < 0.1
                ]
                assert touched
                assert all(infos[one]["end"] == "collision" for one in touched if one in infos)
                collided += 1
        if collided > 1:
            break
    assert collided > 1


def test_the_same_seed_gives_the_same_steps_and_the_seed_told_repeats_them(make: Any) -> None:
    one, other = (make(**CROSSING, egos=2, duration_s=20.0) for _ in "ab")

    def play(env: SceneParallelEnv, seed: int | None) -> list[Any]:
        played: list[Any] = [env.reset(seed=seed)]
        for name in env.possible_agents:
            env.action_space(name).seed(5)
        for _ in range(12):
            played.append(env.step({name: env.action_space(name).sample() for name in env.agents}))
        return played

    first = play(one, 7)
    np.testing.assert_equal(play(other, 7), first)
    drawn = play(one, None)
    assert drawn[0][1]["ego"]["seed"] != 7
    np.testing.assert_equal(play(other, drawn[0][1]["ego"]["seed"]), drawn)


def test_what_is_refused(make: Any) -> None:
    for options, said in (
        ({"egos": 0}, "egos: expected a whole number, 1 to 64, found 0"),
        ({"egos": 2.5}, "found 2.5"),
        ({"ego": "taken_over"}, "ego: all egos are spawned here"),
        ({"scene": "recorded_sample"}, "recorded_sample"),
        ({"predictr": "idm"}, "did you mean 'predictor'"),
        ({"render_mode": "ansi"}, "render_mode: expected one of"),
    ):
        with pytest.raises(OptionError, match=said):
            make(**CROSSING | options)
    env = make(**CROSSING, egos=2)
    with pytest.raises(NeedsResetError):
        env.step({"ego": 0, "ego2": 0})
    _, infos = env.reset(seed=1)
    with pytest.raises(ActionTypeError, match="expected one by each agent's name, found 0"):
        env.step(0)  # type: ignore[arg-type]
    with pytest.raises(ActionError, match="none found of 'ego2'"):
        env.step({"ego": 0})
    with pytest.raises(ActionError, match="no agent 'ego3'; did you mean"):
        env.step({"ego": 0, "ego2": 0, "ego3": 0})
    with pytest.raises(ActionShapeError):
        env.step({"ego": 0, "ego2": np.zeros(2, np.int64)})
    absent = int(np.flatnonzero(infos["ego2"]["action_mask"] == 0)[0])
    with pytest.raises(MaskedActionError):
        env.step({"ego": 0, "ego2": absent})
    env.step({"ego": 0, "ego2": 0})  # what was refused has changed nothing
    env.close()
    with pytest.raises(NeedsResetError):
        env.step({"ego": 0, "ego2": 0})
    lone = make(scene="intersection-v2", predictor=None, egos=2)
    with pytest.raises(OptionError, match="begins without a vehicle 'ego2' of its own"):
        lone.reset(seed=1)


def test_without_pettingzoo_it_is_said_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "hatn_sim.envs.parallel_env")
    monkeypatch.setitem(sys.modules, "pettingzoo", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'hatn-sim\[marl\]'") as told:
        importlib.import_module("hatn_sim.envs.parallel_env")
    assert isinstance(told.value, ImportError)


def test_pictures(make: Any) -> None:
    env = make(**CROSSING, egos=2, render_mode="rgb_array")
    env.reset(seed=2)
    assert env.render().shape == (480, 720, 3)
