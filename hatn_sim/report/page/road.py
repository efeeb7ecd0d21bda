"""The lanes near where somebody was, as the page draws them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import FloatArray, Gate, Kind, Lane
from hatn_sim.geometry import resample
from hatn_sim.report.road_shapes import MOTOR_KINDS, markings, stop_line

NEAR_M: Final = 70.0
"""Lanes farther than this from wherever anybody was are left out: a town may have thousands."""
GRID_PER_M: Final = 50
"""Points of the road are rounded to 2 cm: coarser, long lines are seen to waver."""
CELL_M: Final = 5.0
"""Places where somebody was, within this of each other, count once."""
ROAD, TRAM, PATH = "road", "tram", "path"


def near_lanes(lanes: Iterable[Lane], been_xy_m: FloatArray) -> list[Lane]:
    """The lanes that come near one of the places [P, 2]; all of them where nobody was."""
    everything = list(lanes)
    if not len(been_xy_m):
        return everything
    been = KDTree(np.unique(np.rint(been_xy_m / CELL_M), axis=0) * CELL_M)

    def is_near(lane: Lane) -> bool:
        away_m, _ = been.query(resample(lane.xy_m, CELL_M), distance_upper_bound=NEAR_M)
        return bool(np.isfinite(away_m).any())

    return [lane for lane in everything if is_near(lane)]


def road_content(lanes: Sequence[Lane], origin_m: FloatArray) -> dict[str, Any]:
    """Lanes, markings and lines to stop at, in steps of 2 cm from the origin."""
    road = [lane for lane in lanes if use_of(lane) == ROAD]
    solid, dashed = markings([lane for lane in road if not lane.is_connection], None)
    return {
        "lanes": [
            {
                "use": use_of(lane),
                "joins": lane.is_connection,
                "width_m": round(float(lane.width_m), 2),
                "xy": _flat(lane.xy_m, origin_m),
            }
            for lane in lanes
        ],
        "solid": [_flat(line, origin_m) for line in solid],
        "dashed": [_flat(line, origin_m) for line in dashed],
        "stops": [_stop(lane, origin_m) for lane in road if lane.gate is not Gate.NONE],
    }


def use_of(lane: Lane) -> str:
    """What a lane is paved for."""
    if lane.kinds & MOTOR_KINDS:
        return ROAD
    return TRAM if Kind.TRAM in lane.kinds else PATH


def _stop(lane: Lane, origin_m: FloatArray) -> dict[str, Any]:
    line = stop_line(lane)
    return {
        "gate": line.gate.name.lower(),
        "xy": _flat(line.corners_xy_m, origin_m),
        "signals": list(line.signals),
    }


def _flat(xy_m: FloatArray, origin_m: FloatArray) -> list[int]:
    """x, y, x, y ... without points that the grid makes equal."""
    xy = np.rint((xy_m - origin_m) * GRID_PER_M).astype(np.int64)
    keep = np.ones(len(xy), dtype=np.bool_)
    keep[1:] = np.diff(xy, axis=0).any(axis=1)
    flat: list[int] = xy[keep].ravel().tolist()
    return flat
