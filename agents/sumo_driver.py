"""Leaves the vehicle to the simulator's own driver: the reference every agent is compared with."""

from __future__ import annotations

from hatn_sim.datatypes import Advice, Command, Scene
from hatn_sim.road import Road


class Agent:
    """Never commands anything."""

    reads_suggestions = False
    reads_predictions = False

    def init(self, road: Road) -> None:
        return None

    def step(
        self, state: None, ego_id: str, scene: Scene, advice: Advice
    ) -> tuple[None, Command | None]:
        return None, None
