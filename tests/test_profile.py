"""Advised speed profiles: by hand, and within their bounds whatever they are asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hatn_sim.assist.outlook import travel_at
from hatn_sim.assist.profile import (
    AREA,
    COMFORT_ACCELERATION_MPS2,
    COMFORT_BRAKING_MPS2,
    COMFORT_JERK_MPS3,
    HARD_BRAKING_MPS2,
    HARD_JERK_MPS3,
    KNOT_AT_S,
    KNOTS,
    LEADER_ASKS,
    LINE_ASKS,
    PROFILE_FRAMES,
    Approach,
    Profiles,
    drive,
    hardest_asked,
)

POINTS = 21


def approach(speed: float, allowed: float = 30.0, **more: object) -> Approach:
    """One vehicle on a free road."""
    free = Approach(
        start_s=0.0,
        start_m=np.zeros(1),
        speed_mps=np.array([speed]),
        acceleration_mps2=np.zeros(1),
        allowed_mps=np.full((1, POINTS), allowed),
        leader_m=np.full((1, KNOTS + 1), np.inf),
        leader_mps=np.zeros((1, KNOTS + 1)),
        stop_m=np.array([np.inf]),
        area_m=np.array([[np.inf]]),
        open_s=np.zeros((1, 1)),
    )
    return replace(free, **more)  # type: ignore[arg-type]


def at(profiles: Profiles, time_s: float) -> tuple[float, float]:
    """Speed and way of the first at a time."""
    speed = np.interp(time_s, KNOT_AT_S, profiles.speed_mps[0])
    return float(speed), float(np.interp(time_s, KNOT_AT_S, profiles.travelled_m[0]))


def test_a_start_on_a_free_road_by_hand() -> None:
    found = drive(approach(0.0))
    # 3.5 m/s^3 for 0.5 s, on to 2 m/s^2 in the next quarter, and 2 m/s^2 from then on.
    knots = [0.0, 0.109375, 0.4375, 0.90625, 1.40625]
    np.testing.assert_allclose(found.speed_mps[0, :5], knots)
    np.testing.assert_allclose(found.speed_mps[0, -1], 0.90625 + 2.0 * 4.25)
    ticks = found.tick_speed_mps()
    assert ticks.shape == (1, PROFILE_FRAMES)
    # Within the first quarter v = j t^2 / 2.
    np.testing.assert_allclose(ticks[0, :2], [0.5 * 3.5 * 0.01, 0.5 * 3.5 * 0.04])
    np.testing.assert_allclose(ticks[0, [4, 9, 14, 49]], found.speed_mps[0, [2, 4, 5, 12]])
    # Where it drives evenly, an arrival is a root of a quadratic.
    way = found.travelled_m[0, 3] + 0.90625 * 2.25 + 2.25**2
    np.testing.assert_allclose(found.arrival_s(np.array([[way, 0.0]])), [[3.0, 0.0]], atol=1e-6)


def test_no_faster_than_the_road_allows() -> None:
    allowed = np.where(np.arange(POINTS) * 2.5 < 20.0, 12.0, 9.0)[None]
    found = drive(approach(12.0, allowed_mps=allowed))
    assert found.speed_mps.max() <= 12.0 + 1e-9 and at(found, 5.0)[0] == pytest.approx(9.0, abs=0.1)
    steady = drive(approach(5.0, 8.0))
    assert steady.speed_mps.max() <= 8.0 + 0.05 and at(steady, 5.0)[0] > 7.8


def test_a_yield_arrives_as_the_area_opens() -> None:
    found = drive(approach(8.0, area_m=np.array([[24.0]]), open_s=np.array([[4.0]])))
    # Braking at 1 m/s^2, 24 m take 4 s: 8 * 4 - 4 * 4 / 2 = 24, at most 4 m/s at the end.
    speed, way = at(found, 4.0)
    assert 21.5 < way <= 24.1 and 2.2 < speed <= 4.2
    assert found.braking_mps2[0] < AREA.braking_mps2
    later = drive(approach(8.0, area_m=np.array([[24.0]]), open_s=np.array([[60.0]])))
    assert later.travelled_m.max() < 24.0 and later.braking_mps2[0] <= COMFORT_BRAKING_MPS2


def test_a_stop_line_and_a_standing_leader_are_not_passed() -> None:
    line = drive(approach(6.0, stop_m=np.array([16.0])))
    assert 13.0 < line.travelled_m[0, -1] < 16.0 and line.speed_mps[0, -1] < 1.0
    behind = drive(approach(8.0, leader_m=np.full((1, KNOTS + 1), 30.0)))
    assert 22.0 < behind.travelled_m[0, -1] < 29.0
    assert max(line.braking_mps2[0], behind.braking_mps2[0]) <= COMFORT_BRAKING_MPS2


def test_a_later_start_goes_on_from_there() -> None:
    late = approach(8.0, start_s=1.0, start_m=np.array([8.0]))
    late = replace(late, area_m=np.array([[24.0]]), open_s=np.array([[4.0]]))
    soon = approach(8.0, area_m=np.array([[16.0]]), open_s=np.array([[3.0]]))
    np.testing.assert_allclose(drive(late).speed_mps, drive(soon).speed_mps)
    arrival = drive(late).arrival_s(np.array([[20.0]]))
    np.testing.assert_allclose(arrival, 1.0 + drive(soon).arrival_s(np.array([[12.0]])))


numbers = st.floats(0.0, 1.0)


@given(st.lists(st.tuples(*[numbers] * 6), min_size=1, max_size=6), st.randoms())
def test_bounds_hold_whatever_is_asked_for(rows: list[tuple[float, ...]], random: object) -> None:
    of = np.array(rows)
    count = len(of)
    speed = 15.0 * of[:, 0]
    everything = Approach(
        start_s=0.0,
        start_m=np.zeros(count),
        speed_mps=speed,
        acceleration_mps2=4.0 * of[:, 1] - 2.0,
        allowed_mps=np.repeat(5.0 + 10.0 * of[:, 2:3], POINTS, axis=1),
        leader_m=5.0 + 60.0 * of[:, 3:4] + np.linspace(0.0, 20.0, KNOTS + 1) * of[:, 4:5],
        leader_mps=np.repeat(4.0 * of[:, 4:5], KNOTS + 1, axis=1),
        stop_m=np.where(of[:, 5] < 0.5, 80.0 * of[:, 5], np.inf),
        area_m=60.0 * of[:, 1:3],
        open_s=6.0 * of[:, 4:6],
    )
    found = drive(everything)
    a = found.acceleration_mps2
    assert (a >= -HARD_BRAKING_MPS2).all() and (a <= COMFORT_ACCELERATION_MPS2).all()
    assert (found.speed_mps >= 0.0).all() and (np.diff(found.travelled_m) >= 0.0).all()
    # To let go of the accelerator takes no time.
    before = np.minimum(a[:, :-1], np.maximum(a[:, 1:], 0.0))
    before = np.where(a[:, 1:] < a[:, :-1], before, a[:, :-1])
    jerk = (a[:, 1:] - before) / np.diff(KNOT_AT_S)
    stands = found.speed_mps[:, 1:] == 0.0  # there braking ends at once
    gentle = (found.braking_mps2 <= COMFORT_BRAKING_MPS2)[:, None]
    assert (jerk[~stands] <= COMFORT_JERK_MPS3 + 1e-9).all()
    assert (jerk >= -HARD_JERK_MPS3 - 1e-9).all()
    assert (jerk[np.broadcast_to(gentle, jerk.shape)] >= -COMFORT_JERK_MPS3 - 1e-9).all()
    most = np.maximum(speed, everything.allowed_mps[:, 0])
    # It may still be speeding up when it begins.
    assert (found.speed_mps <= most[:, None] + 0.6).all()
    order = np.random.default_rng(0).permutation(count)
    names = ("start_m", "speed_mps", "acceleration_mps2", "allowed_mps", "leader_m", "leader_mps")
    names = (*names, "stop_m", "area_m", "open_s")
    turned = {name: getattr(everything, name)[order] for name in names}
    np.testing.assert_array_equal(
        drive(replace(everything, **turned)).speed_mps, found.speed_mps[order]
    )


@given(st.floats(0.0, 14.0), st.floats(0.0, 1.0), st.floats(0.0, 12.0))
def test_nobody_enters_before_the_area_opens(speed: float, spare: float, open_s: float) -> None:
    # Room to stop at 2 m/s^2 after 1.5 seconds, and up to 40 m more.
    room = 1.5 * speed + speed**2 / 4.0 + 1.5 + 40.0 * spare
    found = drive(approach(speed, area_m=np.array([[room]]), open_s=np.array([[open_s]])))
    assert (found.travelled_m[0, open_s > KNOT_AT_S] <= room + 0.25).all()
    assert found.braking_mps2[0] <= COMFORT_BRAKING_MPS2 + 0.2


def test_beyond_the_horizon_vehicles_go_on_or_slow_down_to_a_stand() -> None:
    # 6 and 1.5 m/s for 3 s; slowing at 1.5 m/s^2 they stop after 4 and 1 s, 12 and 0.75 m.
    path = np.arange(1.0, 31.0) * np.array([[0.6], [0.15]])
    way, speed = travel_at(path, np.array([1.05, 5.0]))
    np.testing.assert_allclose(way, [[6.3, 30.0], [1.575, 7.5]])
    way, speed = travel_at(path, np.array([1.05, 5.0]), 1.5)
    np.testing.assert_allclose(way, [[6.3, 18.0 + 12.0 - 3.0], [1.575, 4.5 + 0.75]])
    np.testing.assert_allclose(speed, [[6.0, 3.0], [1.5, 0.0]], atol=1e-9)


@pytest.mark.parametrize(("speed", "room"), [(10.0, 30.0), (8.0, 24.0), (5.0, 14.0), (2.0, 3.0)])
def test_whoever_follows_new_profiles_every_tick_stops_short(speed: float, room: float) -> None:
    # As `agents/heed.py` does: for the speed half a second ahead, a tenth at a time.
    way, acceleration = 0.0, 0.0
    for _ in range(150):
        area_m, now = np.array([[room - way]]), np.array([acceleration])
        closed = approach(speed, area_m=area_m, open_s=np.array([[60.0]]), acceleration_mps2=now)
        acceleration = (drive(closed).tick_speed_mps()[0, 4] - speed) / 0.5
        speed = max(speed + 0.1 * acceleration, 0.0)
        way += 0.1 * speed
    assert speed < 0.01 and 0.5 < room - way < 1.1


def everybody(speed: float, areas: list[float], line: float, gap: float, its: float) -> Approach:
    """One vehicle with areas that open after 20 s, a stop line and a leader at constant speed."""
    return approach(
        speed,
        area_m=np.array([areas]),
        open_s=np.full((1, len(areas)), 20.0),
        stop_m=np.array([line]),
        leader_m=gap + its * KNOT_AT_S[None],
        leader_mps=np.full((1, KNOTS + 1), its),
    )


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        (everybody(10.0, [60.0, 30.0], 60.0, 12.0, 0.0), LEADER_ASKS),
        (everybody(10.0, [60.0, 30.0], 60.0, 12.0, 10.0), 1),
        (everybody(10.0, [15.0, 30.0], 60.0, 12.0, 10.0), 0),
        (everybody(10.0, [60.0, 30.0], 12.0, 30.0, 0.0), LINE_ASKS),
    ],
)
def test_what_asks_for_the_hardest_braking(what: Approach, expected: int) -> None:
    (knot,), (asks,) = hardest_asked(what, drive(what), 1.5)
    assert asks == expected and 1 <= knot <= 5  # knots of the first 1.5 s


@given(
    speed=st.floats(5.0, 20.0),
    areas=st.lists(st.floats(5.0, 60.0), min_size=1, max_size=3, unique=True),
    line=st.floats(5.0, 60.0),
    gap=st.floats(5.0, 60.0),
    its=st.floats(0.0, 10.0),
)
def test_what_asks_for_most_is_what_brakes_hardest_alone(
    speed: float, areas: list[float], line: float, gap: float, its: float
) -> None:
    whole = everybody(speed, areas, line, gap, its)
    # Each of them alone, from the same state: what is reached at the first knot.
    free = np.full((1, len(areas)), np.inf)
    nobody = np.full((1, KNOTS + 1), np.inf)
    alone: dict[int, float] = {}
    for asks in (*range(len(areas)), LINE_ASKS, LEADER_ASKS):
        of = replace(
            whole,
            area_m=np.where(np.arange(len(areas)) == asks, whole.area_m, free),
            stop_m=whole.stop_m if asks == LINE_ASKS else np.array([np.inf]),
            leader_m=whole.leader_m if asks == LEADER_ASKS else nobody,
        )
        alone[asks] = float(drive(of).acceleration_mps2[0, 1])
    (knot,), (asks,) = hardest_asked(whole, drive(whole), float(KNOT_AT_S[1]))
    assert knot == 1
    assert alone[int(asks)] == min(alone.values())
    assert drive(whole).acceleration_mps2[0, 1] == min(alone.values())
