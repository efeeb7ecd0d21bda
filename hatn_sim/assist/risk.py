"""Measures of risk at conflicts, for all pairs of a scene at once, from predicted trajectories."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, FloatArray, Prediction, Scene

FAR_S: Final = 60.0
"""Arrivals later than this count as this: the vehicle stands."""


@dataclass(frozen=True, eq=False)
class Encounters:
    """Both vehicles of every node at their conflict, [E, M] each; times are from now.

    `enter` is when the front bumper, `leave` when the rear bumper passes the point of conflict, the
    half width of the other vehicle added at either end. Meaningless where the node is masked.
    """

    ego_enter_s: FloatArray
    ego_leave_s: FloatArray
    other_enter_s: FloatArray
    other_leave_s: FloatArray
    ego_room_m: FloatArray  # from the front bumper to where the vehicle enters
    other_room_m: FloatArray

    def predicted_encroachment_s(self) -> FloatArray:
        """Predictive encroachment time [E, M]: from the first leaving to the second entering.

        Negative where both are predicted to be there at once (Allen et al. 1978, PET, ahead of
        the event).
        """
        ego_first = self.ego_enter_s <= self.other_enter_s
        after_ego = self.other_enter_s - self.ego_leave_s
        return np.where(ego_first, after_ego, self.ego_enter_s - self.other_leave_s)


def encounters(scene: Scene, prediction: Prediction) -> Encounters:
    """Entry and leaving times of egos and their interacting vehicles; needs `prediction.graphs`."""
    graphs = prediction.graphs
    assert graphs is not None
    best = prediction.mode_probability.argmax(axis=1)
    path = prediction.xy_m[np.arange(len(best)), best]
    whole = np.concatenate((scene.xy_m[:, None], path), axis=1)
    travelled = np.cumsum(np.linalg.norm(np.diff(whole, axis=1), axis=2), axis=1)
    ego = np.repeat(graphs.ego[:, None], graphs.rear.shape[1], axis=1)
    other = np.maximum(graphs.rear, 0)
    reach = 0.5 * scene.size_m[:, 0]
    width = 0.5 * scene.size_m[:, 1]

    ego_margin = reach[ego] + width[other]
    other_margin = reach[other] + width[ego]
    ego_room, other_room = (
        graphs.ego_to_conflict_m - ego_margin,
        graphs.rear_to_conflict_m - other_margin,
    )
    return Encounters(
        ego_enter_s=arrival_s(travelled, ego, ego_room),
        ego_leave_s=arrival_s(travelled, ego, ego_room + 2.0 * ego_margin),
        other_enter_s=arrival_s(travelled, other, other_room),
        other_leave_s=arrival_s(travelled, other, other_room + 2.0 * other_margin),
        ego_room_m=ego_room,
        other_room_m=other_room,
    )


def arrival_s(travelled_m: FloatArray, vehicle: np.ndarray, distance_m: FloatArray) -> FloatArray:
    """When vehicles have driven a distance: linear between frames, at the last speed beyond them.

    `travelled_m` [N, F] is the predicted path length; `vehicle` and `distance_m` share any shape.
    """
    path = np.concatenate((np.zeros((len(travelled_m), 1)), travelled_m), axis=1)
    own = path[vehicle]
    frames = own.shape[-1] - 1
    after = np.clip((own < distance_m[..., None]).sum(axis=-1), 1, frames)
    high = np.take_along_axis(own, after[..., None], -1)[..., 0]
    low = np.take_along_axis(own, after[..., None] - 1, -1)[..., 0]
    step = np.maximum(high - low, 1e-3)
    time_s = (after - 1 + (distance_m - low) / step) * DT_S
    return np.clip(np.where(distance_m <= 0, 0.0, time_s), 0.0, FAR_S)


def required_deceleration_mps2(
    distance_m: FloatArray, speed_mps: FloatArray, time_s: FloatArray
) -> FloatArray:
    """DRAC: constant braking that lets a vehicle arrive no earlier than `time_s` from now.

    2 (v t - d) / t^2 while it still rolls then, v^2 / 2d where it has to stop before; 0 where it
    would come later anyhow (after Archer 2005, eq. 4.6; the limit is the arrival of the other).
    """
    time = np.maximum(time_s, 1e-3)
    rolling = 2.0 * (speed_mps * time - distance_m) / time**2
    stopping = speed_mps**2 / (2.0 * np.maximum(distance_m, 0.1))
    needed = np.where(rolling * time > speed_mps, stopping, rolling)
    return np.where(speed_mps * time <= distance_m, 0.0, needed)
