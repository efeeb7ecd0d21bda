"""Hand-drawn roads for the tests, and hypothesis held still."""

from __future__ import annotations

import hashlib
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterable
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # tests run side by side: threads only wait here

import numpy as np
import pytest
from hypothesis import settings

from hatn_sim.datatypes import Gate, Kind, Lane, Scene
from hatn_sim.road import Road
from hatn_sim.simulators import sumo_process

settings.register_profile("still", derandomize=True, deadline=None, max_examples=25)
settings.load_profile("still")


def slow_but(every: Iterable[str], *kept: str) -> list[Any]:
    """Parameters of a test: all of them, of which only those kept run by default."""
    marks = pytest.mark.slow
    every = list(every)
    assert set(kept) <= set(every), f"not among {every}: {set(kept) - set(every)}"
    return [one if one in kept else pytest.param(one, marks=marks) for one in every]


def heed_ctrl_c() -> None:
    """For `preexec_fn`: what is started from a shell's background ignores ctrl-C otherwise."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


EVERYBODY = frozenset(Kind)


def lane(name: str, points: list[tuple[float, float]], *successors: str, **more: object) -> Lane:
    """A lane through points, 3.2 m wide, at 13.9 m/s."""
    return Lane(
        id=name,
        xy_m=np.array(points, dtype=np.float64),
        width_m=3.2,
        speed_limit_mps=13.9,
        successors=successors,
        kinds=EVERYBODY,
        **more,  # type: ignore[arg-type]
    )


def crossing_lanes(angle_rad: float = 0.0, shift_m: tuple[float, float] = (0.0, 0.0)) -> list[Lane]:
    """A crossing at the origin: west to east, south to north, and a left turn from west to north.

    All three meet at right angles in closed form. The left turn is a quarter circle of radius 8 m.
    West has a stop line at its end. Optionally turned and shifted.
    """
    arc = [(-8.0 + 8.0 * np.sin(t), 8.0 - 8.0 * np.cos(t)) for t in np.linspace(0.0, np.pi / 2, 61)]
    lanes = [
        lane("w", [(-108, 0), (-8, 0)], "we", "wn", gate=Gate.STOP_LINE),
        lane("we", [(-8, 0), (8, 0)], "e", is_connection=True),
        lane("e", [(8, 0), (158, 0)]),
        lane("s", [(0, -108), (0, -8)], "sn"),
        lane("sn", [(0, -8), (0, 8)], "n", is_connection=True),
        lane("n", [(0, 8), (0, 158)]),
        lane("wn", arc, "n", is_connection=True, turn=1),
    ]
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[cos, sin], [-sin, cos]])
    return [Lane(**{**one.__dict__, "xy_m": one.xy_m @ turn + np.array(shift_m)}) for one in lanes]


def with_signal_at_south(lanes: list[Lane]) -> list[Lane]:
    """The same, but who comes from the south has a signal, 8 m before the middle."""
    signal = lane("s", [(0, -108), (0, -8)], "sn", gate=Gate.SIGNAL, signals={"sn": 0})
    return [*(one for one in lanes if one.id != "s"), signal]


@pytest.fixture
def crossing() -> Road:
    """The hand-drawn crossing."""
    return Road(crossing_lanes())


def scene_of(
    time_s: float, vehicles: dict[str, tuple[float, float, float, float]], blinker: int = 0
) -> Scene:
    """Cars of 5 m x 2 m: id -> x, y, yaw, speed."""
    rows = np.array(list(vehicles.values()), dtype=np.float64).reshape(-1, 4)
    count = len(rows)
    return Scene(
        time_s=time_s,
        ids=tuple(vehicles),
        xy_m=rows[:, :2].copy(),
        yaw_rad=rows[:, 2].copy(),
        speed_mps=rows[:, 3].copy(),
        size_m=np.tile([5.0, 2.0], (count, 1)),
        kind=np.zeros(count, dtype=np.int64),
        colour=np.full((count, 3), 200),
        blinker=np.full(count, blinker),
        signal_closed=np.zeros(0, dtype=np.bool_),
    )


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Generator[None, None, None]:
    """What is kept for the next command goes nowhere near the user's own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


class StayingNursery(sumo_process._Nursery):
    """Has a user more than it is told of."""

    def __init__(self, module: str) -> None:
        super().__init__(module)
        self._users = 1


@pytest.fixture(autouse=True, scope="module")
def nursery_that_stays() -> Generator[None, None, None]:
    """What SUMO's processes are forked from stays until a module's last test, once it is there.

    As in a program that keeps a simulator open; to start it for every test takes half a second.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sumo_process, "_Nursery", StayingNursery)
        yield
        for nursery in list(StayingNursery._known.values()):
            nursery.leave()


FREEZERS = {
    "hatn_sim.hatn.predictor": ("frozen_sgn", "frozen_edn"),
    "hatn_sim.hatn.adaptation_layer": ("frozen_edn",),
}
"""Who freezes networks, and by which functions."""


def once_for_equals(freeze: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, asked once for networks of the same settings and weights."""
    known: dict[Any, Any] = {}

    def frozen(network: Any, *how: object, **more: object) -> Any:
        content = hashlib.sha256()
        for name, tensor in network.state_dict().items():
            content.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
            content.update(tensor.numpy().tobytes())
        key = (type(network), repr(network.settings), how, *more.items(), content.digest())
        if key not in known:
            known[key] = freeze(network, *how, **more)
        return known[key]

    return frozen


@pytest.fixture(autouse=True, scope="session")
def networks_frozen_once() -> Generator[None, None, None]:
    """To freeze a network takes a second, and a frozen one keeps nothing.

    Where nobody has imported it yet, it is left as it is: that alone would take two seconds.
    """
    with pytest.MonkeyPatch.context() as patch:
        for module, names in FREEZERS.items():
            for name in names if module in sys.modules else ():
                patch.setattr(f"{module}.{name}", once_for_equals(vars(sys.modules[module])[name]))
        yield


@pytest.fixture
def networks_frozen_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a program of its own, for tests that ask whether a second run is the first."""
    from hatn_sim.hatn import adaptation_layer, edn_program, predictor, sgn_program

    monkeypatch.setattr(predictor, "frozen_sgn", sgn_program.frozen_sgn)
    for module in (predictor, adaptation_layer):
        monkeypatch.setattr(module, "frozen_edn", edn_program.frozen_edn)
