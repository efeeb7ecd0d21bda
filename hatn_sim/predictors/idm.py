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
from hatn_sim.road import Road
from hatn_sim.speed_profile import PROFILE_STEP_M, allowed_speed_mps

DESIRED_SPEED_MPS: Final = 54.0 / 3.6
HEADWAY_S: Final = 0.8
STANDSTILL_M: Final = 2.0
ACCELERATION_MPS2: Final = 2.0
BRAKING_MPS2: Final = 3.0
EXPONENT: Final = 4
HARDEST_MPS2: Final = 8.0


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
    allowed = allowed_speed_mps(road, line, s)
    out = np.zeros((len(s), HORIZON_FRAMES))
    for frame in range(HORIZON_FRAMES):
        # A leader on no line of its own keeps its speed, on one it is rolled out as well.
        travelled = np.where(
            seen.lines.line[lead] >= 0, s[lead] - start[lead], scene.speed_mps[lead] * DT_S * frame
        )
        gap = np.where(has_leader, lead_s + travelled - s, np.inf)
        column = np.minimum(((s - start) / PROFILE_STEP_M).astype(np.int64), allowed.shape[1] - 1)
        desired = np.minimum(DESIRED_SPEED_MPS, allowed[np.arange(len(s)), column])
        closing = np.where(has_leader, speed - speed[lead], 0.0)
        acceleration = idm_acceleration(speed, desired, gap, closing)
        faster = np.maximum(speed + acceleration * DT_S, 0.0)
        s = s + 0.5 * (speed + faster) * DT_S
        speed = faster
        out[:, frame] = s
    return out
