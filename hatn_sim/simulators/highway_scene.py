"""highway-env's vehicles as a `Scene`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import FloatArray, Kind, Scene
from hatn_sim.geometry import wrap_angle

EGO: Final = "ego"
EGO_COLOUR: Final = (50, 200, 0)
OTHER_COLOUR: Final = (100, 200, 255)
"""highway-env's own."""
COLUMNS: Final = 6


def ego_name(place: int) -> str:
    """What the vehicle at this place of an environment's controlled ones is called."""
    return EGO if place == 0 else f"{EGO}{place + 1}"


def rows_of(vehicles: Iterable[Any]) -> FloatArray:
    """Position, heading, speed, length and width [N, 6] of vehicles, in highway-env's frame."""
    rows = [(*v.position, v.heading, v.speed, v.LENGTH, v.WIDTH) for v in vehicles]
    return np.array(rows, np.float64).reshape(-1, COLUMNS)


def scene_at(time_s: float, ids: Sequence[str], rows: FloatArray) -> Scene:
    """The scene of rows [N, 6] in highway-env's frame, whose y grows downward."""
    count = len(ids)
    colours = [EGO_COLOUR if name.startswith(EGO) else OTHER_COLOUR for name in ids]
    return Scene(
        time_s=time_s,
        ids=tuple(ids),
        xy_m=rows[:, 0:2] * np.array([1.0, -1.0]),
        yaw_rad=-wrap_angle(rows[:, 2]),
        speed_mps=rows[:, 3].copy(),
        size_m=rows[:, 4:6].copy(),
        kind=np.full(count, Kind.CAR, np.int64),
        colour=np.array(colours, np.int64).reshape(-1, 3),
        blinker=np.zeros(count, np.int64),
        signal_closed=np.zeros(0, np.bool_),
    )
