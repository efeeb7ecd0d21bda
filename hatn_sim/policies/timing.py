"""Who would be at a conflict when: what a driver weighs before it goes.

The observation has the ways and speeds; here they become times, for others at their present speed
and, if they gain, at their present acceleration.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, FloatArray, Scene
from hatn_sim.envs.features import ON_ROAD, OWN, ROAD_AT_M, SLOT, VEHICLES
from hatn_sim.envs.observation import Observation, nearest_vehicles
from hatn_sim.planning.following import time_over_s

TIMES: Final = (
    "the other comes, at its speed",
    "the other comes, at its acceleration",
    "the ego is out of the way",
    "from when the ego is out of the way until the other comes",
    "from when the other is out of the way until the ego comes",
)
"""Of each slot, in s."""
FAR_S: Final = 10.0
NEAR_SIDE_M: Final = 1.5
"""Half the width of who crosses, and some room."""
LEAST_MPS: Final = 0.5
"""Slower ones are taken to come as slowly as this."""
LEAST_MPS2: Final = 0.1

_OWN: Final = {one.name: k for k, one in enumerate(OWN + ON_ROAD)}
_SLOT: Final = {one.name: k for k, one in enumerate(SLOT)}
_SPEED, _LENGTH = _OWN["speed"], _OWN["length"]
_LIMIT: Final = _OWN[f"speed limit at {ROAD_AT_M[0]:g} m"]
_EGO_M: Final = _SLOT["way of the ego to the conflict"]
_OTHER_M: Final = _SLOT["way of the rear vehicle to the conflict"]
_OTHER_MPS: Final = _SLOT["v_r, speed of the rear boundary"]

Speeds = dict[str, float]
"""Of everybody there, by name, in m/s."""


def speeds_of(scene: Scene) -> Speeds:
    """What is remembered of a scene until the next decision."""
    return dict(zip(scene.ids, scene.speed_mps.tolist(), strict=True))


def gains_mps2(scene: Scene, before: Speeds, frames: int) -> FloatArray:
    """Accelerations [N] of all there, since so many frames ago; 0 where unknown."""
    speeds = zip(scene.ids, scene.speed_mps.tolist(), strict=True)
    gained = [speed_mps - before.get(name, speed_mps) for name, speed_mps in speeds]
    return np.array(gained) / (frames * DT_S)


def of_nearest(scene: Scene, ego: int, values: FloatArray) -> FloatArray:
    """Those [VEHICLES] of the vehicles observed, in their order, of values [N]; then 0."""
    near = nearest_vehicles(scene, ego)
    return np.pad(values[near], (0, VEHICLES - len(near)))


def slot_times_s(observation: Observation, other_mps2: np.ndarray) -> np.ndarray:
    """The `TIMES` [MAX_NODES, len(TIMES)] of slots whose others accelerate so [MAX_NODES].

    All are within `FAR_S`, and 0 where there is no slot. To be out of the way is to be past the
    conflict by half a length and `NEAR_SIDE_M`; others are taken to be as long as the ego.
    """
    own, slots = observation["ego"].astype(np.float64), observation["slots"].astype(np.float64)
    aside_m = 0.5 * float(own[_LENGTH]) + NEAR_SIDE_M
    ego_m, other_m = slots[:, _EGO_M], slots[:, _OTHER_M]
    other_mps = np.maximum(slots[:, _OTHER_MPS], LEAST_MPS)
    gain = np.where(other_mps2 > LEAST_MPS2, other_mps2, 0.0)
    speed_mps, limit_mps = float(own[_SPEED]), max(float(own[_LIMIT]), LEAST_MPS)
    ego_comes_s = time_over_s(ego_m - aside_m, speed_mps, limit_mps)
    ego_leaves_s = time_over_s(ego_m + aside_m, speed_mps, limit_mps)
    steady_s = np.maximum(other_m - aside_m, 0.0) / other_mps
    gaining_s = steady_gain_s(other_m - aside_m, other_mps, gain)
    leaves_s = np.maximum(other_m + aside_m, 0.0) / other_mps
    times = (steady_s, gaining_s, ego_leaves_s, gaining_s - ego_leaves_s, ego_comes_s - leaves_s)
    there = observation["slot_mask"] > 0.0
    there[0] = False  # to yield
    return np.where(there[:, None], np.clip(np.column_stack(times), -FAR_S, FAR_S), 0.0)


def steady_gain_s(way_m: np.ndarray, speed_mps: np.ndarray, gain_mps2: np.ndarray) -> np.ndarray:
    """For ways at speeds above 0 that grow steadily; 0 for those that lie behind."""
    way_m = np.maximum(way_m, 0.0)
    # The root's conjugate: exact where nobody gains, too.
    return 2.0 * way_m / (speed_mps + np.sqrt(speed_mps**2 + 2.0 * gain_mps2 * way_m))
