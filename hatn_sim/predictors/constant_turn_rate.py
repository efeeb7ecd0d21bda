"""Everybody goes on at today's turn rate and acceleration (CTRA), fading. No road is needed."""

from __future__ import annotations

import numpy as np

from hatn_sim.datatypes import Prediction, Route, Scene, Tracks
from hatn_sim.predictors.free_motion import fallback_motion
from hatn_sim.road import Road
from hatn_sim.tracks import empty_tracks, extend


class ConstantTurnRate:
    """Circles in the map frame, the same as what stands in for vehicles on no line elsewhere.

    Its memory are the tracks of the last seconds.
    """

    name = "constant_turn_rate"

    def init(self, road: Road) -> Tracks:
        return empty_tracks()

    def observe(
        self, state: Tracks, scene: Scene, routes: tuple[Route | None, ...] | None = None
    ) -> Tracks:
        return extend(state, scene)

    def predict(self, state: Tracks) -> Prediction:
        count = len(state.ids)
        return Prediction(
            ids=state.ids,
            xy_m=fallback_motion(state)[:, None],
            mode_probability=np.ones((count, 1)),
            fallback=np.zeros(count, dtype=np.bool_),
            adapted=np.zeros(count, dtype=np.bool_),
        )
