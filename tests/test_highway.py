"""highway-env as a source of frames: against its own vehicles, geometry by hand, and itself."""

from __future__ import annotations

import itertools
import logging
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from conftest import scene_of, slow_but
from highway_env.envs.intersection_env import ConnectedLaneIntersectionEnv
from highway_env.envs.roundabout_env import ConnectedLaneRoundaboutEnv
from highway_env.vehicle.behavior import IDMVehicle

from hatn_sim.config import HighwaySource, Scenario, load_scenario
from hatn_sim.datatypes import Command, ConflictType, Frame, Gate, Kind, Lane
from hatn_sim.errors import InputError, SimulatorError
from hatn_sim.geometry import wrap_angle
from hatn_sim.score.fidelity import Closeness, measure_fidelity
from hatn_sim.simulators.highway import HighwaySimulator
from hatn_sim.simulators.highway_environment import known_environments
from hatn_sim.simulators.highway_places import RegularRing, RegulatedJunction
from hatn_sim.simulators.touching import touching_pairs
from hatn_sim.traffic import open_traffic

PLACES = ("learn_highway_crossing", "learn_highway_roundabout3", "learn_highway_tee")
SCENES = ("highway_intersection", "highway_roundabout", "highway_merge", *PLACES)


def scenario(environment: str, scale: float = 1.0, **settings: Any) -> Scenario:
    return Scenario(
        name=environment,
        config_path=Path("scenario.toml"),
        simulator="highway",
        scale=scale,
        highway=HighwaySource(environment, settings),
    )


def record(simulator: HighwaySimulator, seed: int, seconds: float) -> list[Frame]:
    frames = [simulator.reset(seed)]
    return frames + [simulator.step() for _ in range(round(seconds * 10))]


def same(one: Frame, other: Frame) -> bool:
    return (
        one.scene.ids == other.scene.ids
        and one.scene.time_s == other.scene.time_s
        and np.array_equal(one.scene.xy_m, other.scene.xy_m)
        and np.array_equal(one.scene.yaw_rad, other.scene.yaw_rad)
        and np.array_equal(one.scene.speed_mps, other.scene.speed_mps)
        and vars(one.truth) == vars(other.truth)
    )


def path_of(frames: list[Frame], name: str) -> np.ndarray:
    """x, y, yaw, speed [T, 4] of a vehicle while it is there."""
    rows: list[np.ndarray] = []
    for frame in frames:
        if name in frame.scene.ids:
            i = frame.scene.ids.index(name)
            scene = frame.scene
            rows.append(np.array([*scene.xy_m[i], scene.yaw_rad[i], scene.speed_mps[i]]))
    return np.array(rows)


@pytest.fixture(scope="module")
def intersection() -> list[Frame]:
    """30 s of the shipped intersection."""
    with HighwaySimulator(load_scenario("highway_intersection", density="dense")) as simulator:
        return record(simulator, 1, 30.0)


# ---------------------------------------------------------------------------------------------
# Frames


def test_frames_come_at_10_hz_and_vehicles_move_at_their_speed(intersection: list[Frame]) -> None:
    assert [frame.scene.time_s for frame in intersection] == pytest.approx(
        np.arange(len(intersection)) * 0.1
    )
    for name in ("ego", *intersection[0].scene.ids[:3]):
        path = path_of(intersection, name)
        step_m = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1)
        # Two steps of 0.05 s each, at speeds that change by at most 6 m/s2 in between.
        assert np.abs(step_m - 0.1 * path[1:, 3]).max() < 0.1 * 6.0 * 0.1 + 1e-9


def test_the_axes_are_mirrored_back() -> None:
    """highway-env's ego comes from the south (its y grows downward) and turns to node o1: west."""
    with HighwaySimulator(scenario("intersection-v2", destination="o1")) as simulator:
        first = simulator.reset(4)
        raw: Any = simulator._environment  # pyright: ignore[reportPrivateUsage]
        ego = raw.road.vehicles[first.scene.ids.index("ego")]
        i = first.scene.ids.index("ego")
        assert ego.position[1] > 0 > first.scene.xy_m[i, 1]
        assert first.scene.xy_m[i] == pytest.approx(ego.position * [1, -1])
        assert first.scene.yaw_rad[i] == pytest.approx(np.pi / 2)  # northward
        path = path_of([first, *(simulator.step() for _ in range(250))], "ego")
    assert path[-1, 0] < -20.0 and abs(path[-1, 1] - 2.0) < 0.5  # on the right of the way west
    turned = np.unwrap(path[:, 2])
    assert turned[-1] - turned[0] == pytest.approx(np.pi / 2, abs=0.05)  # to the left


def test_the_same_seed_gives_the_same_frames_whoever_else_drives() -> None:
    made = load_scenario("highway_intersection", density="dense")
    numbers = np.random.get_state()[1].tolist()  # type: ignore[index]
    with HighwaySimulator(made) as one, HighwaySimulator(made) as other:
        first = record(one, 7, 4.0)
        again = record(one, 7, 4.0)
        third = [other.reset(7)]
        with HighwaySimulator(load_scenario("highway_roundabout")) as noise:
            noise.reset(1)
            for _ in range(40):
                third.append(other.step())
                noise.step()
        elsewhere = record(other, 8, 4.0)
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    assert all(same(a, b) for a, b in zip(first, third, strict=True))
    assert not same(first[-1], elsewhere[-1])
    assert np.random.get_state()[1].tolist() == numbers  # type: ignore[index]


def test_the_drivers_of_one_environment_are_not_those_of_another() -> None:
    """highway-env's intersection sets parameters of a class that all environments share."""
    before = IDMVehicle.DISTANCE_WANTED, IDMVehicle.COMFORT_ACC_MAX
    with HighwaySimulator(scenario("merge-v1")) as merge:
        alone = record(merge, 3, 4.0)
        with HighwaySimulator(scenario("intersection-v2")) as crossing:
            crossing.reset(1)
            vehicles: Any = crossing._environment.road.vehicles  # type: ignore[union-attr]
            assert {vehicle.DISTANCE_WANTED for vehicle in vehicles} == {7}
            assert all(same(a, b) for a, b in zip(alone, record(merge, 3, 4.0), strict=True))
    assert before == (IDMVehicle.DISTANCE_WANTED, IDMVehicle.COMFORT_ACC_MAX)


def test_names_are_unique_and_stay(intersection: list[Frame]) -> None:
    seen: set[str] = set()
    last: set[str] = set()
    for frame in intersection:
        ids = set(frame.scene.ids)
        assert len(ids) == len(frame.scene.ids)
        departed = set(frame.truth.departed)
        assert departed == ids - last and not departed & seen
        assert last - ids == set(frame.truth.arrived) | set(frame.truth.teleported)
        seen, last = seen | ids, ids
    assert "ego" in seen and seen > set(intersection[0].scene.ids)  # others came in


def test_what_a_camera_sees_of_the_vehicles(intersection: list[Frame]) -> None:
    scene = intersection[0].scene
    assert set(scene.kind.tolist()) == {Kind.CAR}
    assert (scene.size_m == [5.0, 2.0]).all()
    assert not scene.blinker.any() and len(scene.signal_closed) == 0
    ego = scene.ids.index("ego")
    others = np.delete(scene.colour, ego, axis=0)
    assert (others == others[0]).all() and (others[0] != scene.colour[ego]).any()
    assert min(frame.scene.speed_mps.min() for frame in intersection) >= -1e-9


def test_traffic_goes_on_past_the_episode_and_scales() -> None:
    with HighwaySimulator(scenario("merge-v1", spawn_probability=0.3)) as simulator:
        frames = record(simulator, 1, 40.0)
    assert "ego" not in frames[-1].scene.ids  # highway-env ends when its ego is at 370 m
    assert frames[-1].scene.ids and not frames[-1].done
    came = sum(len(frame.truth.departed) for frame in frames[1:])
    assert 4 <= came <= 20  # 12 are expected where there is room for all
    with HighwaySimulator(scenario("merge-v1", 3.0, spawn_probability=0.3)) as simulator:
        more = sum(len(frame.truth.departed) for frame in record(simulator, 1, 40.0)[1:])
    assert more > came


def test_without_anybody_to_come_it_ends() -> None:
    with HighwaySimulator(scenario("merge-v1", spawn_probability=0.0)) as simulator:
        simulator.reset(1)
        for _ in range(600):
            frame = simulator.step()
            if frame.done:
                break
    assert frame.done and frame.scene.ids == ()


# ---------------------------------------------------------------------------------------------
# Commands


def test_commands_set_the_acceleration_of_any_vehicle() -> None:
    with HighwaySimulator(load_scenario("highway_intersection")) as simulator:
        frame = simulator.reset(2)
        other = next(name for name in frame.scene.ids if name != "ego")
        start = {name: path_of([frame], name)[0] for name in ("ego", other)}
        for _ in range(10):
            frame = simulator.step([Command("ego", -2.0), Command(other, 1.0), Command("no", 1.0)])
        assert path_of([frame], "ego")[0, 3] == pytest.approx(start["ego"][3] - 2.0)
        assert path_of([frame], other)[0, 3] == pytest.approx(start[other][3] + 1.0)
        for _ in range(80):
            frame = simulator.step([Command("ego", -2.0)])
        assert path_of([frame], "ego")[0, 3] == pytest.approx(0.0)  # stands, and goes not back
        for _ in range(20):
            frame = simulator.step()
        assert path_of([frame], "ego")[0, 3] > 0.5  # its own driver again


def test_a_commanded_vehicle_keeps_its_lane() -> None:
    alone = {"spawn_probability": 0.0, "initial_vehicle_count": 1, "destination": "o1"}
    with HighwaySimulator(scenario("intersection-v2", **alone)) as simulator:
        first = simulator.reset(4)
        frames = [first]
        while "ego" in frames[-1].scene.ids:
            frames.append(simulator.step([Command("ego", 0.0)]))
        rows = measure_fidelity(frames, simulator.road)
    path = path_of(frames, "ego")
    assert np.ptp(path[:, 3]) < 1e-9
    turned_rad = wrap_angle(np.array([path[-1, 2] - path[0, 2]]))
    assert turned_rad == pytest.approx(np.pi / 2, abs=0.05)
    assert rows[0].max_m is not None and rows[0].max_m < 1.0


# ---------------------------------------------------------------------------------------------
# Lanes


def starts(lanes: list[Lane]) -> list[Lane]:
    fed = {name for lane in lanes for name in lane.successors}
    return [lane for lane in lanes if lane.id not in fed]


def test_the_intersection_has_12_lines_and_28_conflicts() -> None:
    with HighwaySimulator(load_scenario("highway_intersection")) as simulator:
        road, lanes = simulator.road, simulator.lanes
    entries = starts(lanes)
    assert sorted(lane.id for lane in entries) == [f"o{arm}_ir{arm}_0" for arm in range(4)]
    lines = sorted({k for lane in entries for k in road.branches((lane.id,), Kind.CAR)})
    assert len(lines) == 12
    conflicts = [road.conflicts(a, b) for a, b in itertools.combinations(lines, 2)]
    assert sum(len(found) for found in conflicts) == 28
    # Arm 0 is south: a right turn leads to the east, a left turn to the west.
    turns = {lane.id: lane.turn for lane in lanes if lane.is_connection}
    assert {key: turns[key] for key in turns if key.startswith("ir0")} == {
        "ir0_il3_0": -1,
        "ir0_il2_0": 0,
        "ir0_il1_0": 1,
    }
    gates = {lane.id: lane.gate for lane in entries}
    assert [gates[f"o{arm}_ir{arm}_0"] for arm in (0, 2)] == [Gate.GIVE_WAY_LINE] * 2
    assert [gates[f"o{arm}_ir{arm}_0"] for arm in (1, 3)] == [Gate.NONE] * 2


@pytest.mark.parametrize("name", SCENES)
def test_lanes_meet_their_successors(name: str) -> None:
    with HighwaySimulator(load_scenario(name)) as simulator:
        lanes = {lane.id: lane for lane in simulator.lanes}
    for lane in lanes.values():
        for successor in lane.successors:
            other = lanes[successor]
            assert np.linalg.norm(other.xy_m[0] - lane.xy_m[-1]) < 0.3, (lane.id, successor)
            out, into = lane.xy_m[-1] - lane.xy_m[-2], other.xy_m[1] - other.xy_m[0]
            angle = np.arctan2(out[0] * into[1] - out[1] * into[0], out @ into)
            assert abs(angle) < 0.5, (lane.id, successor)


def test_the_roundabout_leads_from_every_arm_to_every_arm() -> None:
    with HighwaySimulator(load_scenario("highway_roundabout")) as simulator:
        lanes = {lane.id: lane for lane in simulator.lanes}
        entries = starts(simulator.lanes)
    assert sorted(lane.id for lane in entries) == [f"{arm}er_{arm}es_0" for arm in "ensw"]
    for entry in entries:
        reached, waiting = {entry.id}, [entry.id]
        while waiting:
            fresh = set(lanes[waiting.pop()].successors) - reached
            reached |= fresh
            waiting += fresh
        assert {f"{arm}xs_{arm}xr_0" for arm in "ensw"} <= reached


def test_the_ramp_leads_onto_the_highway_and_conflicts_with_it() -> None:
    with HighwaySimulator(load_scenario("highway_merge")) as simulator:
        road = simulator.road
    (ramp,) = road.branches(("k_b_0",), Kind.CAR)
    assert road.lines[ramp].route[-2:] == ("b_c_2>c_d_1", "c_d_1")
    right, left = (road.branches((name,), Kind.CAR)[0] for name in ("a_b_1", "a_b_0"))
    assert len(road.conflicts(ramp, right)) == 1
    assert road.conflicts(ramp, left) == ()


def lines_of(simulator: HighwaySimulator) -> list[Any]:
    """The keys of all lines from where traffic comes in."""
    return sorted(
        {
            key
            for lane in starts(simulator.lanes)
            for key in simulator.road.branches((lane.id,), Kind.CAR)
        }
    )


def conflict_types(simulator: HighwaySimulator) -> Counter[ConflictType]:
    road = simulator.road
    pairs = itertools.combinations(lines_of(simulator), 2)
    return Counter(found.type for a, b in pairs for found in road.conflicts(a, b))


def test_a_t_junction_has_three_crossings_and_three_merges() -> None:
    """As in any textbook of traffic."""
    with HighwaySimulator(load_scenario("learn_highway_tee")) as simulator:
        assert len(lines_of(simulator)) == 6
        assert conflict_types(simulator) == {ConflictType.CROSS: 3, ConflictType.MERGE: 3}
        gates = {lane.id: lane.gate for lane in starts(simulator.lanes)}
        turns = {lane.id: lane.turn for lane in simulator.lanes if lane.turn}
    assert gates == {
        "o0_ir0_0": Gate.NONE,
        "o1_ir1_0": Gate.NONE,
        "o2_ir2_0": Gate.GIVE_WAY_LINE,
    }
    # The side road is in the south-east: who comes from the east turns left into it.
    assert turns == {"ir0_il2_0": 1, "ir1_il2_0": -1, "ir2_il0_0": -1, "ir2_il1_0": 1}


def test_two_roads_without_left_turns_cross_four_times() -> None:
    with HighwaySimulator(load_scenario("learn_highway_crossing")) as simulator:
        assert len(lines_of(simulator)) == 8
        assert conflict_types(simulator) == {ConflictType.CROSS: 4, ConflictType.MERGE: 4}


def test_the_ring_turned_and_scaled_is_that_of_highway_env() -> None:
    """With its arms, radius and limits: every lane by its ends, headings and length."""
    own: Any = ConnectedLaneRoundaboutEnv().unwrapped
    ours: Any = RegularRing(config={"bearings_deg": [90, 0, -90, 180], "access_m": 127.5})

    def shapes(environment: Any) -> list[list[float]]:
        return sorted(
            np.round(
                [
                    *lane.position(0.0, 0.0),
                    *lane.position(lane.length, 0.0),
                    *np.sin([lane.heading_at(0.0), lane.heading_at(lane.length)]),
                    lane.length,
                    lane.speed_limit,
                ],
                6,
            ).tolist()
            for lane in environment.road.network.lanes_dict().values()
        )

    assert np.allclose(shapes(ours), shapes(own), atol=1e-5)


def test_a_junction_with_four_square_arms_is_that_of_highway_env() -> None:
    """Its ways, and the priorities of those who come in; those who leave have the highest here."""
    own: Any = ConnectedLaneIntersectionEnv().unwrapped
    arm = {"length_m": 100.0, "speed_limit_mps": 10.0}
    priorities = {90: 1, 180: 3, 270: 1, 0: 3}
    arms = [arm | {"bearing_deg": float(b), "priority": p} for b, p in priorities.items()]
    ours: Any = RegulatedJunction(config={"arms": arms, "inner_m": 11.0})
    lanes, same = own.road.network.lanes_dict(), ours.road.network.lanes_dict()
    assert set(lanes) == set(same)
    for index, lane in lanes.items():
        other = same[index]
        for part in (0.0, 0.5, 1.0):
            place = other.position(part * other.length, 0.0)
            assert place == pytest.approx(lane.position(part * lane.length, 0.0), abs=1e-6)
        assert other.speed_limit == lane.speed_limit
        assert other.priority == (3 if index[0].startswith("il") else lane.priority)


@pytest.mark.parametrize("name", slow_but(PLACES, "learn_highway_roundabout3"))
def test_traffic_of_our_places_flows(name: str) -> None:
    """Most of those who came in are through, from every arm, and hardly anybody is taken off."""
    with HighwaySimulator(load_scenario(name, density="dense")) as simulator:
        frames = record(simulator, 4, 90.0)
        entered = {lane.id for lane in starts(simulator.lanes)}
    came = [vehicle for frame in frames for vehicle in frame.truth.departed]
    arrived = {vehicle for frame in frames for vehicle in frame.truth.arrived}
    removed = [vehicle for frame in frames for vehicle in frame.truth.teleported]
    first: dict[str, str] = {}
    for frame in frames:
        for vehicle, route in zip(frame.scene.ids, frame.truth.routes, strict=True):
            first.setdefault(vehicle, (route or ("",))[0])
    assert {first[vehicle] for vehicle in arrived} == entered
    assert len(arrived) > 0.6 * len(came) and len(came) >= 8
    assert len(removed) <= 2


@pytest.mark.parametrize(
    "name", slow_but(SCENES, "highway_intersection", "highway_merge", "learn_highway_tee")
)
def test_vehicles_are_within_a_metre_of_their_lines(name: str) -> None:
    # Our places begin with one vehicle.
    density, seconds = ("dense", 60) if name in PLACES else ("normal", 30)
    with HighwaySimulator(load_scenario(name, density=density)) as simulator:
        simulator.reset(11)
        rows = measure_fidelity((simulator.step() for _ in range(10 * seconds)), simulator.road)
    keeping = {row.mode: row for row in rows if row.state == "keeping lane"}
    for row in keeping.values():
        assert isinstance(row, Closeness) and row.n > 500
        assert row.q99_m is not None and row.q99_m < 1.0
        assert row.within_1_m is not None and row.within_1_m > 0.995
        assert row.max_m is not None and row.max_m < 1.5


def test_routes_are_driven_as_they_are_told(intersection: list[Frame]) -> None:
    """The first route of a vehicle that never left its lane is that of its last frame."""
    first: dict[str, tuple[str, ...] | None] = {}
    for frame in intersection:
        for name, route in zip(frame.scene.ids, frame.truth.routes, strict=True):
            assert first.setdefault(name, route) == route
    for route in first.values():
        assert route is not None and len(route) == 3


# ---------------------------------------------------------------------------------------------
# Collisions


def test_touching_outlines_against_shapely() -> None:
    random = np.random.default_rng(0)
    for _ in range(50):
        places = random.uniform(-8, 8, (8, 2))
        yaw = random.uniform(-np.pi, np.pi, 8)
        scene = scene_of(
            0.0,
            {f"v{k}": (*places[k], yaw[k], 0.0) for k in range(8)},  # type: ignore[dict-item]
        )
        boxes = [
            shapely.affinity.translate(
                shapely.affinity.rotate(shapely.box(-2.5, -1, 2.5, 1), angle, use_radians=True), *xy
            )
            for xy, angle in zip(places, yaw, strict=True)
        ]
        expected = tuple(
            (f"v{i}", f"v{j}")
            for i, j in itertools.combinations(range(8), 2)
            if boxes[i].intersects(boxes[j])
        )
        assert touching_pairs(scene) == expected


def test_a_collision_is_seen_and_cleared() -> None:
    """The last vehicle drives on at 31 m/s without looking; the others slow down to 20 m/s."""
    with HighwaySimulator(scenario("merge-v1", spawn_probability=0.0)) as simulator:
        frame = simulator.reset(1)
        last = frame.scene.ids[int(frame.scene.xy_m[:, 0].argmin())]
        touched: dict[tuple[str, str], float] = {}
        removed: dict[str, float] = {}
        while not removed:
            frame = simulator.step([Command(last, 0.0)])
            for pair in frame.truth.collisions:
                touched.setdefault(pair, frame.scene.time_s)
            removed |= dict.fromkeys(frame.truth.teleported, frame.scene.time_s)
    ((pair, touched_s),) = touched.items()
    assert last in pair and set(removed) == set(pair)
    assert list(removed.values()) == pytest.approx([touched_s + 3.0] * 2, abs=0.15)


# ---------------------------------------------------------------------------------------------
# Any environment, and bad input


@pytest.mark.parametrize("environment", known_environments())
def test_every_environment_with_roads_runs(environment: str) -> None:
    settings = {"vehicles_count": 6} if environment.startswith(("highway", "exit")) else {}
    with HighwaySimulator(scenario(environment, **settings)) as simulator:
        names = {lane.id for lane in simulator.lanes}
        assert all(set(lane.successors) <= names for lane in simulator.lanes)
        frames = record(simulator, 1, 1.0)
        assert all(same(a, b) for a, b in zip(frames, record(simulator, 1, 1.0), strict=True))
    assert frames[-1].scene.ids
    for route in frames[-1].truth.routes:
        assert route is None or set(route) <= names


@pytest.mark.parametrize(
    ("environment", "settings", "expected"),
    [
        ("regular-ring-v0", {"bearings_deg": [0, 40]}, "each more than 48 and less than 220"),
        ("regular-ring-v0", {"bearings_deg": [0, 90]}, "each more than 48 and less than 220"),
        ("regular-ring-v0", {"bearings_deg": [0]}, "bearings_deg: expected two or more"),
        ("regular-ring-v0", {"radius_m": -5}, "radius_m: expected a positive number"),
        ("regular-ring-v0", {"access_m": 0}, "access_m: expected a positive number"),
        ("regular-ring-v0", {"ring_limit_mps": float("nan")}, "ring_limit_mps: expected a posit"),
        ("regulated-junction-v0", {"inner_m": 0}, "inner_m: expected a positive number"),
        (
            "regulated-junction-v0",
            {"arms": [{"bearing_deg": 0.0, "length_m": 0, "speed_limit_mps": 9.0}] * 2},
            "arms: 0: length_m: expected a positive number",
        ),
        (
            "regulated-junction-v0",
            {"arms": [{"angle": 1.0}]},
            "unexpected keyword argument 'angle'",
        ),
        ("regulated-junction-v0", {"arms": []}, "arms: expected two or more"),
        ("regulated-junction-v0", {"ways": [[0, 7]]}, "ways: expected pairs of different arms"),
        ("regulated-junction-v0", {"ways": [[1, 1]]}, "ways: expected pairs of different arms"),
    ],
)
def test_places_that_cannot_be(environment: str, settings: dict[str, Any], expected: str) -> None:
    assert expected in refused(environment, **settings)


def test_a_ring_slower_than_any_path_is_drawn_at() -> None:
    with HighwaySimulator(scenario("regular-ring-v0", ring_limit_mps=1.5)) as simulator:
        assert {lane.speed_limit_mps for lane in simulator.lanes} >= {1.5}
        assert all(np.isfinite(lane.xy_m).all() for lane in simulator.lanes)


def refused(environment: str, **settings: Any) -> str:
    with pytest.raises(InputError) as caught:
        HighwaySimulator(scenario(environment, **settings))
    text = str(caught.value)
    assert text.startswith("scenario.toml: highway.") and "\n" not in text
    return text.removeprefix("scenario.toml: highway.")


def test_an_environment_that_is_none() -> None:
    assert refused("roundabout-v9").startswith(
        "environment: unknown environment 'roundabout-v9'; did you mean 'roundabout-v"
    )
    assert refused("CartPole-v1").startswith("environment: unknown environment 'CartPole-v1'; ")
    assert refused("parking-v0").startswith("environment: 'parking-v0' has no roads to drive along")


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (
            {"spawn_probabilty": 0.5},
            "settings: unknown key 'spawn_probabilty'; did you mean 'spawn",
        ),
        ({"spawn_probability": "0.5"}, "settings.spawn_probability: expected a number from 0 to 1"),
        ({"spawn_probability": True}, "settings.spawn_probability: expected a number from 0 to 1"),
        ({"spawn_probability": 1.5}, "settings.spawn_probability: expected a number from 0 to 1"),
        (
            {"desired_speed_mps": 0},
            "settings.desired_speed_mps: expected a positive number, found 0",
        ),
        ({"initial_vehicle_count": 2.5}, "settings.initial_vehicle_count: expected a whole number"),
        (
            {"controlled_vehicles": 0},
            "settings.controlled_vehicles: expected a whole number from 1",
        ),
        ({"simulation_frequency": 10}, "settings.simulation_frequency: is set here, for frames at"),
        ({"destination": 3}, "settings.destination: expected a text, found 3; correct it"),
        ({"action": {"type": "Teleport"}}, "settings: intersection-v2 fails with them: "),
        ({"observation": "none"}, "settings.observation: expected a table, found 'none'"),
        (
            {"other_vehicles_type": "os.system"},
            "settings.other_vehicles_type: unknown driver 'os.system'; known: highway_env.",
        ),
    ],
)
def test_settings_that_are_wrong(settings: dict[str, Any], expected: str) -> None:
    assert refused("intersection-v2", **settings).startswith(expected)


def test_settings_without_effect_are_told() -> None:
    with HighwaySimulator(scenario("intersection-v2", duration=20)) as simulator:
        assert simulator.notices == ("duration in scenario.toml: without effect, traffic goes on",)


def test_seeds_and_steps_out_of_place() -> None:
    simulator = open_traffic(load_scenario("highway_merge"))
    assert isinstance(simulator, HighwaySimulator)
    assert (simulator.name, simulator.dt_s) == ("highway_merge", 0.1)
    with pytest.raises(SimulatorError, match=r"not running: call reset\(seed\) first"):
        simulator.step()
    with pytest.raises(InputError, match="seed: expected 0 to 2147483647, found -1"):
        simulator.reset(-1)
    simulator.close()
    simulator.close()
    with pytest.raises(InputError, match=r"expected a scene with \[highway\]; add it"):
        HighwaySimulator(replace(simulator.scenario, highway=None))


def test_nothing_is_said_and_no_window_is_opened() -> None:
    program = (
        "import sys, hatn_sim, hatn_sim.cli\n"
        "assert not {'highway_env', 'gymnasium', 'pygame'} & set(sys.modules)\n"
        "from hatn_sim.config import load_scenario\n"
        "from hatn_sim.traffic import open_traffic\n"
        "simulator = open_traffic(load_scenario('highway_merge'))\n"
        "simulator.reset(1)\n"
        "for _ in range(30): simulator.step()\n"
        "import pygame\n"
        "assert not pygame.display.get_init()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_planned_routes_agree_with_those_highway_env_drives(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """It warns where a route does not go on from the lane that a vehicle is on."""
    with (
        caplog.at_level(logging.WARNING),
        HighwaySimulator(load_scenario("highway_roundabout", density="dense")) as simulator,
    ):
        record(simulator, 2, 30.0)
    assert caplog.records == []
