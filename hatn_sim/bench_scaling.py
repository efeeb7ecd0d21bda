"""How the cost of a tick grows with vehicles and with the net: copies of one scene side by side.

Every copy has the same traffic, so that vehicles grow while the traffic around each of them stays
as it is.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hatn_sim.config import Scenario
from hatn_sim.datatypes import Lane, Scene
from hatn_sim.graph import build_graphs
from hatn_sim.perception import begin, perceive
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator

APART_M: Final = 2000.0
WARM_UP_S: Final = 60.0
UNTIMED_STEPS: Final = 30
COPIES: Final = ((1, 1), (2, 2), (5, 5), (10, 10), (20, 20), (50, 50), (100, 100), (100, 1))
"""(copies of the net, copies with traffic)"""


@dataclass(frozen=True)
class Scaling:
    """The cost of seeing so many vehicles in a net of such a size."""

    vehicles: float  # mean number in view
    lane_km: float  # of the whole net
    perceive_ms: float  # median over the steps
    graphs_ms: float
    lines: int  # reference lines drawn so far


def measure_scaling(scenario: Scenario, steps: int, seed: int) -> list[Scaling]:
    """One row for each of `COPIES`, all of them on the same `steps` frames."""
    with SumoSimulator(scenario) as simulator:
        scene = simulator.reset(seed).scene
        for _ in range(round(WARM_UP_S / simulator.dt_s)):
            scene = simulator.step().scene
        scenes = [scene] + [simulator.step().scene for _ in range(UNTIMED_STEPS + steps)]
        lanes = simulator.lanes
    return [_measure(lanes, scenes, *copies) for copies in COPIES]


def _measure(lanes: Sequence[Lane], scenes: Sequence[Scene], nets: int, traffic: int) -> Scaling:
    road = Road([lane for copy in range(nets) for lane in copy_lanes(lanes, copy)])
    state = begin(road)
    perceive_ms: list[float] = []
    graphs_ms: list[float] = []
    for scene in scenes:
        wide = copy_scene(scene, traffic)
        start = time.perf_counter()
        state = perceive(state, wide, None)
        between = time.perf_counter()
        build_graphs(road, state.seen)
        perceive_ms.append(1e3 * (between - start))
        graphs_ms.append(1e3 * (time.perf_counter() - between))
    lane_m = sum(float(np.linalg.norm(np.diff(lane.xy_m, axis=0), axis=1).sum()) for lane in lanes)
    return Scaling(
        vehicles=traffic * float(np.mean([len(scene.ids) for scene in scenes])),
        lane_km=nets * lane_m / 1000.0,
        perceive_ms=float(np.median(perceive_ms[UNTIMED_STEPS:])),
        graphs_ms=float(np.median(graphs_ms[UNTIMED_STEPS:])),
        lines=len(road.lines),
    )


def copy_lanes(lanes: Sequence[Lane], copy: int) -> list[Lane]:
    """The lanes, `copy` times `APART_M` further east, under names of their own."""
    return [
        replace(
            lane,
            id=f"{copy}/{lane.id}",
            xy_m=lane.xy_m + np.array((copy * APART_M, 0.0)),
            successors=tuple(f"{copy}/{name}" for name in lane.successors),
            signals=None
            if lane.signals is None
            else {f"{copy}/{name}": signal for name, signal in lane.signals.items()},
        )
        for lane in lanes
    ]


def copy_scene(scene: Scene, copies: int) -> Scene:
    """So many times the same scene, each `APART_M` further east; the signals are common to all."""
    count = len(scene.ids)
    shift = np.repeat(np.arange(copies), count)[:, None] * np.array((APART_M, 0.0))
    return replace(
        scene,
        ids=tuple(f"{copy}/{name}" for copy in range(copies) for name in scene.ids),
        xy_m=np.tile(scene.xy_m, (copies, 1)) + shift,
        yaw_rad=np.tile(scene.yaw_rad, copies),
        speed_mps=np.tile(scene.speed_mps, copies),
        size_m=np.tile(scene.size_m, (copies, 1)),
        kind=np.tile(scene.kind, copies),
        colour=np.tile(scene.colour, (copies, 1)),
        blinker=np.tile(scene.blinker, copies),
    )
