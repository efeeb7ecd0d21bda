"""Branches of a SUMO worker's simulation.

The life of a child: carry out changes, drive to the horizon, tell what happened.

libsumo is handed in as `sumo`: the worker imports it.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hatn_sim.datatypes import BoolArray, Branch, Change, FloatArray, Lawful
from hatn_sim.simulators.sumo_messages import BranchEnded, BranchesStarted
from hatn_sim.simulators.sumo_obey import Obedience
from hatn_sim.simulators.sumo_routes import RouteTracker
from hatn_sim.simulators.sumo_rows import INVALID_M, ROUNDING_MPS, centred

if TYPE_CHECKING:
    from hatn_sim.simulators.forks import Forks

LAWLESS: Final = (
    "jmIgnoreFoeProb",
    "jmIgnoreFoeSpeed",
    "jmIgnoreJunctionFoeProb",
    "jmDriveAfterYellowTime",
    "jmDriveAfterRedTime",
)
"""What in a vehicle's type makes its driver overlook others or run lights."""
KEPT: Final = {"jmDriveAfterYellowTime": "-1", "jmDriveAfterRedTime": "-1"}
"""SUMO's values for drivers who keep the rules, where they are not 0."""
OVERLOOKED: Final = ("junctionModel.ignoreIDs", "junctionModel.ignoreTypes")
"""What makes a single vehicle overlook others."""


class Branches:
    """The branches of a worker's simulation, each driven by a child."""

    def __init__(
        self, sumo: Any, tracker: RouteTracker, collisions: Callable[[], Sequence[tuple[str, str]]]
    ) -> None:
        self._sumo = sumo
        self._tracker = tracker
        self._collisions = collisions
        self._forks: Forks | None = None

    @property
    def cannot(self) -> str | None:
        """Why this simulation cannot be forked, in the user's words; None where it can."""
        if not hasattr(os, "fork"):
            return "this platform cannot fork a running simulation; use Linux or macOS"
        for option, most in (("threads", 1), ("device.rerouting.threads", 0)):
            if int(self._sumo.simulation.getOption(option)) > most:
                return f"SUMO runs threads, which a fork loses; set its option {option} to {most}"
        return None

    def start(
        self, futures: Sequence[Sequence[Change]], commanded: Collection[str], steps: int
    ) -> BranchesStarted:
        """Forks a child for every set of changes."""
        from hatn_sim.simulators.forks import Forks  # not on every platform: see `cannot`

        if self._forks is None:
            self._forks = Forks(os.cpu_count() or 1)
        works = (partial(self._drive, changes, commanded, steps) for changes in futures)
        return BranchesStarted(tuple(map(self._forks.start, works)))

    def outcome(self, number: int) -> BranchEnded:
        """The branch of this number, when it is done."""
        assert self._forks is not None, "no branch has been started"
        return BranchEnded(self._forks.result(number))

    def reap(self) -> None:
        """Takes in what is done."""
        if self._forks is not None:
            self._forks.reap()

    def end(self) -> None:
        """Ends the children that are still driving."""
        if self._forks is not None:
            self._forks.end()

    def _drive(self, changes: Sequence[Change], commanded: Collection[str], steps: int) -> bytes:
        reader = _Reader(self._sumo, self._tracker, self._collisions)
        drive_branch(self._sumo, changes, commanded, steps, reader.read)
        return pickle.dumps(reader.branch(), protocol=5)


def drive_branch(
    sumo: Any,
    changes: Sequence[Change],
    commanded: Collection[str],
    steps: int,
    read: Callable[[], None],
) -> None:
    """Drives `steps` steps of 0.1 s, and reads before the first and after each.

    `commanded` vehicles are SUMO's again, as after a step without commands.
    """
    for change in changes:
        if isinstance(change, Lawful):
            _keep_rules(sumo, change.ego_id)
    obedience = Obedience(sumo, changes, commanded)
    read()
    for step in range(steps):
        obedience.drive(step)
        sumo.simulationStep()
        read()


def _keep_rules(sumo: Any, name: str) -> None:
    vehicle, vehicle_type = sumo.vehicle, sumo.vehicletype
    if name not in vehicle.getIDList():
        return
    for key in OVERLOOKED:
        if vehicle.getParameter(name, key):
            vehicle.setParameter(name, key, "")
    type_id = vehicle.getTypeID(name)
    for key in LAWLESS:
        if vehicle_type.getParameter(type_id, f"junctionModel.{key}"):
            vehicle_type.setParameter(type_id, f"junctionModel.{key}", KEPT.get(key, "0"))


class _Reader:
    """Reads the least that a branch is made of, step by step.

    The tracker asks SUMO as it does in the run: `getNextLinks`, which it needs at times, draws
    random numbers where drivers overlook others at random, so that not to ask would be inexact.
    """

    def __init__(
        self, sumo: Any, tracker: RouteTracker, collisions: Callable[[], Sequence[tuple[str, str]]]
    ) -> None:
        self._sumo = sumo
        self._tracker = tracker
        self._collisions_now = collisions
        self._columns: dict[str, int] = {}
        self._looks: list[tuple[float, float, float]] = []  # length, width, hardest deceleration
        self._seen: list[list[int]] = []
        self._rows: list[tuple[float, float, float, float]] = []  # front x, y, compass angle, speed
        self._times_s: list[float] = []
        self._collisions: list[tuple[float, str, str]] = []

    def read(self) -> None:
        """Reads what is on the road now; the first call is before the first step."""
        vehicle, simulation, columns, rows = (
            self._sumo.vehicle, self._sumo.simulation, self._columns, self._rows,
        )  # fmt: skip
        position, angle, speed = vehicle.getPosition, vehicle.getAngle, vehicle.getSpeed
        lane, route, track = vehicle.getLaneID, vehicle.getRouteID, self._tracker.index
        time_s, stepped, seen = simulation.getTime(), bool(self._seen), list[int]()
        if stepped:
            for name in simulation.getArrivedIDList():
                self._tracker.forget(name)
            self._collisions += [(time_s, *pair) for pair in self._collisions_now()]
        for name in vehicle.getIDList():
            x_m, y_m = position(name)
            if x_m < INVALID_M:
                continue
            column = columns.get(name)
            if column is None:
                column = columns[name] = len(columns)
                look = vehicle.getLength(name), vehicle.getWidth(name)
                self._looks.append((*look, vehicle.getEmergencyDecel(name)))
            seen.append(column)
            rows.append((x_m, y_m, angle(name), speed(name)))
            if stepped:
                track(name, lane(name), route(name))
        self._seen.append(seen)
        self._times_s.append(time_s)

    def branch(self) -> Branch:
        """All that was read."""
        frames, count = len(self._seen), len(self._columns)
        looks = np.array(self._looks, np.float64).reshape(count, 3)
        frame = np.repeat(np.arange(frames), [len(seen) for seen in self._seen])
        column = np.array([one for seen in self._seen for one in seen], np.int64)
        rows = np.array(self._rows, np.float64).reshape(-1, 4)
        xy_m, yaw_rad = centred(rows[:, :2], rows[:, 2], looks[column, 0])
        valid = np.zeros((frames, count), np.bool_)
        valid[frame, column] = True

        def table(values: FloatArray) -> FloatArray:
            whole = np.zeros((frames, count, *values.shape[1:]))
            whole[frame, column] = values
            return whole

        ids, times_s, speed_mps = tuple(self._columns), np.array(self._times_s), table(rows[:, 3])
        braking = brakes_hardest(valid, speed_mps, looks[:, 2], self._sumo.simulation.getDeltaT())
        return Branch(
            ids=ids,
            time_s=times_s,
            valid=valid,
            xy_m=table(xy_m),
            yaw_rad=table(yaw_rad),
            speed_mps=speed_mps,
            size_m=looks[:, :2].copy(),
            collisions=tuple(self._collisions),
            emergency_braking=tuple(
                (float(times_s[when]), ids[who]) for when, who in np.argwhere(braking).tolist()
            ),
        )


def brakes_hardest(
    valid: BoolArray, speed_mps: FloatArray, hardest_mps2: FloatArray, dt_s: float
) -> BoolArray:
    """[B, N]: the vehicle has braked as hard as it can (`hardest_mps2` [N]) since the frame before.

    As the frames of a run tell it: SUMO warns of these but gives no list of them.
    """
    there = valid[1:] & valid[:-1]
    lost_mps = speed_mps[:-1] - speed_mps[1:]
    braking = np.zeros(valid.shape, np.bool_)
    braking[1:] = there & (lost_mps > 0.0) & (lost_mps >= hardest_mps2 * dt_s - ROUNDING_MPS)
    return braking
