"""The environment that policies learn in: an action is a level of acceleration, within the law."""

from __future__ import annotations

from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete

from hatn_sim.envs.action import FASTER_MPS2, SLOWER_MPS2
from hatn_sim.envs.observation import Observation
from hatn_sim.policies.inputs import Layout, inputs_of
from hatn_sim.policies.law import LEVELS_MPS2, has_stood, lawful_mps2, level_mps2

REWARD: Final = {"time_s": -0.1, "arrival": 2.0, "lawless": 0.0}
"""Beside the weights that environments have: 100 s of waiting are no worse than one collision.
The law is kept for the policy: nothing is to be learnt of it."""


class LawfulLevels(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Observes the row of a policy's inputs, and drives its levels."""

    def __init__(self, env: gymnasium.Env[Observation, Any], layout: Layout) -> None:
        super().__init__(env)
        self.layout = layout
        self.observation_space = Box(-np.inf, np.inf, (layout.size,), np.float32)
        self.action_space = Discrete(len(LEVELS_MPS2))  # type: ignore[assignment]
        self._stood = False
        self._lawful_mps2 = 0.0
        self._start_s = 0.0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """As of the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._stood, self._start_s = False, info["time_s"]
        return self._seen(observation), info

    def step(self, action: int) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Drives a level, by its number; `info` has `driven_s`, since the ego came."""
        wanted = level_mps2(int(action), self._lawful_mps2)
        share = np.array([share_of(wanted)], np.float32)
        observation, reward, is_terminal, is_cut, info = self.env.step(share)
        info["driven_s"] = info["time_s"] - self._start_s
        return self._seen(observation), float(reward), is_terminal, is_cut, info

    def _seen(self, observation: Observation) -> np.ndarray:
        self._stood = has_stood(self._stood, observation)
        self._lawful_mps2 = lawful_mps2(observation, self._stood)
        return inputs_of(self.layout, observation, self._lawful_mps2, self._stood)


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
        disable_env_checker=True,
        **options,
    )
    return LawfulLevels(env, layout)
