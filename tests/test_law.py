"""The law that policies drive by: by hand, and by driving it against others on a real road."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import crossing_lanes, scene_of
from shapely.geometry import Polygon

from hatn_sim.datatypes import DT_S, Gate, Lines, Scene
from hatn_sim.planning.situation import Meetings, Situation, on_route, situation_of
from hatn_sim.policies.law import (
    HOLDS_FRAMES,
    LEVELS_MPS2,
    REACTION_S,
    allowed_mps,
    lawful_mps2,
    level_mps2,
)
from hatn_sim.road import Road

LENGTH_M = 5.0
WEST_EAST, SOUTH_NORTH, TURN = ("w", "we", "e"), ("s", "sn", "n"), ("w", "wn", "n")
Script = Callable[[float], float]
"""Acceleration at a time."""


def meeting(**more: Any) -> Meetings:
    """Nobody is met, or one: 8 m from the ego's nose to an area of 6 m, a car's length beyond it.

    `more` are numbers of that one.
    """
    one = {"room_m": 8.0, "clear_m": 19.0, "other_room_m": 30.0, "other_clear_m": 41.0} | more
    count = int(bool(more))
    return Meetings(
        other=np.ones(count, np.int64),
        merges=np.full(count, one.pop("merges", False)),
        gives_way=np.zeros(count, np.bool_),
        will_wait=np.full(count, one.pop("will_wait", False)),
        **{name: np.full(count, value) for name, value in one.items()},
    )


def driving(
    speed_mps: float, other_mps: float = 0.0, met: Meetings | None = None, **more: Any
) -> Any:
    """An ego on a straight road with a limit of 10 m/s, and another car somewhere."""
    road = Road(crossing_lanes())
    scene = scene_of(0.0, {"ego": (0, 0, 0, speed_mps), "other": (50.0, 0, 0, other_mps)})
    scene = replace(scene, size_m=np.full((2, 2), [LENGTH_M, 1.8]))
    lines: Any = None  # the law reads none
    given: dict[str, Any] = {
        "allowed_mps": np.full(56, 10.0),
        "leader": -1,
        "gap_m": np.inf,
        "stop_m": np.inf,
        "gate_m": np.inf,
        "has_stopped": False,
    }
    half_m = 0.5 * LENGTH_M
    return Situation(
        road=road,
        scene=scene,
        lines=lines,
        ego=0,
        line=0,
        s_m=0.0,
        speed_mps=speed_mps,
        half_m=half_m,
        meetings=met or meeting(),
        **given | more,
    )


def allowed(now: Situation, other_gains_mps2: float = 0.0) -> float:
    return allowed_mps(now, np.array([0.0, other_gains_mps2]))


def stop_mps(way_m: float, there_mps: float = 0.0, reaction_s: float = REACTION_S) -> float:
    """From how fast braking at 2.5 m/s2 gets down to that, so far on, after a reaction."""
    return float(max(np.roots([1.0, 5.0 * reaction_s, -5.0 * way_m - there_mps**2])))


def test_allowed_speeds_worked_out_by_hand() -> None:
    assert allowed(driving(3.0)) == pytest.approx(10.0)
    # Where it is; what is ahead has been slowed down for.
    slower = np.array([7.0, 6.5, 6.0, 5.0, *[5.0] * 52])
    assert allowed(driving(8.0, allowed_mps=slower)) == pytest.approx(7.0)
    # 12 m to one who stands, of which 2 m are kept, after a second: -2.5 + sqrt(2.5^2 + 50) = 5.
    assert allowed(driving(3.0, leader=1, gap_m=12.0)) == pytest.approx(5.0)
    # 6 m to the line, 0.7 m are kept.
    assert allowed(driving(3.0, stop_m=6.0, gate_m=6.0)) == pytest.approx(stop_mps(5.3))
    # A line that it has stood at, or need not stop at, holds nobody.
    assert allowed(driving(3.0, gate_m=6.0)) == pytest.approx(10.0)
    # 10^2 / 2 / 8 = 6.25 m/s2 are more than anybody expects at a signal that closes.
    assert allowed(driving(10.0, stop_m=8.0)) == pytest.approx(10.0)
    assert allowed(driving(10.0, stop_m=10.5)) == pytest.approx(stop_mps(9.8))


def test_whoever_can_no_longer_stop_goes_first() -> None:
    # 8^2 / 5 + 8 * 0.5 = 16.8 m to stop. From 3 m/s, at 2 m/s2, the ego is clear in 3.1 s.
    clear_s = (np.sqrt(9.0 + 4.0 * 19.0) - 3.0) / 2.0
    assert clear_s == pytest.approx(3.11, abs=0.01)
    bound = meeting(other_room_m=16.5, other_clear_m=27.5)
    assert allowed(driving(3.0, 8.0, bound)) == pytest.approx(stop_mps(7.0))
    # Before a line it waits there, where it is in nobody's way.
    assert allowed(driving(3.0, 8.0, bound, gate_m=3.0)) == pytest.approx(stop_mps(2.3))
    # Who is there only when the ego has been gone for a second is in nobody's way either.
    slow = replace(bound, clear_m=np.full(1, 5.0), room_m=np.full(1, 0.5))
    assert (np.sqrt(36.0 + 20.0) - 6.0) / 2.0 + 1.0 < 16.5 / 8.0
    assert allowed(driving(6.0, 8.0, slow)) == pytest.approx(10.0)
    # Nor who is out before the ego comes: 2.0 m at 8 m/s, 8 m from 3 m/s.
    gone = meeting(other_room_m=-9.0, other_clear_m=2.0)
    leaves = driving(3.0, 8.0, gone)
    assert allowed(leaves) == pytest.approx(stop_mps(7.0))  # but it is in the area now


def test_whoever_would_be_there_with_the_ego_goes_first_if_sooner() -> None:
    # Clear in 3.11 s; at 5 m/s, 15 m take 3 s, 16 m take 3.2 s, and both could still stop.
    for room_m, expected in ((15.0, stop_mps(7.0)), (16.0, 10.0)):
        free = meeting(other_room_m=room_m, other_clear_m=room_m + 11.0)
        assert allowed(driving(3.0, 5.0, free)) == pytest.approx(expected)
        assert allowed(driving(3.0, 5.0, replace(free, will_wait=np.full(1, True)))) == 10.0
        # It is not held at a line for who may still change his mind.
        assert allowed(driving(3.0, 5.0, free, gate_m=3.0)) == pytest.approx(expected)
    # 2.5 m/s2 bring 20 m within 2.4 s of 5 m/s, 24 m within 2.8 s, however fast it gains.
    gaining = meeting(other_room_m=20.0, other_clear_m=31.0)
    assert allowed(driving(3.0, 5.0, gaining)) == pytest.approx(10.0)
    assert allowed(driving(3.0, 5.0, gaining), 2.5) == pytest.approx(stop_mps(7.0))
    assert allowed(driving(3.0, 5.0, gaining), 0.3) == pytest.approx(10.0)
    # Who has stood still stands.
    assert allowed(driving(3.0, 0.4, meeting(other_room_m=1.0))) == pytest.approx(10.0)


def test_where_it_is_too_late_to_stop_no_speed_is_gained() -> None:
    # 6^2 / 2 / 3 = 6 m/s2 would be needed.
    late = meeting(room_m=3.0, clear_m=14.0, other_room_m=2.0, other_clear_m=13.0)
    assert allowed(driving(6.0, 5.0, late)) == pytest.approx(6.0)
    # In front of who stands there it brakes all the same, but not if they will be gone.
    stands = replace(late, other_room_m=np.full(1, -2.0), other_clear_m=np.full(1, 6.0))
    assert allowed(driving(6.0, 0.0, stands)) == pytest.approx(stop_mps(2.0))
    leaves = replace(stands, other_clear_m=np.full(1, 1.0))
    assert allowed(driving(6.0, 5.0, leaves)) == pytest.approx(6.0)
    # For who could brake, too, it brakes by 3.5 m/s2 at most: 6^2 / 7 = 5.1 m.
    for room_m, expected in ((5.2, stop_mps(4.2)), (5.1, 6.0)):
        likely = meeting(room_m=room_m, clear_m=16.0, other_room_m=9.0, other_clear_m=20.0)
        assert allowed(driving(6.0, 5.0, likely)) == pytest.approx(expected)
    # With its nose in the area it goes on, unless somebody is farther in, across its way.
    inside = meeting(room_m=-0.5, clear_m=10.0, other_room_m=2.0, other_clear_m=13.0)
    assert allowed(driving(3.0, 5.0, inside)) == pytest.approx(10.0)
    crosses = replace(inside, other_room_m=np.full(1, -2.0))
    assert allowed(driving(3.0, 5.0, crosses)) == pytest.approx(0.0)
    assert allowed(driving(3.0, 5.0, replace(crosses, other_room_m=np.full(1, -0.2)))) == 10.0


def test_a_line_too_near_to_stop_at_is_passed() -> None:
    # 8^2 / 5 = 12.8 m at 2.5 m/s2: not within 2 - 0.7 m, well within 20 - 1 m.
    there = meeting(room_m=20.0, clear_m=31.0, other_room_m=-2.0, other_clear_m=6.0)
    assert allowed(driving(8.0, 0.0, there, gate_m=2.0)) == pytest.approx(stop_mps(19.0))
    assert allowed(driving(8.0, 0.0, there, gate_m=14.0)) == pytest.approx(stop_mps(13.3))


def test_an_area_is_not_entered_where_there_is_no_room_behind_it() -> None:
    # Out in 3.1 s by itself, the other comes in 6 s. Its leader's rear is 3 m short of what it
    # needs, 2 m of distance included: at 2 m/s, gaining 1 m/s2, that takes 1.2 s; standing, ever.
    free = meeting(other_room_m=30.0, other_clear_m=41.0)
    for gap_m, leader_mps, expected in ((18.0, 2.0, 10.0), (18.0, 0.0, stop_mps(7.0))):
        now = driving(3.0, 5.0, free, leader=2, gap_m=gap_m)
        speeds = np.append(now.scene.speed_mps, leader_mps)
        now = replace(now, scene=replace(now.scene, speed_mps=speeds))
        behind = stop_mps(gap_m - 2.0, leader_mps, reaction_s=1.0)
        found = allowed_mps(now, np.zeros(3))
        assert found == pytest.approx(min(expected, behind))
        assert behind > stop_mps(7.0)


def test_who_is_beside_the_ego_is_not_followed() -> None:
    # 1.4 m before the point and at walking pace: the other passes at 8 m/s, its rear is behind.
    passes = meeting(merges=True, room_m=1.4, clear_m=6.4, other_room_m=0.3, other_clear_m=5.3)
    assert allowed(driving(1.9, 8.0, passes)) == pytest.approx(stop_mps(0.4))


def test_whoever_merges_ahead_is_followed_or_waited_for() -> None:
    # 6 - 2 m between fronts, of which 5 m are its length and 2 m are kept: it is to be 3 m/s slower
    # than whoever is ahead, or able to stop within 5 m, whichever is faster.
    ahead = meeting(merges=True, room_m=6.0, clear_m=11.0, other_room_m=2.0, other_clear_m=7.0)
    assert allowed(driving(3.0, 3.0, ahead)) == pytest.approx(stop_mps(5.0))
    # When its nose is in, it can only follow: 5 m are missing.
    inside = replace(ahead, room_m=np.full(1, -0.5), other_room_m=np.full(1, -2.5))
    assert allowed(driving(3.0, 8.0, inside)) == pytest.approx(stop_mps(0.0, there_mps=8.0) - 5.0)
    # 14 - 2 m between fast ones: to follow lets it be faster than to be able to stop.
    far = replace(ahead, room_m=np.full(1, 14.0), clear_m=np.full(1, 19.0))
    long = replace(far, other_clear_m=np.full(1, 15.0))
    follows = stop_mps(5.0, there_mps=8.0)
    assert stop_mps(13.0) < follows < 10.0
    assert allowed(driving(9.0, 8.0, long)) == pytest.approx(follows)
    # Who is past the point before the ego comes is a leader like any other by then.
    assert allowed(driving(3.0, 6.0, far)) == pytest.approx(10.0)


def test_nobody_knows_the_law_of_an_unknown_road() -> None:
    assert lawful_mps2(None, np.zeros(2)) == 0.0
    assert lawful_mps2(driving(3.0, leader=1, gap_m=12.0), np.zeros(2)) == pytest.approx(4.0)
    assert level_mps2(LEVELS_MPS2.index(-3.0), 0.0) == -3.0
    assert level_mps2(len(LEVELS_MPS2) - 1, 0.0) == 0.0


@pytest.mark.parametrize("speed_mps", [0.5, 6.0, 10.0])
@pytest.mark.parametrize("what", ["line", "area", "bend"])
def test_the_fastest_driver_within_the_law_is_slow_enough_in_time(
    speed_mps: float, what: str
) -> None:
    way_m, fastest, hardest = 60.0, 0.0, 0.0
    for _ in range(80):
        if what == "line":
            now = driving(speed_mps, stop_m=way_m)
        elif what == "area":  # of somebody who comes and never gets there
            now = driving(
                speed_mps, 8.0, meeting(room_m=way_m, clear_m=way_m + 11.0, other_room_m=9.0)
            )
        else:
            from_here_m = np.maximum(way_m - 2.0 * np.arange(56), 0.0)
            profile = np.minimum(10.0, np.sqrt(16.0 + 2.0 * 1.5 * from_here_m))
            now = driving(speed_mps, allowed_mps=profile)
        level = level_mps2(len(LEVELS_MPS2) - 1, lawful_mps2(now, np.zeros(2)))
        after_mps = max(speed_mps + REACTION_S * level, 0.0)
        way_m -= 0.5 * (speed_mps + after_mps) * REACTION_S
        speed_mps = after_mps
        fastest, hardest = max(fastest, speed_mps), max(hardest, -level)
        if what != "bend":
            assert way_m > 0.0
    assert fastest == pytest.approx(10.0, abs=0.1) and hardest < 4.0
    if what == "bend":
        assert speed_mps == pytest.approx(4.0, abs=0.01) and hardest < 2.5
    else:
        assert speed_mps < 0.3 and way_m < 1.2


# -- driven ----------------------------------------------------------------------------------------


def outline(scene: Scene, row: int) -> Polygon:
    cos, sin = np.cos(scene.yaw_rad[row]), np.sin(scene.yaw_rad[row])
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * 0.5 * scene.size_m[row]
    return Polygon(corners @ np.array([[cos, sin], [-sin, cos]]) + scene.xy_m[row])


def fastest(
    gate: Gate,
    cars: dict[str, tuple[tuple[str, ...], float, float]],
    script: Script,
    seconds: float,
) -> tuple[bool, float]:
    """Whether the first car, as fast as the law allows, touches one of the others; where it ends.

    Cars are on routes, so far along them and so fast; the others drive by the script.
    """
    entries = ("w", "s")
    lanes = [replace(one, gate=gate if one.id in entries else one.gate) for one in crossing_lanes()]
    road = Road(lanes)
    routes = [route for route, *_ in cars.values()]
    line = np.array([road.line(route) for route in routes])
    s_m, speed_mps = (np.array([car[k] for car in cars.values()], float) for k in (1, 2))
    gains = np.zeros(len(line))
    command, has_stood, before_mps = 0.0, False, speed_mps.copy()
    for frame in range(round(seconds / DT_S)):
        xy, yaw = road.locate(line, s_m, np.zeros(len(line))), road.line_yaw_rad(line, s_m)
        places = np.column_stack((xy, yaw, speed_mps)).tolist()
        scene = scene_of(frame * DT_S, dict(zip(cars, map(tuple, places), strict=True)))
        ego = outline(scene, 0)
        if any(ego.intersects(outline(scene, row)) for row in range(1, len(line))):
            return True, float(s_m[0])
        if frame % HOLDS_FRAMES == 0:
            lines = Lines(np.full(len(line), -1), *np.zeros((4, len(line))))
            for row, route in enumerate(routes):
                lines = on_route(road, scene, lines, row, route)
            now = situation_of(road, scene, lines, 0, has_stood)
            assert now is not None
            has_stood = now.has_stopped
            gains = (speed_mps - before_mps) / REACTION_S
            before_mps = speed_mps.copy()
            command = level_mps2(len(LEVELS_MPS2) - 1, lawful_mps2(now, gains))
        wanted = np.array([command, *[script(frame * DT_S)] * (len(line) - 1)])
        after_mps = np.maximum(speed_mps + DT_S * wanted, 0.0)
        s_m, speed_mps = s_m + 0.5 * DT_S * (speed_mps + after_mps), after_mps
    return False, float(s_m[0])


def steady(_: float) -> float:
    return 0.0


@pytest.mark.parametrize("other_mps", [4.0, 6.0, 8.0, 10.0, 13.0])
@pytest.mark.parametrize("gate", [Gate.NONE, Gate.GIVE_WAY_LINE])
@pytest.mark.parametrize(
    ("own", "theirs"), [(WEST_EAST, SOUTH_NORTH), (SOUTH_NORTH, WEST_EAST), (SOUTH_NORTH, TURN)]
)
def test_the_fastest_driver_touches_nobody_who_drives_on(
    own: tuple[str, ...], theirs: tuple[str, ...], gate: Gate, other_mps: float
) -> None:
    """Neither slows down for the other but by the law; the crossing is 108 m along both."""
    for away_m in (16.0, 28.0, 34.0):
        for s_m, speed_mps in ((90.0, 6.0), (101.0, 0.0)):
            cars = {"ego": (own, s_m, speed_mps), "other": (theirs, 108.0 - away_m, other_mps)}
            touches, ends_m = fastest(gate, cars, steady, 8.0)
            where = f"from {away_m} m and {s_m} m"
            assert not touches, where
            assert ends_m > 112.0 or theirs == TURN, where  # and it has crossed


@pytest.mark.parametrize("away_m", [35.0, 40.0, 45.0, 50.0, 60.0])
def test_nobody_is_caught_behind_a_leader_who_stands(away_m: float) -> None:
    # The leader's rear is 3 m behind the area, too little for a car.
    cars = {
        "ego": (WEST_EAST, 101.0, 0.0),
        "leader": (WEST_EAST, 114.5, 0.0),
        "other": (SOUTH_NORTH, 108.0 - away_m, 8.0),
    }
    touches, ends_m = fastest(Gate.NONE, cars, steady, 14.0)
    assert not touches and ends_m > 106.0  # it goes there afterwards


def test_who_stands_in_the_way_is_not_touched() -> None:
    for s_m in (60.0, 90.0, 96.0):
        cars = {"ego": (WEST_EAST, s_m, 8.0), "other": (SOUTH_NORTH, 108.0, 0.0)}
        touches, ends_m = fastest(Gate.NONE, cars, steady, 12.0)
        assert not touches and ends_m < 108.0 - 1.0 - 2.5, s_m
