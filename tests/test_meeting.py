"""Where two met, against ways laid out by hand: cars of 4.5 by 1.8 m, 20 s at 10 Hz."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hatn_sim.report.meeting import meeting_place
from hatn_sim.score.driven import Driven, driven_from_arrays

Floats = NDArray[np.float64]
T_S: Floats = np.linspace(0.0, 19.9, 200)


def two(one_m: Floats, other_m: Floats) -> Driven:
    """Two that head where they drive."""
    xy_m: Floats = np.stack((one_m, other_m), axis=1)
    velocity = np.gradient(xy_m, 0.1, axis=0)
    return driven_from_arrays(
        ids=("one", "other"),
        time_s=T_S,
        valid=np.ones(xy_m.shape[:2], dtype=np.bool_),
        xy_m=xy_m,
        yaw_rad=np.arctan2(velocity[..., 1], velocity[..., 0]),
        speed_mps=np.linalg.norm(velocity, axis=-1),
        size_m=np.full((2, 2), [4.5, 1.8]),
    )


def along(x_m: Floats, y_m: float = 0.0) -> Floats:
    return np.stack((x_m, np.full(len(x_m), y_m)), axis=1)


def test_two_that_cross_met_where_their_ways_cross() -> None:
    """At (0, 0) at 8 and at 10 s."""
    north = along(8.0 * (T_S - 10.0))[:, ::-1]
    driven = two(along(8.0 * (T_S - 8.0)), north)
    for pair in ((0, 1), (1, 0)):
        assert meeting_place(driven, *pair, 100) == pytest.approx([0.0, 0.0], abs=1.0)
    far = two(along(8.0 * (T_S - 8.0)), north - np.array([0.0, 80.0]))  # 12 s apart
    assert meeting_place(far, 0, 1, 100) is None


def test_a_merge_is_met_where_it_begins() -> None:
    """By 30 degrees into a way of 40 m in common, 2 s behind; 1 s at its end: it is faster."""
    behind_s = T_S - 7.0
    come = 8.0 * behind_s[:, None] * [np.cos(np.pi / 6), np.sin(np.pi / 6)]
    then_m = 10.0 * behind_s - 2.0 * np.maximum(behind_s - 4.0, 0.0)
    later = np.where(behind_s[:, None] < 0.0, come, along(then_m))
    driven = two(along(8.0 * (T_S - 5.0)), later)
    # The one is 4.5 m long: their outlines share some ground from 4 m before the ways are one.
    for frame in (70, 50):
        place = meeting_place(driven, 0, 1, frame)
        assert place is not None and np.hypot(*place) < 4.5


def test_who_follows_met_nobody_but_whom_it_touched() -> None:
    """A follower 12 m behind brakes from 10 to 2.5 m/s and speeds up again; or does not brake."""
    slow_s = np.clip(T_S - 6.0, 0.0, 3.0)  # the area under a speed that falls and rises by 7.5
    lost_m = np.where(slow_s < 1.5, 2.5 * slow_s**2, 11.25 - 2.5 * (3.0 - slow_s) ** 2)
    driven = two(along(10.0 * T_S + 12.0), along(10.0 * T_S - lost_m))
    assert meeting_place(driven, 0, 1, 60) is None
    assert meeting_place(driven, 1, 0, 60) is None
    # The leader stands at 72 m from 6 s on: the follower's front is at its rear at 65.25 + 2.25 m.
    crash = two(along(np.minimum(10.0 * T_S + 12.0, 72.0)), along(10.0 * T_S))
    place = meeting_place(crash, 0, 1, 65)
    assert place == pytest.approx([69.75, 0.0], abs=1.0)


def test_round_a_bend_who_follows_has_met_nobody() -> None:
    """A circle of 10 m: at one place they head alike, a length apart they differ by 26 deg."""
    angle = 0.7 * T_S

    def round_m(at: Floats) -> Floats:
        return 10.0 * np.stack((np.cos(at), np.sin(at)), axis=1)

    assert meeting_place(two(round_m(angle), round_m(angle - 1.2)), 0, 1, 100) is None


def test_two_abreast_in_opposite_lanes_have_not_met() -> None:
    """3.3 m aside; where the other turns off across the lane of the one, they have."""
    east, west_m = along(8.0 * T_S - 80.0), 60.0 - 8.0 * T_S
    assert meeting_place(two(east, along(west_m, 3.3)), 0, 1, 88) is None
    turns = along(np.maximum(west_m, -20.0), 3.3)
    turns[:, 1] -= np.maximum(-20.0 - west_m, 0.0)  # at 10 s to the south
    place = meeting_place(two(east, turns), 0, 1, 104)
    assert place == pytest.approx([-20.0, 0.0], abs=2.0)
