"""Branches of a running simulation: against the run itself going on, and when something dies."""

from __future__ import annotations

import gzip
import os
import re
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hatn_sim.config import Scenario, load_scenario
from hatn_sim.datatypes import DT_S, Branch, Change, Command, Frame, Lawful, Plan
from hatn_sim.errors import InputError
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_branch import Branches, brakes_hardest
from hatn_sim.traffic import open_traffic

NETS = Path(__file__).parent / "nets"
SEED = 7
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="processes are counted in /proc")


def with_risk(name: str, risk: str) -> Scenario:
    scenario = load_scenario(name)
    paths = {path.name.partition(".")[0]: path for path in scenario.driver_paths}
    return replace(scenario, risk=risk, driver_path=paths[risk])


def after(simulator: SumoSimulator, steps: int, seed: int = SEED) -> Frame:
    frame = simulator.reset(seed)
    for _ in range(steps):
        frame = simulator.step()
    return frame


def one_branch(simulator: SumoSimulator, *changes: Change, horizon_s: float) -> Branch:
    (future,) = simulator.branch([changes], horizon_s)
    branch = future.result()
    assert branch is not None
    return branch


def assert_same(branch: Branch, place: int, frame: Frame) -> None:
    """A frame of a branch is that of the run, to the last bit."""
    now = frame.scene
    seen = [row for row, name in enumerate(now.ids) if not name.startswith("person:")]
    ids = [now.ids[row] for row in seen]
    columns = [branch.ids.index(name) for name in ids]
    assert branch.time_s[place] == now.time_s
    assert {branch.ids[k] for k in np.flatnonzero(branch.valid[place])} == set(ids)
    for name in ("xy_m", "yaw_rad", "speed_mps"):
        expected = getattr(now, name)[seen]
        assert getattr(branch, name)[place, columns].tobytes() == expected.tobytes(), name
    assert branch.size_m[columns].tobytes() == now.size_m[seen].tobytes()
    if place:
        events = [pair for time_s, *pair in branch.collisions if time_s == now.time_s]
        assert [tuple(pair) for pair in events] == list(frame.truth.collisions)
        braking = {name for time_s, name in branch.emergency_braking if time_s == now.time_s}
        assert braking == set(frame.truth.emergency_braking)


# ---------------------------------------------------------------------------------------------
# Exact


@pytest.mark.parametrize("name", ["intersection5", "roundabout8"])
def test_the_empty_branch_is_the_run_going_on(name: str) -> None:
    """Stochastic flows, and drivers who overlook others at random."""
    events = 0
    with SumoSimulator(with_risk(name, "inattentive")) as simulator:
        frame = after(simulator, 500)
        for _ in range(8):
            futures = simulator.branch([(), ()], 8.0)
            frames = [frame, *(simulator.step() for _ in range(80))]
            branch, again = (future.result() for future in futures)
            assert branch is not None and again is not None
            assert branch.xy_m.tobytes() == again.xy_m.tobytes()
            for place, frame in enumerate(frames):
                assert_same(branch, place, frame)
            events += len(branch.collisions) + len(branch.emergency_braking)
    assert events


def test_a_city_net_with_signals_and_pedestrians() -> None:
    with SumoSimulator(load_scenario(str(NETS / "street.sumocfg"))) as simulator:
        frame = after(simulator, 300)
        branch = one_branch(simulator, horizon_s=20.0)
        for place in range(201):
            assert_same(branch, place, frame)
            frame = simulator.step()


def test_commanded_vehicles() -> None:
    """A branch that plans what was commanded; and one without plans, where SUMO drives again."""
    with SumoSimulator(with_risk("roundabout8", "assertive")) as simulator:
        first = after(simulator, 400)
        ego, other = first.scene.ids[-1], first.scene.ids[-2]

        def command(step: int) -> list[Command]:
            return [Command(ego, 0.7 * np.sin(0.3 * step)), Command(other, -0.4)]

        frames = [simulator.step(command(step)) for step in range(60)]
        speed_mps = {
            name: np.array([f.scene.speed_mps[f.scene.ids.index(name)] for f in frames], np.float64)
            for name in (ego, other)
        }

        after(simulator, 400)
        plans = [Plan(name, 0.0, speed) for name, speed in speed_mps.items()]
        branch = one_branch(simulator, *plans, horizon_s=6.0)
        for place, frame in enumerate(frames, start=1):
            assert_same(branch, place, frame)

        # From the middle: both are driven, one goes on as planned after a second of SUMO's driver.
        frame = after(simulator, 400)
        for step in range(30):
            frame = simulator.step(command(step))
        futures = simulator.branch([[], [Plan(ego, 1.0, np.full(20, 3.0, np.float64))]], 5.0)
        released, planned = (future.result() for future in futures)
        assert released is not None and planned is not None
        assert_same(released, 0, frame)
        for place in range(1, 51):
            assert_same(released, place, simulator.step())
        column = planned.ids.index(ego)
        same = planned.ids.index(ego), released.ids.index(ego)
        before = planned.speed_mps[:11, same[0]], released.speed_mps[:11, same[1]]
        assert before[0].tobytes() == before[1].tobytes()
        assert (planned.speed_mps[11:31, column] == 3.0).all()
        assert planned.speed_mps[31, column] != 3.0


OUTPUTS = """<output><tripinfo-output value="trips.xml"/><fcd-output value="fcd.xml"/>
<summary-output value="summary.xml"/><collision-output value="hits.xml"/>
<save-state.times value="55"/><save-state.prefix value="state"/></output>
<report><log value="words.txt"/></report>"""


def busy(folder: Path, extra: str) -> Scenario:
    """Two thousand vehicles of a route file that SUMO reads as time goes on."""
    ways = ("west_to_priority priority_to_signal", "signal_to_priority priority_to_west")
    vehicles = "".join(
        f'<vehicle id="v{n}" depart="{n // 2}" departSpeed="max"><route edges="{ways[n % 2]}"/>'
        "</vehicle>"
        for n in range(2000)
    )
    folder.mkdir()
    (folder / "own.rou.xml").write_text(f"<routes>{vehicles}</routes>")
    config = folder / "own.sumocfg"
    config.write_text(
        f"""<configuration><input><net-file value="{NETS / "street.net.xml"}"/>
        <route-files value="own.rou.xml"/><route-steps value="10"/></input>
        <time><step-length value="0.1"/></time>{extra}</configuration>"""
    )
    return load_scenario(str(config))


def written(folder: Path) -> dict[str, str]:
    """The folder's files, without what names the folder or a clock's time."""
    texts: dict[str, str] = {}
    for path in sorted(folder.iterdir()):
        raw = path.read_bytes()
        text = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode()
        texts[path.name] = re.sub(r"<!--.*?-->|\(\d+ms\)", "", text, flags=re.DOTALL)
    return {name: text.replace(str(folder), "") for name, text in texts.items()}


def test_branches_leave_no_trace_in_the_users_files(tmp_path: Path) -> None:
    files: list[dict[str, str]] = []
    for every in (0, 50):
        scenario = busy(tmp_path / f"every_{every}", OUTPUTS)
        with SumoSimulator(scenario) as simulator:
            frame, branches = simulator.reset(SEED), list[Branch | None]()
            for step in range(700):
                if every and step % every == 0:
                    branches.append(simulator.branch([()], 10.0)[0].result())
                    # No branch gets beyond a state that it would have to write.
                    assert (branches[-1] is None) == (45.0 < frame.scene.time_s <= 55.0), step
                frame = simulator.step()
                if branches and branches[-1] is not None:
                    assert_same(branches[-1], step % every + 1, frame)
            assert len(frame.scene.ids) > 10 and branches.count(None) == (2 if every else 0)
        files.append(written(scenario.config_path.parent))
    assert files[0].keys() == files[1].keys()
    assert {"trips.xml", "fcd.xml", "hits.xml", "words.txt"} < files[0].keys()
    assert any(name.startswith("state") for name in files[0])
    for name, text in files[0].items():
        assert files[1][name] == text, name


# ---------------------------------------------------------------------------------------------
# Without the violation

OVERLOOKS = """<vType id="own" sigma="0" speedFactor="1" speedDev="0"/>
<vType id="blind" sigma="0" speedFactor="1" speedDev="0" jmIgnoreFoeProb="1"
       jmIgnoreFoeSpeed="50" jmIgnoreJunctionFoeProb="1"/>"""


def crossing_scene(folder: Path, type_id: str, parameter: str = "") -> Scenario:
    """One vehicle from the south onto a priority road with a vehicle every 2 s."""
    main = [
        f'<vehicle id="main{n}" type="own" depart="{n}" departSpeed="max">'
        '<route edges="west_to_priority priority_to_signal"/></vehicle>'
        for n in range(0, 60, 2)
    ]
    offender = f"""<vehicle id="offender" type="{type_id}" depart="6" departSpeed="8"><route
        edges="priority_south_to_priority priority_to_priority_north"/>{parameter}</vehicle>"""
    folder.mkdir()
    (folder / "own.rou.xml").write_text(
        f"<routes>{OVERLOOKS}{''.join((*main[:4], offender, *main[4:]))}</routes>"
    )
    config = folder / "own.sumocfg"
    config.write_text(
        f"""<configuration><input><net-file value="{NETS / "street.net.xml"}"/>
        <route-files value="own.rou.xml"/></input>
        <time><step-length value="0.1"/></time></configuration>"""
    )
    return load_scenario(str(config))


FOES = " ".join(f"main{n}" for n in range(0, 60, 2))


@pytest.mark.parametrize(
    ("type_id", "parameter"),
    [("blind", ""), ("own", f'<param key="junctionModel.ignoreIDs" value="{FOES}"/>')],
)
def test_without_the_violation(tmp_path: Path, type_id: str, parameter: str) -> None:
    """Who overlooks the priority road drives onto it; who is made to keep the rules waits."""
    with SumoSimulator(crossing_scene(tmp_path / "a", type_id, parameter)) as simulator:
        after(simulator, 70)
        futures = simulator.branch([[], [Lawful("offender")], [Lawful("nobody")]], 20.0)
        as_it_is, lawful, nobody = (future.result() for future in futures)
    assert as_it_is is not None and lawful is not None and nobody is not None

    def slowest_mps(branch: Branch) -> float:
        column = branch.ids.index("offender")
        return branch.speed_mps[branch.valid[:, column], column].min()

    assert slowest_mps(as_it_is) > 4.0
    assert slowest_mps(lawful) < 0.1
    assert nobody.xy_m.tobytes() == as_it_is.xy_m.tobytes()


# ---------------------------------------------------------------------------------------------
# When something dies, or cannot be


def children(pid: int) -> dict[int, str]:
    """The children of a process, with their states."""
    found: dict[int, str] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(words[1]) == pid:
            found[int(path.parent.name)] = words[0]
    return found


def until(what: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@LINUX
def test_a_branch_that_is_killed_is_lost_and_the_run_goes_on() -> None:
    with SumoSimulator(load_scenario("tjunction")) as simulator:
        frame = after(simulator, 300)
        worker = simulator.worker_pid
        assert worker is not None
        descriptors = Path(f"/proc/{worker}/fd")
        before = sorted(path.name for path in descriptors.iterdir())
        (killed,) = simulator.branch([()], 3000.0)
        (pid,) = children(worker)
        os.kill(pid, signal.SIGKILL)
        (kept,) = simulator.branch([()], 1.0)
        assert killed.result() is None and killed.result() is None
        branch = kept.result()
        assert branch is not None
        assert_same(branch, 0, frame)
        assert_same(branch, 1, simulator.step())
        assert not children(worker)
        # Nobody asks for these.
        for _ in range(5):
            simulator.branch([(), ()], 0.1)
            simulator.step()

        def all_gone() -> bool:
            simulator.step()
            return not children(worker)

        until(all_gone)
        assert sorted(path.name for path in descriptors.iterdir()) == before


@LINUX
def test_branches_end_with_the_simulator() -> None:
    simulator = SumoSimulator(load_scenario("tjunction"))
    after(simulator, 100)
    worker = simulator.worker_pid
    assert worker is not None
    (future,) = simulator.branch([()], 3000.0)
    (pid,) = children(worker)
    simulator.reset(SEED)
    assert future.result() is None
    assert not Path(f"/proc/{pid}").exists()
    simulator.close()


def test_a_simulation_in_threads_is_not_branched(tmp_path: Path) -> None:
    threads = '<processing><device.rerouting.threads value="2"/></processing>'
    with SumoSimulator(busy(tmp_path / "threads", threads)) as simulator:
        after(simulator, 10)
        reason = (
            "SUMO runs threads, which a fork loses; set its option device.rerouting.threads to 0"
        )
        assert simulator.cannot_branch == reason
        with pytest.raises(InputError, match=f"own: no branches: {reason}"):
            simulator.branch([()], 1.0)
        assert simulator.step().scene.ids


def test_a_platform_without_fork(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "fork")
    branches = Branches(None, None, tuple)  # type: ignore[arg-type]  # neither is asked
    assert branches.cannot is not None and "cannot fork" in branches.cannot


@pytest.mark.parametrize("name", ["highway_merge", "recorded_sample"])
def test_what_is_not_branched_says_so(name: str) -> None:
    simulator = open_traffic(load_scenario(name))
    reason = simulator.cannot_branch
    assert reason is not None
    with pytest.raises(InputError, match=f"no branches: {reason}"):
        simulator.branch([()], 1.0)
    simulator.close()


def test_a_horizon_below_a_tick() -> None:
    with SumoSimulator(load_scenario("tjunction")) as simulator:
        simulator.reset(SEED)
        with pytest.raises(InputError, match=r"horizon_s: expected 0\.1 s or more, found 0"):
            simulator.branch([()], 0.0)


# ---------------------------------------------------------------------------------------------
# The parts


def test_braking_as_hard_as_it_can() -> None:
    speed_mps = np.array([[10.0, 10.0, 0.0], [9.1, 9.2, 5.0], [9.1, 8.3, 4.0]])
    valid = np.array([[True, True, False], [True, True, True], [True, True, True]])
    hardest = np.array([9.0, 9.0, 10.0])
    expected = [[False] * 3, [True, False, False], [False, True, True]]
    assert brakes_hardest(valid, speed_mps, hardest, DT_S).tolist() == expected
