"""Keeps the speed the vehicle has when the agent takes over, whatever comes."""

from __future__ import annotations

from hatn_sim.datatypes import DT_S, Advice, Command, Scene
from hatn_sim.road import Road


class Agent:
    """Holds a speed by commanding the acceleration that restores it within one tick."""

    reads_suggestions = False
    reads_predictions = False

    def init(self, road: Road) -> float | None:
        return None

    def step(
        self, state: float | None, ego_id: str, scene: Scene, advice: Advice
    ) -> tuple[float | None, Command | None]:
        if ego_id not in scene.ids:
            return state, None
        speed_mps = float(scene.speed_mps[scene.ids.index(ego_id)])
        held_mps = speed_mps if state is None else state
        return held_mps, Command(ego_id, (held_mps - speed_mps) / DT_S)
