"""Many environments, many episodes: the same as one, and nothing is left behind."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from short_env import SHORT, make_short
from test_envs import same

import hatn_sim.envs  # noqa: F401 - registers
from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Command, Frame
from hatn_sim.envs.driving import warmed_up
from hatn_sim.envs.errors import (
    ActionShapeError,
    ActionTypeError,
    MaskedActionError,
    NeedsResetError,
    OptionError,
)
from hatn_sim.envs.seen import _same
from hatn_sim.envs.vector_env import SceneVectorEnv
from hatn_sim.errors import SimulatorError
from hatn_sim.simulators import sumo_process
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_process import _Nursery

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
STREET = Path(__file__).parent / "nets" / "street.sumocfg"
MEGABYTES = 2**20


@pytest.fixture(autouse=True, scope="module")
def nursery_that_stays() -> None:
    """None does: here is asked who is left."""


def children(pid: int) -> set[int]:
    """Its processes, and theirs."""
    found: set[int] = set()
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in map(int, (task / "children").read_text().split()):
            found |= {child} | children(child)
    return found


def own() -> tuple[set[int], set[str]]:
    """The processes and the files that this process has open now."""
    gc.collect()
    return children(os.getpid()), {one.name for one in Path("/proc/self/fd").iterdir()}


def memory_bytes(pid: int) -> int:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def until(what: Any) -> None:
    deadline = time.monotonic() + 60.0
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.01)


# -- several frames at once -----------------------------------------------------------------------


@pytest.mark.parametrize("risk", ["courteous", "inattentive"])
def test_frames_at_once_are_those_one_by_one(risk: str) -> None:
    scenario = load_scenario("intersection5", "dense", risk)
    with SumoSimulator(scenario) as one, SumoSimulator(scenario) as other:
        frames = [one.reset(8)]
        for _ in range(400):
            frames.append(one.step())
        warm = warmed_up(other, other.reset(8), 400)
        assert [frame.scene.time_s for frame in warm] == [
            frame.scene.time_s for frame in frames[-11:]
        ]
        assert all(map(_same, warm, frames[-11:]))
        ego_id = warm[-1].scene.ids[-1]
        commands = [() if k == 4 else (Command(ego_id, -0.5 * k),) for k in range(8)]
        answer = other.drive_on(commands)
        for command, after in zip(commands, answer(), strict=True):
            assert _same(one.step(command), after)
        (last,) = other.drive_on([()] * 30, kept=1)()
        for _ in range(30):
            frame = one.step()
        assert _same(last, frame)


def test_driving_on_ends_with_the_scene(tmp_path: Path) -> None:
    street = STREET.read_text(encoding="utf-8")
    for named in ("street.net.xml", "street.rou.xml"):
        street = street.replace(named, str(STREET.parent / named))
    short = tmp_path / "short.sumocfg"
    short.write_text(street.replace('"600"', '"20"'), encoding="utf-8")
    scenario = load_scenario(str(short))
    with SumoSimulator(scenario) as one, SumoSimulator(scenario) as other:
        frame: Frame = one.reset(1)
        while not frame.done:
            frame = one.step()
        last = warmed_up(other, other.reset(1), 1000)[-1]
        assert last.scene.time_s == pytest.approx(20.0)
        assert last.done and _same(frame, last)
        assert other.drive_on([(), ()], kept=1)()[0].done


def test_a_worker_is_started_where_the_program_is_now(monkeypatch: pytest.MonkeyPatch) -> None:
    with SumoSimulator(load_scenario(str(STREET))) as simulator:
        first = simulator.reset(1)
        # Workers come from a process that was begun elsewhere.
        monkeypatch.chdir(STREET.parent)
        with SumoSimulator(load_scenario(STREET.name)) as other:
            assert _same(other.reset(1), first)


def test_a_worker_is_started_where_the_folder_is_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SumoSimulator(load_scenario(str(STREET))) as simulator:
        first = simulator.reset(1)
        here = tmp_path / "here"
        here.mkdir()
        monkeypatch.chdir(here)
        here.rmdir()
        assert _same(simulator.reset(1), first)


# -- side by side ---------------------------------------------------------------------------------


@pytest.fixture
def many() -> Iterator[Any]:
    made: list[gymnasium.vector.VectorEnv[Any, Any, Any]] = []

    def make(num_envs: int, **options: Any) -> SceneVectorEnv:
        env = gymnasium.make_vec("hatn_sim/Scene-v0", num_envs=num_envs, **options)
        assert isinstance(env, SceneVectorEnv)
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()


@pytest.mark.parametrize(
    ("predictor", "near"), [("constant_velocity", 0.0), ("hatn", 1e-3), (None, 0.0)]
)
def test_side_by_side_as_one_by_one(predictor: str | None, near: float, many: Any) -> None:
    options: dict[str, Any] = {
        "scene": "intersection5",
        "predictor": predictor,
        "warm_up_s": 20.0,
        "duration_s": 2.0,
    }
    if predictor is not None:
        options["masked_action"] = "yield"
    singles = [gymnasium.make("hatn_sim/Scene-v0", **options).unwrapped for _ in range(3)]
    vector = many(3, **options)
    told, _ = vector.reset(seed=5)
    for k, single in enumerate(singles):
        alone, _ = single.reset(seed=5 + k)
        assert all(np.array_equal(told[key][k], alone[key]) for key in alone)
    is_over = [False] * 3
    for number in range(7):
        slots = np.array([(number // 2 + k) % 3 for k in range(3)])
        action = np.sin(slots)[:, None].astype(np.float32) if predictor is None else slots
        told, rewards, ends, cuts, info = vector.step(action)
        for k, single in enumerate(singles):
            if is_over[k]:
                (alone, own_info), reward, end, cut = single.reset(), 0.0, False, False
            else:
                alone, reward, end, cut, own_info = single.step(action[k])
            is_over[k] = bool(end or cut)
            assert (end, cut) == (ends[k], cuts[k])
            assert reward == pytest.approx(rewards[k], abs=near)
            assert info["ego_id"][k] == own_info["ego_id"] and info["end"][k] == own_info["end"]
            assert info["seen"][k].scene.ids == own_info["seen"].scene.ids
            for key, value in alone.items():
                np.testing.assert_allclose(told[key][k], value, atol=near, err_msg=key)
    for single in singles:
        single.close()


def test_a_refused_action_leaves_all_as_they_were(many: Any) -> None:
    vector = many(2, **SHORT | {"predictor": "constant_velocity"})
    vector.reset(seed=3)
    before = vector.get_attr("_episode")
    masks = vector.action_masks()
    assert masks.shape == (2, 8) and masks[:, 0].all()
    with pytest.raises(MaskedActionError, match="environment 1: action: slot 7 is not there"):
        vector.step(np.array([0, 7]))
    with pytest.raises(ActionShapeError, match="each of 2 environments, found 3"):
        vector.step(np.array([0, 0, 0]))
    for wrong in (None, 0):
        with pytest.raises(ActionTypeError, match="expected one of each environment"):
            vector.step(wrong)
    assert vector.get_attr("_episode") == before
    vector.step(np.array([0, 0]))


def test_at_least_one() -> None:
    with pytest.raises(OptionError, match="num_envs: expected 1 or more, found 0"):
        gymnasium.make_vec("hatn_sim/Scene-v0", num_envs=0, **SHORT)


def test_resets_in_the_same_step(many: Any) -> None:
    vector = many(2, **SHORT, duration_s=0.5, autoreset_mode=AutoresetMode.SAME_STEP)
    vector.reset(seed=3)
    told, _, _, cuts, info = vector.step(np.zeros((2, 1), np.float32))
    assert cuts.all() and "final_obs" in info
    assert told["ego"][:, -1].tolist() == [1.0, 1.0]


def test_ctrl_c_leaves_no_result_behind(many: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    vector = many(2, **SHORT)
    first, _ = vector.reset(seed=3)
    with monkeypatch.context() as patched:
        patched.setattr(SyncVectorEnv, "step", interrupted)
        with pytest.raises(KeyboardInterrupt):
            vector.step(np.zeros((2, 1), np.float32))
    again, _ = vector.reset(seed=3)
    assert all(np.array_equal(first[key], again[key]) for key in first)


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_each_in_a_process_of_its_own(context: str) -> None:
    here = make_short()
    here.reset(seed=4)
    vector = AsyncVectorEnv([make_short] * 2, context=context, shared_memory=True)
    told, _ = vector.reset(seed=4)
    alone, _ = here.reset(seed=4)
    assert all(np.array_equal(told[key][0], alone[key]) for key in alone)
    for _ in range(3):
        told, *_ = vector.step(np.zeros((2, 1), np.float32))
        alone, *_ = here.step(np.zeros(1, np.float32))
    assert all(np.array_equal(told[key][0], alone[key]) for key in alone)
    vector.close()
    here.step(np.zeros(1, np.float32))
    here.close()


# -- what is left ---------------------------------------------------------------------------------


def check_resets(count: int, most_megabytes: float) -> None:
    before = own()
    env = gymnasium.make("hatn_sim/Scene-v0", **SHORT).unwrapped
    env.reset(seed=0)
    for _ in range(20):
        env.reset()
    here = own()
    nursery = next(pid for pid in here[0] if pid != env._simulator.worker_pid)
    size = [memory_bytes(pid) for pid in (os.getpid(), nursery)]
    for _ in range(count):
        env.reset()
        env.step(np.zeros(1, np.float32))
    processes, files = own()
    assert len(processes) == len(here[0]) and len(files) == len(here[1])
    for pid, was in zip((os.getpid(), nursery), size, strict=True):
        assert memory_bytes(pid) - was < most_megabytes * MEGABYTES
    env.close()
    assert own() == before


@LINUX
def test_resets_leave_nothing() -> None:
    check_resets(50, 4.0)


@LINUX
@pytest.mark.slow
def test_a_thousand_resets_leave_nothing() -> None:
    check_resets(1000, 8.0)


@LINUX
def test_the_last_to_close_leaves_nothing() -> None:
    before = own()
    one, other = (gymnasium.make("hatn_sim/Scene-v0", **SHORT) for _ in range(2))
    one.reset(seed=1)
    other.reset(seed=1)
    first = one.step(np.zeros(1, np.float32))
    assert len(own()[0] - before[0]) == 3  # two workers, and what both were forked from
    one.close()
    assert len(own()[0] - before[0]) == 2
    assert same(other.step(np.zeros(1, np.float32)), first)
    one.reset(seed=1)
    assert same(one.step(np.zeros(1, np.float32)), first)
    one.close()
    other.close()
    other.close()
    assert own() == before


@LINUX
def test_what_workers_are_forked_from_may_be_killed() -> None:
    before = own()
    env = gymnasium.make("hatn_sim/Scene-v0", **SHORT).unwrapped
    env.reset(seed=2)
    first = env.step(np.zeros(1, np.float32))
    worker = env._simulator.worker_pid
    (nursery,) = children(os.getpid()) - before[0] - {worker}
    os.kill(nursery, signal.SIGKILL)
    env.step(np.zeros(1, np.float32))  # nobody minds
    env.reset(seed=2)
    assert same(env.step(np.zeros(1, np.float32)), first)
    until(lambda: not Path(f"/proc/{worker}").exists())
    env.close()
    assert own() == before


@LINUX
def test_simulators_that_nobody_closes_do_not_pile_up() -> None:
    before = own()[0]
    scenario = load_scenario(str(STREET))
    for _ in range(3):
        simulator = SumoSimulator(scenario)
        simulator.reset(1)
        left = own()[0] - before - {simulator.worker_pid}
        del simulator
        gc.collect()
        until(lambda left=left: len(alive(left)) <= 1)  # but for what all were forked from
    with SumoSimulator(scenario) as simulator:
        simulator.reset(1)
        # The newest may still be leaving, or wait to be asked for.
        assert len(own()[0] - before) <= 3
    while nursery := sumo_process._Nursery._known.get(sumo_process.WORKER):
        nursery.leave()  # who closes nothing does not say so either


def alive(pids: set[int]) -> set[int]:
    """Those that have not ended."""
    return {pid for pid in pids if "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()}


class Interrupted:
    """A socket at which ctrl-C is pressed when an answer is waited for."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket

    def __getattr__(self, name: str) -> Any:
        return getattr(self._socket, name)

    def recv(self, *_: object) -> bytes:
        raise KeyboardInterrupt


@LINUX
def test_ctrl_c_while_a_worker_is_forked(monkeypatch: pytest.MonkeyPatch) -> None:
    before = own()
    scenario = load_scenario(str(STREET))
    with SumoSimulator(scenario) as one, SumoSimulator(scenario) as other:
        one.reset(1)
        (nursery,) = sumo_process._Nursery._known.values()
        with monkeypatch.context() as patched:
            patched.setattr(nursery, "_control", Interrupted(nursery._control))
            with pytest.raises(KeyboardInterrupt):
                other.reset(1)
        other.reset(1)
        # The answer that nobody heard is taken for no other: this is the process that runs.
        worker = other.worker_pid
        assert worker is not None and alive({worker}) == {worker}
        assert _same(one.step(), other.step())
        other.close()
        assert worker not in children(os.getpid())
    until(lambda: own() == before)


@LINUX
def test_a_fork_is_not_kept_waiting_by_what_another_thread_held() -> None:
    """Whoever is forked while a worker is being started starts workers all the same."""
    with _Nursery._lock:
        pid = os.fork()
        if pid == 0:
            free = _Nursery._lock.acquire(timeout=1.0)
            os._exit(0 if free and not _Nursery._known else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0


def test_elsewhere_than_where_it_was_tried_nothing_is_forked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sumo_process, "FORKS", False)
    monkeypatch.setattr(_Nursery, "shared", None)
    with SumoSimulator(load_scenario("tjunction")) as simulator:
        first = simulator.reset(1)
        assert simulator.worker_pid is not None
    assert not first.done


def test_no_room_for_one_more() -> None:
    import resource  # not on every platform

    with SumoSimulator(load_scenario(str(STREET))) as one:
        one.reset(1)
        files = len(list(Path("/proc/self/fd").iterdir())) - 1
        limits = resource.getrlimit(resource.RLIMIT_NOFILE)
        with SumoSimulator(one.scenario) as other:
            resource.setrlimit(resource.RLIMIT_NOFILE, (files, limits[1]))
            try:
                with pytest.raises(SimulatorError, match="could not be started: Too many open"):
                    other.reset(1)
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, limits)
            assert len(list(Path("/proc/self/fd").iterdir())) - 1 == files
            other.reset(1)


def test_a_killed_worker_among_several(many: Any) -> None:
    vector = many(3, **SHORT)
    vector.reset(seed=1)
    killed = vector.envs[1].unwrapped
    os.kill(killed._simulator.worker_pid, signal.SIGKILL)
    with pytest.raises(SimulatorError, match=r"SUMO stopped in intersection5 .*killed by signal 9"):
        vector.step(np.zeros((3, 1), np.float32))
    with pytest.raises(NeedsResetError):
        vector.step(np.zeros((3, 1), np.float32))
    vector.reset(seed=1)
    vector.step(np.zeros((3, 1), np.float32))


PROGRAM = """
import gymnasium, numpy as np, hatn_sim.envs
env = gymnasium.make_vec("hatn_sim/Scene-v0", num_envs=2, scene="intersection5", predictor=None,
                         warm_up_s=1.0)
env.reset(seed=1)
print("begun", flush=True)
while True:
    env.step(np.zeros((2, 1), np.float32))
"""


@LINUX
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_no_process_outlives_the_program(how: signal.Signals) -> None:
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        env=os.environ | {"PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)},
    )
    assert program.stdout is not None and program.stdout.readline() == "begun\n"
    theirs = children(program.pid)
    assert len(theirs) == 3
    if how == signal.SIGINT:
        os.killpg(program.pid, how)  # ctrl-C reaches them all
    else:
        program.kill()
    _, words = program.communicate(timeout=60)
    assert ("KeyboardInterrupt" in words) == (how == signal.SIGINT)
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in theirs))
