"""How many simulator frames a second environments give, beside highway-env's in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from statistics import mean, median
from typing import Any, Final

import gymnasium
import numpy as np

from hatn_sim.config import Scenario
from hatn_sim.datatypes import DT_S, Predictor
from hatn_sim.envs.options import EnvOptions
from hatn_sim.envs.scene_env import SceneEnv
from hatn_sim.envs.traffic import warm_up_s
from hatn_sim.envs.vector_env import SceneVectorEnv
from hatn_sim.simulators.sumo import SumoSimulator

BESIDE: Final = "intersection-v2"
"""The environment of highway-env that all are compared with."""
TOGETHER: Final = 8
CHUNK_FRAMES: Final = 150
"""They take turns of about so many, so that whatever slows the machine down slows all of them."""
RESETS: Final = 7

Drive = Callable[[], tuple[int, float, Callable[[], object] | None]]
"""One step: frames simulated, vehicles at once, and what to do before the next, not timed."""


@dataclass(frozen=True)
class EnvSpeed:
    """Frames of one kind of environment."""

    what: str
    vehicles: float  # mean number at once, of each simulator
    frames_per_s: float
    ratio: float  # to highway-env's


@dataclass(frozen=True)
class ResetTime:
    """A `reset`, and what of it the simulator alone would take; medians, in ms."""

    what: str
    reset_ms: float
    bare_ms: float  # SUMO's own steps of the warm-up


def measure_speeds(
    scenario: Scenario, predictor: Predictor, rounds: int, seed: int
) -> list[EnvSpeed]:
    """highway-env first, then environments of the scene: without prediction, with, side by side."""
    plain: dict[str, Any] = {"scene": scenario, "predictor": None}
    predicting: dict[str, Any] = {
        "scene": scenario,
        "predictor": predictor,
        "masked_action": "yield",
    }
    bare: dict[str, Any] = {"advice": False, "action": "acceleration"}
    with ExitStack() as stack:
        contenders: dict[str, Drive] = {f"highway-env, {BESIDE}": _highway(stack, seed)}
        contenders["no prediction"] = _scene(stack, seed, plain)
        for words, frames in (("each step", 5), ("each frame", 1)):
            options = predicting | {"frames_per_step": frames}
            name = f"{predictor.name}, {words}"
            contenders[f"{name}, advised"] = _scene(stack, seed, options)
            contenders[name] = _scene(stack, seed, options | bare)
            contenders[f"{name}, {TOGETHER} side by side"] = _several(stack, seed, options | bare)
        taken_s = dict.fromkeys(contenders, 0.0)
        frames_of = dict.fromkeys(contenders, 0)
        vehicles: dict[str, list[float]] = {name: [] for name in contenders}
        for _ in range(rounds):
            for name, drive in contenders.items():
                until = frames_of[name] + CHUNK_FRAMES
                while frames_of[name] < until:
                    start = time.perf_counter()
                    frames, count, prepare = drive()
                    taken_s[name] += time.perf_counter() - start
                    frames_of[name] += frames
                    vehicles[name].append(count)
                    if prepare is not None:
                        prepare()
    per_s = {name: frames_of[name] / taken_s[name] for name in contenders}
    beside = next(iter(per_s.values()))
    return [
        EnvSpeed(name, mean(vehicles[name]), speed, speed / beside) for name, speed in per_s.items()
    ]


def measure_resets(scenario: Scenario, predictor: Predictor, seed: int) -> list[ResetTime]:
    """Of environments without prediction and with it."""
    frames = round(warm_up_s(EnvOptions(scene=scenario), scenario) / DT_S)
    rows: list[ResetTime] = []
    for what, used in (("no prediction", None), (predictor.name, predictor)):
        env = SceneEnv(scene=scenario, predictor=used)
        reset_ms: list[float] = []
        bare_ms: list[float] = []
        with SumoSimulator(scenario) as simulator:
            env.reset(seed=seed)  # the road is drawn once
            for number in range(seed + 1, seed + 1 + RESETS):
                start = time.perf_counter()
                env.reset(seed=number)
                reset_ms.append(1e3 * (time.perf_counter() - start))
                simulator.reset(number)
                bare_s = 0.0
                for _ in range(frames):
                    simulator.step()
                    bare_s += simulator.sumo_s
                bare_ms.append(1e3 * bare_s)
        env.close()
        rows.append(ResetTime(what, median(reset_ms), median(bare_ms)))
    return rows


def _highway(stack: ExitStack, seed: int) -> Drive:
    env: Any = gymnasium.make(f"highway_env:{BESIDE}").unwrapped
    stack.callback(env.close)
    env.reset(seed=seed)
    env.action_space.seed(seed)
    each = env.config["simulation_frequency"] // env.config["policy_frequency"]

    def drive() -> tuple[int, float, Callable[[], object] | None]:
        _, _, ends, is_cut, _ = env.step(env.action_space.sample())
        return each, len(env.road.vehicles), env.reset if ends or is_cut else None

    return drive


def _scene(stack: ExitStack, seed: int, options: dict[str, Any]) -> Drive:
    env = SceneEnv(**options)
    stack.callback(env.close)
    env.reset(seed=seed)
    action: Any = np.zeros(1, np.float32) if env.options.action_form != "slot" else 0

    def drive() -> tuple[int, float, Callable[[], object] | None]:
        _, _, ends, is_cut, info = env.step(action)
        count = len(info["seen"].scene.ids)
        return env.options.frames_per_step, count, env.reset if ends or is_cut else None

    return drive


def _several(stack: ExitStack, seed: int, options: dict[str, Any]) -> Drive:
    env = SceneVectorEnv(TOGETHER, autoreset_mode="Disabled", **options)
    stack.callback(env.close)
    env.reset(seed=seed)
    actions = np.zeros((TOGETHER, 1), np.float32)
    frames = TOGETHER * options["frames_per_step"]

    def drive() -> tuple[int, float, Callable[[], object] | None]:
        _, _, ends, cuts, info = env.step(actions)
        over = ends | cuts
        counts: Sequence[int] = [len(seen.scene.ids) for seen in info["seen"]]
        begin_anew = (lambda: env.reset(options={"reset_mask": over})) if over.any() else None
        return frames, mean(counts), begin_anew

    return drive
