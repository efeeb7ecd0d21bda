"""Gymnasium environments over `tick()`; importing this registers them.

| id | scene |
|---|---|
| `hatn_sim/Intersection-v0` | `intersection5`, a five-arm all-way stop |
| `hatn_sim/Roundabout-v0` | `roundabout8`, eight arms, one lane |
| `hatn_sim/Scene-v0` | any, named by `scene` or `tracks` |

    import gymnasium
    import hatn_sim.envs

    env = gymnasium.make("hatn_sim/Intersection-v0", predictor="idm", risk="assertive")

`hatn_sim.envs.options` has the table of all options. `gymnasium.make_vec` makes many of them that
share one batch of predictions (`hatn_sim.envs.vector_env`).
`hatn_sim.envs.parallel_env.SceneParallelEnv` drives several vehicles of a scene (PettingZoo), and
`hatn_sim.envs.prediction_observation.PredictionObservation` adds predictions to an environment of
highway-env that is made elsewhere.
"""

from __future__ import annotations

from typing import Final

from gymnasium.envs.registration import register

from hatn_sim.envs import options as options  # so that help(hatn_sim.envs.options) finds it

SCENES: Final = {
    "hatn_sim/Intersection-v0": {"scene": "intersection5"},
    "hatn_sim/Roundabout-v0": {"scene": "roundabout8"},
    "hatn_sim/Scene-v0": {},
}

for _name, _kwargs in SCENES.items():
    register(
        _name,
        entry_point="hatn_sim.envs.scene_env:SceneEnv",
        vector_entry_point="hatn_sim.envs.vector_env:SceneVectorEnv",
        kwargs=_kwargs | ({"registered_as": _name} if _kwargs else {}),
        # These check what they are given themselves; gymnasium's passive checker is of no use after
        # a first reset that was refused.
        disable_env_checker=True,
    )
