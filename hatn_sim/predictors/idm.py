"""The intelligent driver model: everybody follows the leader on the own reference line."""

from __future__ import annotations

from hatn_sim.datatypes import Prediction, Route, Scene
from hatn_sim.perception import PerceptionState, begin, perceive
from hatn_sim.predictors.along_lines import along_lines
from hatn_sim.predictors.car_following import roll_out
from hatn_sim.predictors.present import present_motion
from hatn_sim.road import Road


class IntelligentDriverModel:
    """Car following, see `car_following`; who crosses the own way is not seen."""

    name = "idm"

    def init(self, road: Road) -> PerceptionState:
        return begin(road)

    def observe(
        self,
        state: PerceptionState,
        scene: Scene,
        routes: tuple[Route | None, ...] | None = None,
    ) -> PerceptionState:
        return perceive(state, scene, routes)

    def predict(self, state: PerceptionState) -> Prediction:
        now = present_motion(state.seen.tracks)
        return along_lines(state, now, roll_out(state.road, state.seen, now))
