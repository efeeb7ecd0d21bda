"""What drivers are told to do, against what it takes by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_alert import moment, row

from hatn_sim.assist.evade import BRAKE, CLEAR, HOLDS_S, evasions, warn
from hatn_sim.assist.moment import Moment
from hatn_sim.assist.pairs import CROSS, MERGE

# Of each car, of 5 m x 2 m, the area begins 3.5 m before the middle of the crossing for its centre:
# 6 m - 2.5 m of half its length; it is out 3.5 m behind.
HALF_M = 3.5
State = tuple[float, float, float]


def sides(found: Moment) -> tuple[int, int]:
    """The columns of "a" and of "b"."""
    first = found.pairs.index[0].tolist()
    return first.index(0), first.index(1)


def test_braking_by_hand() -> None:
    """Both 20 m before the middle: a at 8 m/s, b at 10 m/s, neither accelerates."""
    seen = moment((20.0, 8.0, 0.0), (20.0, 10.0, 0.0))
    found, (a, b) = evasions(seen, seen.pairs), sides(seen)
    room_m, clear_m = 20.0 - HALF_M, 20.0 + HALF_M
    np.testing.assert_allclose(found.open_s[0, a], clear_m / 10.0 + 0.5, rtol=0.02)
    np.testing.assert_allclose(found.room_m[0, a], room_m - 0.5, rtol=0.02)
    # After a second a has 8.5 m to go, its nose may be 0.5 m in, and b is gone 1.85 s later.
    left_m, left_s = room_m - 8.0, clear_m / 10.0 + 0.5 - 1.0
    even = 2.0 * (8.0 * left_s - left_m) / left_s**2
    assert even * left_s < 8.0  # it still rolls then
    np.testing.assert_allclose(found.needed_mps2[0, a], even, rtol=0.05)
    assert found.needed_mps2[0, a] < found.needed_mps2[0, b]


@pytest.mark.parametrize(
    ("east", "north", "warned", "action"),
    [
        ((25.0, 8.0, 0.0), (20.0, 10.0, 0.0), "a", BRAKE),  # the one who is later and slower
        ((20.0, 10.0, 0.0), (25.0, 8.0, 0.0), "b", BRAKE),
        ((4.0, 3.0, 0.0), (30.0, 12.0, 0.0), "b", BRAKE),  # the other is all but in
    ],
)
def test_who_gives_way_more_easily_is_told_to(
    east: State, north: State, warned: str, action: str
) -> None:
    seen = moment(east, north)
    for first, second in ((0, 1), (1, 0)):
        told = warn(seen, first, second, True)
        assert (seen.scene.ids[told.ego], told.action) == (warned, action)
        assert {told.ego, told.other} == {0, 1}
        assert told.room_m is not None and told.open_s is not None and told.text is not None
        assert told.open_s <= HOLDS_S
        assert told.text.startswith("Brake")
        # Where only one may be told, it is that one.
        assert warn(seen, first, second, False).ego == first


def test_who_stands_is_told_to_wait() -> None:
    told = warn(moment((12.0, 0.0, 0.0), (20.0, 10.0, 0.0)), 0, 1, False)
    assert (told.action, told.text) == (BRAKE, "Wait: let the car from the right go first")


def test_who_is_in_the_place_or_out_in_time_does_not_stop_in_it() -> None:
    inside = warn(moment((1.0, 6.0, 0.0), (14.0, 9.0, 0.0)), 0, 1, False)
    assert inside.action == CLEAR and inside.room_m is None and inside.open_s is None
    assert inside.text is not None and inside.text.startswith("Go on")
    # 12 m before the middle at 9 m/s nobody stops in comfort after a second; b comes in 4 s.
    early = warn(moment((12.0, 9.0, 0.0), (43.0, 10.0, 0.0)), 0, 1, False)
    assert early.action == CLEAR


def test_nobody_is_sent_before_a_faster_one_in_its_lane() -> None:
    """a is out after 2.2 s at 10.5 m/s, b comes after 3.0 s at 18 m/s: on a crossing that is early
    enough; where they merge, b takes 0.5 s more to slow down in comfort."""
    seen = moment((16.0, 8.0, 0.0), (58.0, 18.0, 0.0))
    assert seen.pairs.type.tolist() == [CROSS]
    crossing, (a, _) = evasions(seen, seen.pairs), sides(seen)
    merging = evasions(seen, replace(seen.pairs, type=np.array([MERGE])))
    assert not crossing.brakes[0, a]
    assert merging.brakes[0, a]


def test_who_comes_second_brakes_though_it_is_late() -> None:
    """b is in the area before a, who cannot stop any more after a second: it does not hurry."""
    seen = moment((14.0, 10.0, 0.0), (9.0, 9.0, 0.0))
    assert warn(seen, 0, 1, False).action == BRAKE


@pytest.mark.parametrize(("away_m", "speed_mps"), [(32.0, 12.0), (20.0, 12.0), (11.0, 14.0)])
def test_of_two_who_follow_the_one_behind_brakes_however_late(
    away_m: float, speed_mps: float
) -> None:
    """Towards one who all but stands: stopping takes 4 m/s2 after a second, then 16, then there is
    no room left. The one ahead is not told to brake for the one behind."""
    seen = row(away_m, speed_mps)
    front, rear = (seen.scene.ids.index(name) for name in ("front", "rear"))
    for first, second in ((front, rear), (rear, front)):
        told = warn(seen, first, second, True)
        assert (told.ego, told.action) == (rear, BRAKE)
        assert told.room_m is not None and np.isfinite(told.room_m)
        assert told.text is not None and told.text.endswith("keep behind the car ahead")
    assert warn(seen, rear, front, False).action == BRAKE
    alone = warn(seen, front, rear, False)
    assert (alone.ego, alone.action, alone.room_m) == (front, CLEAR, None)


def test_two_who_are_no_pair_are_told_nothing() -> None:
    seen = moment((20.0, 8.0, 0.0), (-30.0, 10.0, 0.0))  # b has left
    told = warn(seen, 0, 1, True)
    assert (told.ego, told.other, told.action, told.text) == (0, 1, None, None)
