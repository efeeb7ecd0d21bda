"""Semantic graphs of hand-made scenes against answers by hand, and their invariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conftest import crossing_lanes, scene_of
from hypothesis import given
from hypothesis import strategies as st

from hatn_sim.datatypes import HISTORY_FRAMES, Front, Gate, Kind, Scene, SemanticGraphs
from hatn_sim.graph import CONTEXT, build_graphs
from hatn_sim.hatn.predictor import repeats_of
from hatn_sim.perception import PerceptionState, begin, perceive
from hatn_sim.road import Road

NORTH = np.pi / 2


def drive(
    road: Road, vehicles: dict[str, tuple[float, float, float, float]], frames: int = 15
) -> PerceptionState:
    """Let everybody drive straight on; the positions given are those of the last frame."""
    state = begin(road)
    for frame in range(frames):
        back_s = 0.1 * (frames - 1 - frame)
        moved = {
            name: (x - v * back_s * np.cos(yaw), y - v * back_s * np.sin(yaw), yaw, v)
            for name, (x, y, yaw, v) in vehicles.items()
        }
        state = perceive(state, scene_of(0.1 * frame, moved), None)
    return state


CROSSING_TRAFFIC = {
    "ego": (-40.0, 0.0, 0.0, 10.0),
    "left": (0.0, -30.0, NORTH, 8.0),
    "behind_left": (0.0, -42.0, NORTH, 8.0),
    "far": (0.0, -100.0, NORTH, 8.0),
    "gone": (0.0, 20.0, NORTH, 8.0),
}


def graphs_of(vehicles: dict[str, tuple[float, float, float, float]]) -> SemanticGraphs:
    road = Road(crossing_lanes())
    return build_graphs(road, drive(road, vehicles).seen)


def row(graphs: SemanticGraphs, name: str) -> int:
    return graphs.ego.tolist().index(graphs.ids.index(name))


def test_nodes_are_those_with_a_conflict_ahead_within_sixty_metres() -> None:
    graphs = graphs_of(CROSSING_TRAFFIC)
    e = row(graphs, "ego")
    names = [graphs.ids[k] for k in graphs.rear[e][graphs.node_mask[e]]]
    # By the larger of the two distances: ego 40 m; left 30 -> 40; behind_left 42 -> 42.
    assert names == ["ego", "left", "behind_left"]
    np.testing.assert_allclose(graphs.ego_to_conflict_m[e, :3], 40.0, atol=0.11)
    np.testing.assert_allclose(graphs.rear_to_conflict_m[e, :3], [40.0, 30.0, 42.0], atol=0.11)
    np.testing.assert_allclose(graphs.conflict_xy_m[e, 1], [0.0, 0.0], atol=0.15)
    assert graphs.focus_mask[e].tolist() == [True, True, True] + [False] * 5
    assert graphs.has_conflict.tolist() == [name not in ("gone", "far") for name in graphs.ids]


def test_features_by_hand() -> None:
    graphs = graphs_of(CROSSING_TRAFFIC)
    e = row(graphs, "ego")
    now = graphs.x[e, :, -1]
    # Node 0: the stop line 8 m before the conflict is the ego's front; its bumper is at 37.5 m.
    np.testing.assert_allclose(now[0], [8.0, 0.0, 0.0, 37.5, 10.0, 0.0, 29.5], atol=0.11)
    assert graphs.front_type[e, 0] == Front.STOP
    # left: nobody ahead of it before the conflict.
    np.testing.assert_allclose(now[1], [0.0, 0.0, 0.0, 27.5, 8.0, 0.0, 27.5], atol=0.11)
    assert graphs.front_type[e, 1] == Front.CONFLICT
    # behind_left: the rear bumper of left, 32.5 m before the conflict.
    np.testing.assert_allclose(now[2], [32.5, 8.0, 0.0, 39.5, 8.0, 0.0, 7.0], atol=0.11)
    assert graphs.front_type[e, 2] == Front.VEHICLE
    assert graphs.ids[graphs.front[e, 2]] == "left"
    # One second ago everybody was as far back as it drives in a second.
    then = graphs.x[e, :, 0]
    np.testing.assert_allclose(then[0, 3] - now[0, 3], 10.0, atol=0.05)
    np.testing.assert_allclose(then[2, [0, 3]] - now[2, [0, 3]], 8.0, atol=0.05)


def test_without_a_conflict_there_is_one_node_to_fifty_metres_ahead() -> None:
    graphs = graphs_of(CROSSING_TRAFFIC)
    e = row(graphs, "gone")
    assert graphs.node_mask[e].sum() == 1
    assert graphs.front_type[e, 0] == Front.FREE
    np.testing.assert_allclose(graphs.x[e, 0, -1], [0, 0, 0, 47.5, 8.0, 0, 47.5], atol=0.11)


def test_a_leader_is_the_front_without_a_conflict_as_well() -> None:
    graphs = graphs_of({"a": (30.0, 0.0, 0.0, 9.0), "b": (50.0, 0.2, 0.0, 7.0)})
    e = row(graphs, "a")
    assert graphs.front_type[e, 0] == Front.VEHICLE
    # Centres 20 m apart: the front is at 50 - (20 - 2.5) m, the rear at 50 - 2.5 m.
    np.testing.assert_allclose(graphs.x[e, 0, -1], [32.5, 7.0, 0, 47.5, 9.0, 0, 15.0], atol=0.05)


def test_newcomers_hold_their_first_value_and_are_masked() -> None:
    road = Road(crossing_lanes())
    graphs = build_graphs(road, drive(road, CROSSING_TRAFFIC, frames=4).seen)
    e = row(graphs, "ego")
    assert graphs.history_mask[e, 0].tolist() == [False] * 7 + [True] * 4
    np.testing.assert_array_equal(graphs.x[e, 0, :7], np.repeat(graphs.x[e, 0, 7:8], 7, axis=0))
    assert not graphs.history_mask[e, 3:].any()
    assert not graphs.x[e, 3:].any()


def test_a_signal_counts_only_while_it_is_closed() -> None:
    from conftest import lane

    from hatn_sim.datatypes import Gate

    lanes = [one for one in crossing_lanes() if one.id != "w"]
    lanes.append(
        lane("w", [(-108, 0), (-8, 0)], "we", "wn", gate=Gate.SIGNAL, signals={"we": 0, "wn": 1})
    )
    for closed, expected in ((True, Front.STOP), (False, Front.CONFLICT)):
        road = Road(lanes)
        state = begin(road)
        for frame in range(HISTORY_FRAMES):
            x = -50.0 + frame
            scene = scene_of(0.1 * frame, {"e": (x, 0, 0, 10), "s": (0, -60.0 + x + 50, NORTH, 10)})
            scene = Scene(**{**scene.__dict__, "signal_closed": np.array([closed, not closed])})
            state = perceive(state, scene, None)
        graphs = build_graphs(road, state.seen)
        assert graphs.front_type[row(graphs, "e"), 0] == expected
        assert graphs.ego_at_red[row(graphs, "e")] == closed
        assert not graphs.ego_at_red[row(graphs, "s")]


def test_a_recording_may_know_nothing_of_the_signals_of_its_map() -> None:
    lanes = [
        replace(one, gate=Gate.SIGNAL, signals={"we": 46, "wn": 3}) if one.id == "w" else one
        for one in crossing_lanes()
    ]
    road = Road(lanes)
    vehicles = {"a": (-30.0, 0.0, 0.0, 8.0), "b": (0.0, -30.0, np.pi / 2, 8.0)}
    state = perceive(begin(road), scene_of(0.0, vehicles), None)
    graphs = build_graphs(road, state.seen)
    assert graphs.has_conflict.any() and not graphs.ego_at_red.any()


def test_context_has_a_name_for_every_entry() -> None:
    graphs = graphs_of(CROSSING_TRAFFIC)
    assert graphs.context.shape[-1] == len(CONTEXT)
    e = row(graphs, "ego")
    by_name = dict(zip(CONTEXT, graphs.context[e, 2], strict=True))
    assert by_name["speed_limit_mps at 0 m"] == 13.9
    assert by_name["length_m of the rear vehicle"] == 5.0
    assert by_name["speed_mps of the leader of the rear vehicle"] == 8.0
    np.testing.assert_allclose(
        by_name["distance_m of the rear vehicle to its leader, up to FREE_M"], 7.0
    )
    assert by_name["gate ahead of the ego before the conflict"] == 1.0
    assert by_name["gate ahead of the rear vehicle before the conflict"] == 0.0
    queued = graphs.context[e, :3, CONTEXT.index("front is a vehicle of the focus group")]
    assert queued.tolist() == [0.0, 0.0, 1.0]


@given(
    angle=st.floats(-3.1, 3.1),
    shift=st.tuples(st.floats(-1000, 1000), st.floats(-1000, 1000)),
    order=st.permutations(list(CROSSING_TRAFFIC)),
)
def test_the_graph_does_not_see_rotation_translation_or_order(
    angle: float, shift: tuple[float, float], order: list[str]
) -> None:
    plain = graphs_of(CROSSING_TRAFFIC)
    cos, sin = np.cos(angle), np.sin(angle)
    moved = {
        name: (
            cos * x - sin * y + shift[0],
            sin * x + cos * y + shift[1],
            float(np.arctan2(np.sin(yaw + angle), np.cos(yaw + angle))),
            v,
        )
        for name in order
        for x, y, yaw, v in [CROSSING_TRAFFIC[name]]
    }
    road = Road(crossing_lanes(angle, shift))
    turned = build_graphs(road, drive(road, moved).seen)
    for name in CROSSING_TRAFFIC:
        a, b = row(plain, name), row(turned, name)
        assert [plain.ids[k] for k in plain.rear[a][plain.node_mask[a]]] == [
            turned.ids[k] for k in turned.rear[b][turned.node_mask[b]]
        ]
        # Lines are sampled anew after the turn; conflicts are found to 0.1 m.
        np.testing.assert_allclose(turned.x[b], plain.x[a], atol=0.11)
        np.testing.assert_allclose(turned.context[b], plain.context[a], atol=0.02)
        np.testing.assert_array_equal(turned.focus_mask[b], plain.focus_mask[a])


def test_a_vehicle_far_away_changes_nothing() -> None:
    road = Road(crossing_lanes())
    more = {**CROSSING_TRAFFIC, "away": (150.0, 0.0, 0.0, 10.0)}
    plain, padded = graphs_of(CROSSING_TRAFFIC), build_graphs(road, drive(road, more).seen)
    for name in CROSSING_TRAFFIC:
        np.testing.assert_array_equal(padded.x[row(padded, name)], plain.x[row(plain, name)])


def test_pedestrians_and_vehicles_off_the_road_have_no_graph() -> None:
    road = Road(crossing_lanes())
    vehicles = {
        "off": (60.0, 60.0, 0.0, 5.0),
        "on": (30.0, 0.0, 0.0, 5.0),
        "walker": (50.0, 0.0, 0.0, 1.0),
    }
    state = begin(road)
    for frame in range(3):
        scene = scene_of(0.1 * frame, vehicles)
        kind = np.array([Kind.CAR, Kind.CAR, Kind.PEDESTRIAN], dtype=np.int64)
        state = perceive(state, Scene(**{**scene.__dict__, "kind": kind}), None)
    graphs = build_graphs(road, state.seen)
    assert [graphs.ids[k] for k in graphs.ego] == ["on"]


def test_a_road_may_be_empty_for_a_while() -> None:
    road = Road(crossing_lanes())
    state = drive(road, CROSSING_TRAFFIC)
    for time_s in (2.0, 2.1):
        state = perceive(state, scene_of(time_s, {}), None)
        assert len(build_graphs(road, state.seen).ego) == 0
    state = perceive(state, scene_of(2.2, {"new": (-40.0, 0.0, 0.0, 10.0)}), None)
    assert len(build_graphs(road, state.seen).ego) == 1


def test_nodes_of_one_rear_vehicle_and_conflict_have_one_history() -> None:
    """Two egos in a row on one line meet the same vehicles at the same place."""
    graphs = graphs_of(CROSSING_TRAFFIC | {"ahead": (-20.0, 0.0, 0.0, 10.0)})
    mask = graphs.node_mask
    repeats = repeats_of(graphs)
    assert len(repeats.first) < len(repeats.history) == mask.sum()
    same = repeats.first.numpy()[repeats.history.numpy()]
    np.testing.assert_array_equal(graphs.x[mask][same], graphs.x[mask])
    np.testing.assert_array_equal(graphs.history_mask[mask][same], graphs.history_mask[mask])
