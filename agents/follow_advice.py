"""Drives as the suggestions say; the simulator's driver does where they are silent."""

from __future__ import annotations

from hatn_sim.datatypes import DT_S, Advice, Command, Scene
from hatn_sim.road import Road


class Agent:
    """Takes the first step of every advised speed profile; a tick later there is a new one."""

    def init(self, road: Road) -> None:
        return None

    def step(
        self, state: None, ego_id: str, scene: Scene, advice: Advice
    ) -> tuple[None, Command | None]:
        for suggestion in advice.suggestions:
            if suggestion.ego_id == ego_id and suggestion.profile_mps:
                speed_mps = float(scene.speed_mps[scene.ids.index(ego_id)])
                return None, Command(ego_id, (suggestion.profile_mps[0] - speed_mps) / DT_S)
        return None, None
