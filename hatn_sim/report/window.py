"""SUMO's window while a run goes on: frame by frame, what there is to show."""

from __future__ import annotations

from hatn_sim.datatypes import Advice, Alert, Scene
from hatn_sim.report.window_shapes import alerted_after, most_pressed, picture_of
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_messages import View


class Window:
    """Shows the egos named; else whom the window follows; else, of those in view, who is warned or
    has to choose."""

    def __init__(
        self, simulator: SumoSimulator, egos: frozenset[str], followed: str | None
    ) -> None:
        """`followed` is a vehicle that the window goes with from its first moment on."""
        self._simulator = simulator
        self._egos = egos
        self._wanted = followed
        self._followed = ""
        self._view_m: View | None = None  # None: it is still to be found where to look
        self._pressed: str | None = None
        self._alerts: dict[str, Alert] = {}

    def show(self, scene: Scene, advice: Advice) -> None:
        """Draws over the traffic of this moment. Raises as `SumoSimulator.draw` does."""
        self._alerts = alerted_after(self._alerts, advice.alerts)
        alerts = self._alerts.values()
        egos = self._egos | {name for name in (self._wanted, self._followed) if name}
        if not egos:
            warned = {one.ego_id for one in alerts}
            self._pressed = most_pressed(
                scene, advice.prediction, self._pressed, warned, self._view_m
            )
            egos = frozenset({self._pressed} if self._pressed else ())
        road = self._simulator.road
        picture = picture_of(scene, road, advice, egos, alerts, self._wanted)
        drawn = self._simulator.draw(picture)
        self._followed = drawn.followed
        if self._view_m is not None or picture.begin_xy_m is not None:
            self._view_m = drawn.view_m
