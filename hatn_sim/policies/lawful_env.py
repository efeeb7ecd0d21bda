"""The environment that policies learn in: an action is a level of acceleration, within the law."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, cast

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete

from hatn_sim.envs.action import FASTER_MPS2, SLOWER_MPS2
from hatn_sim.envs.features import VEHICLES
from hatn_sim.envs.observation import Observation
from hatn_sim.envs.scene_env import SceneEnv
from hatn_sim.policies.inputs import Layout, Moment, inputs_of
from hatn_sim.policies.law import HOLDS_FRAMES, LEVELS_MPS2, lawful_mps2, level_mps2
from hatn_sim.policies.timing import Speeds, gains_mps2, of_nearest, speeds_of

REWARD: Final = {
    "progress_m": 0.01,
    "time_s": -0.05,
    "discomfort_s": -0.015,
    "risk_s": -0.25,
    "lawless": 0.0,
    "collision": -10.0,
    "arrival": 1.0,
}
"""200 s of waiting are no worse than one collision; comfort counts less than time. The law is kept
for the policy: nothing is to be learnt of it."""


class LawfulLevels(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Observes the row of a policy's inputs, and drives its levels."""

    def __init__(self, env: gymnasium.Env[Observation, Any], layout: Layout) -> None:
        super().__init__(env)
        self.layout = layout
        self.observation_space = Box(-np.inf, np.inf, (layout.size,), np.float32)
        self.action_space = Discrete(len(LEVELS_MPS2))  # type: ignore[assignment]
        self._stood = False
        self._lawful_mps2 = 0.0
        self._before: Speeds = {}  # a decision ago
        self._start_s = 0.0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """As of the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._stood, self._before, self._start_s = False, {}, info["time_s"]
        return self._seen(observation, info), info

    def step(self, action: int) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drives a level, by its number; `info` has `driven_s`, since the ego came."""
        wanted = level_mps2(int(action), self._lawful_mps2)
        share = np.array([share_of(wanted)], np.float32)
        observation, reward, is_terminal, is_cut, info = self.env.step(share)
        info["driven_s"] = info["time_s"] - self._start_s
        return self._seen(observation, info), float(reward), is_terminal, is_cut, info

    def infer_lines(self) -> None:
        """From the next episode on nobody's route is told."""
        scene_env = cast(SceneEnv, self.unwrapped)
        scene_env.options = replace(scene_env.options, lines="inferred")

    def _seen(self, observation: Observation, info: dict[str, Any]) -> np.ndarray:
        scene, ego_id = info["seen"].scene, info["ego_id"]
        gains = gains_mps2(scene, self._before, HOLDS_FRAMES)
        now = cast(SceneEnv, self.unwrapped).situation(self._stood)
        self._before = speeds_of(scene)
        self._stood = now is not None and now.has_stopped
        self._lawful_mps2 = lawful_mps2(now, gains)
        near = np.zeros(VEHICLES)
        if ego_id in scene.ids:
            near = of_nearest(scene, scene.ids.index(ego_id), gains)
        moment = Moment(observation, near, self._lawful_mps2, self._stood)
        return inputs_of(self.layout, moment)


class BriefInfo(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Tells no more than a learner reads: all of it goes from process to process."""

    def reset(self, **given: Any) -> tuple[np.ndarray, dict[str, Any]]:
        row, _ = self.env.reset(**given)
        return row, {}

    def step(self, action: int) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        row, reward, is_terminal, is_cut, info = self.env.step(action)
        told = {"end": info["end"], "driven_s": info["driven_s"]}
        return row, float(reward), is_terminal, is_cut, told


def share_of(wanted_mps2: float) -> float:
    """An acceleration as an action of the form `acceleration`."""
    return wanted_mps2 / (FASTER_MPS2 if wanted_mps2 >= 0.0 else -SLOWER_MPS2)


def make_lawful(scene: str, predictor: str, layout: Layout, **options: Any) -> LawfulLevels:
    """An environment of this scene to learn in, or to be judged in. Raises OptionError."""
    env = gymnasium.make(
        "hatn_sim.envs:hatn_sim/Scene-v0",
        scene=scene,
        predictor=predictor,
        observation="slots",
        action="acceleration",
        reward=REWARD,
        advice=False,
        disable_env_checker=True,
        **options,
    )
    return LawfulLevels(env, layout)
