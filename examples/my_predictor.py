"""A predictor of one's own in twenty lines: everybody drives on in a straight line and slows down.

cd examples
hatn-sim check-predictor my_predictor:Slowing
hatn-sim run intersection5 --predictor my_predictor:Slowing --compare constant_velocity
"""

import numpy as np

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES, Prediction


class Slowing:
    name = "slowing"
    braking_mps2 = 0.3

    def init(self, road):
        return None  # nothing seen yet: the state is the last scene

    def observe(self, state, scene, routes=None):
        return scene

    def predict(self, scene):
        time_s = DT_S * np.arange(1, HORIZON_FRAMES + 1)
        speed = scene.speed_mps[:, None]
        time_s = np.minimum(time_s, speed / self.braking_mps2)  # who stands stays
        way_m = speed * time_s - 0.5 * self.braking_mps2 * time_s**2  # [N, F]
        heading = np.stack((np.cos(scene.yaw_rad), np.sin(scene.yaw_rad)), axis=1)
        return Prediction(
            ids=scene.ids,
            xy_m=(scene.xy_m[:, None] + way_m[..., None] * heading[:, None])[:, None],
            mode_probability=np.ones((len(scene.ids), 1)),
            fallback=np.zeros(len(scene.ids), dtype=np.bool_),
            adapted=np.zeros(len(scene.ids), dtype=np.bool_),
        )
