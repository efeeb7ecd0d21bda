"""Asks a running SUMO who conflicts with whom; the library is handed in, not imported."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Final

import numpy as np

from hatn_sim.simulators.sumo_lanes import LaneTable, is_connection, junction_of
from hatn_sim.simulators.sumo_messages import JunctionFoes, LaneFoes

MUTE_MARGIN_M: Final = 0.5
"""How far before a junction that must not be asked about the question ends."""


class FoeReader:
    """SUMO's conflicts, with lanes as rows of the lane table."""

    def __init__(self, sumo: Any, table: LaneTable) -> None:
        self._sumo = sumo
        self._table = table
        self._row = {name: row for row, name in enumerate(table.ids)}

    def junction_foes(self, vehicles: Sequence[str], reach_m: float) -> JunctionFoes:
        """What SUMO says of the conflicts within `reach_m` ahead of every one of the vehicles.

        It is asked up to the first junction without logic: there it would crash.
        """
        row_of = {name: row for row, name in enumerate(vehicles)}
        pairs: list[tuple[int, ...]] = []
        distances: list[tuple[float, ...]] = []
        approaches: list[tuple[int, int]] = []
        approach_m: list[float] = []
        for name, row in row_of.items():
            ahead = self._connections_ahead(name, reach_m)
            approaches += [(row, self._row.get(lane, -1)) for lane, _ in ahead]
            approach_m += [at_m for _, at_m in ahead]
            mute_m = [at_m for lane, at_m in ahead if junction_of(lane) in self._mute]
            asked_m = min(mute_m[0] - MUTE_MARGIN_M, reach_m) if mute_m else reach_m
            if asked_m <= 0.0:  # SUMO would take 0 for its own choice
                continue
            for found in self._sumo.vehicle.getJunctionFoes(name, asked_m):
                foe, enter_m, foe_enter_m, leave_m, foe_leave_m, lane, foe_lane = found[:7]
                if foe in row_of:
                    lanes = (self._row.get(lane, -1), self._row.get(foe_lane, -1))
                    pairs.append((row, row_of[foe], *lanes))
                    distances.append((enter_m, foe_enter_m, leave_m, foe_leave_m))
        pair_rows = np.array(pairs, np.int64).reshape(-1, 4)
        distance_rows = np.array(distances, np.float64).reshape(-1, 4)
        approach_rows = np.array(approaches, np.int64).reshape(-1, 2)
        return JunctionFoes(
            vehicle=pair_rows[:, :2],
            lane=pair_rows[:, 2:],
            enter_m=distance_rows[:, :2],
            leave_m=distance_rows[:, 2:],
            approach_vehicle=approach_rows[:, 0],
            approach_lane=approach_rows[:, 1],
            approach_m=np.array(approach_m, np.float64),
        )

    def lane_foes(self) -> LaneFoes:
        """What SUMO's junctions hold against each other: lanes inside them, and approaches."""
        lane = self._sumo.lane
        inside: list[tuple[int, int]] = []
        approaching: list[tuple[int, int, int]] = []
        mute: list[int] = []
        for name, row in self._row.items():
            if is_connection(name):
                inside += [(row, foe) for foe in self._rows(lane.getInternalFoes(name))]
                if junction_of(name) in self._mute:
                    mute.append(row)
                continue
            for approached, *_ in lane.getLinks(name):
                for target in self._rows([approached]):
                    foes = self._rows(lane.getFoes(name, approached))
                    approaching += [(row, target, foe) for foe in foes]
        return LaneFoes(
            inside=np.array(inside, np.int64).reshape(-1, 2),
            approaching=np.array(approaching, np.int64).reshape(-1, 3),
            mute=np.array(mute, np.int64),
        )

    @cached_property
    def _mute(self) -> frozenset[str]:
        """Junctions of SUMO's type `unregulated`, as far as ways in them have one lane before.

        SUMO names the type nowhere; in others it holds ways out of one lane against each other.
        """
        return frozenset(
            junction_of(link.successor)
            for links in self._table.links
            if len({link.successor for link in links}) > 1
            for link in links
            if is_connection(link.successor) and not self._sumo.lane.getInternalFoes(link.successor)
        )

    def _rows(self, names: Sequence[str]) -> list[int]:
        return [self._row[name] for name in names if name in self._row]

    def _connections_ahead(self, vehicle: str, reach_m: float) -> list[tuple[str, float]]:
        """First lanes of the ways through the junctions ahead, with the distance to their begin.

        The junction that the vehicle is in comes first, with a distance that is not positive.
        """
        lane: str = self._sumo.vehicle.getLaneID(vehicle)
        if not lane:
            return []
        found: list[tuple[str, float]] = []
        ahead_m = -float(self._sumo.vehicle.getLanePosition(vehicle))
        if is_connection(lane):  # SUMO's links begin behind the lane that follows
            found.append((lane, ahead_m))
            lane, through_m = self._through_junction(lane)
            ahead_m += through_m
        ahead_m += self._sumo.lane.getLength(lane)
        for approached, _, _, _, via, _, _, _ in self._sumo.vehicle.getNextLinks(vehicle):
            if ahead_m > reach_m:
                break
            if via:
                found.append((via, ahead_m))
                ahead_m += self._through_junction(via)[1]
            ahead_m += self._sumo.lane.getLength(approached)
        return found

    def _through_junction(self, lane: str) -> tuple[str, float]:
        """The lane behind the junction that `lane` is in, and the length of the way there."""
        length_m = 0.0
        while is_connection(lane) and (links := self._sumo.lane.getLinks(lane)):
            length_m += self._sumo.lane.getLength(lane)
            approached, _, _, _, via, *_ = links[0]
            lane = via or approached
        return lane, length_m
