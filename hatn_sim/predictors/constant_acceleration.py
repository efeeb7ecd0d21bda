"""Everybody follows the own line at today's acceleration, which fades, up to a standstill."""

from __future__ import annotations

from hatn_sim.datatypes import Prediction, Route, Scene
from hatn_sim.perception import PerceptionState, begin, perceive
from hatn_sim.predictors.along_lines import along_lines
from hatn_sim.predictors.free_motion import ACCELERATION_FADE_S, travelled_m
from hatn_sim.predictors.present import present_motion
from hatn_sim.road import Road


class ConstantAcceleration:
    """Along the reference line, which beats straight on wherever roads bend.

    Held for the whole horizon, an acceleration leads too far: it fades over
    `ACCELERATION_FADE_S`. Vehicles on no line go on at their turn rate.
    """

    name = "constant_acceleration"

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
        travel_m = travelled_m(now.speed_mps, now.acceleration_mps2, ACCELERATION_FADE_S)
        return along_lines(state, now, travel_m)
