"""Policies: the law by hand and by driving it, two implementations of one network, one observation
for the environment and the agent."""

from __future__ import annotations

import json
import multiprocessing
import os
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import crossing_lanes, scene_of, slow_but

from hatn_sim import cli
from hatn_sim.datatypes import DT_S, MAX_NODES, Command, Frame, Scene, Truth
from hatn_sim.envs.action import FASTER_MPS2, SLOWER_MPS2
from hatn_sim.envs.features import MODES, ON_ROAD, OTHER, OWN, POINTS, SLOT, VEHICLES
from hatn_sim.envs.mind import glance, open_mind, think
from hatn_sim.envs.observation import Ego, Observation, observe_slots
from hatn_sim.errors import InputError, SimulatorError
from hatn_sim.loop import Adviser, begin, tick
from hatn_sim.planning.situation import Situation
from hatn_sim.policies.beside import mean_time_s
from hatn_sim.policies.driver import PolicyAgent, observed, sight_of
from hatn_sim.policies.inputs import Layout, Moment, inputs_of
from hatn_sim.policies.law import (
    LEVELS_MPS2,
    REACTION_S,
    lawful_mps2,
    yielding_mps,
)
from hatn_sim.policies.lawful_env import make_lawful, share_of
from hatn_sim.policies.network import (
    Network,
    load_network,
    save_network,
    shapes_of,
    shipped_policy,
)
from hatn_sim.policies.timing import gains_mps2, of_nearest, slot_times_s
from hatn_sim.predictors.constant_velocity import ConstantVelocity
from hatn_sim.predictors.find import load_predictor
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator

NAMES = [one.name for one in OWN + ON_ROAD]
LENGTH_M = 5.0


def on_road(speed_mps: float, limit_mps: float = 10.0, **more: float) -> Observation:
    """An ego on a straight road without anybody."""
    own = np.zeros(len(NAMES), np.float32)
    values = {"speed": speed_mps, "length": LENGTH_M} | more
    for name, value in values.items():
        own[NAMES.index(name)] = value
    own[len(OWN)] = 1.0
    for k, name in enumerate(NAMES):
        if name.startswith("speed limit"):
            own[k] = limit_mps
    return {
        "ego": own,
        "vehicles": np.zeros((VEHICLES, len(OTHER)), np.float32),
        "vehicle_mask": np.zeros(VEHICLES, np.float32),
        "slots": np.zeros((MAX_NODES, len(SLOT)), np.float32),
        "slot_mask": np.zeros(MAX_NODES, np.float32),
        "trajectories": np.zeros((VEHICLES + 1, MODES, POINTS, 2), np.float32),
        "mode_probability": np.zeros((VEHICLES + 1, MODES), np.float32),
    }


# -- what it knows ---------------------------------------------------------------------------------


def told(
    observation: Observation, lawful_mps2: float = 1.0, gains: np.ndarray | None = None
) -> Moment:
    """An observation with what is known beside it."""
    known = np.zeros(VEHICLES) if gains is None else gains.copy()
    return Moment(observation, known, lawful_mps2, stood=False)


def merging(ego_m: float, other_m: float, other_mps: float) -> Observation:
    """The ego at 2 m/s and another before a merge, 1.0 s and 1.2 s from it at the earliest."""
    seen = on_road(2.0)
    seen["slot_mask"][:2] = 1.0
    slot = {7: ego_m, 8: other_m, 4: other_mps, 11: 1.0, 12: 1.0, 13: 1.0, 14: 1.2}
    for column, value in slot.items():
        seen["slots"][1, column] = value
    return seen


def test_times_at_a_conflict_worked_out_by_hand() -> None:
    # 4 m beside the conflict on either side: half a length of 5 m and 1.5 m more.
    seen = merging(16.0, 24.0, 5.0)
    gains = np.zeros(MAX_NODES)
    clear_s = (np.sqrt(4.0 + 3.0 * 20.0) - 2.0) / 1.5  # from 2 m/s, at 1.5 m/s2, over 20 m
    comes_s = (np.sqrt(4.0 + 3.0 * 12.0) - 2.0) / 1.5
    expected = [4.0, 4.0, clear_s, 4.0 - clear_s, comes_s - 28.0 / 5.0]
    np.testing.assert_allclose(slot_times_s(seen, gains)[1], expected, rtol=1e-6)
    gains[1] = 2.0
    sooner_s = (np.sqrt(25.0 + 80.0) - 5.0) / 2.0  # 20 m from 5 m/s, at 2 m/s2
    expected[1], expected[3] = sooner_s, sooner_s - clear_s
    np.testing.assert_allclose(slot_times_s(seen, gains)[1], expected, rtol=1e-6)
    # Who brakes may stop to do so.
    gains[1] = -2.0
    assert slot_times_s(seen, gains)[1, 1] == pytest.approx(4.0)
    # 10 m/s are the limit: 4 s and 24 m to get there from 4 m/s, the other 24 m at it.
    fast = on_road(4.0)
    fast["slot_mask"][1] = 1.0
    fast["slots"][1, 7] = 24.0 + 24.0 * 10.0 / 24.0 - 4.0
    assert slot_times_s(fast, np.zeros(MAX_NODES))[1, 2] == pytest.approx(4.0 + 0.6)
    assert not slot_times_s(fast, gains)[[0, 2]].any()


def test_accelerations_are_of_the_time_since_the_last_decision() -> None:
    places = {"far": (40.0, 0.0, 0.0, 4.0), "ego": (0.0, 0.0, 0.0, 9.0), "near": (9.0, 0, 0, 7.0)}
    scene = scene_of(1.0, places)
    gains = gains_mps2(scene, {"near": 6.0, "ego": 1.0}, frames=5)
    # Who was not there has kept its speed.
    np.testing.assert_allclose(gains, [0.0, 16.0, 2.0])
    nearest = of_nearest(scene, 1, gains)
    np.testing.assert_allclose(nearest[:2], [2.0, 0.0])
    assert nearest.shape == (VEHICLES,) and not nearest[2:].any()


def test_the_acceleration_of_a_vehicle_is_that_of_the_slot_before_it() -> None:
    seen = merging(16.0, 24.0, 5.0)
    seen["vehicle_mask"][:2] = 1.0
    seen["vehicles"][1, -1] = 1.0  # the number of its slot
    gains = np.zeros(VEHICLES)
    still, gains[1] = told(seen, gains=gains), 1.5
    moves = told(seen, gains=gains)
    layout = Layout(False)
    rows = [inputs_of(layout, one) for one in (still, moves)]
    changed = [
        np.flatnonzero(np.not_equal(*(row[part] for row in rows))) for part in layout.parts()
    ]
    slot, other = layout.slot, layout.other
    # Of the slot: the acceleration, when the other comes, and how long before that it is clear.
    assert changed[1].tolist() == [slot + k for k in (slot - 6, slot - 4, slot - 2)]
    assert changed[3].tolist() == [2 * other - 1]
    assert rows[1][layout.parts()[3]][2 * other - 1] == pytest.approx(0.5)  # of 3 m/s2
    assert not any(len(changed[part]) for part in (0, 2, 4))


# -- the network ----------------------------------------------------------------------------------


def random_network(layout: Layout, seed: int = 0) -> Network:
    rng = np.random.default_rng(seed)
    tensors = {
        name: rng.normal(0.0, 0.3, shape).astype(np.float32)
        for name, shape in shapes_of(layout).items()
    }
    return Network(layout, tensors, {"note": "learnt nothing"})


def test_without_sight_of_predictions_they_do_not_count() -> None:
    rng = np.random.default_rng(1)
    seen = on_road(5.0)
    other = dict(seen)
    other["trajectories"] = rng.normal(0.0, 9.0, seen["trajectories"].shape).astype(np.float32)
    other["slots"] = seen["slots"].copy()
    other["slots"][:, -1] = 0.3
    blind, sighted = Layout(False), Layout(True)
    np.testing.assert_array_equal(inputs_of(blind, told(seen)), inputs_of(blind, told(other)))
    rows = [inputs_of(sighted, told(one)) for one in (seen, other)]
    assert rows[0].shape == (sighted.size,) and (rows[0] != rows[1]).sum() > 100
    # An episode's end hurries nobody.
    late = dict(seen) | {"ego": seen["ego"].copy()}
    late["ego"][len(OWN) - 1] = 0.7
    np.testing.assert_array_equal(inputs_of(sighted, told(seen)), inputs_of(sighted, told(late)))


def test_the_order_of_vehicles_is_without_effect() -> None:
    rng = np.random.default_rng(2)
    seen = on_road(5.0)
    seen["vehicles"][:4] = rng.normal(0.0, 9.0, (4, len(OTHER)))
    seen["vehicles"][:4, -1] = 0.0  # before no slot
    seen["vehicle_mask"][:4] = 1.0
    turned = dict(seen) | {"vehicles": seen["vehicles"].copy()}
    turned["vehicles"][:4] = seen["vehicles"][[2, 0, 3, 1]]
    masked = dict(seen) | {"vehicles": seen["vehicles"].copy()}
    masked["vehicles"][9] = 5.0  # and so is the number of its slot
    network = random_network(Layout(False))
    values = [network.values(inputs_of(network.layout, told(one))) for one in (seen, turned)]
    np.testing.assert_allclose(values[0], values[1], rtol=1e-5)
    behind_mask = network.values(inputs_of(network.layout, told(masked)))
    np.testing.assert_array_equal(values[0], behind_mask)


def test_a_level_is_an_action_of_the_environment() -> None:
    for wanted in (-8.0, -3.0, 0.0, 1.4):
        share = share_of(wanted)
        assert (share * FASTER_MPS2 if share >= 0 else -share * SLOWER_MPS2) == wanted


def test_weights_come_back_and_damaged_ones_are_refused(tmp_path: Path) -> None:
    path, network = tmp_path / "mine.safetensors", random_network(Layout(True))
    save_network(path, network)
    back = load_network(path)
    row = np.linspace(-1.0, 1.0, network.layout.size, dtype=np.float32)
    np.testing.assert_array_equal(back.values(row), network.values(row))
    assert back.card["note"] == "learnt nothing"
    card = json.loads(path.with_suffix(".json").read_text())
    for key, value, said in (
        ("levels_mps2", [1.0], "another levels_mps2"),
        ("sees_predictions", False, "not of the shapes of the card"),
        ("features", {}, "another features"),
    ):
        path.with_suffix(".json").write_text(json.dumps(card | {key: value}))
        with pytest.raises(InputError, match=said):
            load_network(path)
    save_network(path, replace(network, tensors={k: v * np.nan for k, v in back.tensors.items()}))
    with pytest.raises(InputError, match="not finite"):
        load_network(path)
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="cannot be read with its card"):
        load_network(path)


class OneIsRight(gymnasium.Env[np.ndarray, int]):
    """Pays for the hardest braking where the first number is negative, else for the other end."""

    def __init__(self, layout: Layout) -> None:
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (layout.size,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(len(LEVELS_MPS2))

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        self._left = 10
        return self._row(), {}

    def step(self, action: int) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        paid = float(action == (0 if self._now < 0 else len(LEVELS_MPS2) - 1))
        self._left -= 1
        over = self._left == 0
        return self._row(), paid, over, False, {"end": "arrived", "driven_s": 5.0}

    def _row(self) -> np.ndarray:
        row = self.np_random.normal(0.0, 0.1, self.observation_space.shape).astype(np.float32)
        self._now = row[0] = self.np_random.choice((-1.0, 1.0))
        return row


@pytest.mark.parametrize(
    ("algorithm", "steps"),
    [("ppo", 3072), pytest.param("dqn", 4000, marks=pytest.mark.slow)],
)
def test_what_is_learnt_drives_the_same_without_torch(algorithm: Any, steps: int) -> None:
    pytest.importorskip("stable_baselines3", reason="the extra rl is not installed")
    import torch
    from stable_baselines3.common.vec_env import DummyVecEnv

    from hatn_sim.policies.training import Pace, learn, make_learner, network_of

    layout = Layout(False)
    make_env: Any = lambda: OneIsRight(layout)  # noqa: E731 - stands in for the traffic
    learner = make_learner(algorithm, DummyVecEnv([make_env, make_env]), layout, seed=3)
    watched: list[Any] = []
    rows = learn(learner, Pace(10.0, steps), watched.append, lambda: None)
    assert rows == watched and rows[-1].arrived == 1.0 and rows[-1].time_s == 5.0
    network = network_of(learner, layout, {})
    assert {name: one.shape for name, one in network.tensors.items()} == shapes_of(layout)
    right = 0
    for seed in range(40):
        row, _ = (env := OneIsRight(layout)).reset(seed=seed)
        chosen, _ = learner.predict(row, deterministic=True)
        assert network.best(row) == int(chosen)
        right += int(chosen) == (0 if env._now < 0 else len(LEVELS_MPS2) - 1)
        with torch.no_grad():
            batch = torch.from_numpy(row)[None]
            if algorithm == "dqn":
                theirs = learner.q_net(batch)[0].numpy()  # type: ignore[attr-defined]
            else:
                theirs = learner.policy.get_distribution(batch).distribution.logits[0].numpy()
        ours = network.values(row)
        np.testing.assert_allclose(ours - ours.mean(), theirs - theirs.mean(), atol=1e-4)
    assert right >= 36


class Dies(gymnasium.Env[Any, Any]):
    """Its process ends without a word where it is told to."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, where: str) -> None:
        self._where = where
        self._at("made")

    def _at(self, place: str) -> None:
        if place == self._where:
            os._exit(3)

    def reset(self, **_: Any) -> Any:
        self._at("reset")
        return np.zeros(2, np.float32), {}

    def step(self, action: Any) -> Any:
        self._at("step")
        return np.zeros(2, np.float32), 0.0, False, False, {"end": None, "driven_s": 0.5}


@pytest.mark.parametrize("where", slow_but(["made", "reset", "step"], "step"))
def test_the_death_of_an_environments_process_is_one_error_and_the_end_of_all(where: str) -> None:
    pytest.importorskip("stable_baselines3", reason="the extra rl is not installed")
    from hatn_sim.policies.training import side_by_side

    makers: Any = [partial(Dies, "never"), partial(Dies, where)]
    with (
        pytest.raises(SimulatorError, match="the process of an environment died"),
        side_by_side(makers) as envs,
    ):
        envs.reset()
        envs.step(np.zeros(2, np.int64))
    deadline = time.monotonic() + 30.0
    while multiprocessing.active_children() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not multiprocessing.active_children()


# -- the agent ------------------------------------------------------------------------------------


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    path = tmp_path / "mine.safetensors"
    save_network(path, random_network(Layout(True), seed=4))
    return path


def test_an_agent_makes_graphs_itself_where_a_predictor_has_none(weights: Path) -> None:
    road = Road(crossing_lanes())
    mind = open_mind(ConstantVelocity(), "inferred", "ego", road)
    agent = PolicyAgent(weights)
    state = agent.init(road)
    lane_routes = (("w", "we", "e"), ("s", "sn", "n"))
    for k in range(11):
        ego_mps = 10.0 - 0.3 * k
        places = {
            "ego": (-40.0 + 10.0 * k * DT_S, 0.0, 0.0, ego_mps),
            "other": (0.0, -28.0 + 8.0 * k * DT_S, np.pi / 2, 8.0),
        }
        frame = Frame(scene_of(k * DT_S, places), Truth(lane_routes), done=False)
        if k < 10:
            mind = glance(mind, frame)
            _, thought = think(mind, frame)
        else:
            mind, thought = think(mind, frame)
        before = state
        state, command = agent.step(state, "ego", frame.scene, thought.advice)
        assert command is not None and command.ego_id == "ego"
    seen = replace(state, speed_mps=before.speed_mps)
    ours = observed(seen, 0, frame.scene, sight_of(seen, thought.advice))
    theirs = observe_slots(frame.scene, Ego(0, -3.0, 1.0), thought.sight)
    for key, value in theirs.items():
        np.testing.assert_allclose(ours[key], value, atol=1e-5, err_msg=key)
    assert agent.step(state, "somebody else", frame.scene, thought.advice) == (state, None)


def test_an_agent_drives_as_its_network_does_in_the_environment(
    weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each law that is asked answers the same; here a line and others hold the ego back."""
    asked: dict[str, list[tuple[bool, float]]] = {"lawful_env": [], "driver": []}
    held = {"line": 0, "others": 0, "route": 0}

    def spy(who: str) -> Any:
        def lawful(now: Situation | None, gains: np.ndarray) -> float:
            found = lawful_mps2(now, gains)
            asked[who].append((now is not None and now.has_stopped, found))
            if now is not None and who == "driver":
                held["line"] += bool(np.isfinite(now.stop_m) and found < 2.0)
                held["others"] += len(yielding_mps(now, gains))
                held["route"] += now.line != seen_lines[-1]
            return found

        return lawful

    for who in asked:
        monkeypatch.setattr(f"hatn_sim.policies.{who}.lawful_mps2", spy(who))
    seen_lines: list[int] = []
    network, steps, seed = load_network(weights), 34, 11
    last = max(name for name in network.tensors if name.startswith("head") and "bias" in name)
    network.tensors[last][:] = 9.0 * np.arange(len(LEVELS_MPS2)) ** 2  # it would rather go
    save_network(weights, network)
    told = {"warm_up_s": 20.0, "ego": "taken_over", "density": "light"}
    env = make_lawful("intersection5", "hatn", network.layout, **told)
    row, info = env.reset(seed=seed)
    ego_id, driven = info["ego_id"], []
    for _ in range(steps):
        row, _, is_over, _, info = env.step(network.best(row))
        assert not is_over
        scene = info["seen"].scene
        driven.append(scene.xy_m[scene.ids.index(ego_id)])
    env.close()

    simulator = SumoSimulator(env.unwrapped.scenario)
    try:
        frame = simulator.reset(seed)
        adviser = Adviser(load_predictor("hatn"), egos=frozenset({ego_id}))
        agent = PolicyAgent(weights)
        advised, state = begin(adviser, simulator.road), agent.init(simulator.road)
        begins_s = info["time_s"] - steps * REACTION_S
        ours = []
        while len(ours) < steps:
            if frame.scene.time_s > begins_s - 1.2:
                advised, advice = tick(adviser, advised, frame)
            command = None
            if frame.scene.time_s > begins_s - 0.01:
                own = frame.scene.ids.index(ego_id)
                seen_lines.append(int(advice.prediction.lines.line[own]))
                state = agent.guide(state, frame.truth.routes[own])
                state, command = agent.step(state, ego_id, frame.scene, advice)
                if state.frames % 5 == 1 and state.frames > 1:
                    ours.append(frame.scene.xy_m[frame.scene.ids.index(ego_id)])
            frame = simulator.step(() if command is None else (command,))
    finally:
        simulator.close()
    np.testing.assert_allclose(ours, driven, atol=1e-6)
    theirs = asked["lawful_env"][: len(asked["driver"])]
    assert [stood for stood, _ in asked["driver"]] == [stood for stood, _ in theirs]
    lawful = [[found for _, found in one] for one in (asked["driver"], theirs)]
    np.testing.assert_allclose(*lawful, atol=1e-6)
    assert all(held.values()), held
    assert any(stood for stood, _ in theirs)


@pytest.mark.parametrize("name", ["ppo", "dqn"])
def test_shipped_policies_are_small_and_say_how_they_were_made(name: str) -> None:
    path = shipped_policy(name)
    network = load_network(path)
    assert path.stat().st_size < 2_000_000
    assert f"--algorithm {name}" in network.card["command"]


class Gentle:
    """Gains speed as long as nothing is known against it."""

    def init(self, road: Road) -> int:
        return 0

    def step(
        self, state: int, ego_id: str, scene: Scene, advice: Any
    ) -> tuple[int, Command | None]:
        assert advice.prediction.xy_m.shape[0] == len(scene.ids)
        slow = scene.speed_mps[scene.ids.index(ego_id)] < 5.0
        return state + 1, Command(ego_id, 1.5) if slow else None


def test_a_mark_is_the_time_that_an_agent_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hatn_sim.policies.beside.EPISODES", 2)
    told: list[Any] = []
    found_s = mean_time_s(
        Gentle(),
        ("tjunction",),
        "constant_velocity",
        lambda *done: told.append(done),
        density="light",
    )
    times_s = []
    env = gymnasium.make(
        "hatn_sim.envs:hatn_sim/Scene-v0",
        scene="tjunction",
        density="light",
        predictor=None,
        action="acceleration",
        frames_per_step=1,
        observation="vehicles",
    )
    for seed in (0, 1):
        seen, info = env.reset(seed=seed)
        begins_s, is_over = info["time_s"], False
        while not is_over:
            share = 0.5 * float(seen["ego"][0] < 5.0)
            seen, _, *ends, info = env.step(np.array([share], np.float32))
            is_over = any(ends)
        times_s.append(info["time_s"] - begins_s)
    env.close()
    assert found_s == pytest.approx(sum(times_s) / 2) and times_s[0] != times_s[1]
    assert told == [(1, 2), (2, 2)]


# -- the command ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "."], "exists already"),
        (["--out", "new", "--seed", "-1"], "--seed -1: expected 0 to"),
        (["--out", "new", "--scenes", "intersecton5"], "did you mean 'intersection5'"),
        (["--out", "new", "--predictor", "hatnn"], "did you mean 'hatn'"),
        (["--out", "new", "--mark", "=3"], "expected AGENT or NAME=SECONDS, found '=3'"),
        (["--out", "new", "--mark", "idmm"], "did you mean 'idm'"),
        (["--out", "new", "--algorithm", "sac"], "invalid choice"),
    ],
)
def test_what_is_wrong_with_a_training(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: Any, tmp_path: Any
) -> None:
    pytest.importorskip("stable_baselines3", reason="the extra rl is not installed")
    monkeypatch.chdir(tmp_path)
    try:
        code = cli.main(["train-policy", *words])
    except SystemExit as exit_:
        code = int(exit_.code or 0)
    printed = capsys.readouterr().err
    assert code == 2 and said in printed and printed.count("\n") <= 2
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_a_short_training_leaves_weights_card_progress_and_a_picture(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("stable_baselines3", reason="the extra rl is not installed")
    out = tmp_path / "new"
    words = ["--scenes", "intersection5", "--envs", "2", "--steps", "2000", "--quiet"]
    words += ["--out", str(out)]
    assert cli.main(["train-policy", *words, "--mark", "idm=30", "--mark", "idm"]) == 0
    printed = capsys.readouterr().out
    assert "decisions in" in printed and "; idm takes " in printed
    network = load_network(out / "ppo.safetensors")
    assert str(tmp_path) not in network.card["command"]
    assert len((out / "progress.jsonl").read_text().splitlines()) >= 1
    assert (out / "progress.png").stat().st_size > 10_000
