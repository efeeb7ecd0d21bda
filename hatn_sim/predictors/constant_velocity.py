"""Everybody drives on as now: straight ahead at today's speed."""

from __future__ import annotations

import numpy as np

from hatn_sim.datatypes import FloatArray, Prediction, Route, Scene
from hatn_sim.predictors.free_motion import TIMES_S
from hatn_sim.road import Road


def extrapolate(scene: Scene) -> FloatArray:
    """Positions [N, F, 2] at constant velocity."""
    heading = np.stack((np.cos(scene.yaw_rad), np.sin(scene.yaw_rad)), axis=1)
    step = heading * scene.speed_mps[:, None]
    return scene.xy_m[:, None] + step[:, None] * TIMES_S[:, None]


class ConstantVelocity:
    """The predictor every other one has to beat. Its memory is the last scene."""

    name = "constant_velocity"

    def init(self, road: Road) -> Scene | None:
        return None

    def observe(
        self, state: Scene | None, scene: Scene, routes: tuple[Route | None, ...] | None = None
    ) -> Scene:
        return scene

    def predict(self, state: Scene) -> Prediction:
        count = len(state.ids)
        return Prediction(
            ids=state.ids,
            xy_m=extrapolate(state)[:, None],
            mode_probability=np.ones((count, 1)),
            fallback=np.zeros(count, dtype=np.bool_),
            adapted=np.zeros(count, dtype=np.bool_),
        )
