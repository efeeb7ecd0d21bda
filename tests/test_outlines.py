"""Outlines and encroachment times, against answers by hand, least squares and the simulator."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from hatn_sim.assist.encroachment import encroachments
from hatn_sim.assist.outlines import Boxes, gap_m, overlap, separation_m
from hatn_sim.config import load_scenario
from hatn_sim.score.driven import driven_by
from hatn_sim.simulators.sumo import SumoSimulator

SIZE = np.array([4.0, 2.0])
PLACE = st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-np.pi, np.pi))


def box(x: float, y: float, yaw: float) -> Boxes:
    return Boxes(np.array([x, y]), np.array(yaw), SIZE)


@pytest.mark.parametrize(
    ("other", "apart_m", "gap"),
    [
        (box(4.0, 0.0, 0.0), 0.0, 0.0),  # bumper to bumper
        (box(5.5, 0.0, 0.0), 1.5, 1.5),
        (box(1.0, 0.5, 0.0), -1.5, 0.0),  # 1.5 m aside is the nearest way out
        (box(6.0, 5.0, 0.0), 3.0, np.hypot(2.0, 3.0)),  # corner to corner
        (box(3.5, 0.0, np.pi / 2), 0.5, 0.5),
    ],
)
def test_two_boxes_by_hand(other: Boxes, apart_m: float, gap: float) -> None:
    one = box(0.0, 0.0, 0.0)
    np.testing.assert_allclose(separation_m(one, other), apart_m, atol=1e-12)
    np.testing.assert_allclose(gap_m(one, other), gap, atol=1e-12)


def least_distance_m(one: Boxes, other: Boxes) -> float:
    """Of any point in the one to any in the other: a bounded least-squares problem."""
    turns = [
        np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        for yaw in (float(one.yaw_rad), float(other.yaw_rad))
    ]
    half = np.concatenate((SIZE, SIZE)) / 2
    ways = np.concatenate((turns[0], -turns[1]), axis=1)
    found = lsq_linear(ways, other.xy_m - one.xy_m, (-half, half), method="bvls", tol=1e-14)
    return float(np.sqrt(2.0 * found.cost))


@given(PLACE, PLACE)
def test_gap_and_overlap_are_those_of_the_nearest_points(
    a: tuple[float, float, float], b: tuple[float, float, float]
) -> None:
    one, other = box(*a), box(*b)
    least = least_distance_m(one, other)
    np.testing.assert_allclose(gap_m(one, other), least, atol=1e-6)
    if abs(float(separation_m(one, other))) > 1e-6:
        assert overlap(one, other) == (least < 1e-6)


def crossing(delay_s: float) -> tuple[np.ndarray, np.ndarray, Boxes]:
    """Two at 10 m/s whose centres cross at a right angle, the second later by a delay."""
    time = np.arange(0.0, 6.0, 0.1)
    way = 10.0 * time - 30.0
    east = np.stack((way, np.zeros_like(way)), axis=1)
    north = np.stack((np.zeros_like(way), way - 10.0 * delay_s), axis=1)
    count = len(time)
    boxes = Boxes(
        np.concatenate((east, north)),
        np.repeat([0.0, np.pi / 2], count),
        np.tile(SIZE, (2 * count, 1)),
    )
    return np.repeat([7, 3], count), np.tile(np.arange(count), 2), boxes


@pytest.mark.parametrize(
    ("delay_s", "pet_s"),
    [
        # Each is in the other's way for 3 m to either side, half a length and half a width: the
        # first in frames 28 ... 32, the second from 27.5 + 10 delays on, for six frames.
        (2.05, 1.6),
        (-2.05, 1.6),
        (0.65, 0.2),
        (0.35, -0.2),
        (0.05, -0.5),
    ],
)
def test_encroachment_time_by_hand(delay_s: float, pet_s: float) -> None:
    found = encroachments(*crossing(delay_s))
    assert (found.first.tolist(), found.second.tolist()) == ([3], [7])
    np.testing.assert_allclose(found.pet_s, [pet_s], atol=1e-9)


def test_the_second_enters_when_its_outline_comes_to_where_the_first_was() -> None:
    found = encroachments(*crossing(2.05))
    assert found.entry_frame.tolist() == [48]


def test_who_never_comes_to_one_place_has_no_encroachment_time() -> None:
    vehicle, frame, boxes = crossing(0.0)
    aside = Boxes(boxes.xy_m + 100.0 * (vehicle == 3)[:, None], boxes.yaw_rad, boxes.size_m)
    assert not len(encroachments(vehicle, frame, aside).first)
    late = frame + 70 * (vehicle == 3)
    assert not len(encroachments(vehicle, late, boxes, longest_s=5.0).first)


@pytest.mark.parametrize("rows", [0, 1])
def test_nobody_and_one_alone_have_no_encroachment_time(rows: int) -> None:
    here = np.arange(rows)
    boxes = Boxes(np.zeros((rows, 2)), np.zeros(rows), np.tile(SIZE, (rows, 1)))
    assert not len(encroachments(here, here, boxes).pet_s)


@pytest.mark.parametrize(("scene", "frames"), [("intersection5", 800), ("roundabout8", 1500)])
def test_encroachment_is_negative_for_the_pairs_that_sumo_says_touch(
    scene: str, frames: int
) -> None:
    """Where lanes that lie over each other are known to SUMO as such.

    Those of `roundabout4_two_lane` are not, where its second lane begins: outlines touch there, and
    SUMO does not see it.
    """
    with SumoSimulator(load_scenario(scene, None, "inattentive")) as simulator:
        seen = [simulator.reset(302), *(simulator.step() for _ in range(frames))]
    driven = driven_by(seen)
    boxes = Boxes(driven.xy_m, driven.yaw_rad, driven.size_m[driven.vehicle])
    found = encroachments(driven.vehicle, driven.frame, boxes)
    touched = {
        tuple(sorted((driven.ids[a], driven.ids[b])))
        for a, b, pet in zip(found.first, found.second, found.pet_s, strict=True)
        if pet < 0.0
    }
    assert touched == {(one, other) for _, one, other in driven.contacts}
    assert touched
