"""An episode, from frame to frame: where the ego has got to, what that was worth, how it ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, Frame
from hatn_sim.envs.mind import Mind, Thought
from hatn_sim.envs.options import EnvOptions
from hatn_sim.envs.reward import Terms, has_collided, terms_of
from hatn_sim.envs.way import Way, way_along
from hatn_sim.road import Road

ARRIVED: Final = "arrived"
COLLISION: Final = "collision"
TERMINAL: Final = (ARRIVED, COLLISION)
"""The other ends, "time", "gone" and "over", cut an episode short."""


@dataclass(eq=False)
class Episode:
    """What changes from frame to frame."""

    ego_id: str
    seed: int
    road: Road
    frame: Frame
    mind: Mind | None  # None: nothing is predicted
    thought: Thought | None = None
    way: Way | None = None  # None: the simulator does not know it
    acceleration_mps2: float = 0.0  # of the ego, in the last frame
    frames: int = 0
    end: str = ""

    @property
    def is_over(self) -> bool:
        return bool(self.end)

    @property
    def row(self) -> int | None:
        """Of the ego in the scene; None: it is gone."""
        ids = self.frame.scene.ids
        return ids.index(self.ego_id) if self.ego_id in ids else None

    def begin(self) -> None:
        """To be called in the first frame."""
        self.way = self._way_from_here()

    def advance(self, frame: Frame, options: EnvOptions) -> Terms:
        """Takes in the next frame; what it was worth."""
        before, row = self.frame, self.row
        assert row is not None and not self.end
        self.frame, self.frames = frame, self.frames + 1
        progress_m = self._move(before, row)
        self.end = self._end(options)
        return terms_of(before, frame, self.ego_id, progress_m, self.end == ARRIVED)

    def _move(self, before: Frame, row: int) -> float:
        """Carries the ego's way on; how far it came, in metres."""
        now = self.row
        if now is None:
            return 0.0
        old, new = before.scene, self.frame.scene
        self.acceleration_mps2 = float(new.speed_mps[now] - old.speed_mps[row]) / DT_S
        way = self.way
        if way is not None and way.route == self.frame.truth.routes[now]:
            self.way = way.moved(new.xy_m[now])
            return self.way.s_m - way.s_m
        self.way = self._way_from_here()
        return float(np.linalg.norm(new.xy_m[now] - old.xy_m[row]))

    def _way_from_here(self) -> Way | None:
        row = self.row
        assert row is not None
        route = self.frame.truth.routes[row]
        return way_along(self.road, route, self.frame.scene.xy_m[row]) if route else None

    def _end(self, options: EnvOptions) -> str:
        frame, row, way = self.frame, self.row, self.way
        if has_collided(frame, self.ego_id):
            return COLLISION
        if self.ego_id in frame.truth.arrived:
            return ARRIVED
        if row is None:
            return "gone"
        length_m = float(frame.scene.size_m[row, 0])
        if options.until == "crossed" and way is not None and way.is_crossed(length_m):
            return ARRIVED
        if frame.done:
            return "over"
        return "time" if self.frames * DT_S >= options.duration_s - 1e-6 else ""
