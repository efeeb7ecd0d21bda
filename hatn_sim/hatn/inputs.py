"""What the networks read, cut from perception and graphs: arrays in, float32 arrays out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hatn_sim.datatypes import HISTORY_FRAMES, IntArray
from hatn_sim.perception import Perception

Float32Array = NDArray[np.float32]


def vehicle_history(seen: Perception, vehicle: IntArray) -> Float32Array:
    """Encoder input [B, T, 6] of vehicles [B]: s - s_t, d, v_s, v_d, phi, seen."""
    own = seen.own
    valid = seen.tracks.valid[vehicle, -HISTORY_FRAMES:]
    s = own.s_m[vehicle]
    columns = (
        s - s[:, -1:],
        own.d_m[vehicle],
        own.speed_mps[vehicle],
        own.lateral_mps[vehicle],
        own.phi_rad[vehicle],
        valid.astype(np.float64),
    )
    return np.stack(columns, axis=-1).astype(np.float32)
