"""SUMO's window while a run goes on: frame by frame, what there is to show."""

from __future__ import annotations

from hatn_sim.datatypes import Advice, Alert, Scene
from hatn_sim.report.window_shapes import alerted_after, most_pressed, picture_of
from hatn_sim.simulators.sumo import SumoSimulator


class Window:
    """Shows the egos named; else whom the window follows; else who has to choose."""

    def __init__(
        self, simulator: SumoSimulator, egos: frozenset[str], followed: str | None
    ) -> None:
        """`followed` is a vehicle that the window goes with from its first moment on."""
        self._simulator = simulator
        self._egos = egos
        self._wanted = followed
        self._followed = ""
        self._pressed: str | None = None
        self._alerts: dict[str, Alert] = {}

    def show(self, scene: Scene, advice: Advice) -> None:
        """Draws over the traffic of this moment. Raises as `SumoSimulator.draw` does."""
        self._alerts = alerted_after(self._alerts, advice.alerts)
        prediction = advice.prediction
        egos = self._egos | {name for name in (self._wanted, self._followed) if name}
        if not egos:
            self._pressed = most_pressed(scene, prediction, self._pressed)
            egos = frozenset({self._pressed} if self._pressed else ())
        alerted = {name for one in self._alerts.values() for name in (one.ego_id, one.other_id)}
        road = self._simulator.road
        picture = picture_of(scene, road, prediction, egos, alerted, self._wanted)
        self._followed = self._simulator.draw(picture)
