"""Reads the lanes of a running SUMO's net; the library is handed in, not imported."""

from __future__ import annotations

from typing import Any

import numpy as np

from hatn_sim.datatypes import Kind
from hatn_sim.simulators.sumo_lanes import LaneTable, Link, kinds_of


def read_lane_table(sumo: Any) -> LaneTable:
    """Every lane of the running simulation's net, those for pedestrians only left out."""
    lane = sumo.lane
    kinds = {lane_id: _allowed_kinds(sumo, lane_id) for lane_id in lane.getIDList()}
    ids = tuple(key for key, value in kinds.items() if value - {Kind.PEDESTRIAN})
    signals = _signal_indices(sumo)
    shapes = [lane.getShape(lane_id) for lane_id in ids]
    links: list[tuple[Link, ...]] = []
    for lane_id in ids:
        own: list[Link] = []
        for approached, _, _, _, via, state, direction, _ in lane.getLinks(lane_id):
            successor = via or approached
            if kinds[successor] - {Kind.PEDESTRIAN}:
                own.append(Link(successor, state, direction, signals.get((lane_id, approached))))
        links.append(tuple(own))
    return LaneTable(
        ids=ids,
        point_counts=tuple(len(shape) for shape in shapes),
        xy_m=np.array([point[:2] for shape in shapes for point in shape], np.float64).reshape(
            -1, 2
        ),
        length_m=tuple(lane.getLength(lane_id) for lane_id in ids),
        width_m=tuple(lane.getWidth(lane_id) for lane_id in ids),
        speed_limit_mps=tuple(lane.getMaxSpeed(lane_id) for lane_id in ids),
        kinds=tuple(kinds[lane_id] for lane_id in ids),
        links=tuple(links),
    )


def _allowed_kinds(sumo: Any, lane_id: str) -> frozenset[Kind]:
    allowed = sumo.lane.getAllowed(lane_id)
    if allowed:
        return kinds_of(allowed)
    # SUMO says nothing both where all are allowed and where nobody is.
    return frozenset() if sumo.lane.getDisallowed(lane_id) else frozenset(Kind)


def _signal_indices(sumo: Any) -> dict[tuple[str, str], int]:
    """(lane, lane approached) -> index of its signal among those of all traffic lights."""
    indices: dict[tuple[str, str], int] = {}
    offset = 0
    for light in sumo.trafficlight.getIDList():
        groups = sumo.trafficlight.getControlledLinks(light)
        for place, group in enumerate(groups):
            for source, target, _ in group:
                indices[source, target] = offset + place
        offset += len(sumo.trafficlight.getRedYellowGreenState(light))
    return indices
