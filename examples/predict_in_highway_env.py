"""Your own environment of highway-env, with predictions in its observation.

python examples/predict_in_highway_env.py
"""

from __future__ import annotations

import gymnasium
import highway_env  # noqa: F401 - registers intersection-v2 and the others
import numpy as np

from hatn_sim.envs.prediction_observation import PredictionObservation

IDLE, SLOWER, FASTER = 1, 0, 2
NEAR_M = 6.0


def will_be_near(observation: dict[str, np.ndarray]) -> bool:
    """Whether anybody's likeliest way comes near to ours at the same time within 3 s."""
    ways = observation["trajectories"][:, 0]  # [1 + vehicles, points, x and y]; row 0 is the ego
    others = ways[1:][observation["vehicle_mask"] == 1]
    away_m = np.linalg.norm(others - ways[0], axis=-1)
    return bool((away_m < NEAR_M).any())


def main(episodes: int = 3) -> None:
    env = gymnasium.make("intersection-v2", config={"policy_frequency": 5})
    env = PredictionObservation(env, predictor="hatn")
    for seed in range(episodes):
        observation, info = env.reset(seed=seed)
        is_over, steps = False, 0
        while not is_over:
            own = observation["observation"]  # what intersection-v2 observes by itself
            assert own.shape == (15, 7)
            action = SLOWER if will_be_near(observation) else FASTER
            observation, _, terminated, truncated, info = env.step(action)
            is_over, steps = terminated or truncated, steps + 1
        print(f"seed {seed}: {'crashed' if info['crashed'] else 'fine'} after {steps / 5:.1f} s")
    env.close()


if __name__ == "__main__":
    main()
