"""Where vehicles are that drive along their reference lines, begun as they move now."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, Prediction, Route, Scene
from hatn_sim.perception import Perception, PerceptionState, begin, perceive
from hatn_sim.predictors.free_motion import TIMES_S, continued_xy_m
from hatn_sim.predictors.present import Present, present_motion
from hatn_sim.road import Road

Travel = Callable[[Road, Perception, Present], FloatArray]
"""A rule: how far vehicles travel along their lines [N, F], of no meaning for those on none."""

TO_LINE_S: Final = 0.7
"""Until about then a vehicle moves on as it moves now, from then on as its line leads."""


class LineFollower:
    """A predictor: everybody drives along the own line, as far as a rule says."""

    def __init__(self, name: str, travel: Travel) -> None:
        self.name = name
        self._travel = travel

    def init(self, road: Road) -> PerceptionState:
        return begin(road)

    def observe(
        self,
        state: PerceptionState,
        scene: Scene,
        routes: tuple[Route | None, ...] | None = None,
    ) -> PerceptionState:
        return perceive(state, scene, routes)

    def predict(self, state: PerceptionState) -> Prediction:
        now = present_motion(state.seen.tracks)
        return along_lines(state, now, self._travel(state.road, state.seen, now))


def along_lines(state: PerceptionState, now: Present, travel_m: FloatArray) -> Prediction:
    """The prediction for vehicles that travel so far [N, F] along their lines, at their offset.

    A centre need not move exactly along the line: the lines of maps are not what people drive, and
    the centre of a long vehicle cuts corners. So each begins as its motion now goes on, and changes
    over to the line within a second. Vehicles on no line stay with their motion: the fallback.
    """
    seen = state.seen
    xy = continued_xy_m(seen.tracks, now)
    on: BoolArray = seen.lines.line >= 0
    if on.any():
        line, s, d = seen.lines.line[on], seen.lines.s_m[on], seen.lines.d_m[on]
        at = state.road.locate(
            line, s[:, None] + travel_m[on], np.repeat(d[:, None], len(TIMES_S), axis=1)
        )
        # Where the line is a polyline, Frenet and back is not exact: keep now where it is.
        at += (seen.scene.xy_m[on] - state.road.locate(line, s, d))[:, None]
        as_now = np.exp(-((TIMES_S / TO_LINE_S) ** 2))[:, None]
        xy[on] = as_now * xy[on] + (1.0 - as_now) * at
    count = len(on)
    return Prediction(
        ids=seen.scene.ids,
        xy_m=xy[:, None],
        mode_probability=np.ones((count, 1)),
        fallback=~on,
        adapted=np.zeros(count, dtype=np.bool_),
        lines=seen.lines,
    )
