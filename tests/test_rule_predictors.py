"""The rule-based predictors against closed forms, fine integration, and what they must not see."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from conftest import crossing_lanes, lane, scene_of
from test_invariance import in_order, moved, traffic

from hatn_sim.datatypes import DT_S, HISTORY_FRAMES, TRACK_FRAMES, FloatArray, Lane, Scene, Tracks
from hatn_sim.perception import PerceptionState, begin, perceive
from hatn_sim.predictors import car_following
from hatn_sim.predictors.car_following import idm_acceleration, roll_out
from hatn_sim.predictors.find import load_predictor
from hatn_sim.predictors.free_motion import (
    TIMES_S,
    continued_xy_m,
    fallback_motion,
    travelled_m,
    turning_xy_m,
)
from hatn_sim.predictors.fsm import CloserBy, find_meetings
from hatn_sim.predictors.present import Present, present_motion
from hatn_sim.road import Road

NAMES = ("constant_acceleration", "constant_turn_rate", "idm", "fsm_d", "fsm_t")
PAST_S = DT_S * np.arange(1 - TRACK_FRAMES, 1, dtype=np.float64)


def tracks_of(xy_m: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray) -> Tracks:
    """Vehicles that have been in view all the time."""
    ids = tuple(str(k) for k in range(len(xy_m)))
    return Tracks(ids, xy_m, yaw_rad, speed_mps, np.ones(speed_mps.shape, dtype=np.bool_))


def circling(speed_mps: float, turn_rate_radps: float, slip_rad: float, at_s: FloatArray) -> Tracks:
    """One vehicle on a circle about (0, r), whose centre moves aslant to its heading."""
    course = turn_rate_radps * at_s
    radius_m = speed_mps / turn_rate_radps
    xy = radius_m * np.stack((np.sin(course), 1.0 - np.cos(course)), axis=-1)
    return tracks_of(xy[None], (course - slip_rad)[None], np.full((1, len(at_s)), speed_mps))


# -- free motion ------------------------------------------------------------------------------


def test_braking_to_a_standstill_and_speeding_up() -> None:
    speed, acceleration = np.array([6.0, 5.0, 0.0]), np.array([-4.0, 2.0, -1.0])
    found = travelled_m(speed, acceleration, 1e6)
    t = TIMES_S
    stops = np.where(t < 1.5, 6.0 * t - 2.0 * t * t, 4.5)
    np.testing.assert_allclose(found, [stops, 5.0 * t + t * t, 0.0 * t], atol=1e-4)


@pytest.mark.parametrize(("speed", "acceleration"), [(6.0, -4.0), (3.0, 1.5), (9.0, -1.0)])
def test_fading_acceleration_by_fine_integration(speed: float, acceleration: float) -> None:
    fine_s = 1e-4
    at_s = fine_s * (np.arange(30_000) + 0.5)
    speeds = speed + np.cumsum(acceleration * np.exp(-at_s / 2.0)) * fine_s
    travelled = np.cumsum(np.maximum(speeds, 0.0)) * fine_s
    found = travelled_m(np.array([speed]), np.array([acceleration]), 2.0)[0]
    np.testing.assert_allclose(found, travelled[999::1000], atol=2e-3)
    assert (np.diff(found) >= 0.0).all()


def test_a_steady_turn_is_a_circle() -> None:
    found = turning_xy_m(
        np.zeros((1, 2)), np.zeros(1), 0.4 * TIMES_S[None], 8.0 * TIMES_S[None]
    )  # radius 20 m about (0, 20)
    angle = 0.4 * TIMES_S
    expected = 20.0 * np.stack((np.sin(angle), 1.0 - np.cos(angle)), axis=1)
    np.testing.assert_allclose(found[0], expected, atol=1e-9)


# -- motion now -------------------------------------------------------------------------------


def test_motion_now_is_that_of_the_centre() -> None:
    now = present_motion(circling(8.0, 0.4, 0.15, PAST_S))
    assert now.speed_mps[0] == pytest.approx(8.0, abs=2e-3)  # a chord is shorter than its arc
    assert now.course_rad[0] == pytest.approx(0.0, abs=2e-3)
    assert now.turn_rate_radps[0] == pytest.approx(0.4, abs=1e-6)
    assert now.acceleration_mps2[0] == pytest.approx(0.0, abs=1e-9)


def test_the_integration_of_the_simulator_is_carried_on() -> None:
    """SUMO moves by the speed at the end of a step: the next step is exact."""
    speed = 5.0 + 2.0 * (PAST_S - PAST_S[0])
    x = np.cumsum(speed * DT_S)
    tracks = tracks_of(np.stack((x, 0.0 * x), axis=1)[None], np.zeros((1, len(x))), speed[None])
    found = fallback_motion(tracks)[0, 0, 0] - x[-1]
    assert found == pytest.approx((speed[-1] + 2.0 * DT_S) * DT_S, abs=2e-4)


def test_a_newcomer_goes_straight_on() -> None:
    road = Road([])
    state = perceive(begin(road), scene_of(0.0, {"a": (3.0, 4.0, 0.5, 10.0)}), None)
    heading = np.array([np.cos(0.5), np.sin(0.5)])
    expected = np.array([3.0, 4.0]) + 10.0 * TIMES_S[:, None] * heading
    np.testing.assert_allclose(fallback_motion(state.seen.tracks)[0], expected, atol=1e-9)


def test_noise_is_averaged_and_a_clean_change_is_believed_at_once() -> None:
    rng = np.random.default_rng(1)
    count = 400
    x = 8.0 * PAST_S
    xy = np.stack((x, 0.0 * x), axis=1) + rng.normal(0.0, 0.03, (count, len(x), 2))
    yaw, speed = rng.normal(0.0, 0.01, (2, count, len(x)))
    now = present_motion(tracks_of(xy, yaw, 8.0 + 10.0 * speed))
    last_only = np.diff(8.0 + 10.0 * speed, axis=1)[:, -1] / DT_S
    assert now.acceleration_mps2.std() < 0.45 * last_only.std()
    braked = np.where(PAST_S > -0.15, 8.0 - 4.0 * (PAST_S + 0.1), 8.0)[None]
    clean = present_motion(tracks_of(xy[:1], yaw[:1], braked))
    assert clean.acceleration_mps2[0] < -2.0


def test_standing_vehicles_stand_though_their_positions_shake() -> None:
    rng = np.random.default_rng(2)
    xy = rng.normal(0.0, 0.01, (50, TRACK_FRAMES, 2))
    zero = np.zeros((50, TRACK_FRAMES))
    found = fallback_motion(tracks_of(xy, zero, zero))
    assert np.linalg.norm(found - xy[:, -1:], axis=2).mean() < 0.1
    np.testing.assert_array_equal(fallback_motion(tracks_of(0.0 * xy, zero, zero)), 0.0)


# -- car following ----------------------------------------------------------------------------


def straight() -> Road:
    return Road([lane("long", [(0.0, 0.0), (600.0, 0.0)])])


def seen_on(road: Road, *scenes: Scene, routes: tuple[tuple[str, ...], ...]) -> PerceptionState:
    state = begin(road)
    for scene in scenes:
        state = perceive(state, scene, routes)
    assert (state.seen.lines.line >= 0).all()
    return state


def steady(scene: Scene, acceleration_mps2: float = 0.0) -> Present:
    count = len(scene.ids)
    return Present(
        scene.speed_mps, np.full(count, acceleration_mps2), scene.yaw_rad, np.zeros(count)
    )


def test_acceleration_is_zero_at_the_equilibrium_gap() -> None:
    speed = np.array([2.0, 6.0, 12.0])
    desired = np.full(3, 15.0)
    gap = (2.0 + 0.8 * speed) / np.sqrt(1.0 - (speed / desired) ** 4)
    np.testing.assert_allclose(idm_acceleration(speed, desired, gap, 0.0 * speed), 0.0, atol=1e-12)


def test_free_acceleration_by_hand() -> None:
    no_one = np.full(4, np.inf)
    speed, desired = np.array([0.0, 5.0, 10.0, 20.0]), np.full(4, 10.0)
    found = idm_acceleration(speed, desired, no_one, np.zeros(4))
    # above the desired speed: -3 (1 - (10 / 20)^(1.5 * 4 / 3)) = -3 * 3 / 4
    np.testing.assert_allclose(found, [1.5, 1.5 * 15.0 / 16.0, 0.0, -2.25], atol=1e-12)


def test_a_free_road_by_fine_integration() -> None:
    road = straight()
    scene = scene_of(0.0, {"a": (50.0, 0.0, 0.0, 4.0)})
    state = seen_on(road, scene, routes=(("long",),))
    found = roll_out(road, state.seen, steady(scene))[0]
    speed, travelled, fine_s, expected = 4.0, 0.0, 1e-3, []
    for k in range(3000):
        as_now = np.exp(-k * fine_s / car_following.START_FADE_S)
        speed += (1.0 - as_now) * 1.5 * (1.0 - (speed / 13.9) ** 4) * fine_s
        travelled += speed * fine_s
        if (k + 1) % 100 == 0:
            expected.append(travelled)
    np.testing.assert_allclose(found, expected, atol=0.03)


def test_the_follower_comes_to_the_equilibrium_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(car_following, "HORIZON_FRAMES", 600)
    monkeypatch.setattr(car_following, "START_FADE_S", 0.1)
    road = straight()
    scene = scene_of(0.0, {"a": (60.0, 0.0, 0.0, 8.0), "off": (90.0, 0.5, 0.0, 8.0)})
    state = perceive(begin(road), scene, (("long",), None))
    travelled = roll_out(road, state.seen, steady(scene))[0, -1]
    gap = 90.0 + 8.0 * 60.0 - (60.0 + travelled) - 5.0
    assert gap == pytest.approx((2.0 + 0.8 * 8.0) / np.sqrt(1.0 - (8.0 / 13.9) ** 4), abs=1e-3)


def test_stop_lines_are_stopped_at_and_left_after_a_stop() -> None:
    """The line of `w` ends at x = -8 with a stop line; bumpers are 2.5 m ahead of centres."""
    road = Road(crossing_lanes())
    moving = scene_of(0.0, {"a": (-20.0, 0.0, 0.0, 6.0)})
    state = seen_on(road, moving, routes=(("w", "we", "e"),))
    front = -20.0 + 2.5 + roll_out(road, state.seen, steady(moving, -1.5))[0]
    assert front.max() < -8.0
    standing = scene_of(0.0, {"a": (-11.0, 0.0, 0.0, 0.0)})
    state = seen_on(road, standing, routes=(("w", "we", "e"),))
    front = -11.0 + 2.5 + roll_out(road, state.seen, steady(standing))[0]
    assert front[-1] > -8.0


# -- who is followed at a crossing ------------------------------------------------------------

WEST_EAST, SOUTH_NORTH = ("w", "we", "e"), ("s", "sn", "n")


def at_crossing(**vehicles: tuple[float, float, float, float]) -> PerceptionState:
    scene = scene_of(0.0, vehicles)
    routes = tuple(WEST_EAST if name == "ego" else SOUTH_NORTH for name in vehicles)
    return seen_on(Road(crossing_lanes()), scene, routes=routes)


def followed(state: PerceptionState, closer_by: CloserBy) -> dict[str, str]:
    found = find_meetings(state.road, state.seen, present_motion(state.seen.tracks), closer_by)
    ids = state.seen.scene.ids
    return {ids[a]: ids[b] for a, b in zip(found.follower, found.leader, strict=True)}


NORTH = np.pi / 2.0


def test_who_is_followed_by_distance_and_by_time() -> None:
    """30 m at 8 m/s to the crossing: 3.75 s. Slow is 25 m and 25 s away, quick 10 m and 1 s."""
    state = at_crossing(
        ego=(-30.0, 0.0, 0.0, 8.0),
        slow=(0.0, -25.0, NORTH, 1.0),
        quick=(0.0, -10.0, NORTH, 10.0),
    )
    # Nobody from the south follows the ego, which has a stop line before it.
    assert followed(state, CloserBy.DISTANCE) == {"ego": "slow"}
    assert followed(state, CloserBy.TIME) == {"ego": "quick"}


def test_who_is_later_or_stands_is_not_followed() -> None:
    state = at_crossing(
        ego=(-30.0, 0.0, 0.0, 8.0),
        later=(0.0, -40.0, NORTH, 8.0),
        stands=(0.0, -12.0, NORTH, 0.0),
    )
    assert followed(state, CloserBy.DISTANCE) == {}
    assert followed(state, CloserBy.TIME) == {}


@pytest.mark.parametrize("name", ["fsm_d", "fsm_t"])
def test_the_ego_drops_back_for_whom_it_follows(name: str) -> None:
    state = at_crossing(ego=(-30.0, 0.0, 0.0, 8.0), other=(0.0, -24.0, NORTH, 8.0))
    fsm, idm = load_predictor(name).predict(state), load_predictor("idm").predict(state)
    assert fsm.xy_m[0, 0, -1, 0] < idm.xy_m[0, 0, -1, 0] - 0.5
    np.testing.assert_allclose(fsm.xy_m[1], idm.xy_m[1], atol=1e-9)


# -- what predictors must not see -------------------------------------------------------------


def predicted(name: str, lanes: Sequence[Lane], scenes: Sequence[Scene]) -> dict[str, FloatArray]:
    predictor = load_predictor(name)
    state = predictor.init(Road(lanes))
    for scene in scenes:
        state = predictor.observe(state, scene)
    prediction = predictor.predict(state)
    assert np.isfinite(prediction.xy_m).all()
    return dict(zip(prediction.ids, prediction.xy_m[:, 0], strict=True))


@cache
def unmoved(name: str, scene: str) -> dict[str, FloatArray]:
    return predicted(name, *traffic(scene))


@pytest.mark.parametrize("scene", ["intersection5", "roundabout8"])
@pytest.mark.parametrize("name", NAMES)
def test_turned_shifted_and_in_another_order(name: str, scene: str) -> None:
    rng = np.random.default_rng(5)
    cos, sin = np.cos(2.0), np.sin(2.0)

    def move(xy_m: FloatArray) -> FloatArray:
        return xy_m @ np.array([[cos, sin], [-sin, cos]]) + np.array([300.0, -700.0])

    lanes, scenes = moved(scene, move, 2.0)
    shuffled = [in_order(one, rng.permutation(len(one.ids)).tolist()) for one in scenes]
    found, expected = predicted(name, lanes, shuffled), unmoved(name, scene)
    assert found.keys() == expected.keys()
    for vehicle, xy_m in expected.items():
        np.testing.assert_allclose(found[vehicle], move(xy_m), atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_off_the_road_and_nobody_at_all(name: str) -> None:
    past = [
        scene_of(0.1 * k, {"a": (0.8 * k, 500.0, 0.0, 8.0), "b": (0.0, 600.0, 1.0, 0.0)})
        for k in range(HISTORY_FRAMES)
    ]
    for lanes in ([], crossing_lanes()):
        found = predicted(name, lanes, past)
        np.testing.assert_allclose(found["a"][:, 0], 8.0 + 8.0 * TIMES_S, atol=1e-6)
        np.testing.assert_array_equal(found["b"], np.tile([0.0, 600.0], (30, 1)))
        assert predicted(name, lanes, [scene_of(0.0, {})]) == {}


@pytest.mark.parametrize("name", ["constant_acceleration", "idm", "fsm_d", "fsm_t"])
def test_begins_as_the_motion_now_and_ends_along_the_line(name: str) -> None:
    """Beside a straight lane and slightly turned away: nothing jumps, and it stays beside it."""
    road = straight()
    predictor = load_predictor(name)
    state = predictor.init(road)
    for k in range(HISTORY_FRAMES):
        pose = (50.0 + 0.8 * k, 0.5 + 0.008 * k, 0.01, float(np.hypot(8.0, 0.08)))
        scene = scene_of(0.1 * k, {"a": pose})
        state = predictor.observe(state, scene)
    prediction = predictor.predict(state)
    assert not prediction.fallback[0]
    tracks = state.seen.tracks
    straight_on = continued_xy_m(tracks, present_motion(tracks))[0]
    np.testing.assert_allclose(prediction.xy_m[0, 0, 0], straight_on[0], atol=0.01)
    assert prediction.xy_m[0, 0, -1, 1] == pytest.approx(0.58, abs=1e-3)
