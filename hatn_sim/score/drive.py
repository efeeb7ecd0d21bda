"""A vehicle's drive through its first crossing, and what everybody around it did meanwhile.

Whoever drives it, an agent or the simulator, it is taken in by the same recorder, so that drives of
several are measured alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, FloatArray, Frame
from hatn_sim.road import Road
from hatn_sim.score.driven import Driven, DrivenRecorder
from hatn_sim.score.missed_gaps import LOOK_EVERY_FRAMES, Start, start_of
from hatn_sim.way import Way, way_along

RUN_OUT_S: Final = 3.0
"""What the drive has brought on others is looked at for so long after the crossing."""
CROSSED: Final = "crossed"
COLLISION: Final = "collision"
TIME: Final = "time"
GONE: Final = "gone"
"""How a drive ends."""


@dataclass(frozen=True, eq=False)
class Drive:
    """What became of it. Frames are those of `driven`."""

    ego_id: str
    driven: Driven
    begin_frame: int  # the first with the ego
    enter_frame: int | None  # its front bumper is in the crossing
    cross_frame: int | None  # its rear bumper is out of it
    end: str
    starts: tuple[Start, ...]  # it could have made


class DriveRecorder:
    """Takes in the frames of a drive, from some before the ego's first on, until it is over."""

    def __init__(self, ego_id: str, road: Road, limit_s: float) -> None:
        self.ego_id = ego_id
        self.end = ""
        self._road = road
        self._limit = round(limit_s / DT_S)
        self._recorder = DrivenRecorder()
        self._frames = 0
        self._way: Way | None = None
        self._begin: int | None = None
        self._enter: int | None = None
        self._cross: int | None = None
        self._starts: list[Start] = []

    @property
    def is_over(self) -> bool:
        """Nothing that follows belongs to the drive."""
        if not self.end:
            return False
        last = 0 if self._cross is None else self._cross + round(RUN_OUT_S / DT_S)
        return self.end != CROSSED or self._frames > last

    def see(self, frame: Frame) -> None:
        """The next frame."""
        now = self._frames
        self._frames += 1
        self._recorder.add(frame)
        scene, truth = frame.scene, frame.truth
        if self.ego_id not in scene.ids:
            if self._begin is not None and not self.end:
                arrived = self.ego_id in truth.arrived
                self._finish(CROSSED if arrived else GONE, now if arrived else None)
            return
        row = scene.ids.index(self.ego_id)
        if self._begin is None:
            self._begin = now
        if any(self.ego_id in pair for pair in truth.collisions):
            self.end = COLLISION
            return
        if self.end:
            return
        self._go_on(frame, row, now)
        if not self.end and (now - self._begin >= self._limit or frame.done):
            self.end = TIME

    def _finish(self, end: str, cross_frame: int | None) -> None:
        self.end, self._cross = end, cross_frame

    def _go_on(self, frame: Frame, row: int, now: int) -> None:
        scene, route = frame.scene, frame.truth.routes[row]
        xy_m: FloatArray = scene.xy_m[row]
        if self._way is not None and self._way.route == route:
            self._way = self._way.moved(xy_m)
        elif route:
            self._way = way_along(self._road, route, xy_m)
        way = self._way
        if way is None or way.first_crossing is None:
            return
        half_m = 0.5 * float(scene.size_m[row, 0])
        if self._enter is None and way.s_m + half_m >= way.first_crossing.entry_s_m:
            self._enter = now
        if way.s_m - half_m >= way.first_crossing.exit_s_m:
            self._finish(CROSSED, now)
        elif now % LOOK_EVERY_FRAMES == 0:
            red = self._at_red(way, scene.signal_closed)
            start = start_of(now, way, float(scene.speed_mps[row]), 2.0 * half_m, red)
            self._starts += [] if start is None else [start]

    def _at_red(self, way: Way, signal_closed: np.ndarray) -> bool:
        crossing = way.first_crossing
        if self._enter is not None or crossing is None or crossing.from_lane is None:
            return False
        signals = self._road.lanes[crossing.from_lane].signals or {}
        index = signals.get(crossing.into_lane)
        return index is not None and bool(signal_closed[index])

    def drive(self) -> Drive:
        """All that was taken in; the ego has been seen."""
        assert self._begin is not None
        return Drive(
            self.ego_id,
            self._recorder.driven(),
            self._begin,
            self._enter,
            self._cross,
            self.end or TIME,
            tuple(self._starts),
        )
