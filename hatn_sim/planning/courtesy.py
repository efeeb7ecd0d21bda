"""Others have eyes, too: who can still let the ego go once it is on its way will mostly do so.

Letters as in `occupancy`, and Q meetings.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray
from hatn_sim.planning.occupancy import TIMES_S, Occupancy
from hatn_sim.planning.situation import Situation

REACTION_S: Final = 1.0
GENTLE_MPS2: Final = 2.5
"""Nobody is expected to brake harder than this for the ego."""
RUDE: Final = 0.15
"""So many go on all the same where they need not give way ..."""
LAWLESS: Final = 0.02
"""... and so many where they have to."""


def heedless(now: Situation, travelled_m: FloatArray, others: Occupancy) -> FloatArray:
    """[R, J, K]: how many of those who drive so would go on when they see the ego before them.

    1, but for whoever could still stop gently before the area when the ego, which has then come so
    far [R, G], has entered it.
    """
    out = np.ones((len(travelled_m), *others.probability.shape))
    met = now.meetings
    gives_way: BoolArray = met.gives_way
    row_of = {int(vehicle): row for row, vehicle in enumerate(others.vehicle)}
    known = np.array([int(vehicle) in row_of for vehicle in met.other], dtype=np.bool_)
    if not known.any():
        return out
    row = np.array([row_of[int(vehicle)] for vehicle in met.other[known]])
    start = np.broadcast_to(now.scene.xy_m[others.vehicle][:, None, None], others.boxes.xy_m.shape)
    path = np.concatenate((start[:, :, :1], others.boxes.xy_m), axis=2)[row]
    step_m = np.linalg.norm(np.diff(path, axis=2), axis=3)  # [Q, K, G]
    speed = step_m / TIMES_S[0]
    needed_m = np.cumsum(step_m, axis=2) + speed * REACTION_S + speed**2 / (2.0 * GENTLE_MPS2)
    can_stop: BoolArray = np.asarray(needed_m <= met.other_room_m[known, None, None])
    inside = travelled_m[:, None, :] > met.room_m[known, None]  # [R, Q, G]
    enters: IntArray = np.argmax(inside, axis=2)
    ever: BoolArray = np.any(inside, axis=2)
    lets = can_stop[np.arange(len(row)), :, enters] & ever[..., None]  # [R, Q, K]
    share = np.where(gives_way[known], LAWLESS, RUDE)[:, None]
    out[:, row] = np.where(lets, share, 1.0)
    return out
