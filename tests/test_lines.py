"""The choice of the reference line: by motion, by blinker, and never by the future."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import crossing_lanes, scene_of

from hatn_sim.config import load_scenario
from hatn_sim.perception import begin, perceive
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator

SCENES = (
    "intersection5",
    "intersection4_allway",
    "tjunction",
    "roundabout8",
    "roundabout4_two_lane",
)


def route_at(road: Road, poses: list[tuple[float, float, float, float]], blinker: int = 0) -> str:
    state = begin(road)
    for frame, pose in enumerate(poses):
        state = perceive(state, scene_of(0.1 * frame, {"v": pose}, blinker), None)
    index = int(state.seen.lines.line[0])
    return "none" if index < 0 else road.lines[index].route[1]


def arc_poses(upto_rad: float) -> list[tuple[float, float, float, float]]:
    """Up the west arm and along the left turn."""
    straight = [(x, 0.0, 0.0, 5.0) for x in np.arange(-40.0, -8.0, 0.5)]
    turn = [
        (-8 + 8 * np.sin(t), 8 - 8 * np.cos(t), float(t), 5.0)
        for t in np.arange(0.0, upto_rad, 0.5 / 8.0)
    ]
    return straight + turn


def test_motion_decides_inside_the_junction() -> None:
    road = Road(crossing_lanes())
    assert route_at(road, arc_poses(0.5)) == "wn"
    assert route_at(road, [(x, 0.0, 0.0, 5.0) for x in np.arange(-40.0, 2.0, 0.5)]) == "we"


@pytest.mark.parametrize(("blinker", "expected"), [(0, "we"), (1, "wn")])
def test_a_blinker_decides_before_the_fork(blinker: int, expected: str) -> None:
    road = Road(crossing_lanes())
    poses = [(x, 0.0, 0.0, 10.0) for x in np.arange(-60.0, -30.0, 1.0)]
    assert route_at(road, poses, blinker) == expected


def test_where_lines_tie_the_probability_says_so() -> None:
    road = Road(crossing_lanes())
    state = begin(road)
    for frame, x in enumerate(np.arange(-90.0, -75.0, 1.0)):
        state = perceive(state, scene_of(0.1 * frame, {"v": (x, 0.0, 0.0, 10.0)}), None)
    assert 0.45 < state.seen.lines.probability[0] < 0.6
    for frame, pose in enumerate(arc_poses(1.2)):
        state = perceive(state, scene_of(2.0 + 0.1 * frame, {"w": pose}), None)
    assert state.seen.lines.probability[0] > 0.9


def test_a_vehicle_off_every_line_has_none() -> None:
    road = Road(crossing_lanes())
    assert route_at(road, [(40.0, 30.0, 1.0, 5.0)] * 5) == "none"
    assert route_at(road, [(-50.0, 0.0, np.pi, 5.0)] * 5) == "none", "against the direction"


@pytest.mark.parametrize("scene", SCENES)
def test_inferred_lines_are_the_routes_inside_the_junction(scene: str) -> None:
    """From two metres into a connection on, the inferred line runs where the route does."""
    right = total = 0
    with SumoSimulator(load_scenario(scene)) as simulator:
        frame = simulator.reset(5)
        road = simulator.road
        inferred, by_route = begin(road), begin(Road(road.lanes.values()))
        for _ in range(900):
            frame = simulator.step()
            inferred = perceive(inferred, frame.scene, None)
            by_route = perceive(by_route, frame.scene, frame.truth.routes)
            mine, true = inferred.seen.lines, by_route.seen.lines
            for k in np.flatnonzero(true.line >= 0).tolist():
                other = by_route.road
                into = true.s_m[k] - other.fork_s_m[true.line[k]]
                ends = other.fork_end_s_m[true.line[k]] - true.s_m[k]
                if not ((into > 2.0) & (ends > 0.0)).any():
                    continue
                total += 1
                ahead = np.array([5.0])
                if mine.line[k] < 0:
                    continue
                at = road.locate(mine.line[k : k + 1], mine.s_m[k] + ahead, np.zeros(1))
                want = other.locate(true.line[k : k + 1], true.s_m[k] + ahead, np.zeros(1))
                right += bool(np.linalg.norm(at - want) < 1.0)
    assert total > 100
    assert right / total > 0.97
