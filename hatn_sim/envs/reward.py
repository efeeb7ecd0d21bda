"""What a step was worth: terms from `Truth` and progress, each times its weight.

| term | unit | what is counted, summed over the frames of a step |
|---|---|---|
| `progress_m` | m | along the way that the ego really drives; where it has been before, on its \
way there from another one, does not count again |
| `time_s` | s | |
| `discomfort_s` | s | square of the ego's acceleration over `COMFORT_MPS2`, at most \
`MOST_DISCOMFORT`, times the time |
| `risk_s` | s | time in which anybody within `NEAR_M` of the ego, or itself, brakes hard: from 0 \
at `HARD_MPS2` to 1 at `HARDEST_MPS2`, and 1 where the simulator says emergency |
| `lawless` | 1 | 1 for a stop line passed without a stop at it, or a closed signal that it \
could have stopped for; and for speed above 1.1 times the limit, 1 a second at 2.1 times of it |
| `collision` | 1 | the ego has touched somebody |
| `arrival` | 1 | the ego has arrived |
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, FloatArray, Frame, Scene
from hatn_sim.envs.options import RewardWeights

COMFORT_MPS2: Final = 3.0
MOST_DISCOMFORT: Final = 9.0
NEAR_M: Final = 40.0
HARD_MPS2: Final = 3.0
HARDEST_MPS2: Final = 8.0


@dataclass(frozen=True)
class Terms:
    """The terms of a reward, not weighted. Names are those of `RewardWeights`."""

    progress_m: float = 0.0
    time_s: float = 0.0
    discomfort_s: float = 0.0
    risk_s: float = 0.0
    lawless: float = 0.0
    collision: float = 0.0
    arrival: float = 0.0

    def __add__(self, other: Terms) -> Terms:
        return Terms(
            self.progress_m + other.progress_m,
            self.time_s + other.time_s,
            self.discomfort_s + other.discomfort_s,
            self.risk_s + other.risk_s,
            self.lawless + other.lawless,
            self.collision + other.collision,
            self.arrival + other.arrival,
        )

    def weighted(self, weights: RewardWeights) -> dict[str, float]:
        """What each adds to the reward, by name."""
        return {
            # Adding 0 makes 0 of -0, which is bad to read.
            one.name: getattr(self, one.name) * getattr(weights, one.name) + 0.0
            for one in fields(Terms)
        }


def terms_of(
    before: Frame,
    after: Frame,
    ego_id: str,
    progress_m: float,
    arrived: bool,
    lawless: float = 0.0,
) -> Terms:
    """The terms of one frame; the ego is in `before`."""
    scene = before.scene
    acceleration = (_speed_mps(scene, after.scene) - scene.speed_mps) / DT_S
    ego = scene.ids.index(ego_id)
    own_mps2 = float(acceleration[ego])
    emergency = after.truth.emergency_braking
    share = 0.0
    if emergency or acceleration.min() < -HARD_MPS2:
        away = scene.xy_m - scene.xy_m[ego]
        near = np.einsum("nx,nx->n", away, away) <= NEAR_M**2
        hardest_mps2 = -float(acceleration[near].min())
        share = min(max((hardest_mps2 - HARD_MPS2) / (HARDEST_MPS2 - HARD_MPS2), 0.0), 1.0)
        close = zip(scene.ids, near.tolist(), strict=True)
        if any(is_near and name in emergency for name, is_near in close):
            share = 1.0
    return Terms(
        progress_m=progress_m,
        time_s=DT_S,
        discomfort_s=DT_S * min((own_mps2 / COMFORT_MPS2) ** 2, MOST_DISCOMFORT),
        risk_s=DT_S * share,
        lawless=lawless,
        collision=float(has_collided(after, ego_id)),
        arrival=float(arrived),
    )


def _speed_mps(before: Scene, after: Scene) -> FloatArray:
    """Of the vehicles of the scene before, in the one after; who left has not braked."""
    if before.ids == after.ids:
        return after.speed_mps
    row = {name: k for k, name in enumerate(after.ids)}
    to = np.array([row.get(name, -1) for name in before.ids], dtype=np.int64)
    return np.where(to >= 0, after.speed_mps[to], before.speed_mps)


def has_collided(frame: Frame, ego_id: str) -> bool:
    """Whether the ego touches anybody in this frame."""
    return any(ego_id in pair for pair in frame.truth.collisions)
