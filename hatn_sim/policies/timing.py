"""Who would be at a conflict when: what a driver weighs before it goes.

The observation has the ways and speeds; here they become times, for others at their present speed
and, if they gain, at their present acceleration.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, Scene
from hatn_sim.envs.features import ON_ROAD, OWN, ROAD_AT_M, SLOT, VEHICLES
from hatn_sim.envs.observation import Observation, nearest_vehicles
from hatn_sim.policies.law import NEAR_SIDE_M

TIMES: Final = (
    "the other comes, at its speed",
    "the other comes, at its acceleration",
    "the ego is out of the way",
    "from when the ego is out of the way until the other comes",
    "from when the other is out of the way until the ego comes",
)
"""Of each slot, in s."""
FAR_S: Final = 10.0
START_MPS2: Final = 1.5
"""How fast the ego is taken to gain speed."""
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


def gains_mps2(scene: Scene, ego: int, before: Speeds, frames: int) -> np.ndarray:
    """Accelerations [VEHICLES] of those observed, since so many frames ago; 0 where unknown."""
    gains = np.zeros(VEHICLES)
    for k, row in enumerate(nearest_vehicles(scene, ego).tolist()):
        speed_mps = float(scene.speed_mps[row])
        gains[k] = (speed_mps - before.get(scene.ids[row], speed_mps)) / (frames * DT_S)
    return gains


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
    ego_comes_s = _gaining_s(ego_m - aside_m, speed_mps, limit_mps)
    ego_leaves_s = _gaining_s(ego_m + aside_m, speed_mps, limit_mps)
    steady_s = np.maximum(other_m - aside_m, 0.0) / other_mps
    gaining_s = _steady_gain_s(other_m - aside_m, other_mps, gain)
    leaves_s = np.maximum(other_m + aside_m, 0.0) / other_mps
    times = (steady_s, gaining_s, ego_leaves_s, gaining_s - ego_leaves_s, ego_comes_s - leaves_s)
    there = observation["slot_mask"] > 0.0
    there[0] = False  # to yield
    return np.where(there[:, None], np.clip(np.column_stack(times), -FAR_S, FAR_S), 0.0)


def _gaining_s(way_m: np.ndarray, speed_mps: float, limit_mps: float) -> np.ndarray:
    """For ways, at `START_MPS2` up to the limit; 0 for those that lie behind."""
    way_m = np.maximum(way_m, 0.0)
    gain_mps = max(limit_mps - speed_mps, 0.0)
    gaining_m = (speed_mps + 0.5 * gain_mps) * gain_mps / START_MPS2
    root = np.sqrt(speed_mps**2 + 2.0 * START_MPS2 * np.minimum(way_m, gaining_m))
    return (root - speed_mps) / START_MPS2 + np.maximum(way_m - gaining_m, 0.0) / limit_mps


def _steady_gain_s(way_m: np.ndarray, speed_mps: np.ndarray, gain_mps2: np.ndarray) -> np.ndarray:
    """For ways at speeds above 0 that grow steadily; 0 for those that lie behind."""
    way_m = np.maximum(way_m, 0.0)
    # The root's conjugate: exact where nobody gains, too.
    return 2.0 * way_m / (speed_mps + np.sqrt(speed_mps**2 + 2.0 * gain_mps2 * way_m))
