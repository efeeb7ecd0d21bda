"""How long each network takes for a given number of agents, as in the paper's figure.

Where a scene has too few agents, it stands side by side with copies of itself, as in the paper.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hatn_sim.bench import Stopwatch, adapt, adaptives_of
from hatn_sim.bench_scaling import UNTIMED_STEPS, WARM_UP_S, copy_lanes, copy_scene
from hatn_sim.config import Scenario
from hatn_sim.datatypes import Lane, Scene
from hatn_sim.errors import InputError
from hatn_sim.graph import build_graphs
from hatn_sim.hatn.adaptation_memory import AdaptationState
from hatn_sim.hatn.predictor import Hatn
from hatn_sim.perception import begin, perceive
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator

AGENTS: Final = (1, 10, 50, 100)
STAGES: Final = {
    "perceive": "tracks, lines, leaders",
    "graphs": "semantic graphs",
    "sgn": "SGN",
    "edn": "EDN",
    "adaptation_1": "adaptation, 1 step",
    "adaptation_3": "adaptation, 3 steps",
}
"""Key -> what is timed."""


@dataclass(frozen=True)
class Runtime:
    """A stage for so many agents in one batch."""

    stage: str
    agents: int
    median_ms: float


def measure_runtime(
    scenario: Scenario, predictor: Hatn, steps: int, seed: int, agents: Sequence[int] = AGENTS
) -> list[Runtime]:
    """Every stage for every number of agents, all on the same `steps` frames of one scene.

    Raises InputError where the scene has a moment without vehicles.
    """
    with SumoSimulator(scenario) as simulator:
        scene = simulator.reset(seed).scene
        for _ in range(round(WARM_UP_S / simulator.dt_s)):
            scene = simulator.step().scene
        scenes = [scene] + [simulator.step().scene for _ in range(UNTIMED_STEPS + steps)]
        lanes = simulator.lanes
    fewest = min(len(scene.ids) for scene in scenes)
    if not fewest:
        raise InputError(f"{scenario.name}: is empty at times; choose another --scenes")
    return [
        Runtime(stage, number, ms)
        for number in agents
        for stage, ms in _measure(lanes, scenes, predictor, number, math.ceil(number / fewest))
    ]


def _measure(
    lanes: Sequence[Lane], scenes: Sequence[Scene], predictor: Hatn, agents: int, copies: int
) -> list[tuple[str, float]]:
    watch = Stopwatch()
    road = Road([lane for copy in range(copies) for lane in copy_lanes(lanes, copy)])
    state = begin(road)
    adaptives = adaptives_of(predictor)
    learnt: dict[str, AdaptationState | None] = dict.fromkeys(adaptives)
    for index, scene in enumerate(scenes):
        if index == UNTIMED_STEPS:
            watch = Stopwatch()
        some = first_vehicles(copy_scene(scene, copies), agents)
        state = watch.time("perceive", perceive, state, some, None)
        graphs = watch.time("graphs", build_graphs, road, state.seen)
        if len(graphs.ego):
            intention = watch.time("sgn", predictor.intend, graphs)
            watch.time("edn", predictor.drive, state, graphs.ego, intention)
            prediction = predictor.predict_graphs(state, graphs, intention)
            for stage, adaptive in adaptives.items():
                learnt[stage] = watch.time(
                    stage, adapt, adaptive, learnt[stage], state, graphs, intention, prediction
                )
    return [
        (stage, float(np.median(watch.taken_ms[stage])))
        for stage in STAGES
        if watch.taken_ms[stage]
    ]


def first_vehicles(scene: Scene, count: int) -> Scene:
    """The scene with its first vehicles only, those longest in it."""
    return replace(
        scene,
        ids=scene.ids[:count],
        xy_m=scene.xy_m[:count],
        yaw_rad=scene.yaw_rad[:count],
        speed_mps=scene.speed_mps[:count],
        size_m=scene.size_m[:count],
        kind=scene.kind[:count],
        colour=scene.colour[:count],
        blinker=scene.blinker[:count],
    )
