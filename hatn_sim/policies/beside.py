"""How long another agent takes in the traffic that policies learn in: a mark beside their curve."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import Advice, Agent
from hatn_sim.envs.action import FASTER_MPS2, SLOWER_MPS2
from hatn_sim.envs.scene_env import SceneEnv
from hatn_sim.loop import decide
from hatn_sim.policies.lawful_env import share_of

EPISODES: Final = 20
"""Of each scene."""
FIRST_SEED: Final = 0


def mean_time_s(
    agent: Agent,
    scenes: Sequence[str],
    predictor: str,
    tell: Callable[[int, int], object],
    **traffic: Any,
) -> float:
    """Seconds until an episode's end, whatever it is, on average over `EPISODES` of each scene.

    `tell` is told how many are over, of how many. Raises InputError where the agent fails.
    """
    times_s: list[float] = []
    for scene in scenes:
        env = SceneEnv(
            scene=scene,
            predictor=predictor,
            action="acceleration",
            frames_per_step=1,
            advice=getattr(agent, "reads_suggestions", True),
            **traffic,
        )
        try:
            for seed in range(FIRST_SEED, FIRST_SEED + EPISODES):
                times_s.append(_time_s(agent, env, seed))
                tell(len(times_s), EPISODES * len(scenes))
        finally:
            env.close()
    return float(np.mean(times_s))


def _time_s(agent: Agent, env: SceneEnv, seed: int) -> float:
    _, info = env.reset(seed=seed)
    begins_s, ego_id, state = info["time_s"], info["ego_id"], agent.init(env.road)
    is_over = False
    while not is_over:
        advice: Advice = info["seen"].advice
        state, command = decide(agent, state, ego_id, env.frame, advice)
        # Without a command the simulator drives on, which an environment has no action for.
        wanted_mps2 = 0.0 if command is None else command.acceleration_mps2
        share = share_of(float(np.clip(wanted_mps2, SLOWER_MPS2, FASTER_MPS2)))
        *_, is_terminal, is_cut, info = env.step(np.array([share], np.float32))
        is_over = is_terminal or is_cut
    return info["time_s"] - begins_s
