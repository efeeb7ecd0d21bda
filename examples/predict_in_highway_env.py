"""Your own environment of highway-env, with predictions in its observation.

    python examples/predict_in_highway_env.py

drives on whatever comes, and looks how early it could have been seen who would come too near.
"""

from __future__ import annotations

import gymnasium
import highway_env
import numpy as np

from hatn_sim.envs.prediction_observation import PredictionObservation

gymnasium.register_envs(highway_env)  # intersection-v2 and the others

FASTER = 2
NEAR_M = 3.0
POLICY_HZ = 5


def comes_near(observation: dict[str, np.ndarray]) -> bool:
    """Whether anybody's likeliest way meets ours, at the same time, within 3 s."""
    ways = observation["trajectories"][:, 0]  # [1 + vehicles, points, x and y]; row 0 is the ego
    others = ways[1:][observation["vehicle_mask"] == 1]
    away_m = np.linalg.norm(others - ways[0], axis=-1)
    return bool((away_m < NEAR_M).any())


def main(seeds: tuple[int, ...] = (3, 4, 6), predictor: str = "hatn") -> None:
    env = gymnasium.make("intersection-v2", config={"policy_frequency": POLICY_HZ})
    env = PredictionObservation(env, predictor)
    for seed in seeds:
        # observation["observation"] is what intersection-v2 observes by itself, [15, 7].
        observation, _ = env.reset(seed=seed)
        near = [comes_near(observation)]
        while True:
            observation, _, terminated, truncated, info = env.step(FASTER)
            near.append(comes_near(observation))
            if terminated or truncated:
                break
        end = "crashed" if info["crashed"] else "arrived" if terminated else "ran out of time"
        seen = f"seen at {near.index(True) / POLICY_HZ:.1f} s" if any(near) else "nobody came near"
        print(f"seed {seed}: {end} after {(len(near) - 1) / POLICY_HZ:.1f} s, {seen}")
    env.close()


if __name__ == "__main__":
    main()
