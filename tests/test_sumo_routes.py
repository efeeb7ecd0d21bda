"""Chains of lanes on a net drawn by hand, with a stand-in for SUMO.

Two lanes a_0, a_1 lead straight on to b_0, b_1; from there b_0 leads to d_0 only, b_1 to c_0 only:

    a_0 - :j_0_0 - b_0 - :k_0_0 - d_0
    a_1 - :j_0_1 - b_1 - :k_1_0 - c_0
"""

from __future__ import annotations

import numpy as np
import pytest

from hatn_sim.datatypes import Gate, Kind
from hatn_sim.simulators.sumo_lanes import LaneTable, Link, gate_of, kinds_of, lanes_of
from hatn_sim.simulators.sumo_routes import (
    LaneGraph,
    RouteTracker,
    behind,
    plan_ahead,
    plan_beside,
)

STRAIGHT = {"a_0": ":j_0_0", ":j_0_0": "b_0", "b_0": ":k_0_0", ":k_0_0": "d_0"}
LEFT = {"a_1": ":j_0_1", ":j_0_1": "b_1", "b_1": ":k_1_0", ":k_1_0": "c_0"}


def table(a_m: float = 50.0, b_m: float = 40.0) -> LaneTable:
    onward = {**STRAIGHT, **LEFT, "c_0": None, "d_0": None}
    lengths = {"a": a_m, "b": b_m, "c": 300.0, "d": 300.0}
    return LaneTable(
        ids=tuple(onward),
        point_counts=(2,) * len(onward),
        xy_m=np.arange(4.0 * len(onward)).reshape(-1, 2),
        length_m=tuple(lengths.get(lane[0], 10.0) for lane in onward),
        width_m=(3.2,) * len(onward),
        speed_limit_mps=(10.0,) * len(onward),
        kinds=(frozenset(Kind),) * len(onward),
        links=tuple(
            () if after is None else (Link(after, "M", "l" if lane == "b_1" else "s", None),)
            for lane, after in onward.items()
        ),
    )


def test_ahead_along_the_route_to_its_end_or_for_150_m() -> None:
    graph = LaneGraph(table())
    assert plan_ahead(graph, "a_0", ["b", "d"], ()) == (
        ("a_0", ":j_0_0", "b_0", ":k_0_0", "d_0"),
        True,
    )
    long = LaneGraph(table(b_m=150.0))
    assert plan_ahead(long, "a_0", ["b", "d"], ()) == (("a_0", ":j_0_0", "b_0"), True)
    assert plan_ahead(graph, ":k_1_0", ["c"], ()) == ((":k_1_0", "c_0"), True)


def test_ahead_stops_where_lanes_have_to_be_changed() -> None:
    graph = LaneGraph(table())
    assert plan_ahead(graph, "a_0", ["b", "c"], ()) == (("a_0", ":j_0_0", "b_0"), False)
    assert plan_beside(graph, "a_0", ["b", "c"], ()) == (("a_1", ":j_0_1", "b_1", ":k_1_0", "c_0"))
    assert plan_beside(graph, ":j_0_0", ["b", "c"], ()) is None


def test_behind_follows_what_was_driven_and_goes_over_to_lanes_beside() -> None:
    graph = LaneGraph(table())
    driven = ("a_0", ":j_0_0", "b_0")
    assert behind(graph, "b_0", driven) == ("a_0", ":j_0_0")
    assert behind(graph, "b_1", driven) == ("a_1", ":j_0_1")
    assert behind(graph, "c_0", driven) == ("a_1", ":j_0_1", "b_1", ":k_1_0")
    assert behind(graph, "b_1", ()) == ()
    # 60 m are enough: b (80) alone suffices.
    assert behind(LaneGraph(table(b_m=80.0)), "d_0", driven) == ("b_0", ":k_0_0")


class Sumo:
    """Says what a simulator would say of one vehicle, and counts how often it is asked."""

    def __init__(self, *edges: str) -> None:
        self.edges = list(edges)
        self.gap_m = 300.0
        self.asked = 0

    def edges_and_lanes(self, vehicle: str) -> tuple[list[str], set[str]]:
        self.asked += 1
        return self.edges, set()

    def gap_to_lane_end_m(self, vehicle: str) -> float:
        return self.gap_m


def test_tracker_asks_once_for_a_journey_without_surprises() -> None:
    sumo = Sumo("b", "d")
    tracker = RouteTracker(LaneGraph(table()), sumo.edges_and_lanes, sumo.gap_to_lane_end_m)
    lanes = ["a_0", "a_0", ":j_0_0", "b_0", "d_0"]  # too fast to be seen on :k_0_0
    assert {tracker.index("v", lane, "r") for lane in lanes} == {0}
    assert sumo.asked == 1
    assert tracker.index("v", "", "r") == -1


def test_tracker_plans_anew_after_a_lane_change_and_a_new_route() -> None:
    sumo = Sumo("b", "d")
    tracker = RouteTracker(LaneGraph(table()), sumo.edges_and_lanes, sumo.gap_to_lane_end_m)
    tracker.index("v", "a_0", "r")
    tracker.index("v", "b_0", "r")
    sumo.edges = ["c"]
    changed = tracker.index("v", "b_1", "other route")
    assert tracker.routes[changed] == ("a_1", ":j_0_1", "b_1", ":k_1_0", "c_0")
    tracker.forget("v")
    assert tracker.routes[tracker.index("v", "b_1", "r")] == ("b_1", ":k_1_0", "c_0")


def test_tracker_goes_over_to_the_lane_beside_within_100_m_of_the_end() -> None:
    sumo = Sumo("c")
    tracker = RouteTracker(LaneGraph(table(b_m=400.0)), sumo.edges_and_lanes, lambda _: sumo.gap_m)
    assert tracker.routes[tracker.index("v", "b_0", "r")] == ("b_0",)
    sumo.gap_m = 100.5
    assert tracker.routes[tracker.index("v", "b_0", "r")] == ("b_0",)
    sumo.gap_m = 99.5
    assert tracker.routes[tracker.index("v", "b_0", "r")] == ("b_1", ":k_1_0", "c_0")
    asked = sumo.asked
    assert tracker.routes[tracker.index("v", "b_1", "r")] == ("b_1", ":k_1_0", "c_0")
    assert sumo.asked == asked


def test_lanes_of_the_table() -> None:
    lanes = {lane.id: lane for lane in lanes_of(table())}
    assert lanes[":k_1_0"].turn == 1 and lanes[":k_0_0"].turn == 0
    assert lanes["a_0"].successors == (":j_0_0",) and lanes["c_0"].successors == ()
    assert lanes["a_0"].xy_m.tolist() == [[0.0, 1.0], [2.0, 3.0]]
    assert lanes["a_1"].xy_m.tolist() == [[16.0, 17.0], [18.0, 19.0]]


@pytest.mark.parametrize(
    ("states", "gate"),
    [
        ("", Gate.NONE),
        ("M", Gate.NONE),
        ("=", Gate.NONE),
        ("Mm", Gate.NONE),
        ("mm", Gate.GIVE_WAY_LINE),
        ("s", Gate.STOP_LINE),
        ("ww", Gate.STOP_LINE),
    ],
)
def test_gates_of_link_states(states: str, gate: Gate) -> None:
    assert gate_of([Link("x_0", state, "s", None) for state in states]) == gate
    assert states == "" or gate_of([Link("x_0", states[0], "s", 3)]) == Gate.SIGNAL


def test_kinds_of_classes() -> None:
    assert kinds_of(["passenger", "truck", "tram", "ship"]) == {
        Kind.CAR,
        Kind.LORRY,
        Kind.TRAM,
        Kind.OTHER,
    }
    assert kinds_of(["pedestrian", "wheelchair"]) == {Kind.PEDESTRIAN}
    assert kinds_of(["bus", "wheelchair"]) == {Kind.BUS}
