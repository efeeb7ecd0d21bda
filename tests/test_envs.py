"""Environments: against numbers worked out by hand, highway-env's own physics and recordings."""

from __future__ import annotations

import copy
import os
import pickle
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import crossing_lanes, lane, scene_of, slow_but, with_signal_at_south
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env
from highway_env.vehicle.kinematics import Vehicle

import hatn_sim.envs
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import DT_S, MAX_NODES, Command, Frame, Scene, Truth
from hatn_sim.envs.action import (
    FASTER_MPS2,
    SLOWER_MPS2,
    acceleration_command,
    action_space,
    chosen_slot,
    highway_command,
    numbers_of,
)
from hatn_sim.envs.ego import begin_episode
from hatn_sim.envs.errors import (
    ActionRangeError,
    ActionShapeError,
    ActionTypeError,
    EgoError,
    EpisodeOverError,
    MaskedActionError,
    NeedsResetError,
    OptionError,
    RenderError,
)
from hatn_sim.envs.features import ON_ROAD, OTHER, OWN, SLOT, observation_space
from hatn_sim.envs.mind import Mind, Thought, glance, open_mind, slot_profile, think
from hatn_sim.envs.observation import (
    Ego,
    Observation,
    admissible_slots,
    observe_slots,
    observe_vehicles,
)
from hatn_sim.envs.options import RewardWeights, read_options
from hatn_sim.envs.reward import terms_of
from hatn_sim.envs.scene_env import SceneEnv
from hatn_sim.envs.seeds import number_of
from hatn_sim.errors import InputError, RunningError, SimulatorError
from hatn_sim.predictors.constant_velocity import ConstantVelocity
from hatn_sim.resources import scenarios_dir
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.traffic import open_traffic
from hatn_sim.way import way_along

CORRIDOR = ("w", "we", "e")
ACROSS = ("s", "sn", "n")
STREET = Path(__file__).parent / "nets" / "street.sumocfg"
COMFORT_MPS2 = 2.0


def name_of(features: tuple[Any, ...], begins: str) -> int:
    return next(k for k, one in enumerate(features) if one.name.startswith(begins))


# -- observation ----------------------------------------------------------------------------------


def met(
    angle_rad: float = 0.0,
    shift_m: tuple[float, float] = (0.0, 0.0),
    closed: tuple[bool, ...] = (),
) -> tuple[Mind, Thought]:
    """An ego 30 m before the crossing at 10 m/s, another 20 m before it from the right at 8 m/s.

    `closed`: whether the signal is that the other has then, 9.5 m before it.
    """
    lanes = crossing_lanes(angle_rad, shift_m)
    road = Road(with_signal_at_south(lanes) if closed else lanes)
    mind = open_mind(ConstantVelocity(), "route", "ego", road)
    turn = np.array(
        [[np.cos(angle_rad), np.sin(angle_rad)], [-np.sin(angle_rad), np.cos(angle_rad)]]
    )

    def frame_at(time_s: float) -> Frame:
        scene = scene_of(
            time_s,
            {
                "ego": (-40.0 + 10.0 * time_s, 0.0, 0.0, 10.0),
                "other": (0.0, -28.0 + 8.0 * time_s, np.pi / 2, 8.0),
            },
        )
        moved = replace(
            scene,
            xy_m=scene.xy_m @ turn + np.array(shift_m),
            yaw_rad=(scene.yaw_rad + angle_rad + np.pi) % (2 * np.pi) - np.pi,
            signal_closed=np.array(closed, np.bool_),
        )
        return Frame(moved, Truth((CORRIDOR, ACROSS)), done=False)

    for k in range(10):
        mind = glance(mind, frame_at(k * DT_S))
    return think(mind, frame_at(1.0))


def observed(mind: Mind, thought: Thought) -> Observation:
    return observe_slots(mind.state.perception.seen.scene, Ego(0, -0.5, 0.75), thought.sight)


def test_an_observation_worked_out_by_hand() -> None:
    seen = observed(*met())
    own = seen["ego"]
    assert own[: len(OWN)].tolist() == [10.0, -0.5, 5.0, 2.0, 0.75]
    on_road = dict(zip((one.name for one in ON_ROAD), own[len(OWN) :].tolist(), strict=True))
    assert on_road["on a reference line; what follows is 0 where not"] == 1.0
    assert on_road["speed limit at 0 m"] == pytest.approx(13.9)
    assert on_road["has a conflict"] == 1.0
    assert on_road["way to the nearest conflict, 50: none"] == pytest.approx(30.0, abs=0.3)
    # The stop line is 8 m before the crossing; what counts is the centre of the ego.
    gate = on_road["centre to a stop line, give-way line or closed signal, 50: none"]
    assert gate == pytest.approx(22.0, abs=0.3)
    assert on_road["has a leader"] == 0.0
    assert on_road["gap to the leader, 60: none"] == 60.0

    assert seen["vehicle_mask"].tolist() == [1.0] + [0.0] * 14
    other = [30.0, -20.0, 0.0, 1.0, -10.0, 8.0, 8.0, 5.0, 2.0, 1.0]
    np.testing.assert_allclose(seen["vehicles"][0], other, atol=1e-5)
    assert not seen["vehicles"][1:].any()

    assert seen["slot_mask"].tolist() == [1.0, 1.0] + [0.0] * 6
    slot = seen["slots"][1]
    # The other's gap ends at the conflict; it begins at its front bumper.
    np.testing.assert_allclose(slot[:7], [0.0, 0.0, 0.0, 17.5, 8.0, 0.0, 17.5], atol=0.3)
    np.testing.assert_allclose(slot[7:11], [30.0, 20.0, 30.0, 0.0], atol=0.3)
    assert slot[11:13].tolist() == [0.0, 1.0]
    assert slot[-1] == 0.0
    assert not seen["slots"][2:].any()

    times_s = np.arange(1, 7) * 0.5
    straight = np.stack((10.0 * times_s, np.zeros(6)), axis=1)
    np.testing.assert_allclose(seen["trajectories"][0, 0], straight, atol=1e-4)
    across = np.stack((np.full(6, 30.0), -20.0 + 8.0 * times_s), axis=1)
    np.testing.assert_allclose(seen["trajectories"][1, 0], across, atol=1e-4)
    assert seen["mode_probability"][:3].tolist() == [[1, 0, 0], [1, 0, 0], [0, 0, 0]]


def test_an_observation_does_not_hang_on_where_the_world_is() -> None:
    here, there = observed(*met()), observed(*met(2.4, (350.0, -120.0)))
    for key, value in here.items():
        np.testing.assert_allclose(there[key], value, atol=2e-3, err_msg=key)


def test_probabilities_of_slots_and_the_likeliest_modes_first() -> None:
    mind, thought = met()
    graphs, prediction = thought.sight.graphs, thought.sight.prediction
    chances = np.where(graphs.focus_mask, 0.0, 0.0)
    chances[graphs.ego.tolist().index(0), :2] = [0.3, 0.7]
    paths = np.repeat(prediction.xy_m, 4, axis=1)
    paths[:, 2] += 1.0
    modes = np.tile([0.1, 0.2, 0.65, 0.05], (2, 1))
    told = replace(prediction, slot_probability=chances, xy_m=paths, mode_probability=modes)
    sight = replace(thought.sight, prediction=told)
    seen = observe_slots(mind.state.perception.seen.scene, Ego(0, 0.0, 1.0), sight)
    np.testing.assert_allclose(seen["slots"][:2, -1], [0.3, 0.7], atol=1e-6)
    np.testing.assert_allclose(seen["mode_probability"][0], [0.65, 0.2, 0.1], atol=1e-6)
    apart = seen["trajectories"][0, 0] - seen["trajectories"][0, 1]
    np.testing.assert_allclose(apart, 1.0, atol=1e-4)


def test_slots_that_may_be_chosen() -> None:
    _, thought = met()
    assert np.flatnonzero(admissible_slots(thought.sight, 0)).tolist() == [0, 1]
    red = replace(thought.sight.graphs, ego_at_red=np.ones(2, np.bool_))
    assert np.flatnonzero(admissible_slots(replace(thought.sight, graphs=red), 0)).tolist() == [0]


def test_what_is_out_of_range_is_observed_as_the_end_of_it() -> None:
    crowd = {f"v{k}": (3.0 * k, 1000.0 if k > 20 else 0.0, 0.0, 70.0) for k in range(25)}
    scene = scene_of(0.0, crowd)
    seen = observe_vehicles(scene, Ego(0, -40.0, 1.0))
    space = observation_space("vehicles", has_slots=False)
    assert seen in space
    assert seen["ego"][:2].tolist() == [40.0, -10.0]
    assert seen["vehicle_mask"].all()
    # The nearest first; whoever is a kilometre away is not among them.
    np.testing.assert_allclose(seen["vehicles"][:, 0], 3.0 * np.arange(1, 16), atol=1e-4)


def test_the_table_has_every_number() -> None:
    space = observation_space("slots", has_slots=True)
    table = SceneEnv.__doc__ or ""
    for features, key in ((OWN + ON_ROAD, "ego"), (OTHER, "vehicles"), (SLOT, "slots")):
        box = space[key]
        assert isinstance(box, Box) and box.shape[-1] == len(features)
        for index, one in enumerate(features):
            assert f"| {index} | {one.name} | {one.low:.4g} ... {one.high:.4g} |" in table


# -- actions --------------------------------------------------------------------------------------


def test_actions_that_are_refused() -> None:
    there = np.arange(MAX_NODES) < 2
    assert chosen_slot(1, there, "refuse") == 1
    assert chosen_slot(np.array([1]), there, "refuse") == 1
    assert chosen_slot(5, there, "yield") == 0
    with pytest.raises(
        MaskedActionError, match=r"slot 5 is not there now, expected one of \[0, 1\]"
    ):
        chosen_slot(5, there, "refuse")
    for wrong in (0.5, "pass", None, True):
        with pytest.raises(ActionTypeError, match="expected the number of a slot, 0 to 7"):
            chosen_slot(wrong, there, "refuse")
    with pytest.raises(ActionShapeError):
        chosen_slot(np.array([0, 1]), there, "refuse")
    with pytest.raises(ActionRangeError, match="found 8"):
        chosen_slot(8, there, "refuse")
    space = action_space("acceleration")
    assert isinstance(space, Box)
    with pytest.raises(ActionTypeError):
        numbers_of("fast", space)
    with pytest.raises(ActionTypeError):
        numbers_of([[0.0], [0.0, 1.0]], space)
    with pytest.raises(ActionShapeError, match=r"expected an array of shape \(1,\), found \(2,\)"):
        numbers_of([0.0, 0.0], space)
    for wrong in ([1.5], [np.nan]):
        with pytest.raises(ActionRangeError, match="from -1 to 1"):
            numbers_of(wrong, space)
    with pytest.raises(gymnasium.error.InvalidAction):
        chosen_slot(5, there, "refuse")


@pytest.mark.parametrize(("share", "wanted"), [(1, FASTER_MPS2), (0, 0), (-1, SLOWER_MPS2)])
def test_accelerations(share: float, wanted: float) -> None:
    assert acceleration_command("a", np.array([share])) == Command("a", wanted)


def test_a_sampled_slot_is_there() -> None:
    space = action_space("slot")
    assert {int(space.sample()) for _ in range(20)} == {0}


def test_a_yield_lets_the_other_go_within_comfort_and_a_pass_does_not_wait() -> None:
    mind, thought = met()
    scene = mind.state.perception.seen.scene
    # It has stopped at its stop line: else it would do so first, whatever it chooses.
    mind = replace(mind, stopped=frozenset({"ego"}))
    waits, goes = (slot_profile(mind, thought.sight, scene, 0, slot) for slot in (0, 1))
    travelled = [DT_S * np.cumsum(speeds) for speeds in (waits, goes)]
    # The other is out of the way some 3.3 s from now: its rear 1 m behind the ego's lane.
    assert travelled[0][29] < 30.0 - 2.5 < travelled[1][29] + 2.0
    faster = np.diff([10.0, *waits]) / DT_S
    assert faster.min() > -3.5 and faster.max() < COMFORT_MPS2 + 0.1


@pytest.mark.parametrize("closed", [True, False])
def test_a_yield_waits_for_nobody_whom_a_signal_holds(closed: bool) -> None:
    mind, thought = met(closed=(closed,))
    scene = mind.state.perception.seen.scene
    mind = replace(mind, stopped=frozenset({"ego"}))
    yields, passes = (slot_profile(mind, thought.sight, scene, 0, slot) for slot in (0, 1))
    assert (yields == passes) == closed
    # It is a slot all the same, as it is in the observation.
    assert thought.sight.graphs.focus_mask[0, :2].all()


# -- reward ---------------------------------------------------------------------------------------


def test_terms_of_a_reward_worked_out_by_hand() -> None:
    before = scene_of(0.0, {"ego": (0, 0, 0, 10), "near": (20, 0, 0, 10), "far": (90, 0, 0, 10)})
    after = scene_of(0.1, {"far": (91, 0, 0, 9.0), "ego": (1, 0, 0, 9.7), "near": (21, 0, 0, 9.45)})
    routes = (None,) * 3
    first = Frame(before, Truth(routes), done=False)
    terms = terms_of(first, Frame(after, Truth(routes), done=False), "ego", 0.98, arrived=False)
    # The near one brakes at 5.5 m/s2, half way from 3 to 8; the far one, at 10, is not near.
    assert terms.risk_s == pytest.approx(0.1 * 0.5)
    assert terms.discomfort_s == pytest.approx(0.1)  # 3 m/s2
    assert (terms.progress_m, terms.time_s, terms.collision, terms.arrival) == (0.98, 0.1, 0.0, 0.0)
    truth = Truth(routes, collisions=(("ego", "near"),), emergency_braking=("near",))
    worst = terms_of(first, Frame(after, truth, done=False), "ego", 0.98, arrived=True)
    assert (worst.risk_s, worst.collision, worst.arrival) == (0.1, 1.0, 1.0)
    weighted = (terms + worst).weighted(RewardWeights(progress_m=2.0, collision=-7.0))
    assert weighted["progress_m"] == pytest.approx(3.92)
    assert weighted["collision"] == -7.0
    assert weighted["time_s"] == pytest.approx(0.2 * RewardWeights().time_s)


def test_how_far_along_its_way() -> None:
    road = Road([*crossing_lanes(), lane("x", [(500, 0), (600, 0)])])
    way = way_along(road, CORRIDOR, np.array([-100.3, 0.4]))
    assert way.s_m == pytest.approx(7.7)
    assert way.last_junction_s_m == pytest.approx(116.0)
    for x_m in np.arange(-100.0, 30.0, 1.3):
        way = way.moved(np.array([x_m, -0.2]))
        assert way.s_m == pytest.approx(x_m + 108.0)
        # The junction ends at 8 m; 10 m more, and half of 5 m.
        assert way.is_crossed(5.0) == (x_m > 20.5)
    beside = way_along(road, CORRIDOR, np.array([-300.0, 90.0]))
    for _ in range(2):
        assert beside.s_m == 0.0
        beside = beside.moved(np.array([-400.0, 0.0]))
    assert not way_along(road, ("x",), np.array([590.0, 0.0])).is_crossed(5.0)


# -- options --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"scenne": "x"}, "unknown option 'scenne'; did you mean 'scene'"),
        ({"speed": 3}, "unknown option 'speed'; known: scene, tracks, map"),
        ({"scene": "roundabout-v9"}, "did you mean 'roundabout-v1'"),
        ({"scene": "CartPole-v1"}, "'CartPole-v1' is no road environment of highway-env; those"),
        ({"scene": "parking-v0"}, "'parking-v0' is no road environment of highway-env; those are"),
        (
            {"scene": str(STREET.with_suffix(".net.xml"))},
            "folder of a run; a net alone has no traffic, name the .sumocfg that runs it",
        ),
        ({"scene": str(STREET), "density": "heavy"}, "density heavy is for scenes with a scenario"),
        ({"tracks": __file__}, "they were driven on: add map='FILE'"),
        ({"scene": "intersection5", "predictor": "hatm"}, "(your own: predictor='module:Class')"),
        ({"scene": "intersection5", "predictor": None, "advice": True}, "advice: True needs a"),
        ({"scene": str(STREET), "warm_up_s": 600.0}, "of street, which ends after 600 s"),
        (
            {"scene": "roundabout8", "registered_as": "hatn_sim/Intersection-v0"},
            "hatn_sim/Intersection-v0 is intersection5, found 'roundabout8'; make hatn_sim/Scene",
        ),
        ({}, "expected either scene or tracks, found neither"),
        ({"scene": "intersection"}, "unknown scene 'intersection'; did you mean 'intersection5'"),
        ({"scene": "intersection5", "risk": "rude"}, "unknown risk 'rude'"),
        ({"scene": "intersection5", "predictor": "hatm"}, "predictor: unknown predictor 'hatm'"),
        ({"scene": "intersection5", "predictor": 3}, "predictor: expected str"),
        ({"scene": "intersection5", "action": "slots"}, "did you mean 'slot'"),
        ({"scene": "intersection5", "action": "highway"}, "for environments of highway-env"),
        ({"scene": "intersection5", "predictor": None, "action": "slot"}, "needs a predictor"),
        ({"scene": "intersection5", "frames_per_step": 0}, "expected 1 to 50, found 0"),
        ({"scene": "intersection5", "frames_per_step": 2.5}, "expected int, found 2.5"),
        ({"scene": "intersection5", "duration_s": True}, "duration_s: expected float"),
        ({"scene": "intersection5", "reward": {"colision": 1}}, "did you mean 'collision'"),
        ({"scene": "intersection5", "reward": {"time_s": "a"}}, "time_s: expected a number"),
        ({"scene": "intersection5", "net": "a.net.xml"}, "net: a.net.xml is for recorded tracks"),
        ({"scene": "intersection5", "ego": "spawned", "ego_id": "a"}, "only be taken over"),
        ({"scene": "recorded_sample"}, "recorded tracks take no actions; add net="),
        ({"scene": "recorded_sample", "ego": "spawned"}, "choose 'taken_over'"),
        ({"scene": "highway_merge", "warm_up_s": 5.0}, "on the road from the beginning"),
        ({"scene": "intersection-v2", "density": "dense"}, "density: an environment of highway"),
        ({"scene": "intersection5", "render_mode": "ansi"}, "render_mode: expected one of"),
    ],
)
def test_options_that_are_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(OptionError) as told:
        SceneEnv(**{"predictor": "constant_velocity", **options})
    assert said in str(told.value) and "\n" not in str(told.value)
    assert "--" not in str(told.value)  # nobody is at a command line


def test_options_that_are_named_keep_the_others() -> None:
    options = read_options({"scene": Path("a.sumocfg"), "reward": {"collision": -20}})
    assert options.scene == "a.sumocfg"
    assert options.reward == RewardWeights(collision=-20.0)
    assert (options.action_form, options.observation_form) == ("slot", "slots")
    plain = read_options({"scene": "a", "predictor": None})
    assert (plain.action_form, plain.observation_form) == ("acceleration", "vehicles")


# -- episodes -------------------------------------------------------------------------------------


@pytest.fixture
def make() -> Iterator[Any]:
    """Makes environments that are closed after the test."""
    made: list[SceneEnv] = []

    def one(name: str = "hatn_sim/Scene-v0", **options: Any) -> SceneEnv:
        env = gymnasium.make(name, **options).unwrapped
        assert isinstance(env, SceneEnv)
        made.append(env)
        return env

    yield one
    for env in made:
        env.close()


HIGHWAY = {"scene": "highway_intersection", "predictor": None}
CROSSING = {"scene": "intersection5", "predictor": "constant_velocity", "warm_up_s": 5.0}
REPLAY = {
    "scene": "recorded_sample",
    "net": str(scenarios_dir() / "tjunction" / "tjunction.net.xml"),
    "predictor": "idm",
}
EVERYWHERE = {
    "intersection": ("hatn_sim/Intersection-v0", {"predictor": "idm", "warm_up_s": 5.0}),
    "roundabout": (
        "hatn_sim/Roundabout-v0",
        {"predictor": None, "warm_up_s": 20.0, "ego": "taken_over", "density": "dense"},
    ),
    "highway": ("hatn_sim/Scene-v0", {"scene": "roundabout-v1", "predictor": "constant_velocity"}),
    "steered": ("hatn_sim/Scene-v0", HIGHWAY | {"action": "highway"}),
    "replay": ("hatn_sim/Scene-v0", REPLAY),
}


@pytest.mark.parametrize("name", slow_but(EVERYWHERE, "intersection", "steered", "replay"))
def test_gymnasium_has_nothing_to_say(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env_id, options = EVERYWHERE[name]
    env = gymnasium.make(env_id, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=name != "steered")
    env.close()


def test_out_of_turn(make: Any) -> None:
    env = make(**HIGHWAY, render_mode="rgb_array", duration_s=0.5)
    for call in (lambda: env.step(env.action_space.sample()), env.render):
        with pytest.raises(NeedsResetError, match="expected a call of reset before"):
            call()
    with pytest.raises(OptionError, match="reset: expected no options"):
        env.reset(options={"density": "dense"})
    env.reset(seed=3)
    *_, terminated, truncated, info = env.step(np.zeros(1))
    assert (terminated, truncated, info["end"]) == (False, True, "time")
    with pytest.raises(EpisodeOverError, match=r"the episode is over \(time\)"):
        env.step(np.zeros(1))
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(1))
    env.close()
    with pytest.raises(NeedsResetError):
        env.step(np.zeros(1))
    silent = make(**HIGHWAY)
    silent.reset(seed=3)
    with pytest.raises(RenderError, match="expected a render_mode"):
        silent.render()


def test_what_runs_cannot_be_copied(make: Any) -> None:
    env = make(scene=str(STREET), predictor=None, ego="taken_over", warm_up_s=5.0)
    assert copy.deepcopy(env).unwrapped.options.scene == str(STREET)  # nothing runs yet
    _, info = env.reset(seed=3)
    for copied in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(RunningError, match="reset with the same seed"):
            copied(env.unwrapped)
    # What it says instead is so, and the refusal has left the environment as it was.
    twin = make(scene=str(STREET), predictor=None, ego="taken_over", warm_up_s=5.0)
    assert twin.reset(seed=3)[1]["seen"] == info["seen"]
    ours, theirs = (one.step(np.ones(1, np.float32))[-1]["seen"] for one in (env, twin))
    assert ours == theirs
    env.close()
    pickle.loads(pickle.dumps(env)).close()


def test_an_environment_that_predicts_is_pickled_with_its_predictors_name(make: Any) -> None:
    env = make(scene="tjunction", density="light", warm_up_s=2.0, ego="taken_over")
    twin = pickle.loads(pickle.dumps(env.unwrapped))
    for one in (env, twin):
        one.reset(seed=5)
    (ours, *_), (theirs, *_) = (one.step(0) for one in (env, twin))
    np.testing.assert_array_equal(ours["trajectories"], theirs["trajectories"])
    assert ours["trajectories"].any()
    twin.close()


def test_an_ego_that_never_comes(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hatn_sim.envs.ego.LONGEST_WAIT_S", 15.0)
    with pytest.raises(EgoError, match="nobody called 'nobody' is in the route files of street"):
        make(scene=str(STREET), predictor=None, ego_id="nobody")
    env = make(scene="highway_intersection", predictor=None, ego="taken_over", ego_id="nobody")
    with pytest.raises(EgoError, match=r"did not come on the road in the 15 s .* where waiting"):
        env.reset(seed=1)
    late = make(scene=str(STREET), predictor=None, warm_up_s=599.9, ego="taken_over")
    with pytest.raises(EgoError, match=r"where the scene is over; choose a shorter warm_up_s$"):
        late.reset(seed=1)
    empty = make(**REPLAY | {"warm_up_s": 3000.0, "predictor": None})
    with pytest.raises(EgoError, match=r"it was over at .* within the warm-up of 3000 s"):
        empty.reset(seed=1)
    replay = make(**REPLAY | {"ego_id": "nobody", "predictor": None})
    with pytest.raises(InputError, match="there is no vehicle 'nobody' to take over"):
        replay.reset(seed=1)


def play(env: SceneEnv, steps: int, seed: int) -> list[tuple[Any, ...]]:
    """What comes of the likeliest of the slots that are there, or of an even drive."""
    env.action_space.seed(seed)
    played: list[tuple[Any, ...]] = [env.reset(seed=seed)]
    for _ in range(steps):
        played.append(env.step(env.action_space.sample()))
        if played[-1][2] or played[-1][3]:
            played.append(env.reset())
    return played


def same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return bool(np.array_equal(one, other))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


@pytest.mark.parametrize("name", ["intersection", "highway", "replay"])
def test_the_same_seed_gives_the_same_episode(name: str, make: Any) -> None:
    env_id, options = EVERYWHERE[name]
    one, other = make(env_id, **options), make(env_id, **options)
    assert all(map(same, play(one, 20, 4), play(other, 20, 4)))
    # The first has been here before; what it has drawn of the road since is without effect.
    assert all(map(same, play(one, 8, 4), play(other, 8, 4)))


def test_the_seed_told_repeats_an_episode_that_was_drawn(make: Any) -> None:
    one, other = make(**CROSSING), make(**CROSSING)
    one.reset(seed=4)
    observation, info = one.reset()
    again, same_info = other.reset(seed=info["seed"])
    assert same(observation, again) and same(info, same_info)


def test_seeds_that_sumo_does_not_take_have_episodes_of_their_own(make: Any) -> None:
    small = (0, 1, 2**31 - 1)
    assert [number_of(seed) for seed in small] == list(small)
    large = {k + 2**power for power in (31, 32, 40) for k in range(1000)}
    numbers = {number_of(seed) for seed in large}
    assert len(numbers) == len(large) == 3000 and min(numbers) >= 0 and max(numbers) < 2**31
    env = make(**CROSSING)
    observation, info = env.reset(seed=2**40)
    assert info["seed"] not in (0, 2**40)
    other, _ = env.reset(seed=2**40 + 1)
    assert not same(observation, other)
    for seed in (2**40, info["seed"]):
        again, same_info = env.reset(seed=seed)
        assert same(observation, again) and same_info["seed"] == info["seed"]


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERYWHERE)
@pytest.mark.parametrize("predictor", ["hatn", "idm"])
def test_the_same_seed_gives_the_same_500_steps(name: str, predictor: str, make: Any) -> None:
    env_id, options = EVERYWHERE[name]
    options = options if options["predictor"] is None else options | {"predictor": predictor}
    one, other = make(env_id, **options), make(env_id, **options)
    assert all(map(same, play(one, 500, 11), play(other, 500, 11)))


def test_observations_are_of_their_space_to_the_end(make: Any) -> None:
    env = make(**CROSSING, masked_action="yield", until="end")
    env.action_space.seed(1)
    observation, info = env.reset(seed=2)
    ended = False
    while not ended:
        assert observation in env.observation_space
        np.testing.assert_array_equal(observation["action_mask"], info["action_mask"])
        np.testing.assert_array_equal(env.action_masks(), info["action_mask"] == 1)
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert reward == pytest.approx(sum(info["reward_terms"].values()))
        ended = terminated or truncated
    assert observation in env.observation_space
    assert info["end"] in ("arrived", "collision", "time")
    assert terminated == (info["end"] != "time")


def test_a_spawned_ego_takes_the_way_of_another(make: Any) -> None:
    with SumoSimulator(load_scenario("intersection5")) as simulator:
        random = np.random.default_rng(0)
        ego_id, frames = begin_episode(simulator, 5, "spawned", None, 100, random)
        frame = frames[-1]
        assert ego_id == "ego" and "ego" in frame.truth.departed
        route = frame.truth.routes[frame.scene.ids.index("ego")]
        assert route in [
            frame.truth.routes[k] for k, name in enumerate(frame.scene.ids) if name != "ego"
        ]
        # It comes in at the begin of its way, and the history before it is there.
        at = frame.scene.xy_m[frame.scene.ids.index("ego")]
        assert route is not None
        assert np.linalg.norm(at - simulator.road.lanes[route[0]].xy_m[0]) < 10.0
        times = [one.scene.time_s for one in frames]
        np.testing.assert_allclose(np.diff(times), DT_S)
        assert len(frames) == 11
        with pytest.raises(InputError, match="'ego' cannot be steered"):
            simulator.step([Command("ego", 0.0, 0.1)])


def test_the_commanded_acceleration_is_driven(make: Any) -> None:
    env = make(scene="intersection5", predictor=None, warm_up_s=5.0, frames_per_step=3)
    _, info = env.reset(seed=2)
    speed = info["seen"].scene.speed_mps[info["seen"].scene.ids.index("ego")]
    observation, *_ = env.step(np.array([-0.25], np.float32))
    assert observation["ego"][0] == pytest.approx(speed + 3 * DT_S * 0.25 * SLOWER_MPS2, abs=1e-4)
    assert observation["ego"][1] == pytest.approx(0.25 * SLOWER_MPS2, abs=1e-3)


def test_highway_envs_own_action_moves_the_ego_as_its_own_vehicle(make: Any) -> None:
    env = make(**HIGHWAY, action="highway", frames_per_step=4)
    _, info = env.reset(seed=6)
    scene: Scene = info["seen"].scene
    row = scene.ids.index("ego")
    mirror = np.array([1.0, -1.0])
    own = Vehicle(None, scene.xy_m[row] * mirror, -scene.yaw_rad[row], scene.speed_mps[row])
    action = np.array([0.4, 0.3], np.float32)
    own.act({"acceleration": 5.0 * 0.4, "steering": 0.3 * np.pi / 4})
    for _ in range(8):
        own.step(1 / 20)
    *_, info = env.step(action)
    scene, row = info["seen"].scene, info["seen"].scene.ids.index("ego")
    np.testing.assert_allclose(scene.xy_m[row] * mirror, own.position, atol=1e-5)
    assert -scene.yaw_rad[row] == pytest.approx(own.heading, abs=1e-5)
    assert scene.speed_mps[row] == pytest.approx(own.speed, abs=1e-5)
    # Its y grows downward: what is positive there is to the right.
    assert highway_command("a", np.array([0.0, 1.0])).steering_rad == pytest.approx(-np.pi / 4)


def test_in_a_replay_the_others_are_where_they_were_recorded(make: Any) -> None:
    env = make(**REPLAY | {"predictor": None})
    _, info = env.reset(seed=1)
    ego_id = info["ego_id"]
    with open_traffic(load_scenario("recorded_sample")) as recorded:  # type: ignore[attr-defined]
        frame = recorded.reset(0)
        for _ in range(8):
            now: Scene = info["seen"].scene
            while frame.scene.time_s < now.time_s - 0.5 * DT_S:
                frame = recorded.step()
            there = {name: frame.scene.xy_m[k] for k, name in enumerate(frame.scene.ids)}
            others = [k for k, name in enumerate(now.ids) if name != ego_id]
            assert others
            for k in others:
                np.testing.assert_allclose(now.xy_m[k], there[now.ids[k]], atol=1e-6)
            *_, info = env.step(np.array([0.5]))
            assert ego_id in info["seen"].scene.ids
    # The ego is not: it has accelerated all the time.
    last: Scene = info["seen"].scene
    assert np.linalg.norm(last.xy_m[last.ids.index(ego_id)] - there[ego_id]) > 1.0


def test_one_environment_does_not_mind_what_becomes_of_another(make: Any) -> None:
    plain = {"scene": "intersection5", "predictor": None, "warm_up_s": 3.0}
    alone, closed, killed = (make(**plain) for _ in range(3))
    for env in (alone, closed, killed):
        env.reset(seed=9)
    first = alone.step(np.zeros(1))
    pid = killed._simulator.worker_pid
    os.kill(pid, signal.SIGKILL)
    closed.close()
    with pytest.raises(SimulatorError, match=r"SUMO stopped in intersection5.*\(seed 9\)"):
        killed.step(np.zeros(1))
    with pytest.raises(NeedsResetError):
        killed.step(np.zeros(1))
    alone.step(np.zeros(1))
    killed.reset(seed=9)
    assert same(killed.step(np.zeros(1)), first)


def test_pictures(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    env = make(**CROSSING, render_mode="rgb_array")
    env.reset(seed=2)
    first = env.render()
    assert first.shape == (480, 720, 3) and first.dtype == np.uint8
    env.step(0)
    second = env.render()
    assert second.shape == first.shape and (second != first).any()
    assert np.array_equal(env.render(), second)
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    window = make(**HIGHWAY, render_mode="human")
    window.reset(seed=1)
    window.step(np.zeros(1))
    assert window.render() is None
    window.close()
    monkeypatch.setenv("SDL_VIDEODRIVER", "none")
    with pytest.raises(RenderError, match="needs a screen, found none"):
        make(**HIGHWAY, render_mode="human").reset(seed=1)


def test_the_registered_names() -> None:
    assert set(hatn_sim.envs.SCENES) <= set(gymnasium.registry)
    with pytest.raises(OptionError, match="make hatn_sim/Scene-v0 for others"):
        gymnasium.make("hatn_sim/Roundabout-v0", scene="intersection5", predictor=None)


def test_the_options_are_there_once_the_package_is() -> None:
    code = "import hatn_sim.envs; print(hatn_sim.envs.options.__doc__)"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "| `frames_per_step` | 5 |" in told.stdout


def test_info_can_be_read(make: Any) -> None:
    env = make(**CROSSING)
    _, info = env.reset(seed=2)
    assert len(repr(info)) < 1000
    assert repr(info["seen"]).startswith("Seen('ego' at ") and "predicted)" in repr(info["seen"])
