"""What a policy knows of a moment, as the one row of numbers that it reads.

Every number is divided by a scale of its unit, so that all are about one. `Layout` says where the
parts are: the ego, slots and vehicles with their masks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import MAX_NODES
from hatn_sim.envs.features import MODES, ON_ROAD, OTHER, OWN, POINTS, SLOT, VEHICLES, Feature
from hatn_sim.envs.observation import Observation
from hatn_sim.policies.timing import TIMES, slot_times_s

SCALES: Final = {"m": 20.0, "m/s": 10.0, "m/s2": 3.0, "s": 3.0, "1/m": 0.1}
"""By unit; all others stay as they are."""
TIME_LEFT: Final = len(OWN) - 1
"""Not read: a driver is in no more hurry because an episode ends."""
OF_LAW: Final = 2
"""What the ego reads beside its observation: the acceleration that is allowed, has it stood."""
MOST_ALLOWED_MPS2: Final = 8.0
CHANCE: Final = len(SLOT) - 1
NUMBER: Final = len(OTHER) - 1


def _scales(features: Sequence[Feature]) -> np.ndarray:
    return np.array([SCALES.get(one.unit, 1.0) for one in features], np.float32)


_OWN: Final = _scales(OWN + ON_ROAD)
_OTHER: Final = _scales(OTHER)
_SLOT: Final = _scales(SLOT)


@dataclass(frozen=True)
class Layout:
    """The parts of a row, in their order."""

    sees_predictions: bool  # slot probabilities, predicted trajectories and their chances
    knows_times: bool = True  # accelerations and `TIMES`; older policies do without

    @property
    def own(self) -> int:
        return len(OWN) + len(ON_ROAD) - 1 + OF_LAW

    @property
    def slot(self) -> int:
        known = 1 + len(TIMES) if self.knows_times else 0
        return len(SLOT) + known - (not self.sees_predictions)

    @property
    def other(self) -> int:
        predicted = MODES * (POINTS * 2 + 1) if self.sees_predictions else 0
        return len(OTHER) + self.knows_times + predicted

    @property
    def size(self) -> int:
        return self.own + MAX_NODES * (self.slot + 1) + VEHICLES * (self.other + 1)

    def parts(self) -> tuple[slice, ...]:
        """Of the ego, the slots, their mask, the vehicles and theirs."""
        sizes = (self.own, MAX_NODES * self.slot, MAX_NODES, VEHICLES * self.other, VEHICLES)
        ends = np.cumsum(sizes).tolist()
        return tuple(slice(end - size, end) for size, end in zip(sizes, ends, strict=True))


@dataclass(frozen=True, eq=False)
class Moment:
    """An observation of the form `slots`, and what is known beside it."""

    observation: Observation
    gains_mps2: np.ndarray  # [VEHICLES] accelerations of those observed, in their order
    lawful_mps2: float  # what is allowed
    stood: bool  # at the stop line ahead


def inputs_of(layout: Layout, now: Moment) -> np.ndarray:
    """The row [layout.size] of a moment, as float32."""
    observation = now.observation
    own = np.delete(observation["ego"] / _OWN, TIME_LEFT)
    lawful = np.clip(now.lawful_mps2, -MOST_ALLOWED_MPS2, MOST_ALLOWED_MPS2) / SCALES["m/s2"]
    slots, others = observation["slots"] / _SLOT, observation["vehicles"] / _OTHER
    if layout.knows_times:
        of_slots = _of_slots(observation, now.gains_mps2)
        times = slot_times_s(observation, of_slots) / SCALES["s"]
        slots = np.column_stack((slots, of_slots / SCALES["m/s2"], times))
        others = np.column_stack((others, now.gains_mps2 / SCALES["m/s2"]))
    if layout.sees_predictions:
        paths = observation["trajectories"][1:].reshape(VEHICLES, -1) / SCALES["m"]
        others = np.hstack((others, paths, observation["mode_probability"][1:]))
    else:
        slots = np.delete(slots, CHANCE, axis=1)
    masks = observation["slot_mask"], observation["vehicle_mask"]
    of_law = np.array([lawful, now.stood])
    parts = (own, of_law, slots.ravel(), masks[0], others.ravel(), masks[1])
    return np.concatenate(parts).astype(np.float32)


def _of_slots(observation: Observation, gains_mps2: np.ndarray) -> np.ndarray:
    """The accelerations [MAX_NODES] of those behind the slots; 0 where nobody is seen there."""
    behind = np.zeros(MAX_NODES)
    number = observation["vehicles"][:, NUMBER].astype(np.int64)
    behind[number] = gains_mps2 * observation["vehicle_mask"]
    behind[0] = 0.0  # of those who are behind none
    return behind
