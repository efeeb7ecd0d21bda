"""What agents are made of, against hand-computed answers and chance itself; agents that cross."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import crossing_lanes, lane, scene_of

from hatn_sim.assist.outlines import Boxes, overlap
from hatn_sim.assist.outlines import gap_m as outlines_gap_m
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import DT_S, Advice, Agent, Gate, Lane, Scene
from hatn_sim.loop import Adviser, Driver, run, warm_up
from hatn_sim.planning.courtesy import LAWLESS, RUDE, heedless
from hatn_sim.planning.doubt import AFTER_S, Doubt, doubts_m, learn
from hatn_sim.planning.following import halt_before_m, safe_acceleration
from hatn_sim.planning.occupancy import (
    TIMES_S,
    Occupancy,
    contact_probability,
    ego_boxes,
    predicted_occupancy,
)
from hatn_sim.planning.situation import Situation, begin_driving, guide, look
from hatn_sim.planning.ways import sample_ways
from hatn_sim.plugins import load_agent
from hatn_sim.predictors.constant_velocity import ConstantVelocity
from hatn_sim.road import Road
from hatn_sim.traffic import open_traffic

SIGMAS = np.full((1, len(TIMES_S)), 0.7), np.full((1, len(TIMES_S)), 0.3)
WEST_EAST = ("w", "we", "e")
SOUTH_NORTH = ("s", "sn", "n")
UP = np.pi / 2.0


def seen(
    road: Road,
    vehicles: dict[str, tuple[float, float, float, float]],
    route: tuple[str, ...] = WEST_EAST,
) -> Situation:
    """What "ego" sees at first sight."""
    _, now = look(guide(begin_driving(road), route), "ego", scene_of(0.0, vehicles))
    assert now is not None
    return now


def test_what_a_driver_sees_of_its_way(crossing: Road) -> None:
    now = seen(crossing, {"ego": (-40.0, 0.0, 0.0, 8.0), "ahead": (-25.0, 0.0, 0.0, 5.0)})
    assert now.gap_m == pytest.approx(10.0) and now.leader_mps == 5.0
    assert now.stop_m == pytest.approx(-8.0 - (-40.0 + 2.5), abs=0.01)
    assert not len(now.meetings.other)
    now = seen(crossing, {"ego": (-20.0, 0.0, 0.0, 8.0), "foe": (0.0, -30.0, UP, 8.0)})
    # The strip of the foe is 2 m wide, and each is half its own length long.
    assert now.leader == -1 and now.gap_m == np.inf
    np.testing.assert_allclose(now.meetings.room_m, 20.0 - 1.0 - 2.5, atol=0.3)
    np.testing.assert_allclose(now.meetings.clear_m, 20.0 + 1.0 + 2.5, atol=0.3)
    np.testing.assert_allclose(now.meetings.other_room_m, 30.0 - 3.5, atol=0.3)
    assert not now.meetings.gives_way.any()
    now = seen(crossing, {"ego": (0.0, -20.0, UP, 8.0), "foe": (-30.0, 0.0, 0.0, 8.0)}, SOUTH_NORTH)
    assert now.meetings.gives_way.all() and now.stop_m == now.gate_m == np.inf


def test_who_has_a_line_waits_if_it_still_can_stop_there() -> None:
    stop, give_way = Gate.STOP_LINE, Gate.GIVE_WAY_LINE
    for own, its, own_y, foe_x, foe_mps, waits in (
        (Gate.NONE, stop, -20.0, -30.0, 8.0, True),
        (Gate.NONE, stop, -20.0, -14.0, 6.0, False),  # 3.5 m: 5.1 m/s2
        (give_way, stop, -20.0, -30.0, 8.0, False),  # both have one ahead
        (give_way, stop, -4.0, -30.0, 8.0, True),  # the ego has passed its own
        (give_way, give_way, -4.0, -30.0, 8.0, False),  # and they are equals
    ):
        gates = {"s": own, "w": its}
        lanes = [replace(one, gate=gates.get(one.id, one.gate)) for one in crossing_lanes()]
        here = {"ego": (0.0, own_y, UP, 4.0), "foe": (foe_x, 0.0, 0.0, foe_mps)}
        now = seen(Road(lanes), here, SOUTH_NORTH)
        has_line = own is give_way and own_y == -20.0
        assert now.gate_m == (pytest.approx(20.0 - 2.5 - 8.0) if has_line else np.inf)
        assert now.stop_m == np.inf
        assert now.meetings.will_wait.tolist() == [waits], (own, its, own_y, foe_x)


def test_the_way_is_the_one_it_was_told(crossing: Road) -> None:
    here = {"ego": (-20.0, 0.0, 0.0, 6.0)}
    for route in (WEST_EAST, ("w", "wn", "n")):
        assert seen(crossing, here, route).line == crossing.line(route)


def test_every_line_of_a_long_way_is_seen() -> None:
    """30 stop lines, more than a line of the road has room for."""
    lanes = []
    for k in range(30):
        x = 60.0 * k
        lanes.append(lane(f"a{k}", [(x, 0), (x + 50, 0)], f"c{k}", gate=Gate.STOP_LINE))
        after = [f"a{k + 1}"] if k < 29 else []
        lanes.append(lane(f"c{k}", [(x + 50, 0), (x + 60, 0)], *after, is_connection=True))
    road, route = Road(lanes), tuple(one.id for one in lanes)
    for k in (0, 10, 23, 24, 29):
        now = seen(road, {"ego": (60.0 * k + 20.0, 0.5, 0.0, 8.0)}, route)
        assert now.stop_m == pytest.approx(30.0 - 2.5, abs=0.01), k
        assert now.lines.d_m[now.ego] == pytest.approx(0.5)


def test_a_stop_line_is_kept_until_one_has_stood_at_it(crossing: Road) -> None:
    state = guide(begin_driving(crossing), WEST_EAST)
    stops: list[float] = []
    for frame, (x, speed) in enumerate([(-12.0, 2.0), (-11.0, 0.1), (-10.9, 1.0), (-10.6, 3.0)]):
        state, now = look(state, "ego", scene_of(0.1 * frame, {"ego": (x, 0.0, 0.0, speed)}))
        assert now is not None
        stops.append(now.stop_m)
    np.testing.assert_allclose(stops, [1.5, np.inf, np.inf, np.inf], atol=0.01)
    assert look(state, "nobody", scene_of(1.0, {}))[1] is None


@pytest.mark.parametrize(
    ("foe", "waits"),
    [
        ((0.0, -25.0, UP, 10.0), True),  # would be there at the same time
        ((0.0, 0.0, UP, 0.0), True),  # stands in the way
        ((0.0, -70.0, UP, 8.0), False),  # far
        ((0.0, 12.0, UP, 8.0), False),  # has been there
        ((0.0, -10.0, UP, 0.0), False),  # stands before
    ],
)
def test_whom_a_plain_driver_waits_for(
    crossing: Road, foe: tuple[float, float, float, float], waits: bool
) -> None:
    now = seen(crossing, {"ego": (-20.0, 0.0, 0.0, 6.0), "foe": foe}, WEST_EAST)
    now = replace(now, stop_m=np.inf)
    assert np.isfinite(halt_before_m(now)) == waits
    if waits:
        assert halt_before_m(now) == pytest.approx(20.0 - 3.5 - 1.0, abs=0.3)
        assert safe_acceleration(now, halt_before_m(now)) < safe_acceleration(now)


def test_contact_is_about_as_likely_as_chance_says() -> None:
    random = np.random.default_rng(5)
    draws = 40000
    along, across = 1.2, 0.5
    for ego_at, ego_yaw, tight in (
        ((0.0, 0.0), 0.0, True),
        ((3.0, 1.0), 0.0, True),
        ((5.2, 0.5), np.pi / 2, True),
        ((1.0, 2.5), 0.6, False),
        ((4.0, 2.0), 2.2, False),
    ):
        size = np.array([5.0, 2.0])
        ego = Boxes(np.array(ego_at)[None, None], np.full((1, 1), ego_yaw), size[None, None])
        other = Boxes(np.zeros((1, 1, 1, 2)), np.zeros((1, 1, 1)), size[None, None, None])
        occupied = Occupancy(
            np.zeros(1, np.int64), np.ones((1, 1)), other, np.full((1, 1), along),
            np.full((1, 1), across),
        )  # fmt: skip
        said = float(contact_probability(ego, occupied, 0.0)[0, 0, 0])
        off = random.normal(size=(draws, 2)) * (along, across)
        boxes = Boxes(off, np.zeros(draws), np.broadcast_to(size, (draws, 2)))
        share = float(overlap(ego[0], boxes).mean())
        assert said >= share - 0.01
        if tight:  # along the axes it is exact
            assert said == pytest.approx(share, abs=0.01)
        else:
            assert said <= share + 0.3


def test_a_likelier_mode_counts_more_and_gone_ones_not_at_all(crossing: Road) -> None:
    now = seen(crossing, {"ego": (-20.0, 0.0, 0.0, 8.0), "foe": (0.0, -20.0, UP, 8.0)})
    prediction = ConstantVelocity().predict(now.scene)
    stays = np.repeat(now.scene.xy_m[:, None, None], 30, axis=2)
    both = replace(
        prediction,
        xy_m=np.concatenate((prediction.xy_m, stays), axis=1),
        mode_probability=np.array([[1.0, 0.0], [0.25, 0.75]]),
    )
    sigmas = np.full((2, len(TIMES_S)), 0.5)
    others = predicted_occupancy(now, both, sigmas, sigmas)
    travelled = 8.0 * TIMES_S[None]
    contact = contact_probability(ego_boxes(now, travelled), others, 0.0)
    assert contact.shape == (1, 1, 2)
    assert contact[0, 0, 0] > 0.9 and contact[0, 0, 1] < 1e-6
    # The foe could stop gently for who is there before it, but not from where they meet at once.
    np.testing.assert_array_equal(heedless(now, travelled, others)[0, 0], [1.0, RUDE])
    sooner = heedless(now, 40.0 * TIMES_S[None], others)[0, 0]
    np.testing.assert_array_equal(sooner, [1.0, RUDE])
    lawful = replace(now, meetings=replace(now.meetings, gives_way=np.ones(1, np.bool_)))
    assert heedless(lawful, travelled, others)[0, 0, 1] == LAWLESS


def test_doubt_is_learnt_from_what_became_of_predictions() -> None:
    random = np.random.default_rng(3)
    truth = {f"v{k}": (0.0, 10.0 * k, 0.0, 8.0) for k in range(20)}
    predictor, doubt = ConstantVelocity(), Doubt()
    biased_m = 0.4 * random.normal(size=(20, 1, 1, 1))
    for frame in range(80):
        time_s = DT_S * frame
        scene = scene_of(
            time_s, {name: (x + v * time_s, y, yaw, v) for name, (x, y, yaw, v) in truth.items()}
        )
        prediction = predictor.predict(scene)
        # Along the way it is wrong by so much at all times, across it is right.
        wrong = prediction.xy_m + biased_m * np.array([1.0, 0.0])
        doubt = learn(doubt, scene, replace(prediction, xy_m=wrong), "v0")
    along, across = doubts_m(doubt, scene)
    known = float(np.sqrt((biased_m[1:] ** 2).mean()))
    at = np.searchsorted(TIMES_S, AFTER_S[-1] - 1e-9)
    assert along.shape == (20, len(TIMES_S))
    # What was assumed at first weighs on; with 180 to 280 comparisons it is the smaller part.
    assert known < along[0, at] < known + 0.6
    assert across[0, at] < 0.2 < along[0, at]
    assert (np.diff(along[0]) >= -1e-9).all() or along[0, -1] > 0.0
    still = scene_of(0.0, {"v1": (0.0, 0.0, 0.0, 0.0)})
    assert doubts_m(doubt, still)[0][0, at] == pytest.approx(1.3)  # nobody stood yet


def test_to_wait_before_the_next_area_is_always_possible(crossing: Road) -> None:
    now = seen(crossing, {"ego": (-30.0, 0.0, 0.0, 8.0), "foe": (0.0, -20.0, UP, 8.0)})
    now = replace(now, stop_m=np.inf)
    ways = sample_ways(now, ConstantVelocity().predict(now.scene), 0.0)
    room_m = float(now.meetings.room_m[0])
    assert (ways.travelled_m[:, -1] < room_m).any() and (ways.travelled_m[:, -1] > room_m).any()
    assert (np.diff(ways.travelled_m, axis=1) >= -1e-9).all()
    assert ways.travelled_m[0, -1] == ways.travelled_m[:, -1].max()
    assert ways.acceleration_mps2.max() <= 2.0 + 1e-6


def crossed(agent: Agent, road: Road, foe_mps: float, foe_from_m: float) -> tuple[float, float]:
    """When the ego is over the crossing, and how near it came to a foe that never brakes."""
    predictor = ConstantVelocity()
    state, x, speed, nearest = agent.init(road), -40.0, 8.0, np.inf
    guide_of = getattr(agent, "guide", None)
    for frame in range(400):
        scene = scene_of(
            DT_S * frame,
            {
                "ego": (x, 0.0, 0.0, speed),
                "foe": (0.0, foe_from_m + foe_mps * DT_S * frame, UP, foe_mps),
            },
        )
        nearest = min(nearest, gap_m(scene))
        if x > 12.0:
            return DT_S * frame, nearest
        if guide_of is not None:
            state = guide_of(state, WEST_EAST)
        state, command = agent.step(state, "ego", scene, Advice(predictor.predict(scene), (), ()))
        assert command is not None
        speed = max(speed + DT_S * command.acceleration_mps2, 0.0)
        x += DT_S * speed
    return np.inf, nearest


def gap_m(scene: Scene) -> float:
    boxes = Boxes(scene.xy_m, scene.yaw_rad, scene.size_m)
    return float(outlines_gap_m(boxes[0], boxes[1]))


@pytest.mark.parametrize("name", ["idm", "mpc", "heed"])
@pytest.mark.parametrize("foe_from_m", [-55.0, -70.0, -85.0, -100.0])
def test_an_agent_lets_go_whoever_does_not_brake_and_then_crosses(
    crossing: Road, name: str, foe_from_m: float
) -> None:
    time_s, nearest_m = crossed(load_agent(name), crossing, 9.0, foe_from_m)
    assert nearest_m > 0.5
    assert time_s < 30.0


ONCOMING_M = 1.75
"""From the middle of the road to that of either lane."""


def left_turn_lanes(radius_m: float) -> list[Lane]:
    """From the west, left round to the north, across a lane from the east; gives way at x = -8."""
    angle = np.linspace(0.0, np.pi / 2, 61)
    x, y = -8.0 + radius_m * np.sin(angle), radius_m * (1.0 - np.cos(angle)) - ONCOMING_M
    arc = list(zip(x.tolist(), y.tolist(), strict=True))
    start = [(-108.0, -ONCOMING_M), (-8.0, -ONCOMING_M)]
    return [
        lane("w", start, "wn", gate=Gate.GIVE_WAY_LINE),
        lane("wn", arc, "n", is_connection=True, turn=1),
        lane("n", [arc[-1], (arc[-1][0], arc[-1][1] + 150.0)]),
        lane("e", [(150.0, ONCOMING_M), (40.0, ONCOMING_M)], "ew"),
        lane("ew", [(40.0, ONCOMING_M), (-20.0, ONCOMING_M)], "o", is_connection=True),
        lane("o", [(-20.0, ONCOMING_M), (-150.0, ONCOMING_M)]),
    ]


@pytest.mark.parametrize("name", ["idm", "mpc"])
@pytest.mark.parametrize("radius_m", [12.0, 30.0])
def test_who_waits_to_turn_left_keeps_its_nose_out_of_oncoming_traffic(
    name: str, radius_m: float
) -> None:
    road, agent = Road(left_turn_lanes(radius_m)), load_agent(name)
    route = ("w", "wn", "n")
    line, state = np.array([road.line(route)]), agent.init(road)
    s_m, speed, nearest_m, slowest_mps = 60.0, 8.0, np.inf, np.inf
    for frame in range(700):
        at_s_m = np.array([s_m])
        (at_m,), yaw = road.locate(line, at_s_m, np.zeros(1)), road.line_yaw_rad(line, at_s_m)
        cars = {"ego": (at_m[0], at_m[1], float(yaw[0]), speed)}
        # Eight who never brake, at 10 m/s and 4.5 s apart: less than a left turn takes.
        places = {f"{k}": 60.0 + 45.0 * k - 10.0 * DT_S * frame for k in range(8)}
        cars |= {k: (x, ONCOMING_M, np.pi, 10.0) for k, x in places.items() if abs(x) < 140.0}
        scene = scene_of(DT_S * frame, cars)
        boxes = Boxes(scene.xy_m, scene.yaw_rad, scene.size_m)
        for k in range(1, len(cars)):
            nearest_m = min(nearest_m, float(outlines_gap_m(boxes[0], boxes[k])))
        slowest_mps = min(slowest_mps, speed)
        if s_m > 150.0:
            break
        state = agent.guide(state, route)
        advice = Advice(ConstantVelocity().predict(scene), (), ())
        state, command = agent.step(state, "ego", scene, advice)
        assert command is not None
        speed = max(speed + DT_S * command.acceleration_mps2, 0.0)
        s_m += DT_S * speed
    assert slowest_mps < 4.0  # it had to let somebody go
    assert nearest_m > 0.25
    assert s_m > 150.0  # and did cross


def test_an_agent_stops_at_the_stop_line(crossing: Road) -> None:
    agent = load_agent("mpc")
    state, x, speed, slowest = agent.init(crossing), -40.0, 8.0, 8.0
    for frame in range(200):
        scene = scene_of(DT_S * frame, {"ego": (x, 0.0, 0.0, speed)})
        advice = Advice(ConstantVelocity().predict(scene), (), ())
        state, command = agent.step(state, "ego", scene, advice)
        assert command is not None
        speed = max(speed + DT_S * command.acceleration_mps2, 0.0)
        x += DT_S * speed
        if x + 2.5 < -8.0:
            slowest = min(slowest, speed)
    assert slowest < 0.3 and x > 12.0


@pytest.mark.parametrize(
    ("name", "scene"),
    [
        *((name, "highway_intersection") for name in ("idm", "heed", "hatn_planner", "mpc")),
        ("idm", "highway_roundabout"),
        *(
            pytest.param(name, "highway_roundabout", marks=pytest.mark.slow)
            for name in ("heed", "hatn_planner", "mpc")
        ),
    ],
)
def test_agents_drive_in_highway_env(scene: str, name: str) -> None:
    simulator = open_traffic(load_scenario(scene))
    places: list[np.ndarray] = []
    frame = warm_up(simulator, simulator.reset(3), 0)
    advisers = [Adviser(ConstantVelocity(), egos=frozenset({"ego"}))]
    drivers = {"ego": Driver(load_agent(name))}

    def note(_: int, frame: object, __: object) -> None:
        scene: Scene = frame.scene  # type: ignore[attr-defined]
        if "ego" in scene.ids:
            places.append(scene.xy_m[scene.ids.index("ego")])

    run(simulator, advisers, frame, 40, note, drivers)
    simulator.close()
    assert np.linalg.norm(places[-1] - places[0]) > 5.0
