"""Follows its leader by the intelligent driver model and waits for gaps: nothing is predicted.

The fair baseline of all that plan: it keeps limits, stops at stop lines and closed signals, and
crosses where those who come would, at their present speeds, leave it time enough.
"""

from __future__ import annotations

from hatn_sim.datatypes import Advice, Command, Route, Scene
from hatn_sim.planning.following import halt_before_m, safe_acceleration
from hatn_sim.planning.situation import DriverState, begin_driving, guide, look
from hatn_sim.road import Road


class Agent:
    """The intelligent driver model, with accepted time gaps where lines meet."""

    reads_suggestions = False
    reads_predictions = False

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
        return state, Command(ego_id, safe_acceleration(now, halt_before_m(now)))
