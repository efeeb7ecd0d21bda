"""What rewards forbid and what they do not pay twice: worked out by hand, and driven."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import crossing_lanes, lane, scene_of

import hatn_sim.envs  # noqa: F401 - registers
from hatn_sim.datatypes import DT_S, Advice, Frame, Gate, Truth
from hatn_sim.envs.episode import Episode
from hatn_sim.envs.options import EnvOptions, RewardWeights
from hatn_sim.envs.reward import Terms
from hatn_sim.envs.rules import Rules, Step, lawless, may_pass, rules_along, still_came_mps
from hatn_sim.envs.scene_env import SceneEnv
from hatn_sim.loop import guided
from hatn_sim.plugins import load_agent
from hatn_sim.policies.lawful_env import REWARD
from hatn_sim.road import Road
from hatn_sim.way import way_along

CORRIDOR = ("w", "we", "e")
OPEN, CLOSED = np.zeros(1, np.bool_), np.ones(1, np.bool_)


def rules_of(gate: Gate, slow: float = 13.9) -> Rules:
    """Of the crossing from the west: a line at 100 m, and lanes that end at 100, 116, 266 m."""
    lanes = {one.id: one for one in crossing_lanes()}
    lanes["w"] = replace(lanes["w"], gate=gate, signals={"we": 0})
    lanes["we"] = replace(lanes["we"], speed_limit_mps=slow)
    road = Road(lanes.values())
    return rules_along(road, way_along(road, CORRIDOR, np.array([-100.0, 0.0])))


def test_signs_along_a_way() -> None:
    rules = rules_of(Gate.STOP_LINE, slow=5.0)
    assert rules.ends_m == pytest.approx((100.0, 116.0, 266.0))
    assert (rules.line_s_m, rules.signal) == ((100.0,), (-1,))
    # What a connection is given for its bend is no sign.
    assert rules.limit_mps == (13.9,) * 3
    assert rules_of(Gate.SIGNAL).signal == (0,)
    for gate in (Gate.NONE, Gate.GIVE_WAY_LINE):
        assert not len(rules_of(gate).line_s_m)


def test_a_stop_line_asks_for_a_stop_near_before_it() -> None:
    rules = rules_of(Gate.STOP_LINE)
    assert not may_pass(rules, False, 90.0, 0.0, OPEN)  # in a queue
    assert not may_pass(rules, False, 98.0, 2.0, OPEN)
    assert may_pass(rules, False, 98.0, 0.1, OPEN)
    assert may_pass(rules, True, 99.5, 2.0, OPEN)  # it has stood
    over = Step(100.9, 101.1, 2.5, 2.0)
    assert lawless(rules, True, over) == 0.0
    assert lawless(rules, False, over) == 1.0
    assert lawless(rules, False, Step(99.9, 100.1, 2.5, 2.0)) == 0.0  # who stands does so there


def test_a_signal_that_closes_too_late_may_be_passed() -> None:
    rules = rules_of(Gate.SIGNAL)
    assert may_pass(rules, False, 80.0, 10.0, OPEN)
    # 10 m/s take 16.7 m to stop at 3 m/s2.
    assert may_pass(rules, True, 84.0, 10.0, CLOSED)
    assert not may_pass(rules, True, 83.0, 10.0, CLOSED)
    assert not may_pass(rules, False, 84.0, 10.0, CLOSED)  # it was closed before


def test_speed_above_the_limit() -> None:
    rules = rules_of(Gate.NONE)
    assert lawless(rules, False, Step(50.0, 51.5, 2.5, 1.1 * 13.9)) == 0.0
    fast = Step(50.0, 53.0, 2.5, 2.1 * 13.9)
    assert lawless(rules, False, fast) == pytest.approx(DT_S)
    # Who came so fast has to slow down; what it is slower by it may not be again.
    came = replace(fast, came_mps=fast.speed_mps)
    assert lawless(rules, False, came) == 0.0
    slower = replace(came, speed_mps=20.0)
    assert still_came_mps(rules, slower) == 20.0
    assert still_came_mps(rules, replace(came, speed_mps=13.0)) == 0.0


# -- progress -------------------------------------------------------------------------------------


def test_circles_over_lanes_earn_nothing() -> None:
    """A two-way street, 3.2 m apart: round and round on a circle of radius 5 m, at 5 m/s."""
    road = Road([lane("east", [(-50, -1.6), (50, -1.6)]), lane("west", [(50, 1.6), (-50, 1.6)])])

    def at(angle_rad: float, time_s: float) -> Frame:
        x_m, y_m = 5.0 * np.sin(angle_rad), -5.0 * np.cos(angle_rad)
        scene = scene_of(time_s, {"ego": (float(x_m), float(y_m), angle_rad, 5.0)})
        return Frame(scene, Truth((("east",) if y_m < 0.0 else ("west",),)), done=False)

    episode = Episode("ego", 0, road, at(0.0, 0.0), None)
    episode.begin()
    options, rounds = EnvOptions(scene="a"), list[float]()
    frames = round(2.0 * np.pi / DT_S)  # 31.4 m a round
    for k in range(4):
        begun = k * frames
        terms = Terms()
        for frame in range(begun + 1, begun + frames + 1):
            terms += episode.advance(at(frame * DT_S, frame * DT_S), options)
        rounds.append(terms.progress_m)
    assert 10.0 < rounds[0] < 32.0
    assert max(map(abs, rounds[1:])) < 2.5  # some slack for each change of lanes


def test_a_change_of_lanes_costs_no_progress() -> None:
    road = Road([lane("near", [(0, 0), (200, 0)]), lane("far", [(0, 3.2), (200, 3.2)])])

    def at(x_m: float) -> Frame:
        far = (x_m // 30.0) % 2
        scene = scene_of(x_m, {"ego": (x_m, 3.2 * far, 0.0, 10.0)})
        return Frame(scene, Truth((("far" if far else "near",),)), done=False)

    episode = Episode("ego", 0, road, at(10.0), None)
    episode.begin()
    terms = Terms()
    for x_m in np.arange(11.0, 151.0):
        terms += episode.advance(at(float(x_m)), EnvOptions(scene="a"))
    assert terms.progress_m >= 140.0


# -- driven ---------------------------------------------------------------------------------------

PLAIN: dict[str, Any] = {"scene": "intersection5", "predictor": None, "warm_up_s": 20.0}


def drive(policy: str, seed: int) -> tuple[str, float, float]:
    """The end, the sum of rewards and what of it is for breaking the law."""
    steps = {"frames_per_step": 1} | PLAIN | ({"predictor": "idm"} if policy == "slots" else {})
    env = gymnasium.make("hatn_sim/Scene-v0", **steps, disable_env_checker=True).unwrapped
    assert isinstance(env, SceneEnv)
    _, info = env.reset(seed=seed)
    agent = load_agent("idm")
    state, earned, lawless_sum, is_over = agent.init(env._simulator.road), 0.0, 0.0, False
    while not is_over:
        action: Any = np.ones(1, np.float32)
        if policy == "slots":
            action = int(np.flatnonzero(info["action_mask"])[-1])
        elif policy == "idm":
            assert env._episode is not None
            frame = env._episode.frame
            state = guided(agent, state, "ego", frame)
            nothing: Advice = None  # type: ignore[assignment] - it does not look at it
            state, command = agent.step(state, "ego", frame.scene, nothing)
            wanted_mps2 = 0.0 if command is None else command.acceleration_mps2
            share = wanted_mps2 / (3.0 if wanted_mps2 >= 0.0 else 8.0)
            action = np.clip(np.array([share], np.float32), -1.0, 1.0)
        _, reward, terminated, truncated, info = env.step(action)
        earned += reward
        lawless_sum += info["reward_terms"]["lawless"]
        is_over = terminated or truncated
    env.close()
    return info["end"], earned, lawless_sum


def test_full_throttle_through_a_stop_earns_less_than_the_law() -> None:
    end, earned, lawless_sum = drive("full throttle", 1)
    assert end == "arrived"
    assert earned - lawless_sum > 4.5  # as it was before the law counted
    lawful_end, lawful, none = drive("idm", 1)
    assert (lawful_end, none) == ("arrived", 0.0)
    assert 4.0 < lawful < earned - lawless_sum and earned < -10.0


def test_slots_are_driven_lawfully() -> None:
    assert drive("slots", 2)[2] == 0.0


def test_what_policies_learn_from_has_not_changed() -> None:
    weights = RewardWeights(**REWARD)
    terms = Terms(12.5, 0.5, 0.3, 0.2, 0.0, 1.0, 1.0)
    # What the policy that ships was trained with.
    before = (0.01 * 12.5, -0.05 * 0.5, -0.015 * 0.3, -0.25 * 0.2, -10.0, 1.0)
    assert sum(terms.weighted(weights).values()) == sum(before)
    assert sum(replace(terms, lawless=3.0).weighted(weights).values()) == sum(before)
