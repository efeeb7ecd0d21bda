"""The lanes of a place and how they follow each other: which are near, which lead where."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, Kind, Lane, Route
from hatn_sim.lane_index import LaneIndex

AHEAD_M: Final = 150.0
"""How far candidate lines are drawn out beyond the lane they start from."""
BEHIND_M: Final = 60.0
"""How much of a line is kept behind a vehicle: more than three seconds of history."""
MAX_BRANCHES: Final = 16
NEAR_M: Final = 3.5
NEAR_RAD: Final = np.deg2rad(60.0)


class LaneGraph:
    """Lanes by name, in the order given, and the ways over them."""

    def __init__(self, lanes: Iterable[Lane]) -> None:
        self.lanes: dict[str, Lane] = {lane.id: lane for lane in lanes}

    @cached_property
    def numbers(self) -> dict[str, int]:
        """The place of each lane in the order."""
        return {name: number for number, name in enumerate(self.lanes)}

    @cached_property
    def predecessors(self) -> dict[str, list[str]]:
        """The lanes that lead to each."""
        before: dict[str, list[str]] = {name: [] for name in self.lanes}
        for lane in self.lanes.values():
            for successor in lane.successors:
                if successor in before:
                    before[successor].append(lane.id)
        return before

    @cached_property
    def knows_junctions(self) -> bool:
        """Whether any lane is a connection through a junction."""
        return any(lane.is_connection for lane in self.lanes.values())

    @cached_property
    def _index(self) -> LaneIndex:
        return LaneIndex([lane.xy_m for lane in self.lanes.values()])

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(self.lanes)

    def near(self, xy_m: FloatArray, yaw_rad: float, kind: Kind) -> list[str]:
        """Lanes within `NEAR_M` and `NEAR_RAD` of a pose that a `kind` may use, nearest first."""
        found = self._index.near(xy_m, yaw_rad, NEAR_M, NEAR_RAD)
        names = (self._names[number] for number in found)
        return [name for name in names if kind in self.lanes[name].kinds]

    def prefix_to(self, lane_id: str, kind: Kind) -> Route:
        """Lanes that lead to `lane_id`, the straightest first, for `BEHIND_M`, and itself."""
        route, so_far_m = [lane_id], 0.0
        while so_far_m < BEHIND_M:
            before = [
                name
                for name in self.predecessors[route[0]]
                if kind in self.lanes[name].kinds and name not in route
            ]
            if not before:
                break
            best = min(before, key=lambda name: (abs(self.lanes[name].turn), name))
            route.insert(0, best)
            so_far_m += length_m(self.lanes[best])
        return tuple(route)

    def routes_from(self, prefix: Route, kind: Kind) -> list[Route]:
        """Routes that begin with `prefix` and go on through every connection for `AHEAD_M`."""
        open_routes: list[tuple[float, Route]] = [(0.0, prefix)]
        done: list[Route] = []
        while open_routes:
            so_far_m, route = open_routes.pop(0)
            ahead = [
                name
                for name in self.lanes[route[-1]].successors
                if name in self.lanes and kind in self.lanes[name].kinds and name not in route
            ]
            full = len(done) + len(open_routes) + len(ahead) > MAX_BRANCHES
            # The first fork is never left out: no lane ahead would be a candidate.
            if not ahead or so_far_m >= AHEAD_M or (full and route != prefix):
                done.append(route)
                continue
            open_routes += [
                (so_far_m + length_m(self.lanes[name]), (*route, name)) for name in ahead
            ]
            open_routes.sort()
        return done


def length_m(lane: Lane) -> float:
    """The length of a lane's centre line."""
    return float(np.linalg.norm(np.diff(lane.xy_m, axis=0), axis=1).sum())
