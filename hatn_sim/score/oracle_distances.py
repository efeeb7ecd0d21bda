"""How far vehicles are from a conflict, by our lines and by SUMO's list."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray
from hatn_sim.road import LINE_STEP_M, Road
from hatn_sim.score.oracle_lanes import JunctionLanes
from hatn_sim.score.oracle_meetings import Listed, Meetings

AREA_MERGE_M: Final = 2.5
"""SUMO's area of a merge begins where centre lines are this near, or half the lanes' widths."""
AROUND_M: Final = 25.0
"""Where the begin of a merge is looked for, before and behind our entry."""


@dataclass(frozen=True, eq=False)
class DistanceErrors:
    """D distances of one vehicle to one conflict, ours minus SUMO's."""

    vehicle: IntArray  # [D]
    place_m: FloatArray  # [D] to the same place of the area
    entry_m: FloatArray  # [D] to the begin of the area, each by its own width
    waiting_places: int  # SUMO's distances to a place to wait before the area: left out


class Distances:
    """Compares distances; keeps where SUMO's rule lets merges begin on our lines."""

    def __init__(self, road: Road, lanes: JunctionLanes) -> None:
        self._road = road
        self._lanes = lanes
        self._begins: dict[tuple[int, int, int, float], float] = {}

    def errors(
        self,
        line: IntArray,
        front_s_m: FloatArray,
        meetings: Meetings,
        listed: Listed,
        ours: tuple[FloatArray, BoolArray],
        found: BoolArray,
    ) -> DistanceErrors:
        """Errors over the rows of SUMO's list that are of a meeting which both have.

        Where SUMO's area is a crossing, the place is its middle and our point; where it is a merge,
        the place is where the lines come as near as SUMO's rule wants. Behind a place to wait
        inside the junction, SUMO gives the distance to that place instead.

        Args:
            line: [N] of the vehicles.
            front_s_m: [N] their front bumpers.
            meetings: M of them.
            listed: SUMO's rows.
            ours: conflicts [M, Q, 7] along the first lines, and which count [M, Q].
            found: [M] whether both have the meeting.
        """
        table, here = ours
        vehicles: list[int] = []
        place_m: list[float] = []
        entry_m: list[float] = []
        waiting = 0
        for k in np.flatnonzero(listed.current & listed.ahead & found[listed.meeting]).tolist():
            meeting, side = int(listed.meeting[k]), int(listed.side[k])
            own, foe = (int(row) for row in listed.lane[k])
            merge = self._lanes.target[own] >= 0
            merge &= self._lanes.target[own] == self._lanes.target[foe]
            if not merge and self._lanes.way[own] != own:
                waiting += 1
                continue
            vehicle = int(meetings.vehicle[meeting, side])
            enter_s_m = float(front_s_m[vehicle] + listed.enter_m[k])
            leave_s_m = float(front_s_m[vehicle] + listed.leave_m[k])
            conflicts = table[meeting, here[meeting]].reshape(-1, 7)[:, :6].reshape(-1, 2, 3)
            mine, others = conflicts[:, side], conflicts[:, 1 - side]
            if merge:
                lines = int(line[vehicle]), int(line[meetings.vehicle[meeting, 1 - side]])
                begins = [
                    self._begin_s_m(lines, (own, foe), float(a), float(b))
                    for a, b in zip(mine[:, 0], others[:, 0], strict=True)
                ]
                places = np.array(begins) - enter_s_m
            else:
                places = mine[:, 1] - 0.5 * (enter_s_m + leave_s_m)
            nearest = int(np.abs(places).argmin())
            vehicles.append(vehicle)
            place_m.append(float(places[nearest]))
            entry_m.append(float(mine[nearest, 0]) - enter_s_m)
        return DistanceErrors(
            np.array(vehicles, dtype=np.int64), np.array(place_m), np.array(entry_m), waiting
        )

    def _begin_s_m(
        self, line: tuple[int, int], lane: tuple[int, int], own_s_m: float, other_s_m: float
    ) -> float:
        """Where on the first of two lines SUMO's rule lets the area of their merge begin."""
        key = (*line, lane[0], own_s_m)
        if key not in self._begins:
            own, foe = (self._lanes.lanes[row] for row in lane)
            one, other = (self._road.lines[number] for number in line)
            width_m = min(AREA_MERGE_M, 0.5 * (own.width_m + foe.width_m))
            begin = merge_begin_m(one.xy_m, other.xy_m, own_s_m, other_s_m, width_m)
            if own.id in one.route:  # SUMO looks at that lane only
                begin = max(begin, float(one.lane_start_s_m[one.route.index(own.id)]))
            self._begins[key] = begin
        return self._begins[key]


def merge_begin_m(
    one_xy_m: FloatArray, other_xy_m: FloatArray, one_s_m: float, other_s_m: float, width_m: float
) -> float:
    """The arc length from which on a line [P, 2] is within `width_m` of another it merges into.

    Both have a vertex every `LINE_STEP_M`; they are near each other at `one_s_m`, `other_s_m`.
    """
    around = [
        xy[max(int((s_m - AROUND_M) / LINE_STEP_M), 0) : int((s_m + AROUND_M) / LINE_STEP_M)]
        for xy, s_m in ((one_xy_m, one_s_m), (other_xy_m, other_s_m))
    ]
    start, end = around[1][:-1], around[1][1:]
    along = end - start
    offset = around[0][:, None, :] - start[None]
    t = np.clip((offset * along).sum(axis=2) / (along * along).sum(axis=1), 0.0, 1.0)
    apart_m = np.linalg.norm(offset - t[:, :, None] * along, axis=2).min(axis=1)
    together = int(apart_m.argmin())
    wide = np.flatnonzero(apart_m[: together + 1] >= width_m)
    first = max(int((one_s_m - AROUND_M) / LINE_STEP_M), 0)
    if not len(wide):
        return first * LINE_STEP_M
    last = int(wide[-1])
    part = (apart_m[last] - width_m) / max(apart_m[last] - apart_m[last + 1], 1e-9)
    return (first + last + float(part)) * LINE_STEP_M
