"""Pairs and measures of risk: nothing, a finite value by hand, infinity; and SUMO's SSM device."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import crossing_lanes, scene_of

from hatn_sim.assist.pairs import FOLLOW, Pairs, pairs_of
from hatn_sim.assist.risk import (
    arrival_s,
    deceleration_to_avoid_mps2,
    required_deceleration_mps2,
    time_headway_s,
    time_to_collision_s,
    times_at_speed,
    times_predicted,
)
from hatn_sim.datatypes import ConflictType, FloatArray
from hatn_sim.perception import begin, perceive
from hatn_sim.road import Road

NORTH = np.pi / 2
Vehicles = dict[str, tuple[float, float, float, float]]


def pairs_at(vehicles: Vehicles, angle_rad: float = 0.0) -> tuple[Pairs, FloatArray]:
    """Pairs of cars of 5 m x 2 m at the hand-drawn crossing, and their speeds."""
    state = begin(Road(crossing_lanes(angle_rad)))
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turned = {
        name: (x * cos - y * sin, x * sin + y * cos, yaw + angle_rad, speed)
        for name, (x, y, yaw, speed) in vehicles.items()
    }
    for frame in range(3):
        state = perceive(state, scene_of(0.1 * frame, turned), None)
    seen = state.seen
    found = pairs_of(state.road, seen.scene, seen.lines, seen.leader, seen.leader_s_m)
    return found, seen.scene.speed_mps


def crossing(east_m: float, east_mps: float, north_m: float, north_mps: float) -> Vehicles:
    return {"a": (east_m, 0.0, 0.0, east_mps), "b": (0.0, north_m, NORTH, north_mps)}


@pytest.mark.parametrize("angle_rad", [0.0, 1.0])
def test_the_area_of_a_right_angled_crossing(angle_rad: float) -> None:
    pairs, speed = pairs_at(crossing(-40.0, 10.0, -20.0, 8.0), angle_rad)
    assert pairs.index.tolist() == [[0, 1]]
    assert pairs.type.tolist() == [ConflictType.CROSS]
    np.testing.assert_allclose(pairs.angle_rad, NORTH, atol=1e-6)
    # Half a length and half the other's width: 2.5 m + 1 m to either side of the point.
    np.testing.assert_allclose(pairs.room_m, [[36.5, 16.5]], atol=0.15)
    np.testing.assert_allclose(pairs.clear_m, [[43.5, 23.5]], atol=0.15)
    times = times_at_speed(pairs, speed)
    np.testing.assert_allclose(times.enter_s, [[3.65, 16.5 / 8]], atol=0.02)
    np.testing.assert_allclose(times.leave_s, [[4.35, 23.5 / 8]], atol=0.02)
    np.testing.assert_allclose(times.encroachment_s(), 3.65 - 23.5 / 8, atol=0.04)
    assert time_to_collision_s(pairs, speed).tolist() == [np.inf]  # they miss each other
    assert time_headway_s(pairs, speed).tolist() == [np.inf]  # nobody follows


def test_a_vehicle_that_is_out_of_the_area_is_in_no_pair() -> None:
    pairs, _ = pairs_at(crossing(4.0, 10.0, -20.0, 8.0))
    assert not len(pairs.index)


def test_who_meets_at_a_crossing_does_so_when_the_second_comes() -> None:
    pairs, speed = pairs_at(crossing(-20.0, 10.0, -20.0, 9.0))
    np.testing.assert_allclose(time_to_collision_s(pairs, speed), [16.5 / 9], atol=0.02)
    leave = times_at_speed(pairs, speed).leave_s
    needed = deceleration_to_avoid_mps2(pairs, speed, leave)
    # The first has to come no earlier than the second leaves: 2 (v t - d) / t^2.
    t = 23.5 / 9
    np.testing.assert_allclose(needed[0, 0], 2.0 * (10.0 * t - 16.5) / t**2, rtol=0.02)


def test_who_stands_before_the_area_never_enters() -> None:
    pairs, speed = pairs_at(crossing(-20.0, 10.0, -20.0, 0.0))
    times = times_at_speed(pairs, speed)
    assert times.encroachment_s().tolist() == [np.inf]
    assert time_to_collision_s(pairs, speed).tolist() == [np.inf]
    assert deceleration_to_avoid_mps2(pairs, speed, times.leave_s)[0, 1] == 0.0


def row_of_two(gap_m: float, speed_mps: float, ahead_mps: float) -> tuple[Pairs, FloatArray]:
    pairs, speed = pairs_at(
        {"a": (-40.0 - gap_m - 5.0, 0.0, 0.0, speed_mps), "b": (-40.0, 0.0, 0.0, ahead_mps)}
    )
    assert pairs.type.tolist() == [FOLLOW]
    assert pairs.index.tolist() == [[1, 0]]
    return pairs, speed


def test_following_by_hand() -> None:
    pairs, speed = row_of_two(12.0, 10.0, 7.0)
    np.testing.assert_allclose(time_to_collision_s(pairs, speed), [4.0], atol=1e-6)
    np.testing.assert_allclose(time_headway_s(pairs, speed), [1.2], atol=1e-6)
    needed = deceleration_to_avoid_mps2(pairs, speed, np.zeros((1, 2)))
    np.testing.assert_allclose(needed, [[np.inf, 9.0 / 24.0]], atol=1e-6)


def test_following_without_closing_in() -> None:
    pairs, speed = row_of_two(12.0, 7.0, 7.0)
    assert time_to_collision_s(pairs, speed).tolist() == [np.inf]
    assert deceleration_to_avoid_mps2(pairs, speed, np.zeros((1, 2)))[0, 1] == 0.0
    pairs, speed = row_of_two(12.0, 0.0, 0.0)
    assert time_headway_s(pairs, speed).tolist() == [np.inf]


def merge(one_m: float, one_mps: float, other_m: float, other_mps: float) -> Pairs:
    """Two cars of 5 m before the entry of a merge."""
    to_point = np.array([[one_m, other_m]])
    return Pairs(
        index=np.array([[0, 1]]),
        type=np.array([ConflictType.MERGE]),
        room_m=to_point - 2.5,
        clear_m=to_point + 2.5,
        to_point_m=to_point,
        length_m=np.full((1, 2), 5.0),
        angle_rad=np.array([0.5]),
    )


def test_merging_by_hand() -> None:
    # The first is in after 0.5 s, out after 1.5 s; the second comes after 3.25 s, at 10 m/s. It
    # is 30 m behind now and closes 25 m at 5 m/s, which takes 5 s.
    pairs, speed = merge(5.0, 5.0, 35.0, 10.0), np.array([5.0, 10.0])
    np.testing.assert_allclose(times_at_speed(pairs, speed).encroachment_s(), [1.75])
    np.testing.assert_allclose(time_to_collision_s(pairs, speed), [5.0])
    needed = deceleration_to_avoid_mps2(pairs, speed, times_at_speed(pairs, speed).leave_s)
    np.testing.assert_allclose(needed[0, 1], 25.0 / 50.0)
    # As fast as the first, it never comes near.
    speed = np.array([10.0, 10.0])
    assert time_to_collision_s(pairs, speed).tolist() == [np.inf]
    # Side by side, they touch as the second enters.
    pairs, speed = merge(12.5, 10.0, 14.5, 10.0), np.array([10.0, 10.0])
    np.testing.assert_allclose(time_to_collision_s(pairs, speed), [1.2])


def test_the_order_of_a_pair_means_nothing() -> None:
    pairs, speed = merge(5.0, 5.0, 35.0, 10.0), np.array([5.0, 10.0])
    names = ("index", "room_m", "clear_m", "to_point_m", "length_m")
    other = replace(pairs, **{name: getattr(pairs, name)[:, ::-1] for name in names})
    np.testing.assert_array_equal(
        time_to_collision_s(pairs, speed), time_to_collision_s(other, speed)
    )
    leave = times_at_speed(pairs, speed).leave_s
    np.testing.assert_array_equal(
        deceleration_to_avoid_mps2(pairs, speed, leave)[:, ::-1],
        deceleration_to_avoid_mps2(other, speed, leave[:, ::-1]),
    )


def test_predicted_times_at_constant_speed_are_those_at_speed() -> None:
    pairs, speed = pairs_at(crossing(-20.0, 10.0, -30.0, 9.0))
    travelled = speed[:, None] * 0.1 * np.arange(1, 31)
    twice_as_fast = np.stack((travelled, 2.0 * travelled), axis=1)
    steady = times_at_speed(pairs, speed)
    found = times_predicted(pairs, twice_as_fast)
    np.testing.assert_allclose(found.enter_s, [steady.enter_s, 0.5 * steady.enter_s])
    # The first as slow as it is, the second twice as fast.
    np.testing.assert_allclose(found.mixed().leave_s[0, 1], steady.leave_s * np.array([1.0, 0.5]))


def test_arrival_is_linear_between_frames_and_beyond_them() -> None:
    travelled: FloatArray = np.array([np.arange(1, 31) * 1.0, np.zeros(30)], dtype=np.float64)
    vehicle = np.array([0, 0, 0, 1, 1])
    found = arrival_s(travelled, vehicle, np.array([2.5, 30.0, 45.0, -1.0, 5.0]))
    np.testing.assert_allclose(found, [0.25, 3.0, 4.5, 0.0, 60.0])


@pytest.mark.parametrize(
    ("distance", "speed", "time", "expected"),
    [
        (40.0, 10.0, 5.0, 2.0 * 10.0 / 25.0),  # still rolling at 6 m/s when the other is gone
        (40.0, 10.0, 4.0, 0.0),  # arrives just then
        (40.0, 10.0, 30.0, 100.0 / 80.0),  # has to stop before
        (5.0, 0.0, 9.0, 0.0),  # stands
    ],
)
def test_required_deceleration_by_hand(
    distance: float, speed: float, time: float, expected: float
) -> None:
    found = required_deceleration_mps2(np.array(distance), np.array(speed), np.array(time))
    np.testing.assert_allclose(found, expected, atol=1e-12)
