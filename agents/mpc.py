"""Plans anew at every tick: the profile that costs least among those sampled along the own way.

Profiles differ in where they wait and for how long (`planning.ways`); each is weighed by the time
it loses, its comfort and how likely it ends in contact with where others are predicted, with their
modes, outlines and errors (`planning.occupancy`). A way that may end in contact more often than
`MOST_RISK` is taken only where every one may. To wait before the next area is always among them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hatn_sim.assist.profile import COMFORT_BRAKING_MPS2
from hatn_sim.datatypes import DT_S, Advice, Command, FloatArray, Route, Scene
from hatn_sim.planning.courtesy import heedless
from hatn_sim.planning.doubt import Doubt, doubts_m, learn
from hatn_sim.planning.occupancy import contact_probability, ego_boxes, predicted_occupancy
from hatn_sim.planning.situation import DriverState, Situation, begin_driving, guide, look
from hatn_sim.planning.ways import Ways, sample_ways
from hatn_sim.road import Road

MOST_RISK: Final = 0.05
RISK_S: Final = 60.0
"""Seconds that the ego would lose rather than collide: 1 % of risk is worth 0.6 s."""
HARSH_S: Final = 0.02
"""Seconds for one (m/s2)^2 of mean squared acceleration."""
HARD_S: Final = 0.5
"""Seconds for each m/s2 by which the hardest braking is beyond comfort."""
TOO_RISKY_S: Final = 600.0
"""As `RISK_S`, of what is beyond `MOST_RISK`."""
MARGIN_M: Final = 0.3
LEAST_MPS: Final = 5.0
"""Way lost is time lost at the speed of the road, at least at this."""


@dataclass(frozen=True, eq=False)
class Memory:
    driver: DriverState
    doubt: Doubt
    acceleration_mps2: float = 0.0  # commanded last


class Agent:
    """Model predictive control by samples, with a chance constraint."""

    reads_suggestions = False

    def init(self, road: Road) -> Memory:
        return Memory(begin_driving(road), Doubt())

    def guide(self, state: Memory, route: Route | None) -> Memory:
        return replace(state, driver=guide(state.driver, route))

    def step(
        self, state: Memory, ego_id: str, scene: Scene, advice: Advice
    ) -> tuple[Memory, Command | None]:
        # Whether its nose is in the way where lines bend, it sees by outlines.
        driver, now = look(state.driver, ego_id, scene, as_swept=False)
        doubt = learn(state.doubt, scene, advice.prediction, ego_id)
        if now is None:
            return Memory(driver, doubt), None
        ways = sample_ways(now, advice.prediction, state.acceleration_mps2)
        along_m, across_m = doubts_m(doubt, scene)
        others = predicted_occupancy(now, advice.prediction, along_m, across_m)
        contact = contact_probability(ego_boxes(now, ways.travelled_m), others, MARGIN_M)
        contact *= heedless(now, ways.travelled_m, others)
        contact = (contact * others.probability).sum(axis=2)  # over modes
        risk = 1.0 - np.prod(1.0 - contact, axis=1)
        best = int(cost_s(now, ways, risk).argmin())
        acceleration = float(ways.speed_mps[best, 0] - now.speed_mps) / DT_S
        return Memory(driver, doubt, acceleration), Command(ego_id, acceleration)


def cost_s(now: Situation, ways: Ways, risk: FloatArray) -> FloatArray:
    """What each way [R] costs, in seconds; those of too much risk more than any other."""
    lost_m = ways.travelled_m[:, -1].max() - ways.travelled_m[:, -1]
    lost_s = lost_m / max(float(now.allowed_mps[:10].mean()), LEAST_MPS)
    acceleration = ways.acceleration_mps2
    harsh_s = HARSH_S * np.mean(acceleration**2, axis=1)
    harsh_s += HARD_S * np.maximum(-acceleration.min(axis=1) - COMFORT_BRAKING_MPS2, 0.0)
    risk_s = RISK_S * risk + TOO_RISKY_S * np.maximum(risk - MOST_RISK, 0.0)
    return np.asarray(lost_s + harsh_s + risk_s)
