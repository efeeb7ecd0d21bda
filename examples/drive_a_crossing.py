"""A first look: drive one vehicle over a crossing, with predictions of all others in view.

    python examples/drive_a_crossing.py

takes half a minute and writes `crossing.gif`. What it shows, in this order: how an environment
is made, what is observed, two policies of a line or two on the same episodes, and a video.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from PIL import Image

import hatn_sim.envs
from hatn_sim.envs.features import ON_ROAD, OWN, SLOT

gymnasium.register_envs(hatn_sim.envs)  # hatn_sim/Intersection-v0 and the others

Observation = dict[str, np.ndarray]
Policy = Callable[[Observation], int]

EGO = [one.name for one in OWN + ON_ROAD]
SLOTS = [one.name for one in SLOT]
"""What the numbers are; `help(hatn_sim.envs.scene_env.SceneEnv)` has the tables with units."""
PROBABILITY = len(SLOTS) - 1


# 1. An environment. `predictor` may be any of "constant_velocity", "idm", "hatn", ... or your own,
#    and `hatn_sim.envs.options` has the table of what else can be set.


def crossing(**options: Any) -> gymnasium.Env[Any, Any]:
    """A five-arm all-way stop. An action holds for 0.5 s and is a slot: 0 is to yield."""
    return gymnasium.make("hatn_sim/Intersection-v0", predictor="hatn", **options)


# 2. What is observed. All is relative to the ego and its conflicts, so that a policy learnt here
#    can be tried elsewhere; what is not there is 0 and masked.


def describe(observation: Observation) -> None:
    """Prints what a human would want to know of a moment."""
    ego = dict(zip(EGO, observation["ego"].tolist(), strict=True))
    print(f"at {ego['speed']:.1f} m/s, {int(observation['vehicle_mask'].sum())} others in view")
    if ego["has a conflict"]:
        print(f"  the next conflict is {ego['way to the nearest conflict, 50: none']:.0f} m ahead")
    for k in np.flatnonzero(observation["action_mask"]):
        said = "yield" if k == 0 else f"pass before the vehicle of slot {k}"
        print(
            f"  {said}: a human would with probability {observation['slots'][k, PROBABILITY]:.2f}"
        )
    # Rows of `trajectories` are the ego and the vehicles, the nearest first; the likeliest of
    # their ways comes first, and its last point is where they will be in 3 s.
    for k in np.flatnonzero(observation["vehicle_mask"])[:2]:
        x_m, y_m = observation["vehicles"][k, :2]
        then_x_m, then_y_m = observation["trajectories"][k + 1, 0, -1]
        print(
            f"  vehicle {k}: {x_m:.0f} m ahead and {y_m:.0f} m left of us, "
            f"{then_x_m:.0f} and {then_y_m:.0f} m in 3 s"
        )


# 3. Policies: an observation in, an action out.


def patient(observation: Observation) -> int:
    """Yields to everybody."""
    return 0


def as_expected(observation: Observation) -> int:
    """Takes the slot that the predictor would expect a human to take."""
    may_choose = observation["action_mask"] == 1
    return int(np.where(may_choose, observation["slots"][:, PROBABILITY], -1.0).argmax())


def drive(env: gymnasium.Env[Any, Any], policy: Policy, seed: int) -> tuple[str, float, float]:
    """One episode: how it ended, how long it took in seconds, and the sum of its rewards."""
    observation, info = env.reset(seed=seed)
    begun_s, reward_sum, is_over = info["time_s"], 0.0, False
    while not is_over:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        reward_sum += float(reward)
        is_over = terminated or truncated
    return info["end"], info["time_s"] - begun_s, reward_sum


# 4. A video. With `pip install moviepy`, gymnasium.wrappers.RecordVideo writes an .mp4 instead.


def record(policy: Policy, seed: int, path: Path, most_steps: int = 100) -> None:
    """Writes an episode as an animated picture."""
    env = crossing(render_mode="rgb_array")
    observation, _ = env.reset(seed=seed)
    pictures: list[Any] = [env.render()]
    for _ in range(most_steps):
        observation, _, terminated, truncated, _ = env.step(policy(observation))
        pictures.append(env.render())
        if terminated or truncated:
            break
    env.close()
    first, *others = [Image.fromarray(picture) for picture in pictures]
    first.save(path, save_all=True, append_images=others, duration=500, loop=0)


def main(seeds: tuple[int, ...] = (1, 2), video: Path = Path("crossing.gif")) -> None:
    env = crossing()
    observation, _ = env.reset(seed=seeds[0])
    while observation["action_mask"].sum() < 2:  # nobody to meet yet
        observation, *_ = env.step(0)
    describe(observation)
    for policy in (patient, as_expected):
        for seed in seeds:
            end, took_s, reward_sum = drive(env, policy, seed)
            print(f"{policy.__name__}, seed {seed}: {end} in {took_s:.1f} s, {reward_sum:+.2f}")
    env.close()
    record(as_expected, seeds[0], video)
    print(f"video: {video}")


if __name__ == "__main__":
    main()
