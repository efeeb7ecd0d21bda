"""A predictor that is told: the future of a live simulation, from an exact branch of it.

At every prediction the simulation is forked and driven on for 3 s, with the vehicle for which it is
asked going on at the speed that it has now, whatever is in its way, and everybody else driven as
they would be: as they yield to it, or do not. So it is right about all others as long as the ego
keeps its speed. Nobody on the road can know this: it is what a prediction could be worth at most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hatn_sim.datatypes import (
    DT_S,
    HORIZON_FRAMES,
    Branch,
    FloatArray,
    Plan,
    Prediction,
    Route,
    Scene,
    Simulator,
)
from hatn_sim.errors import SimulatorError
from hatn_sim.road import Road
from hatn_sim.score.closed_loop_rows import ORACLE


@dataclass(frozen=True, eq=False)
class BranchOracle:
    """Predicts the newest frame of `simulator`, for `ego_id`. Its memory is the last scene."""

    simulator: Simulator
    ego_id: str

    @property
    def name(self) -> str:
        return ORACLE

    def init(self, road: Road) -> Scene | None:
        return None

    def observe(
        self, state: Scene | None, scene: Scene, routes: tuple[Route | None, ...] | None = None
    ) -> Scene:
        return scene

    def predict(self, state: Scene) -> Prediction:
        """Raises SimulatorError where the branch was lost."""
        changes: tuple[Plan, ...] = ()
        if self.ego_id in state.ids:
            speed_mps = float(state.speed_mps[state.ids.index(self.ego_id)])
            changes = (Plan(self.ego_id, 0.0, np.full(HORIZON_FRAMES, speed_mps)),)
        branch = self.simulator.branch([changes], HORIZON_FRAMES * DT_S)[0].result()
        if branch is None:
            raise SimulatorError(
                f"the branch that {ORACLE} looks into at {state.time_s:.1f} s was lost"
            )
        count = len(state.ids)
        return Prediction(
            ids=state.ids,
            xy_m=future_xy_m(state, branch)[:, None],
            mode_probability=np.ones((count, 1)),
            fallback=np.zeros(count, dtype=np.bool_),
            adapted=np.zeros(count, dtype=np.bool_),
        )


def future_xy_m(scene: Scene, branch: Branch) -> FloatArray:
    """[N, F, 2] where the vehicles of the scene are in the branch.

    Whoever leaves it goes on straight at the last speed; pedestrians, whom branches leave out, too.
    """
    column = {name: k for k, name in enumerate(branch.ids)}
    of = np.array([column.get(name, -1) for name in scene.ids], dtype=np.int64)
    known = of >= 0
    valid = np.zeros((1 + HORIZON_FRAMES, len(of)), dtype=np.bool_)
    valid[:, known] = branch.valid[:, of[known]]
    valid[0] = True
    last = np.where(valid, np.arange(1 + HORIZON_FRAMES)[:, None], 0)
    np.maximum.accumulate(last, axis=0, out=last)  # the last frame until then with it in view
    xy_m = np.broadcast_to(scene.xy_m, (*valid.shape, 2)).copy()
    yaw_rad = np.broadcast_to(scene.yaw_rad, valid.shape).copy()
    speed_mps = np.broadcast_to(scene.speed_mps, valid.shape).copy()
    later = valid.copy()
    later[0] = False
    frame, vehicle = np.nonzero(later)
    xy_m[frame, vehicle] = branch.xy_m[frame, of[vehicle]]
    yaw_rad[frame, vehicle] = branch.yaw_rad[frame, of[vehicle]]
    speed_mps[frame, vehicle] = branch.speed_mps[frame, of[vehicle]]
    who = np.arange(len(of))
    heading = np.stack([np.cos(yaw_rad[last, who]), np.sin(yaw_rad[last, who])], axis=-1)
    gone_s = DT_S * (np.arange(1 + HORIZON_FRAMES)[:, None] - last)
    ahead_m = speed_mps[last, who] * gone_s
    found = xy_m[last, who] + ahead_m[..., None] * heading
    return np.ascontiguousarray(found[1:].transpose(1, 0, 2))
