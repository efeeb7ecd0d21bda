"""Drives as the suggestions say; the simulator's driver does where they are silent.

While it drives, SUMO's own checks of gaps and right of way are off (speed mode 32): whether the
advice is safe is up to the advice.
"""

from __future__ import annotations

from hatn_sim.datatypes import DT_S, Advice, Command, Scene
from hatn_sim.road import Road

AHEAD_FRAMES = 5


class Agent:
    """Goes for the speed advised half a second ahead; a tick later there is a new profile."""

    def init(self, road: Road) -> None:
        return None

    def step(
        self, state: None, ego_id: str, scene: Scene, advice: Advice
    ) -> tuple[None, Command | None]:
        for suggestion in advice.suggestions:
            if suggestion.ego_id == ego_id and suggestion.profile_mps:
                speed_mps = float(scene.speed_mps[scene.ids.index(ego_id)])
                wanted_mps = suggestion.profile_mps[AHEAD_FRAMES - 1]
                return None, Command(ego_id, (wanted_mps - speed_mps) / (AHEAD_FRAMES * DT_S))
        return None, None
