"""Drives what HATN predicts of the ego itself: its most probable slot and the trajectory to it.

The paper's planning use (Wang et al., arXiv 2202.05140): the prediction for the own vehicle is the
plan. A leader and a line to stop at are kept all the same; nothing else is checked. With other
predictors it drives their most probable trajectory.
"""

from __future__ import annotations

import numpy as np

from hatn_sim.datatypes import DT_S, Advice, Command, Route, Scene
from hatn_sim.planning.following import safe_acceleration
from hatn_sim.planning.situation import DriverState, begin_driving, guide, look
from hatn_sim.road import Road

AHEAD_FRAMES = 10
"""Where it would be in a second is where it goes: over less, who stands would never start."""


class Agent:
    """Goes as far in the next second as its most probable trajectory does."""

    def init(self, road: Road) -> DriverState:
        return begin_driving(road)

    def guide(self, state: DriverState, route: Route | None) -> DriverState:
        return guide(state, route)

    def step(
        self, state: DriverState, ego_id: str, scene: Scene, advice: Advice
    ) -> tuple[DriverState, Command | None]:
        state, now = look(state, ego_id, scene)
        if now is None:
            return state, None
        said = advice.prediction
        path_m = said.xy_m[now.ego, int(said.mode_probability[now.ego].argmax()), :AHEAD_FRAMES]
        path_m = np.concatenate((scene.xy_m[now.ego : now.ego + 1], path_m))
        way_m = float(np.linalg.norm(np.diff(path_m, axis=0), axis=1).sum())
        ahead_s = AHEAD_FRAMES * DT_S
        planned_mps2 = 2.0 * (way_m - now.speed_mps * ahead_s) / ahead_s**2
        return state, Command(ego_id, min(planned_mps2, safe_acceleration(now)))
