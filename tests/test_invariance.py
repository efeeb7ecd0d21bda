"""What graphs must not see: where the world lies, how it is turned, mirrored, ordered, timed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hatn_sim.config import load_scenario
from hatn_sim.datatypes import FloatArray, Lane, Scene, SemanticGraphs
from hatn_sim.geometry import wrap_angle
from hatn_sim.graph import AHEAD_AT_M, CONTEXT, build_graphs
from hatn_sim.perception import begin, perceive
from hatn_sim.road import Road
from hatn_sim.simulators.sumo import SumoSimulator

SCENES = ("intersection5", "roundabout8", "roundabout4_two_lane")
Move = Callable[[FloatArray], FloatArray]
SIGNED_FEATURES = [2, 5]  # phi_f, phi_r
SIGNED_CONTEXT = [
    *range(len(AHEAD_AT_M), 2 * len(AHEAD_AT_M)),  # curvatures
    CONTEXT.index("lateral_m of the rear vehicle"),
]


@cache
def traffic(name: str) -> tuple[tuple[Lane, ...], tuple[Scene, ...]]:
    """Lanes, and two seconds of traffic after 80 s."""
    with SumoSimulator(load_scenario(name)) as simulator:
        simulator.reset(3)
        for _ in range(800):
            simulator.step()
        scenes = tuple(simulator.step().scene for _ in range(20))
        return tuple(simulator.lanes), scenes


def graphs_of(lanes: Sequence[Lane], scenes: Sequence[Scene]) -> SemanticGraphs:
    road = Road(lanes)
    state = begin(road)
    for scene in scenes:
        state = perceive(state, scene, None)
    graphs = build_graphs(road, state.seen)
    assert graphs.has_conflict.sum() >= 2  # else nothing would be tested
    return graphs


@cache
def unmoved(name: str) -> SemanticGraphs:
    return graphs_of(*traffic(name))


def moved(
    name: str, move: Move, turn_rad: float = 0.0, mirror: bool = False, later_s: float = 0.0
) -> tuple[list[Lane], list[Scene]]:
    lanes, scenes = traffic(name)
    hand = -1 if mirror else 1
    return (
        [replace(lane, xy_m=move(lane.xy_m), turn=hand * lane.turn) for lane in lanes],
        [
            replace(
                scene,
                time_s=scene.time_s + later_s,
                xy_m=move(scene.xy_m),
                yaw_rad=wrap_angle(hand * scene.yaw_rad + turn_rad),
                blinker=hand * scene.blinker,
            )
            for scene in scenes
        ],
    )


def assert_same(one: SemanticGraphs, other: SemanticGraphs, move: Move, hand: int = 1) -> None:
    """Equal, node for node by name, but for the signs that a mirror turns."""
    assert {one.ids[k] for k in one.ego} == {other.ids[k] for k in other.ego}
    row = {other.ids[k]: index for index, k in enumerate(other.ego)}
    order = [row[one.ids[k]] for k in one.ego]
    for name in ("rear", "front"):
        found = [
            [[graphs.ids[k] if k >= 0 else None for k in nodes] for nodes in getattr(graphs, name)]
            for graphs in (one, other)
        ]
        assert found[0] == [found[1][index] for index in order], name
    sign, context_sign = np.ones(7), np.ones(len(CONTEXT))
    sign[SIGNED_FEATURES] = hand
    context_sign[SIGNED_CONTEXT] = hand
    np.testing.assert_allclose(one.x, other.x[order] * sign, atol=1e-6)
    np.testing.assert_allclose(one.context, other.context[order] * context_sign, atol=1e-6)
    for name in ("focus_mask", "history_mask", "front_type", "conflict_type", "has_conflict"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name)[order], name)
    there = one.node_mask
    np.testing.assert_allclose(
        move(one.conflict_xy_m[there]), other.conflict_xy_m[order][there], atol=1e-6
    )


@pytest.mark.parametrize("name", SCENES)
@settings(max_examples=3)
@given(
    angle_rad=st.floats(-3.1, 3.1),
    shift_m=st.tuples(st.floats(-4000.0, 4000.0), st.floats(-4000.0, 4000.0)),
)
def test_turned_and_shifted(name: str, angle_rad: float, shift_m: tuple[float, float]) -> None:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)

    def move(xy_m: FloatArray) -> FloatArray:
        return xy_m @ np.array([[cos, sin], [-sin, cos]]) + np.array(shift_m)

    assert_same(unmoved(name), graphs_of(*moved(name, move, angle_rad)), move)


@pytest.mark.parametrize("name", SCENES)
def test_mirrored_with_the_hand_of_traffic(name: str) -> None:
    def move(xy_m: FloatArray) -> FloatArray:
        return xy_m * np.array([1.0, -1.0])

    mirrored = graphs_of(*moved(name, move, mirror=True))
    assert_same(unmoved(name), mirrored, move, hand=-1)


@settings(max_examples=5)
@given(seed=st.integers(0, 10**6), later_s=st.floats(0.0, 1e5))
def test_another_order_of_vehicles_at_another_time(seed: int, later_s: float) -> None:
    name = "roundabout8"
    rng = np.random.default_rng(seed)
    lanes, scenes = moved(name, lambda xy_m: xy_m, later_s=later_s)
    shuffled = [in_order(scene, rng.permutation(len(scene.ids))) for scene in scenes]
    assert_same(unmoved(name), graphs_of(lanes, shuffled), lambda xy_m: xy_m)


@settings(max_examples=5)
@given(seed=st.integers(0, 10**6), others=st.integers(1, 40))
def test_whoever_is_off_the_road_is_padding(seed: int, others: int) -> None:
    """Vehicles on no lane, wherever they stand in the arrays, change no graph."""
    name = "intersection5"
    lanes, scenes = traffic(name)
    rng = np.random.default_rng(seed)
    away_m = rng.uniform(3000.0, 4000.0, (others, 2))
    padded = []
    for scene in scenes:
        count = len(scene.ids)
        wide = replace(
            scene,
            ids=scene.ids + tuple(f"away{k}" for k in range(others)),
            xy_m=np.concatenate((scene.xy_m, away_m)),
            **{
                field: np.concatenate(
                    (getattr(scene, field), np.repeat(getattr(scene, field)[:1], others, axis=0))
                )
                for field in ("yaw_rad", "speed_mps", "size_m", "kind", "colour", "blinker")
            },
        )
        padded.append(in_order(wide, rng.permutation(count + others)))
    assert_same(unmoved(name), graphs_of(lanes, padded), lambda xy_m: xy_m)


def in_order(scene: Scene, order: Sequence[int]) -> Scene:
    """The same scene with its vehicles in another order."""
    fields = ("xy_m", "yaw_rad", "speed_mps", "size_m", "kind", "colour", "blinker")
    return replace(
        scene,
        ids=tuple(scene.ids[k] for k in order),
        **{field: getattr(scene, field)[order] for field in fields},
    )
