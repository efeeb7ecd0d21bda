"""Several driven vehicles on one crossing, in a parallel environment of PettingZoo.

pip install 'hatn-sim[marl]'
python examples/drive_several.py
"""

from __future__ import annotations

import numpy as np

from hatn_sim.envs.parallel_env import SceneParallelEnv


def main(egos: int = 4, seed: int = 1) -> None:
    env = SceneParallelEnv(scene="intersection5", egos=egos, predictor="hatn")
    observations, infos = env.reset(seed=seed)
    while env.agents:
        # Each takes the likeliest of the slots that it may choose from.
        actions = {
            name: int(np.where(seen["action_mask"] == 1, seen["slots"][:, -1], -1.0).argmax())
            for name, seen in observations.items()
            if name in env.agents
        }
        observations, _, _, _, infos = env.step(actions)
        for name, info in infos.items():
            if info["end"]:
                print(f"{info['time_s']:.1f} s: {name} {info['end']}, left: {env.agents}")
    env.close()


if __name__ == "__main__":
    main()
