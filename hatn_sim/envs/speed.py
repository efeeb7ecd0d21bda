"""How many simulator frames a second environments give, beside highway-env's in the same run.

Like is held against like: highway-env's frames are driven twice, the same both times. The first
time its vehicles are counted, and the demand of the scene is chosen so that in its environments,
over the episodes that will be timed, there are as many at once. The second time counts.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
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
KNOWN_EPISODES: Final = 40
"""After so many more episodes most ways that cross have been met."""
SCALES: Final = (0.05, 6.0)
"""Demands are looked for between these multiples of what route files say."""
CLOSE: Final = 0.02
"""Mean numbers of vehicles that differ by this share are the same."""
HALVINGS: Final = 6
NEARBY: Final = tuple(sign * 0.02 * k for k in range(1, 10) for sign in (1.0, -1.0))
"""Demands beside the one that halving came to, as shares of it: a little more traffic may be fewer
vehicles at once, as other vehicles meet."""

Drive = Callable[[], tuple[int, float, Callable[[], object] | None]]
"""One step: frames simulated, vehicles at once, and what to do before the next, not timed."""
Open = Callable[[ExitStack, float], Drive]
"""Begins the episodes of a contender, with the demand of the scene multiplied so."""


@dataclass(frozen=True)
class EnvSpeed:
    """Frames of one kind of environment."""

    what: str
    scale: float | None  # of the demand in the scene's route files; None: highway-env
    vehicles: float  # mean number at once, of each simulator
    frame_s: float  # that passes in a frame
    frames_per_s: float
    ratio: float  # to highway-env's frames
    ratio_of_time: float  # the same of the time that passes in them


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
    plain: dict[str, Any] = {"predictor": None}
    predicting: dict[str, Any] = {"predictor": predictor, "action": "acceleration"}
    alone, several = (partial(kind, scenario, seed) for kind in (_alone, _several))
    wanted = mean_vehicles(partial(_highway, seed=seed), 1.0, rounds)
    # What is predicted changes nothing in the traffic, nor does how many frames make a step.
    alone_scale, several_scale = (
        scale_to_meet(partial(mean_vehicles, kind(plain), rounds=rounds), wanted)
        for kind in (alone, several)
    )
    contenders: dict[str, tuple[float | None, Open]] = {
        f"highway-env, {BESIDE}": (None, partial(_highway, seed=seed)),
        "no prediction": (alone_scale, alone(plain)),
    }
    # In highway-env's a step is a second; as rarely, as often as steps are, and as often as may be.
    for words, frames in (("each second", 10), ("each step", 5), ("each frame", 1)):
        advised = predicting | {"frames_per_step": frames}
        bare = advised | {"advice": False}
        name = f"{predictor.name}, {words}"
        contenders[f"{name}, advised"] = alone_scale, alone(advised)
        contenders[name] = alone_scale, alone(bare)
        contenders[f"{name}, {TOGETHER} side by side"] = several_scale, several(bare)
    taken_s = dict.fromkeys(contenders, 0.0)
    frames_of = dict.fromkeys(contenders, 0)
    vehicles: dict[str, list[float]] = {name: [] for name in contenders}
    with ExitStack() as stack:
        drives = {name: begin(stack, scale or 1.0) for name, (scale, begin) in contenders.items()}
        for _ in range(rounds):
            for name, drive in drives.items():
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
    beside_s = _highway_frame_s()
    speeds: list[EnvSpeed] = []
    for name, (scale, _) in contenders.items():
        frame_s = beside_s if scale is None else DT_S
        ratio = per_s[name] / beside
        of_time = ratio * frame_s / beside_s
        count = mean(vehicles[name])
        speeds.append(EnvSpeed(name, scale, count, frame_s, per_s[name], ratio, of_time))
    return speeds


def mean_vehicles(begin: Open, scale: float, rounds: int) -> float:
    """Vehicles at once over as many frames of a contender as will be timed."""
    counts: list[float] = []
    with ExitStack() as stack:
        drive = begin(stack, scale)
        for _ in range(rounds):
            left = CHUNK_FRAMES
            while left > 0:
                frames, count, prepare = drive()
                left -= frames
                counts.append(count)
                if prepare is not None:
                    prepare()
    return mean(counts)


def scale_to_meet(vehicles_at: Callable[[float], float], wanted: float) -> float:
    """The demand, of those tried, at which there are as many vehicles as wanted, or nearly so.

    `vehicles_at` tells how many there are at a demand; it rises, if not at every step.
    """
    found: dict[float, float] = {}

    def tried(scale: float) -> float:
        count = vehicles_at(scale)
        found[abs(count / wanted - 1.0)] = scale
        return count

    low, high = SCALES
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if tried(middle) < wanted else (low, middle)
        if min(found) <= CLOSE:
            break
    nearest = found[min(found)]
    for share in NEARBY:
        if min(found) <= CLOSE:
            break
        tried(min(nearest * (1.0 + share), SCALES[1]))
    return found[min(found)]


def measure_resets(scenario: Scenario, predictor: Predictor, seed: int) -> list[ResetTime]:
    """Of environments without prediction, and with it: in their first episodes, and later on."""
    frames = round(warm_up_s(EnvOptions(scene=scenario), scenario) / DT_S)
    rows: list[ResetTime] = []
    for what, used in (("no prediction", None), (predictor.name, predictor)):
        env = SceneEnv(scene=scenario, predictor=used)
        env.reset(seed=seed)  # the road is drawn once
        seeds = range(seed + 1, seed + 1 + RESETS)
        rows.append(_reset_time(what, env, seeds, scenario, frames))
        if used is not None:  # who meets whom where is found out once, too
            known = seeds.stop + KNOWN_EPISODES
            for number in range(seeds.stop, known):
                env.reset(seed=number)
            what = f"{what}, from episode {known - seed + 1} on"
            rows.append(_reset_time(what, env, range(known, known + RESETS), scenario, frames))
        env.close()
    return rows


def _reset_time(
    what: str, env: SceneEnv, seeds: range, scenario: Scenario, frames: int
) -> ResetTime:
    reset_ms: list[float] = []
    bare_ms: list[float] = []
    with SumoSimulator(scenario) as simulator:
        for number in seeds:
            start = time.perf_counter()
            env.reset(seed=number)
            reset_ms.append(1e3 * (time.perf_counter() - start))
            simulator.reset(number)
            bare_s = 0.0
            for _ in range(frames):
                simulator.step()
                bare_s += simulator.sumo_s
            bare_ms.append(1e3 * bare_s)
    return ResetTime(what, median(reset_ms), median(bare_ms))


def _highway(stack: ExitStack, _scale: float, *, seed: int) -> Drive:
    env: Any = gymnasium.make(f"highway_env:{BESIDE}").unwrapped
    stack.callback(env.close)
    env.reset(seed=seed)
    env.action_space.seed(seed)
    each = env.config["simulation_frequency"] // env.config["policy_frequency"]

    def drive() -> tuple[int, float, Callable[[], object] | None]:
        _, _, ends, is_cut, _ = env.step(env.action_space.sample())
        return each, len(env.road.vehicles), env.reset if ends or is_cut else None

    return drive


def _highway_frame_s() -> float:
    env: Any = gymnasium.make(f"highway_env:{BESIDE}").unwrapped
    env.close()
    return 1.0 / float(env.config["simulation_frequency"])


def _scaled(scenario: Scenario, scale: float) -> Scenario:
    return replace(scenario, scale=scale, density=None)


def _alone(scenario: Scenario, seed: int, options: dict[str, Any]) -> Open:
    def begin(stack: ExitStack, scale: float) -> Drive:
        env = SceneEnv(scene=_scaled(scenario, scale), **options)
        stack.callback(env.close)
        env.reset(seed=seed)
        action = np.zeros(1, np.float32)

        def drive() -> tuple[int, float, Callable[[], object] | None]:
            _, _, ends, is_cut, info = env.step(action)
            count = len(info["seen"].scene.ids)
            return env.options.frames_per_step, count, env.reset if ends or is_cut else None

        return drive

    return begin


def _several(scenario: Scenario, seed: int, options: dict[str, Any]) -> Open:
    def begin(stack: ExitStack, scale: float) -> Drive:
        scene = _scaled(scenario, scale)
        env = SceneVectorEnv(TOGETHER, autoreset_mode="Disabled", scene=scene, **options)
        stack.callback(env.close)
        env.reset(seed=seed)
        actions = np.zeros((TOGETHER, 1), np.float32)
        frames = TOGETHER * options.get("frames_per_step", EnvOptions.frames_per_step)

        def drive() -> tuple[int, float, Callable[[], object] | None]:
            _, _, ends, cuts, info = env.step(actions)
            over = ends | cuts
            counts: Sequence[int] = [len(seen.scene.ids) for seen in info["seen"]]
            begin_anew = (lambda: env.reset(options={"reset_mask": over})) if over.any() else None
            return frames, mean(counts), begin_anew

        return drive

    return begin
