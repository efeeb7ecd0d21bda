"""What an action is, what is refused, and how it becomes commands.

| form | space | meaning |
|---|---|---|
| `slot` | `Discrete(8)` | 0: yield; k: pass before the vehicle behind slot k. A tracker drives it \
within comfort limits, and brakes harder only for what it would else run into |
| `acceleration` | `Box(-1, 1, (1,))` | 1: `FASTER_MPS2`, 0: keep the speed, -1: `SLOWER_MPS2`; \
linear between |
| `highway` | `Box(-1, 1, (2,))` | acceleration and steering of highway-env's `ContinuousAction`: \
5 m/s2 and pi/4 to the right at 1 |
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from gymnasium.spaces import Box, Discrete

from hatn_sim.datatypes import DT_S, MAX_NODES, BoolArray, Command
from hatn_sim.envs.errors import (
    ActionRangeError,
    ActionShapeError,
    ActionTypeError,
    MaskedActionError,
    OptionError,
)

YIELD: Final = 0
FASTER_MPS2: Final = 3.0
SLOWER_MPS2: Final = -8.0
HIGHWAY_MPS2: Final = 5.0
HIGHWAY_STEERING_RAD: Final = np.pi / 4.0
ROUNDING: Final = 1e-6


class Slots(Discrete):
    """Slots to choose from. Sampled without a mask, one of those that are there now."""

    def __init__(self, seed: int | np.random.Generator | None = None) -> None:
        super().__init__(MAX_NODES, seed=seed)
        self.admissible: BoolArray = np.arange(MAX_NODES) == YIELD

    def sample(self, mask: Any = None, probability: Any = None) -> np.int64:
        """As of `Discrete`; `admissible` is the mask where neither is given.

        A mask may be of any type, such as the one that is observed.
        """
        if mask is None and probability is None:
            mask = self.admissible
        return super().sample(None if mask is None else np.asarray(mask, np.int8), probability)


def action_space(form: str) -> Slots | Box:
    """The space of a form of action."""
    match form:
        case "slot":
            return Slots()
        case "acceleration":
            return Box(-1.0, 1.0, (1,), np.float32)
        case "highway":
            return Box(-1.0, 1.0, (2,), np.float32)
        case _:
            raise OptionError(f"action: expected slot, acceleration or highway, found {form!r}")


def chosen_slot(action: object, admissible: BoolArray, on_masked: str) -> int:
    """The slot of an action. Raises ActionError where it is none of those there are."""
    number = np.asarray(action)
    if number.dtype.kind not in "iu":
        raise ActionTypeError(
            f"action: expected the number of a slot, 0 to {MAX_NODES - 1}, found {action!r}"
        )
    if number.shape not in ((), (1,)):
        raise ActionShapeError(f"action: expected one number, found an array of {number.shape}")
    slot = int(number.reshape(()))
    if not 0 <= slot < MAX_NODES:
        raise ActionRangeError(f"action: expected a slot of 0 to {MAX_NODES - 1}, found {slot}")
    if admissible[slot]:
        return slot
    if on_masked == "yield":
        return YIELD
    there = np.flatnonzero(admissible).tolist()
    raise MaskedActionError(
        f"action: slot {slot} is not there now, expected one of {there}; see the action_mask, or "
        "choose masked_action='yield'"
    )


def numbers_of(action: object, space: Box) -> np.ndarray:
    """The numbers of a continuous action. Raises ActionError where they are not of the space."""
    try:
        numbers = np.asarray(action)
    except ValueError:  # rows of different lengths
        numbers = np.array(None)
    if numbers.dtype.kind not in "iuf":
        raise ActionTypeError(f"action: expected {space.shape[0]} number(s), found {action!r}")
    if numbers.shape != space.shape:
        raise ActionShapeError(
            f"action: expected an array of shape {space.shape}, found {numbers.shape}"
        )
    # Not finite is not within either.
    if not (np.abs(numbers) <= 1.0 + ROUNDING).all():
        raise ActionRangeError(
            f"action: expected shares from -1 to 1, not m/s2, found {numbers.tolist()}"
        )
    return np.clip(numbers.astype(np.float64), -1.0, 1.0)


def acceleration_command(ego_id: str, numbers: np.ndarray) -> Command:
    """The command of the form `acceleration`."""
    share = float(numbers[0])
    return Command(ego_id, share * FASTER_MPS2 if share >= 0.0 else -share * SLOWER_MPS2)


def highway_command(ego_id: str, numbers: np.ndarray) -> Command:
    """The command of the form `highway`; there, right is positive."""
    share, steering = numbers.tolist()
    return Command(ego_id, share * HIGHWAY_MPS2, -steering * HIGHWAY_STEERING_RAD)


def tracking_command(
    ego_id: str, speed_mps: float, profile_mps: Sequence[float], frame: int
) -> Command:
    """What brings the ego to the speed that a profile has at the end of its `frame`-th frame."""
    wanted_mps = profile_mps[min(frame, len(profile_mps) - 1)]
    return Command(ego_id, (wanted_mps - speed_mps) / DT_S)
