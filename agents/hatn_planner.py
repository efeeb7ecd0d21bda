"""Drives what HATN predicts of the ego itself: its most probable slot and the trajectory to it.

The paper's planning use (Wang et al., arXiv 2202.05140): the prediction for the own vehicle is the
plan. A leader and a line to stop at are kept all the same; nothing else is checked. Of who stands
it is most probable that it goes on standing, which would never end: who has stood for long goes as
`idm` does until it rolls. With other predictors their most probable trajectory is driven.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, Advice, Command, Prediction, Route, Scene
from hatn_sim.planning.following import halt_before_m, safe_acceleration
from hatn_sim.planning.situation import DriverState, Situation, begin_driving, guide, look
from hatn_sim.road import Road

AHEAD_FRAMES: Final = 10
"""Where it would be in a second is where it goes."""
PATIENCE_S: Final = 3.0
ROLLS_MPS: Final = 2.0


@dataclass(frozen=True, eq=False)
class Memory:
    driver: DriverState
    crawls_s: float = 0.0  # since it last rolled


class Agent:
    """Goes as far in the next second as its most probable trajectory does."""

    def init(self, road: Road) -> Memory:
        return Memory(begin_driving(road))

    def guide(self, state: Memory, route: Route | None) -> Memory:
        return replace(state, driver=guide(state.driver, route))

    def step(
        self, state: Memory, ego_id: str, scene: Scene, advice: Advice
    ) -> tuple[Memory, Command | None]:
        driver, now = look(state.driver, ego_id, scene)
        if now is None:
            return replace(state, driver=driver), None
        crawls_s = state.crawls_s + DT_S if now.speed_mps < ROLLS_MPS else 0.0
        wanted_mps2 = min(planned_mps2(now, advice.prediction), safe_acceleration(now))
        if crawls_s > PATIENCE_S:
            wanted_mps2 = max(wanted_mps2, safe_acceleration(now, halt_before_m(now)))
        return Memory(driver, crawls_s), Command(ego_id, wanted_mps2)


def planned_mps2(now: Situation, said: Prediction) -> float:
    """The steady acceleration that gets the ego as far as its most probable trajectory."""
    best = int(said.mode_probability[now.ego].argmax())
    path_m = said.xy_m[now.ego, best, :AHEAD_FRAMES]
    path_m = np.concatenate((now.scene.xy_m[now.ego : now.ego + 1], path_m))
    way_m = float(np.linalg.norm(np.diff(path_m, axis=0), axis=1).sum())
    ahead_s = AHEAD_FRAMES * DT_S
    return 2.0 * (way_m - now.speed_mps * ahead_s) / ahead_s**2
