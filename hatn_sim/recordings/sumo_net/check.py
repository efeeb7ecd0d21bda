"""How true a built net is to the lanes that it was built from, as SUMO itself reads it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import FloatArray, Kind, Lane
from hatn_sim.geometry import resample, tangent_rad, wrap_angle
from hatn_sim.recordings.sumo_net.plan import NetPlan

STEP_M: Final = 0.05
GIVEN_EVERY: Final = 20
"""Of the given centre lines every twentieth sample is looked at: one for each metre."""
NEAREST: Final = 40
SAME_WAY_RAD: Final = np.deg2rad(30.0)
NOT_THERE_M: Final = 10.0
"""Told where the built net has nothing that runs the same way nearer than this."""


@dataclass(frozen=True)
class NetCheck:
    """Given lanes against the lanes that SUMO has. Distances are within 3 cm."""

    lanes: int  # given, those for pedestrians only excepted
    edges: int
    junctions: int
    connections: int
    distance_m_median: float  # of points of the given centre lines to the built ones
    distance_m_p99: float
    distance_m_max: float
    successors: int  # pairs of lanes that follow one another, as given and cut
    successors_kept: int


def check_net(given: Sequence[Lane], plan: NetPlan, built: Sequence[Lane]) -> NetCheck:
    """The figures of a net: `built` are its lanes as SUMO reads them."""
    lanes = [lane for lane in given if lane.kinds - {Kind.PEDESTRIAN}]
    away_m = _distances_m(lanes, built)
    pairs = {(lane.id, name) for lane in plan.lanes for name in lane.successors}
    kept = pairs & _kept_pairs(plan, {lane.id: lane for lane in built})
    return NetCheck(
        lanes=len(lanes),
        edges=len(plan.edges),
        junctions=len(plan.nodes),
        connections=len(plan.connections),
        distance_m_median=float(np.median(away_m)),
        distance_m_p99=float(np.quantile(away_m, 0.99)),
        distance_m_max=float(away_m.max()),
        successors=len(pairs),
        successors_kept=len(kept),
    )


def _distances_m(given: Sequence[Lane], built: Sequence[Lane]) -> FloatArray:
    points, yaw = _sampled(given, GIVEN_EVERY)
    built_points, built_yaw = _sampled(built, 1)
    tree = KDTree(built_points)
    away_m, sample = tree.query(
        points, k=min(NEAREST, len(built_points)), distance_upper_bound=NOT_THERE_M
    )
    there = np.isfinite(away_m)
    turned = wrap_angle(built_yaw[np.where(there, sample, 0)] - yaw[:, None])
    away_m = np.where(there & (np.abs(turned) <= SAME_WAY_RAD), away_m, NOT_THERE_M)
    return np.asarray(away_m.min(axis=1))


def _sampled(lanes: Sequence[Lane], every: int) -> tuple[FloatArray, FloatArray]:
    """Every so many of the points of centre lines `STEP_M` apart, and the directions there."""
    lines = [resample(lane.xy_m, STEP_M) for lane in lanes]
    yaws = [tangent_rad(line)[::every] for line in lines]
    return np.concatenate([line[::every] for line in lines]), np.concatenate(yaws)


def _kept_pairs(plan: NetPlan, built: Mapping[str, Lane]) -> set[tuple[str, str]]:
    """Pairs of given lanes that follow one another on lanes that do so in the built net."""
    kept: set[tuple[str, str]] = set()
    for edge in plan.edges:
        for index, chain in enumerate(edge.lanes):
            if f"{edge.id}_{index}" in built:
                kept.update(pairwise(chain.given))
    for connection in plan.connections:
        source, target = (
            f"{edge}_{index}" for edge, index in (connection.source, connection.target)
        )
        if source in built and target in _reached(source, built):
            first, last = connection.given
            way = (first, *connection.through, last)
            kept.update(pairwise(way))
    return kept


def _reached(source: str, built: Mapping[str, Lane]) -> set[str]:
    """The lanes that follow a lane, directly or through a junction."""
    reached: set[str] = set()
    queue = list(built[source].successors)
    while queue:
        name = queue.pop()
        if name not in reached:
            reached.add(name)
            if name in built and built[name].is_connection:
                queue += built[name].successors
    return reached
