"""Geometry, lines and conflicts against answers by hand."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from conftest import crossing_lanes, lane
from hypothesis import given
from hypothesis import strategies as st

from hatn_sim.datatypes import ConflictType, FloatArray, Kind
from hatn_sim.geometry import resample, tangent_rad, wrap_angle
from hatn_sim.lane_graph import MAX_BRANCHES
from hatn_sim.road import LINE_STEP_M, Road

WEST_EAST = ("w", "we", "e")
SOUTH_NORTH = ("s", "sn", "n")
WEST_NORTH = ("w", "wn", "n")


def test_resampling_keeps_arc_length_and_draws_the_last_step_out() -> None:
    xy = resample(np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 4.0], [3.0, 6.2]]), 0.5)
    assert len(xy) == 16  # 7.2 m: 15 steps, the last one to 7.5 m
    np.testing.assert_allclose(xy[10], [3.0, 4.0])
    np.testing.assert_allclose(xy[-1], [3.0, 6.5])
    np.testing.assert_allclose(tangent_rad(xy)[[2, -1]], [np.arctan2(4, 3), np.pi / 2])


@pytest.mark.parametrize(
    ("angle", "expected"), [(0.0, 0.0), (np.pi, -np.pi), (3 * np.pi, -np.pi), (-4.0, 2.2831853)]
)
def test_angles_are_wrapped(angle: float, expected: float) -> None:
    np.testing.assert_allclose(wrap_angle(np.array(angle)), expected)


def test_a_crossing_by_hand(crossing: Road) -> None:
    (found,) = crossing.conflicts(crossing.line(WEST_EAST), crossing.line(SOUTH_NORTH))
    assert found.type is ConflictType.CROSS
    # Both lines reach the origin after 108 m; they are within 1.8 m for 1.8 m to either side.
    np.testing.assert_allclose(found.point_s_m, (108.0, 108.0), atol=0.11)
    np.testing.assert_allclose(found.entry_s_m, (106.2, 106.2), atol=0.11)
    np.testing.assert_allclose(found.exit_s_m, (109.8, 109.8), atol=0.11)


def test_a_merge_by_hand(crossing: Road) -> None:
    (found,) = crossing.conflicts(crossing.line(WEST_NORTH), crossing.line(SOUTH_NORTH))
    assert found.type is ConflictType.MERGE
    # On the arc x = -8 + 8 sin t: 1.8 m west of the line north where sin t = 6.2 / 8.
    t = np.arcsin(6.2 / 8.0)
    np.testing.assert_allclose(found.entry_s_m[0], 100.0 + 8.0 * t, atol=0.15)
    # The arc's nearest point to (0, y): within 1.8 m of the circle of radius 8 round (-8, 8).
    y = 8.0 - np.sqrt(9.8**2 - 8.0**2)
    np.testing.assert_allclose(found.entry_s_m[1], 108.0 + y, atol=0.15)
    assert found.point_s_m == found.entry_s_m
    assert found.exit_s_m[1] > 250.0  # together to the end


def test_diverging_is_no_conflict(crossing: Road) -> None:
    assert crossing.conflicts(crossing.line(WEST_EAST), crossing.line(WEST_NORTH)) == ()


def test_opposite_directions_and_neighbours_are_no_conflict() -> None:
    road = Road(
        [
            lane("east", [(0, 0), (100, 0)]),
            lane("west", [(100, 1.0), (0, 1.0)]),
            lane("beside", [(0, 3.2), (100, 3.2)]),
            lane("near", [(0, -1.5), (100, -1.5)]),
        ]
    )
    east = road.line(("east",))
    for other in ("west", "beside", "near"):
        assert road.conflicts(east, road.line((other,))) == (), other


def test_two_lines_may_conflict_twice() -> None:
    t = np.linspace(0.0, 2.5 * np.pi, 300)
    wave = list(zip(20.0 * t, 8.0 * np.sin(t), strict=True))
    road = Road([lane("straight", [(-10, 0), (170, 0)]), lane("wave", wave)])
    found = road.conflicts(road.line(("straight",)), road.line(("wave",)))
    # The wave begins within the straight line's corridor, heading 22 degrees off: they diverge.
    assert [round(c.point_s_m[0]) for c in found] == [
        10 + round(20 * np.pi),
        10 + round(40 * np.pi),
    ]


def test_one_lane_in_two_directions_is_a_conflict_over_all_of_it() -> None:
    """Two roads share the strip from x = 0 to 60 m, one eastwards and one westwards."""
    road = Road(
        [
            lane("east", [(-40, -30), (0, 0), (60, 0), (100, -30)]),
            lane("west", [(100, 30), (60, 0), (0, 0), (-40, 30)]),
        ]
    )
    (found,) = road.conflicts(road.line(("east",)), road.line(("west",)))
    assert found.type is ConflictType.CROSS
    # 50 m on the ramps, which part at atan(3/4) to either side: 1.8 m apart after 1.5 m.
    np.testing.assert_allclose(found.entry_s_m, (48.5, 48.5), atol=1.6)
    np.testing.assert_allclose(found.exit_s_m, (111.5, 111.5), atol=1.6)
    np.testing.assert_allclose(found.point_s_m, (80.0, 80.0), atol=0.6)


def test_lines_against_each_other_that_change_sides_cross() -> None:
    turn = np.deg2rad(160.0)
    other = [(-80 * np.cos(turn), -80 * np.sin(turn)), (80 * np.cos(turn), 80 * np.sin(turn))]
    road = Road([lane("east", [(-80, 0), (80, 0)]), lane("other", other)])
    (found,) = road.conflicts(road.line(("east",)), road.line(("other",)))
    assert found.type is ConflictType.CROSS
    np.testing.assert_allclose(found.point_s_m, (80.0, 80.0), atol=0.6)
    # Points of one line are within 1.8 m of the other up to 1.8 m / sin 20 degrees.
    np.testing.assert_allclose(found.entry_s_m, np.full(2, 80.0 - 1.8 / np.sin(turn)), atol=0.15)


def test_lanes_that_part_and_meet_again_conflict_where_they_meet() -> None:
    """Round an island between x = 30 and 90 m; together before and after."""
    road = Road(
        [
            lane("north", [(0, 0), (30, 0), (40, 5), (80, 5), (90, 0), (150, 0)]),
            lane("south", [(0, 0), (30, 0), (40, -5), (80, -5), (90, 0), (150, 0)]),
        ]
    )
    (found,) = road.conflicts(road.line(("north",)), road.line(("south",)))
    assert found.type is ConflictType.MERGE
    # A point h beside the middle is 2 h cos(a) from the other line, with tan(a) = 1/2, and comes
    # to the middle after h / sin(a).
    a = np.arctan(0.5)
    meet_s_m = 30.0 + 40.0 + 2.0 * np.hypot(10.0, 5.0)
    expected = meet_s_m - 0.9 / (np.cos(a) * np.sin(a))
    np.testing.assert_allclose(found.entry_s_m, (expected, expected), atol=0.15)


def test_lines_that_start_side_by_side_may_still_cross() -> None:
    """A turn to the right across a narrow lane beside it."""
    road = Road(
        [
            lane("straight", [(0, 0), (80, 0)]),
            lane("turn", [(0, 1.5), (40, 1.5), (45, 0), (50, -8), (50, -40)]),
        ]
    )
    (found,) = road.conflicts(road.line(("straight",)), road.line(("turn",)))
    assert found.type is ConflictType.CROSS
    np.testing.assert_allclose(found.point_s_m[0], 45.0, atol=0.3)


@pytest.mark.parametrize("phase_m", [0.0, 0.2, 0.5])
def test_a_short_shared_lane_is_a_merge_wherever_the_vertices_fall(phase_m: float) -> None:
    road = Road(
        [
            lane("straight", [(phase_m, 0), (100, 0)]),
            lane("through", [(20, -20), (40, 0), (46, 0), (66, 20)]),
        ]
    )
    (found,) = road.conflicts(road.line(("straight",)), road.line(("through",)))
    assert found.type is ConflictType.MERGE
    # At 45 degrees 1.8 m away after 1.8 m of the other line, 1.8 m * sqrt 2 of this one.
    np.testing.assert_allclose(found.entry_s_m[1], np.hypot(20, 20) - 1.8 * 2**0.5, atol=0.15)
    np.testing.assert_allclose(found.entry_s_m[0], 40.0 - phase_m - 1.8, atol=0.9)


def test_a_u_turn_merges_with_oncoming_traffic() -> None:
    t = np.linspace(0.0, np.pi, 60)
    arc = list(zip(3.0 * np.sin(t), -3.0 * np.cos(t), strict=True))
    road = Road(
        [
            lane("u", [(-50, -3), *arc, (-60, 3)]),
            lane("oncoming", [(60, 3), (-60, 3)]),
        ]
    )
    (found,) = road.conflicts(road.line(("u",)), road.line(("oncoming",)))
    assert found.type is ConflictType.MERGE
    # The arc is 3 m + 3 m cos t below y = 3: within 1.8 m from cos t = -0.4 on.
    np.testing.assert_allclose(found.entry_s_m[0], 50.0 + 3.0 * np.arccos(-0.4), atol=0.15)


def test_roads_that_meet_at_no_junction_pass_over_each_other() -> None:
    over = [lane("over", [(-80, -40), (80, -40)])]
    road = Road([*crossing_lanes(), *over])
    assert road.conflicts(road.line(("over",)), road.line(SOUTH_NORTH)) == ()
    assert len(road.conflicts(road.line(WEST_EAST), road.line(SOUTH_NORTH))) == 1
    # Nor does a bridge over the junction itself meet those below, but a road into it does.
    bridge = lane("bridge", [(-80, -60), (80, 60)])
    road = Road([*crossing_lanes(), bridge])
    assert road.conflicts(road.line(("bridge",)), road.line(SOUTH_NORTH)) == ()
    below = [lane("a", [(-80, -60), (-8, -6)], "b"), lane("c", [(8, 6), (80, 60)])]
    within = lane("b", [(-8, -6), (8, 6)], "c", is_connection=True)
    road = Road([*crossing_lanes(), *below, within])
    assert len(road.conflicts(road.line(("a", "b", "c")), road.line(SOUTH_NORTH))) == 1
    # A road that knows no junctions has only its geometry to go by.
    road = Road([lane("s", [(0, -108), (0, -8)]), *over])
    assert len(road.conflicts(road.line(("over",)), road.line(("s",)))) == 1


def test_the_table_of_a_pair_is_the_same_from_both_sides(crossing: Road) -> None:
    lines = np.array([crossing.line(r) for r in (WEST_NORTH, SOUTH_NORTH, WEST_EAST)])
    first, second = np.array([0, 1, 0, 0, 2]), np.array([1, 0, 2, 0, 1])
    found = crossing.conflict_table.of_pairs(lines[first], lines[second])
    # A merge both ways round, nothing where they diverge or are one, a crossing.
    assert found.pair.tolist() == [0, 1, 4]
    assert found.type.tolist() == [ConflictType.MERGE, ConflictType.MERGE, ConflictType.CROSS]
    for sides in (found.entry_s_m, found.point_s_m, found.exit_s_m):
        np.testing.assert_array_equal(sides[0], sides[1, ::-1])
    (alone,) = crossing.conflicts(int(lines[2]), int(lines[1]))
    np.testing.assert_array_equal(found.point_s_m[2], alone.point_s_m)
    np.testing.assert_array_equal(found.entry_s_m[2], alone.entry_s_m)
    np.testing.assert_array_equal(found.exit_s_m[2], alone.exit_s_m)


def test_all_conflicts_are_found_at_once_where_lines_are_few(
    crossing: Road, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = np.array([crossing.line(r) for r in (WEST_NORTH, SOUTH_NORTH, WEST_EAST)])
    pairs = np.repeat(lines, 3), np.tile(lines, 3)
    one_by_one = Road(crossing_lanes())
    for route in (WEST_NORTH, SOUTH_NORTH, WEST_EAST):
        one_by_one.line(route)
    expected = one_by_one.conflict_table.of_pairs(*pairs)
    crossing.find_all_conflicts(most_lines=2)
    assert len(crossing.conflict_table) == 0
    crossing.find_all_conflicts(most_lines=3)
    monkeypatch.setattr("hatn_sim.road.find_conflicts", None)  # it is not asked again
    found = crossing.conflict_table.of_pairs(*pairs)
    np.testing.assert_array_equal(found.pair, expected.pair)
    np.testing.assert_array_equal(found.rows, expected.rows)
    # Lines that were let go are not asked about.
    for _ in range(3):
        crossing.touch(lines[:1])
    crossing.release(idle_frames=2)
    crossing.find_all_conflicts(most_lines=3)


def vertices(road: Road, line: int) -> FloatArray:
    """[P, 2]"""
    return road.xy_m[road.offset[line] : road.offset[line] + road.count[line]].copy()


def test_lines_not_in_use_are_let_go_and_their_numbers_used_again(crossing: Road) -> None:
    kept, gone = crossing.line(WEST_NORTH), crossing.line(SOUTH_NORTH)
    pair = np.array([kept]), np.array([gone])
    before = crossing.conflict_table.of_pairs(*pair).point_s_m
    xy_m, count = vertices(crossing, kept), len(crossing.conflict_table)
    for _ in range(4):
        crossing.touch(np.array([[kept, -1]]))
    crossing.release(idle_frames=4)
    assert crossing.line(SOUTH_NORTH) == gone and len(crossing.conflict_table) == count
    for _ in range(5):
        crossing.touch(np.array([[kept, -1]]))
    crossing.release(idle_frames=4)
    assert len(crossing.conflict_table) == 0
    other = crossing.line(WEST_EAST)
    assert other == gone and crossing.lines[gone].route == WEST_EAST
    fresh = Road(crossing.lanes.values())
    alone = fresh.line(WEST_EAST)
    np.testing.assert_array_equal(vertices(crossing, other), vertices(fresh, alone))
    for name in ("gate_s_m", "fork_s_m", "fork_turn"):
        np.testing.assert_array_equal(getattr(crossing, name)[other], getattr(fresh, name)[alone])
    np.testing.assert_array_equal(vertices(crossing, kept), xy_m)
    again = crossing.line(SOUTH_NORTH)
    assert again not in (kept, other)
    found = crossing.conflict_table.of_pairs(np.array([kept]), np.array([again]))
    np.testing.assert_array_equal(found.point_s_m, before)
    # West to east diverges from west to north: nothing is left over from the pair before.
    assert not len(crossing.conflict_table.of_pairs(*pair).pair)


@given(
    s=st.floats(1.0, 250.0),
    d=st.floats(-3.0, 3.0),
    angle=st.floats(-3.0, 3.0),
    shift=st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
)
def test_frenet_and_back(s: float, d: float, angle: float, shift: tuple[float, float]) -> None:
    road = Road(crossing_lanes(angle, shift))
    line = np.array([road.line(WEST_NORTH)])
    there = road.locate(line, np.array([s]), np.array([d]))
    back_s, back_d = road.project(line, there, np.array([s]), 3.0)
    # At 0.5 m a vertex the arc of 8 m radius has corners of 3.6 degrees.
    np.testing.assert_allclose([back_s[0], back_d[0]], [s, d], atol=0.12)
    found_s, _ = road.search(line, there, np.zeros(1), 270.0)
    np.testing.assert_allclose(found_s, back_s, atol=0.02)
    for off_m in (-0.8, 0.8):
        tracked_s, tracked_d = road.track(line, there, np.array([s + off_m]))
        np.testing.assert_allclose([tracked_s[0], tracked_d[0]], [s, d], atol=0.15)


def test_projection_agrees_with_shapely(crossing: Road) -> None:
    index = crossing.line(WEST_NORTH)
    curve = shapely.LineString(vertices(crossing, index))
    random = np.random.default_rng(3)
    xy = np.column_stack((random.uniform(-60, 4, 200), random.uniform(-4, 60, 200)))
    line = np.full(200, index)
    s, d = crossing.search(line, xy, np.zeros(200), 270.0)
    distance = shapely.distance(curve, shapely.points(xy))
    near = distance < 3.5
    assert near.sum() > 20
    np.testing.assert_allclose(np.abs(d[near]), distance[near], atol=1e-6)
    expected_s = shapely.line_locate_point(curve, shapely.points(xy))
    length = shapely.length(curve)
    scale = (crossing.count[index] - 1) * LINE_STEP_M / length  # chords are shorter than arcs
    np.testing.assert_allclose(s[near], expected_s[near] * scale, atol=0.15)


def test_branches_follow_every_connection_a_kind_may_use() -> None:
    lanes = crossing_lanes()
    only_trams = frozenset({Kind.TRAM})
    lanes = [
        one if one.id != "wn" else type(one)(**{**one.__dict__, "kinds": only_trams})
        for one in lanes
    ]
    road = Road(lanes)
    routes = {road.lines[k].route for k in road.branches(("w",), Kind.CAR)}
    assert routes == {WEST_EAST}
    routes = {road.lines[k].route for k in road.branches(("w",), Kind.TRAM)}
    assert routes == {WEST_EAST, WEST_NORTH}


def test_no_way_on_is_left_out_of_a_fork_with_many() -> None:
    exits = [f"x{k}" for k in range(MAX_BRANCHES + 4)]
    lanes = [lane("in", [(-50, 0), (0, 0)], *exits)]
    lanes += [lane(name, [(0, 0), (40, k)]) for k, name in enumerate(exits)]
    road = Road(lanes)
    routes = {road.lines[k].route for k in road.branches(("in",), Kind.CAR)}
    assert routes == {("in", name) for name in exits}


def test_gates_and_forks_lie_where_the_lanes_end(crossing: Road) -> None:
    index = crossing.line(WEST_NORTH)
    np.testing.assert_allclose(crossing.gate_s_m[index, 0], 100.0)
    np.testing.assert_allclose(crossing.fork_s_m[index, 0], 100.0)
    np.testing.assert_allclose(crossing.fork_end_s_m[index, 0], 100.0 + 4.0 * np.pi, atol=0.01)
    assert crossing.fork_turn[index, 0] == 1
    assert np.isinf(crossing.gate_s_m[index, 1:]).all()


def test_curvature_is_that_of_the_arc(crossing: Road) -> None:
    index = crossing.line(WEST_NORTH)
    middle = int((100.0 + 2.0 * np.pi) / LINE_STEP_M)
    middle += crossing.offset[index]
    np.testing.assert_allclose(crossing.curvature_per_m[middle], 1.0 / 8.0, rtol=0.03)
    assert abs(crossing.curvature_per_m[crossing.offset[index] + 100]) < 1e-9
