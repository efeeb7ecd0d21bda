"""Drives as the suggestions say; where they are silent, by the intelligent driver model.

While it drives, SUMO's own checks of gaps and right of way are off (speed mode 32): whether the
advice is safe is up to the advice. A leader and a line to stop at are kept all the same.
"""

from __future__ import annotations

from hatn_sim.datatypes import DT_S, Advice, Command, Route, Scene
from hatn_sim.planning.following import halt_before_m, safe_acceleration
from hatn_sim.planning.situation import DriverState, begin_driving, guide, look
from hatn_sim.road import Road

AHEAD_FRAMES = 5


class Agent:
    """Goes for the speed advised half a second ahead; a tick later there is a new profile."""

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
        for suggestion in advice.suggestions:
            if suggestion.ego_id == ego_id and suggestion.profile_mps:
                wanted_mps = suggestion.profile_mps[AHEAD_FRAMES - 1]
                advised_mps2 = (wanted_mps - now.speed_mps) / (AHEAD_FRAMES * DT_S)
                return state, Command(ego_id, min(advised_mps2, safe_acceleration(now)))
        return state, Command(ego_id, safe_acceleration(now, halt_before_m(now)))
