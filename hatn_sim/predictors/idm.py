"""The intelligent driver model, rolled out along every vehicle's own reference line.

Treiber, Hennecke and Helbing (2000), "Congested traffic states in empirical observations and
microscopic simulations", eq. 2 and 3, with the urban values of Liebner et al. (2012), the variant
whose desired speed is limited by the lane and by the curvature ahead.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES, FloatArray, Prediction, Route, Scene
from hatn_sim.perception import Perception, PerceptionState, begin, perceive
from hatn_sim.predictors.constant_velocity import extrapolate
from hatn_sim.road import LINE_STEP_M, Road

DESIRED_SPEED_MPS: Final = 54.0 / 3.6
HEADWAY_S: Final = 0.8
STANDSTILL_M: Final = 2.0
ACCELERATION_MPS2: Final = 2.0
BRAKING_MPS2: Final = 3.0
EXPONENT: Final = 4
LATERAL_MPS2: Final = 2.5
HARDEST_MPS2: Final = 8.0
LOOK_AHEAD_M: Final = 60.0


def idm_acceleration(
    speed_mps: FloatArray, desired_mps: FloatArray, gap_m: FloatArray, closing_mps: FloatArray
) -> FloatArray:
    """Acceleration in m/s2; `gap_m` is bumper to bumper, inf without a leader."""
    braking = speed_mps * closing_mps / (2.0 * np.sqrt(ACCELERATION_MPS2 * BRAKING_MPS2))
    wanted_m = STANDSTILL_M + np.maximum(0.0, speed_mps * HEADWAY_S + braking)
    free = (speed_mps / np.maximum(desired_mps, 0.1)) ** EXPONENT
    interaction = (wanted_m / np.maximum(gap_m, 0.1)) ** 2
    return np.clip(ACCELERATION_MPS2 * (1.0 - free - interaction), -HARDEST_MPS2, None)


class IntelligentDriverModel:
    """Every vehicle follows its leader; both are rolled out together."""

    name = "idm"

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
        seen, scene = state.seen, state.seen.scene
        on = seen.lines.line >= 0
        xy = extrapolate(scene)
        if on.any():
            s_m = _roll_out(state.road, seen)[on]
            d_m = np.repeat(seen.lines.d_m[on, None], HORIZON_FRAMES, axis=1)
            line = seen.lines.line[on]
            # Where the line is a polyline, Frenet and back is not exact: keep now where it is.
            now = state.road.locate(line, seen.lines.s_m[on], seen.lines.d_m[on])
            xy[on] = state.road.locate(line, s_m, d_m) + (scene.xy_m[on] - now)[:, None]
        count = len(scene.ids)
        return Prediction(
            ids=scene.ids,
            xy_m=xy[:, None],
            mode_probability=np.ones((count, 1)),
            fallback=~on,
            adapted=np.zeros(count, dtype=np.bool_),
            lines=seen.lines,
        )


def _roll_out(road: Road, seen: Perception) -> FloatArray:
    """Arc lengths [N, F] on the own lines."""
    scene, line = seen.scene, np.maximum(seen.lines.line, 0)
    s, speed = seen.lines.s_m.copy(), seen.own.speed_mps[:, -1].copy()
    start = s.copy()
    has_leader = seen.leader >= 0
    lead = np.maximum(seen.leader, 0)
    half_m = 0.5 * scene.size_m[:, 0]
    lead_s = np.where(has_leader, seen.leader_s_m - half_m - half_m[lead], np.inf)
    allowed = _allowed_speed(road, line, s)
    out = np.zeros((len(s), HORIZON_FRAMES))
    for frame in range(HORIZON_FRAMES):
        # A leader on no line of its own keeps its speed, on one it is rolled out as well.
        travelled = np.where(seen.lines.line[lead] >= 0, s[lead] - start[lead],
                             scene.speed_mps[lead] * DT_S * frame)
        gap = np.where(has_leader, lead_s + travelled - s, np.inf)
        column = np.minimum(((s - start) / LINE_STEP_M).astype(np.int64), allowed.shape[1] - 1)
        desired = np.minimum(DESIRED_SPEED_MPS, allowed[np.arange(len(s)), column])
        closing = np.where(has_leader, speed - speed[lead], 0.0)
        acceleration = idm_acceleration(speed, desired, gap, closing)
        faster = np.maximum(speed + acceleration * DT_S, 0.0)
        s = s + 0.5 * (speed + faster) * DT_S
        speed = faster
        out[:, frame] = s
    return out


def _allowed_speed(road: Road, line: np.ndarray, s_m: FloatArray) -> FloatArray:
    """Speed [N, P] allowed every `LINE_STEP_M` from now on by the lane and by the curvature.

    A bend is braked for at `BRAKING_MPS2` / 2 before it is reached, as drivers do.
    """
    points = int((LOOK_AHEAD_M + DESIRED_SPEED_MPS * HORIZON_FRAMES * DT_S) / LINE_STEP_M)
    index = (s_m[:, None] / LINE_STEP_M).astype(np.int64) + np.arange(points)
    index = np.minimum(index, road.count[line][:, None] - 1)
    bend = np.sqrt(LATERAL_MPS2 / np.maximum(np.abs(road.curvature_per_m[line[:, None], index]), 1e-3))
    square = np.minimum(road.speed_limit_mps[line[:, None], index], bend) ** 2
    # v(s)^2 <= v(s')^2 + b (s' - s) for every s' ahead: one running minimum from the far end.
    fall = BRAKING_MPS2 * LINE_STEP_M * np.arange(points)
    reachable = np.minimum.accumulate((square + fall)[:, ::-1], axis=1)[:, ::-1] - fall
    return np.sqrt(reachable)
