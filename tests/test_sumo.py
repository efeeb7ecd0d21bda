"""SUMO behind its pipe: against the net's geometry, against libsumo itself, and when it fails."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import libsumo
import numpy as np
import pytest
from conftest import heed_ctrl_c

from hatn_sim.config import Scenario, load_scenario
from hatn_sim.datatypes import Command, Frame, Gate, Kind, Lane
from hatn_sim.errors import InputError, SimulatorError
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_config import start_options
from hatn_sim.simulators.sumo_lanes import edge_of, is_connection

NETS = Path(__file__).parent / "nets"
STREET = NETS / "street.sumocfg"
SEED = 7


def scene(tmp_path: Path, routes: str, extra: str = "") -> Scenario:
    """A scene on the test street with these routes."""
    (tmp_path / "own.rou.xml").write_text(f"<routes>{routes}</routes>")
    config = tmp_path / "own.sumocfg"
    config.write_text(
        f"""<configuration><input><net-file value="{NETS / "street.net.xml"}"/>
        <route-files value="own.rou.xml"/></input>
        <time><step-length value="0.1"/></time>{extra}</configuration>"""
    )
    return load_scenario(str(config))


CAR = (
    '<vType id="car" length="4.5" width="1.8" color="200,10,20" sigma="0" speedFactor="1"'
    ' speedDev="0"/>'
)


def vehicle(name: str, edges: str, **attributes: object) -> str:
    words = {"type": "car", "depart": 0, "departSpeed": 10} | attributes
    written = " ".join(f'{key}="{value}"' for key, value in words.items())
    return f'<vehicle id="{name}" {written}><route edges="{edges}"/></vehicle>'


def row(frame: Frame, name: str) -> int:
    return frame.scene.ids.index(name)


def same(one: Frame, other: Frame) -> bool:
    arrays = [
        "xy_m",
        "yaw_rad",
        "speed_mps",
        "size_m",
        "kind",
        "colour",
        "blinker",
        "signal_closed",
    ]
    return (
        one.scene.ids == other.scene.ids
        and one.scene.time_s == other.scene.time_s
        and one.truth.routes == other.truth.routes
        and one.truth.departed == other.truth.departed
        and all(
            getattr(one.scene, name).tobytes() == getattr(other.scene, name).tobytes()
            for name in arrays
        )
    )


# ---------------------------------------------------------------------------------------------
# Where things are


def test_centre_and_yaw_follow_from_the_geometry_of_the_net(tmp_path: Path) -> None:
    routes = CAR + "".join(
        (
            # name, edges, place of the front bumper from the lane's start
            vehicle("to_east", "west_to_priority priority_to_signal", departPos=50, departLane=0),
            vehicle(
                "to_north", "priority_south_to_priority priority_to_priority_north", departPos=20
            ),
            vehicle(
                "to_south", "priority_north_to_priority priority_to_priority_south", departPos=30
            ),
            vehicle("to_west", "signal_to_priority priority_to_west", departPos=10),
        )
    )
    with SumoSimulator(scene(tmp_path, routes)) as simulator:
        assert simulator.reset(SEED).scene.ids == ()
        frame = simulator.step()
    # Lane axes read off street.net.xml; half of 4.5 m back from the bumper.
    expected = {
        "to_east": (-160 + 50 - 2.25, -4.8, 0.0),
        "to_north": (1.6, -100 + 20 - 2.25, np.pi / 2),
        "to_south": (-1.6, 100 - 30 + 2.25, -np.pi / 2),
        "to_west": (112.8 - 10 + 2.25, 1.6, np.pi),
    }
    assert set(frame.scene.ids) == set(expected)
    for name, (x_m, y_m, yaw_rad) in expected.items():
        place = row(frame, name)
        assert frame.scene.xy_m[place] == pytest.approx((x_m, y_m), abs=1e-6)
        assert frame.scene.yaw_rad[place] == pytest.approx(yaw_rad, abs=1e-9)
        assert frame.scene.speed_mps[place] == pytest.approx(10.0)
        assert tuple(frame.scene.size_m[place]) == (4.5, 1.8)
        assert tuple(frame.scene.colour[place]) == (200, 10, 20)
        assert frame.scene.kind[place] == Kind.CAR
    assert set(frame.truth.departed) == set(expected)


def test_frames_and_routes_agree_with_libsumo_itself() -> None:
    scenario = load_scenario(str(STREET))
    options, _ = start_options(scenario)
    seen_blinkers: set[int] = set()
    seen_signals: set[bool] = set()
    kinds: set[int] = set()
    libsumo.start(["sumo", *options, "--seed", str(SEED), "--no-warnings"])
    try:
        with SumoSimulator(scenario) as simulator:
            simulator.reset(SEED)
            successors = {lane.id: lane.successors for lane in simulator.lanes}
            length_m = {lane.id: libsumo.lane.getLength(lane.id) for lane in simulator.lanes}
            for _ in range(1500):
                libsumo.simulationStep()
                frame = simulator.step()
                now = frame.scene
                vehicles = [name for name in now.ids if not name.startswith("person:")]
                assert tuple(vehicles) == libsumo.vehicle.getIDList()
                assert now.time_s == libsumo.simulation.getTime()
                heading = np.column_stack((np.cos(now.yaw_rad), np.sin(now.yaw_rad)))
                bumper = now.xy_m + 0.5 * now.size_m[:, :1] * heading
                kinds.update(now.kind.tolist())
                seen_blinkers.update(now.blinker.tolist())
                seen_signals.update(now.signal_closed.tolist())
                state = libsumo.trafficlight.getRedYellowGreenState("signal")
                assert now.signal_closed.tolist() == [letter not in "gG" for letter in state]
                for place, name in enumerate(vehicles):
                    assert bumper[place] == pytest.approx(libsumo.vehicle.getPosition(name))
                    assert now.speed_mps[place] == libsumo.vehicle.getSpeed(name)
                    angle = np.deg2rad(90 - libsumo.vehicle.getAngle(name))
                    assert heading[place] == pytest.approx((np.cos(angle), np.sin(angle)))
                    route = frame.truth.routes[place]
                    assert route is not None
                    check_route(route, name, successors, length_m)
    finally:
        libsumo.close()
    assert seen_blinkers == {-1, 0, 1}
    assert seen_signals == {False, True}
    assert kinds == {Kind.CAR, Kind.VAN, Kind.LORRY, Kind.BICYCLE, Kind.PEDESTRIAN}


def check_route(
    route: tuple[str, ...],
    name: str,
    successors: dict[str, tuple[str, ...]],
    length_m: dict[str, float],
) -> None:
    """A chain of successive lanes along the vehicle's edges, through where it is, long enough."""
    for lane, following in itertools.pairwise(route):
        assert following in successors[lane]
    journey = libsumo.vehicle.getRoute(name)
    edges = tuple(edge_of(lane) for lane in route if not is_connection(lane))
    starts = [start for start, edge in enumerate(journey) if edge == edges[0]]
    assert any(journey[start : start + len(edges)] == edges for start in starts)
    current = libsumo.vehicle.getLaneID(name)
    assert edge_of(current) in {edge_of(lane) for lane in route}
    position_m = libsumo.vehicle.getLanePosition(name)
    gap_m = length_m[current] - position_m
    if current in route:
        here = route.index(current)
        ahead_m = gap_m + sum(length_m[lane] for lane in route[here + 1 :])
        behind_m = position_m + sum(length_m[lane] for lane in route[:here])
        assert behind_m >= min(60.0, libsumo.vehicle.getDistance(name)) - 1e-6
        assert ahead_m >= 100.0 or edges[-1] == journey[-1]
    else:
        assert gap_m <= 100.0  # it has to change lanes before this one ends


def test_routes_that_are_equal_are_the_same_object() -> None:
    with SumoSimulator(load_scenario(str(STREET))) as simulator:
        simulator.reset(SEED)
        objects: dict[tuple[str, ...], set[int]] = {}
        kept = []
        for _ in range(600):
            frame = simulator.step()
            kept.append(frame)
            for route in frame.truth.routes:
                if route is not None:
                    objects.setdefault(route, set()).add(id(route))
    assert objects
    assert all(len(identities) == 1 for identities in objects.values())


def test_a_vehicle_on_the_wrong_lane_is_routed_over_the_lane_it_must_change_to(
    tmp_path: Path,
) -> None:
    # Only lane 1 leads north; the car must stay on lane 0 (lane change mode 0 is not for routes,
    # so a wall of cars beside it keeps it there).
    wall = "".join(
        vehicle(f"wall_{place}", "west_to_priority priority_to_priority_north", departLane=1,
                departPos=place, departSpeed=0)
        for place in range(150, 60, -8)
    )  # fmt: skip
    lost = vehicle("lost", "west_to_priority priority_to_priority_north", departLane=0,
                   departPos=90, departSpeed=0)  # fmt: skip
    blocker = vehicle("blocker", "priority_to_priority_north", departSpeed=0, departPos=6).replace(
        "</vehicle>",
        '<stop lane="priority_to_priority_north_0" endPos="8" duration="60"/></vehicle>',
    )
    with SumoSimulator(scene(tmp_path, CAR + wall + lost + blocker)) as simulator:
        simulator.reset(SEED)
        frame = simulator.step()
        place = row(frame, "lost")
        assert frame.scene.xy_m[place, 1] == pytest.approx(-4.8)  # still on lane 0
        assert frame.truth.routes[place] == (
            "west_to_priority_1",
            ":priority_11_0",
            ":priority_13_0",
            "priority_to_priority_north_0",
        )


def test_after_a_lane_change_the_lanes_behind_lead_to_the_lane_taken(tmp_path: Path) -> None:
    lost = vehicle("lost", "west_to_priority priority_to_priority_north", departLane=0)
    with SumoSimulator(scene(tmp_path, CAR + lost)) as simulator:
        simulator.reset(SEED)
        routes = []
        frame = simulator.step()
        while not frame.done:
            routes.append(frame.truth.routes[0])
            frame = simulator.step()
    assert len(set(routes[-50:])) == 1
    assert routes[-1] == (
        "west_to_priority_1",
        ":priority_11_0",
        ":priority_13_0",
        "priority_to_priority_north_0",
    )


def test_parked_and_teleporting_vehicles_and_pedestrians(tmp_path: Path) -> None:
    parked = vehicle("parked", "stop_to_east", departLane=1, departSpeed=0, departPos=20).replace(
        "</vehicle>",
        '<stop lane="stop_to_east_1" endPos="60" duration="5" parking="true"/></vehicle>',
    )
    stopped = vehicle("stopped", "signal_to_stop stop_to_east", departPos=30).replace(
        "</vehicle>", '<stop lane="signal_to_stop_0" endPos="90" duration="300"/></vehicle>'
    )
    stuck = vehicle("stuck", "signal_to_stop stop_to_east", departPos=10, depart=1)
    walker = '<person id="parked" depart="0"><walk edges="stop_to_east"/></person>'
    impatient = '<processing><time-to-teleport value="5"/></processing>'
    content = CAR + walker + parked + stopped + stuck
    with SumoSimulator(scene(tmp_path, content, impatient)) as simulator:
        simulator.reset(SEED)
        teleported: list[str] = []
        parked_routes = set()
        absent = False
        for _ in range(400):
            frame = simulator.step()
            teleported += frame.truth.teleported
            assert len(set(frame.scene.ids)) == len(frame.scene.ids)
            assert np.abs(frame.scene.xy_m).max(initial=0.0) < 1e3
            if "parked" in frame.scene.ids:
                parked_routes.add(frame.truth.routes[row(frame, "parked")])
            absent |= bool(teleported) and "stuck" not in frame.scene.ids
            walkers = frame.scene.kind == Kind.PEDESTRIAN
            names = [frame.scene.ids[place] for place in np.flatnonzero(walkers)]
            assert names == ["person:parked"]
            assert frame.truth.routes[row(frame, "person:parked")] is None
    assert teleported == ["stuck"]
    assert absent
    assert parked_routes == {None, ("stop_to_east_1",)}


def test_done_when_the_last_vehicle_has_left_or_the_time_is_over(tmp_path: Path) -> None:
    car = CAR + vehicle("car", "stop_to_east", departLane=1, departPos=100)
    with SumoSimulator(scene(tmp_path, car)) as simulator:
        frame = simulator.reset(SEED)
        arrived: list[str] = []
        while not frame.done:
            frame = simulator.step()
            arrived += frame.truth.arrived
    assert arrived == ["car"]
    assert frame.scene.ids == ()
    over = '<time><begin value="2"/><end value="3"/></time>'
    late = CAR + vehicle("car", "stop_to_east", departLane=1, depart=2)
    with SumoSimulator(scene(tmp_path, late, over)) as simulator:
        frame = simulator.reset(SEED)
        assert frame.scene.time_s == 2.0
        while not frame.done:
            frame = simulator.step()
    assert frame.scene.time_s == pytest.approx(3.0)
    assert frame.scene.ids == ("car",)


# ---------------------------------------------------------------------------------------------
# The road


@pytest.fixture(scope="module")
def lanes() -> dict[str, Lane]:
    return {lane.id: lane for lane in SumoSimulator(load_scenario(str(STREET))).lanes}


def test_gates(lanes: dict[str, Lane]) -> None:
    assert lanes["priority_north_to_priority_0"].gate == Gate.GIVE_WAY_LINE
    assert lanes["signal_to_priority_0"].gate == Gate.NONE  # the major road, left turn included
    assert lanes["priority_to_signal_0"].gate == Gate.SIGNAL
    assert lanes["signal_to_stop_0"].gate == Gate.STOP_LINE
    assert lanes["stop_to_stop_north_0"].gate == Gate.NONE  # the end of the road
    assert all(lane.gate == Gate.NONE for lane in lanes.values() if lane.is_connection)


def test_signals_are_named_by_the_lanes_they_open(lanes: dict[str, Lane]) -> None:
    # linkIndex of the <connection>s in street.net.xml; there is one traffic light.
    assert lanes["priority_to_signal_0"].signals == {":signal_4_0": 4, ":signal_5_0": 5}
    assert lanes["signal_to_stop_0"].signals is None


def test_turns_successors_and_shape(lanes: dict[str, Lane]) -> None:
    assert lanes["signal_to_priority_0"].successors == (
        ":priority_3_0",
        ":priority_4_0",
        ":priority_5_0",
    )
    assert lanes[":priority_5_0"].successors == (":priority_12_0",)
    assert [lanes[f":priority_{part}_0"].turn for part in (3, 4, 5, 12)] == [-1, 0, 1, 1]
    assert lanes[":priority_12_0"].is_connection
    assert not lanes["signal_to_priority_0"].is_connection
    assert lanes["signal_to_priority_0"].xy_m.tolist() == [[112.8, 1.6], [7.2, 1.6]]
    assert lanes["signal_to_priority_0"].speed_limit_mps == pytest.approx(11.0)
    assert lanes["signal_to_priority_0"].width_m == pytest.approx(3.2)


def test_pavements_are_left_out_and_kinds_are_told(lanes: dict[str, Lane]) -> None:
    assert "stop_to_east_0" not in lanes
    assert lanes["stop_to_east_1"].kinds == frozenset(Kind) - {Kind.PEDESTRIAN}
    assert lanes["signal_to_stop_0"].kinds == frozenset(Kind)
    assert all(other in lanes for lane in lanes.values() for other in lane.successors)


def test_road_is_at_hand_before_and_after_reset() -> None:
    with SumoSimulator(load_scenario(str(STREET))) as simulator:
        road = simulator.road
        assert simulator.worker_pid is None
        simulator.reset(SEED)
        assert simulator.road is road


# ---------------------------------------------------------------------------------------------
# Repeating


def frames(simulator: SumoSimulator, seed: int, count: int) -> list[Frame]:
    return [simulator.reset(seed), *(simulator.step() for _ in range(count))]


def test_the_same_seed_gives_the_same_frames_bit_for_bit() -> None:
    with SumoSimulator(load_scenario(str(STREET))) as simulator:
        first = frames(simulator, SEED, 500)
        other = frames(simulator, SEED + 1, 500)
        again = frames(simulator, SEED, 500)
    assert all(map(same, first, again))
    assert not all(map(same, first, other))


def test_two_simulators_run_side_by_side() -> None:
    scenario = load_scenario(str(STREET))
    with SumoSimulator(scenario) as one, SumoSimulator(scenario) as two:
        one.reset(SEED)
        two.reset(SEED)
        assert all(same(one.step(), two.step()) for _ in range(200))


def test_randomness_of_a_users_configuration_is_overridden_and_said(tmp_path: Path) -> None:
    flow = CAR + (
        '<flow id="f" type="car" from="stop_to_east" to="stop_to_east" departLane="1"'
        ' end="100" probability="0.3"/>'
    )
    random = '<random_number><random value="true"/></random_number>'
    with SumoSimulator(scene(tmp_path, flow, random)) as simulator:
        assert simulator.notices == (
            "random in own.sumocfg: overridden, so that the seed repeats the run",
        )
        assert all(map(same, frames(simulator, 1, 300), frames(simulator, 1, 300)))


# ---------------------------------------------------------------------------------------------
# Commands


@pytest.mark.parametrize("action_s", [0.1, 1.0])
def test_a_command_is_obeyed_and_the_vehicle_given_back(tmp_path: Path, action_s: float) -> None:
    car = CAR + vehicle("car", "west_to_priority priority_to_signal", departLane=0, departSpeed=5)
    action = f'<processing><default.action-step-length value="{action_s}"/></processing>'
    with SumoSimulator(scene(tmp_path, car, action)) as simulator:
        simulator.reset(SEED)
        speeds = [simulator.step().scene.speed_mps[0]]
        for acceleration in [-2.0] * 10 + [0.5] * 10 + [-9.0] * 5:
            speeds.append(simulator.step([Command("car", acceleration)]).scene.speed_mps[0])
        expected = [5 - 0.2 * k for k in range(11)] + [3 + 0.05 * k for k in range(1, 11)]
        assert speeds[:21] == pytest.approx(expected, abs=1e-6)
        assert speeds[21:] == pytest.approx([2.6, 1.7, 0.8, 0.0, 0.0], abs=1e-6)
        free = [simulator.step().scene.speed_mps[0] for _ in range(100)]
        assert max(free) == pytest.approx(11.0, abs=0.01)  # SUMO drives at the limit again


def test_a_command_overrides_the_rules_of_the_road(tmp_path: Path) -> None:
    wait = '<stop lane="signal_to_stop_0" endPos="80" duration="100"/></vehicle>'
    content = CAR + (
        vehicle("wall", "signal_to_stop", departPos=78, departSpeed=0).replace("</vehicle>", wait)
        + vehicle("ego", "signal_to_stop", departPos=40, departSpeed=5)
    )
    with SumoSimulator(scene(tmp_path, content)) as simulator:
        simulator.reset(SEED)
        simulator.step()
        hits: set[tuple[str, str]] = set()
        for _ in range(100):
            commands = [Command("ego", 1.0), Command("nobody", 1.0)]
            hits.update(simulator.step(commands).truth.collisions)
    assert hits == {("ego", "wall")}


# ---------------------------------------------------------------------------------------------
# Refusals and deaths


def test_sumo_refusing_names_its_first_error(tmp_path: Path) -> None:
    bad = scene(tmp_path, CAR + vehicle("a", "nowhere"))
    with pytest.raises(InputError) as caught, SumoSimulator(bad) as simulator:
        simulator.reset(SEED)
    assert str(caught.value) == (
        f"{bad.config_path}: SUMO refuses it: Error: The edge 'nowhere' within the route for "
        "vehicle 'a' is not known. The route can not be build."
    )


def test_malformed_net_and_routes_are_placed(tmp_path: Path) -> None:
    bad = scene(tmp_path, "<vehicle")
    with pytest.raises(InputError, match=r"tag 'vehicle' In file .*own\.rou\.xml' At line/col"):
        SumoSimulator(bad).reset(SEED)
    net = (NETS / "street.net.xml").read_text()
    (tmp_path / "cut.net.xml").write_text(net[:5000])
    text = bad.config_path.read_text()
    bad.config_path.write_text(text.replace(str(NETS / "street.net.xml"), "cut.net.xml"))
    with pytest.raises(InputError, match=r"Error: unexpected end of input In file .*cut\.net\.xml"):
        SumoSimulator(bad).reset(SEED)


def test_unknown_option_in_the_configuration(tmp_path: Path) -> None:
    bad = scene(tmp_path, CAR + vehicle("a", "stop_to_east"), "<speling value='1'/>")
    with pytest.raises(InputError, match="Error: No option with the name 'speling' exists"):
        SumoSimulator(bad).reset(SEED)


def test_nobody_to_drive(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="it has no vehicles: expected some in its route files"):
        SumoSimulator(scene(tmp_path, CAR)).reset(SEED)


def test_nothing_to_drive_on(tmp_path: Path) -> None:
    bad = scene(tmp_path, CAR + vehicle("a", "only"))
    (tmp_path / "one.net.xml").write_text(
        """<net version="1.20"><location netOffset="0,0" convBoundary="0,0,50,0"
        origBoundary="0,0,50,0" projParameter="!"/>
        <edge id="only" from="a" to="b" priority="1">
        <lane id="only_0" index="0" speed="10" length="50" shape="0,0 50,0"/></edge>
        <junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,1"/>
        <junction id="b" type="dead_end" x="50" y="0" incLanes="only_0" intLanes=""
        shape="50,0 50,1"/></net>"""
    )
    text = bad.config_path.read_text()
    bad.config_path.write_text(text.replace(str(NETS / "street.net.xml"), "one.net.xml"))
    with pytest.raises(InputError, match="its net has no junction"):
        SumoSimulator(bad).reset(SEED)


@pytest.mark.parametrize("seed", [-1, 2**31])
def test_seeds_sumo_cannot_take(seed: int) -> None:
    with pytest.raises(InputError, match=f"seed: expected 0 to 2147483647, found {seed}"):
        SumoSimulator(load_scenario(str(STREET))).reset(seed)


def test_sumo_giving_up_in_the_middle(tmp_path: Path) -> None:
    # SUMO reads routes as time goes by, and meets the bad one only then.
    content = CAR + "".join(
        vehicle(f"v{depart}", "stop_to_east", departLane=1, depart=depart)
        for depart in range(0, 500, 5)
    )
    bad = scene(tmp_path, content + vehicle("late", "nowhere", depart=500))
    with SumoSimulator(bad) as simulator:
        simulator.reset(SEED)
        with pytest.raises(SimulatorError) as caught:
            for _ in range(20_000):
                simulator.step()
        assert simulator.worker_pid is None
    message = str(caught.value)
    assert message.startswith("SUMO stopped in own at ")
    assert f" s (seed {SEED}): Error: The edge 'nowhere'" in message


def test_a_killed_worker_is_one_clear_error() -> None:
    simulator = SumoSimulator(load_scenario(str(STREET)))
    simulator.reset(SEED)
    for _ in range(10):
        simulator.step()
    pid = simulator.worker_pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    with pytest.raises(SimulatorError) as caught:
        simulator.step()
    assert str(caught.value) == (
        f"SUMO stopped in street at 1.0 s (seed {SEED}): its process ended (killed by signal 9)"
    )
    assert not alive(pid)
    with pytest.raises(SimulatorError, match=r"call reset\(seed\) first"):
        simulator.step()
    assert simulator.reset(SEED).scene.time_s == 0.0
    simulator.close()


def test_closing_twice_leaves_no_process() -> None:
    simulator = SumoSimulator(load_scenario(str(STREET)))
    simulator.close()
    simulator.reset(SEED)
    pid = simulator.worker_pid
    assert pid is not None
    assert alive(pid)
    simulator.close()
    simulator.close()
    assert not alive(pid)


PARENT = """
import sys, time
from hatn_sim.config import load_scenario
from hatn_sim.simulators.sumo import SumoSimulator
simulator = SumoSimulator(load_scenario(sys.argv[1]))
simulator.reset(1)
print(simulator.worker_pid, flush=True)
while True:
    simulator.step()
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_the_worker_does_not_outlive_its_parent(how: signal.Signals) -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, str(STREET)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=heed_ctrl_c,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)},
    )
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    if how == signal.SIGINT:
        os.killpg(parent.pid, how)  # ctrl-C reaches the worker too
    else:
        parent.kill()
    _, words = parent.communicate(timeout=30)
    deadline = time.monotonic() + 30
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not alive(pid)
    assert ("KeyboardInterrupt" in words) == (how == signal.SIGINT)


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        if Path("/proc/self").exists():
            return False
        return subprocess.run(["ps", "-p", str(pid)], capture_output=True).returncode == 0
    return state != "Z"  # a zombie has ended; who inherits it collects it


# ---------------------------------------------------------------------------------------------
# The user's own step length and collision options


@pytest.mark.parametrize(
    ("element", "notice", "action"),
    [
        ("", "step-length 1 s (default) in own.sumocfg: run at 0.1 s"
             " with 1 s as action step length", "1"),
        ('<step-length value="0.5"/>', "step-length 0.5 s in own.sumocfg: run at 0.1 s"
                                       " with 0.5 s as action step length", "0.5"),
        ('<time><step-length v="0.26"/></time>', "step-length 0.26 s in own.sumocfg: run at 0.1 s"
                                                 " with 0.3 s as action step length", "0.3"),
        ('<step-length value="0.05"/>', "step-length 0.05 s in own.sumocfg: run at 0.1 s", None),
        ('<step-length value="0.1"/>', None, None),
    ],
)  # fmt: skip
def test_step_length(tmp_path: Path, element: str, notice: str | None, action: str | None) -> None:
    scenario = scene(tmp_path, CAR + vehicle("car", "stop_to_east", departLane=1))
    text = scenario.config_path.read_text()
    scenario.config_path.write_text(
        text.replace('<time><step-length value="0.1"/></time>', element)
    )
    options, notices = start_options(scenario)
    assert notices == (() if notice is None else (notice,))
    assert options[options.index("--step-length") + 1] == "0.1"
    if action is None:
        assert "--default.action-step-length" not in options
    else:
        assert options[options.index("--default.action-step-length") + 1] == action
    with SumoSimulator(scenario) as simulator:
        simulator.reset(SEED)
        assert simulator.step().scene.time_s == pytest.approx(0.1)
        assert simulator.step().scene.time_s == pytest.approx(0.2)


def test_a_step_length_that_is_no_number(tmp_path: Path) -> None:
    scenario = scene(tmp_path, CAR + vehicle("car", "stop_to_east"))
    text = scenario.config_path.read_text()
    scenario.config_path.write_text(text.replace('"0.1"', '"fast"'))
    with pytest.raises(InputError, match="step-length: expected seconds, found 'fast'"):
        SumoSimulator(scenario)


def test_collision_options_only_where_the_user_has_none(tmp_path: Path) -> None:
    routes = CAR + vehicle("car", "stop_to_east", departLane=1)
    options, _ = start_options(scene(tmp_path, routes))
    assert options[options.index("--collision.mingap-factor") + 1] == "0"
    own = '<processing><collision.action value="remove"/></processing>'
    options, _ = start_options(scene(tmp_path, routes, own))
    assert not any(word.startswith("--collision") for word in options)


def test_windows_and_ports_of_a_users_configuration_are_not_opened(tmp_path: Path) -> None:
    gui = (
        '<gui_only><gui-settings-file value="missing.xml"/><start value="true"/></gui_only>'
        '<traci_server><remote-port value="8813"/></traci_server>'
    )
    routes = CAR + vehicle("car", "stop_to_east", departLane=1)
    with SumoSimulator(scene(tmp_path, routes, gui)) as simulator:
        assert simulator.notices == ("remote-port in own.sumocfg: not opened",)
        simulator.reset(SEED)
        assert simulator.step().scene.ids == ("car",)


def test_output_files_of_a_users_configuration_are_finished(tmp_path: Path) -> None:
    output = '<output><tripinfo-output value="trips.xml"/></output>'
    routes = CAR + vehicle("car", "stop_to_east", departLane=1, departPos=140)
    with SumoSimulator(scene(tmp_path, routes, output)) as simulator:
        frame = simulator.reset(SEED)
        while not frame.done:
            frame = simulator.step()
    written = (tmp_path / "trips.xml").read_text()
    assert '<tripinfo id="car"' in written
    assert written.rstrip().endswith("</tripinfos>")
