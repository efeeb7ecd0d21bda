"""An episode, from frame to frame: where the ego has got to, what that was worth, how it ends."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, FloatArray, Frame
from hatn_sim.envs.ground import Ground, new_m
from hatn_sim.envs.mind import Mind, Thought
from hatn_sim.envs.options import EnvOptions
from hatn_sim.envs.reward import Terms, has_collided, terms_of
from hatn_sim.envs.rules import Rules, Step, lawless, may_pass, rules_along, still_came_mps
from hatn_sim.road import Road
from hatn_sim.way import Way, way_along

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
    rules: Rules | None = None  # along the way
    may_pass: bool = False  # the line ahead
    came_mps: float = 0.0  # its speed as it came, while that is too fast
    ground: Ground = field(default_factory=Ground)  # of ways before this one
    known_m: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))  # of it, on this one
    acceleration_mps2: float = 0.0  # of the ego, in the last frame
    frames: int = 0
    end: str = ""
    row: int | None = field(init=False)  # of the ego in the scene; None: it is gone

    @property
    def is_over(self) -> bool:
        return bool(self.end)

    def __post_init__(self) -> None:
        self.row = self._row_in(self.frame)

    def _row_in(self, frame: Frame) -> int | None:
        ids = frame.scene.ids
        return ids.index(self.ego_id) if self.ego_id in ids else None

    def begin(self) -> None:
        """To be called in the first frame."""
        self._take_way()
        self._look_ahead()
        row = self.row
        assert row is not None
        self.came_mps = float(self.frame.scene.speed_mps[row])

    def advance(self, frame: Frame, options: EnvOptions) -> Terms:
        """Takes in the next frame; what it was worth."""
        before, row = self.frame, self.row
        assert row is not None and not self.end
        self.frame, self.frames, self.row = frame, self.frames + 1, self._row_in(frame)
        progress_m, offences = self._move(before, row)
        self.end = self._end(options)
        is_arrival = self.end == ARRIVED
        return terms_of(before, frame, self.ego_id, progress_m, is_arrival, offences)

    def _move(self, before: Frame, row: int) -> tuple[float, float]:
        """Carries the ego's way on: how far it came, in metres, and how lawlessly."""
        now = self.row
        if now is None:
            return 0.0, 0.0
        old, new = before.scene, self.frame.scene
        self.acceleration_mps2 = float(new.speed_mps[now] - old.speed_mps[row]) / DT_S
        last = self.way
        if last is None:
            self._take_way()
            self._look_ahead()
            return 0.0, 0.0
        way = self.way = last.moved(new.xy_m[now])
        offences = self._offences(last, way, now)
        if last.route == self.frame.truth.routes[now]:
            progress_m = new_m(self.known_m, last.s_m, way.s_m)
        else:
            self.ground = self.ground.left(last.route, last.ends_m, last.s_m)
            progress_m = self._take_way() * float(np.linalg.norm(new.xy_m[now] - old.xy_m[row]))
        self._look_ahead()
        return progress_m, offences

    def _take_way(self) -> bool:
        """The way of this frame is the ego's now; whether that begins on new ground."""
        row = self.row
        assert row is not None
        route = self.frame.truth.routes[row]
        self.way = self.rules = None
        if not route:
            return False
        way = self.way = way_along(self.road, route, self.frame.scene.xy_m[row])
        self.rules = rules_along(self.road, way)
        self.known_m = self.ground.known_m(route, way.ends_m)
        begins_m, ends_m = self.known_m.T
        return not bool(((begins_m <= way.s_m) & (way.s_m < ends_m)).any())

    def _offences(self, last: Way, way: Way, row: int) -> float:
        if self.rules is None:
            return 0.0
        scene = self.frame.scene
        half_m = 0.5 * float(scene.size_m[row, 0])
        speed_mps = float(scene.speed_mps[row])
        step = Step(last.s_m + half_m, way.s_m + half_m, half_m, speed_mps, self.came_mps)
        self.came_mps = still_came_mps(self.rules, step)
        return lawless(self.rules, self.may_pass, step)

    def _look_ahead(self) -> None:
        row, way, rules, scene = self.row, self.way, self.rules, self.frame.scene
        if row is None or way is None or rules is None:
            self.may_pass = False
            return
        front_m = way.s_m + 0.5 * float(scene.size_m[row, 0])
        speed_mps = float(scene.speed_mps[row])
        self.may_pass = may_pass(rules, self.may_pass, front_m, speed_mps, scene.signal_closed)

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
