"""Vehicles of a branch that do as they are told: their speeds, step by step.

libsumo is handed in as `sumo`: the worker imports it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Final

from hatn_sim.datatypes import Change, GiveWay, Plan
from hatn_sim.simulators.sumo_rows import (
    FOLLOW_SPEED_MODE,
    OBEY_SPEED_MODE,
    OWN_SPEED_MODE,
)

NOSE_M: Final = 0.5
"""Whose front bumper is farther in a place than this does not stop in it."""
LEAST_ROOM_M: Final = 0.1


class Obedience:
    """Drives those who are told what to do, and releases them.

    `commanded` vehicles are SUMO's again, as after a step without commands.
    """

    def __init__(self, sumo: Any, changes: Sequence[Change], commanded: Collection[str]) -> None:
        self._sumo = sumo
        self._told = {
            one.ego_id: _Planned(one) if isinstance(one, Plan) else _GivesWay(one, sumo.vehicle)
            for one in changes
            if isinstance(one, Plan | GiveWay)
        }
        self._driving = set(commanded)
        self._before_mps: dict[str, float] = {}

    def drive(self, step: int) -> None:
        """Sets the speeds of a step that is to come."""
        if not self._told and not self._driving:
            return
        vehicle = self._sumo.vehicle
        present = set(vehicle.getIDList())
        dt_s: float = self._sumo.simulation.getDeltaT()
        speeds_mps: dict[str, float] = {}
        for name, one in self._told.items():
            if name not in present:
                continue
            now_mps = vehicle.getSpeed(name)
            # What the driver does by himself is known for the step before; he does so again.
            own_mps = vehicle.getSpeedWithoutTraCI(name) - self._before_mps.get(name, now_mps)
            speed_mps = one.next_speed_mps(step, dt_s, now_mps, now_mps + own_mps)
            self._before_mps[name] = now_mps
            if speed_mps is not None:
                speeds_mps[name] = max(speed_mps, 0.0)
        for name in (self._driving - speeds_mps.keys()) & present:
            vehicle.setSpeed(name, -1.0)
            vehicle.setSpeedMode(name, OWN_SPEED_MODE)
        for name, speed_mps in speeds_mps.items():
            if name not in self._driving:
                vehicle.setSpeedMode(name, self._told[name].speed_mode)
            vehicle.setSpeed(name, speed_mps)
        self._driving = set(speeds_mps)


class _Planned:
    """Drives a plan."""

    def __init__(self, plan: Plan) -> None:
        self.speed_mode = FOLLOW_SPEED_MODE if plan.follows else OBEY_SPEED_MODE
        self._plan = plan
        self._excess_mps: float | None = None  # how much faster than planned it was at the start

    def next_speed_mps(
        self, step: int, dt_s: float, now_mps: float, own_mps: float
    ) -> float | None:
        """For the step to come; None: its driver chooses."""
        plan = self._plan
        place = step - round(plan.start_s / dt_s)
        if not 0 <= place < len(plan.speed_mps):
            return None
        planned_mps = float(plan.speed_mps[place])
        if plan.blend_s > 0.0:
            if self._excess_mps is None:
                self._excess_mps = now_mps - planned_mps
            planned_mps += self._excess_mps * max(1.0 - (place + 1) * dt_s / plan.blend_s, 0.0)
        return max(planned_mps, own_mps) if plan.at_least else planned_mps


class _GivesWay:
    """Gives way."""

    speed_mode = OBEY_SPEED_MODE

    def __init__(self, change: GiveWay, vehicle: Any) -> None:
        self._change, self._vehicle = change, vehicle
        self._begun_m: float | None = None  # on the odometer

    def next_speed_mps(
        self, step: int, dt_s: float, now_mps: float, own_mps: float
    ) -> float | None:
        """For the step to come; None: its driver chooses."""
        change, driven_m = self._change, self._vehicle.getDistance(self._change.ego_id)
        if self._begun_m is None:
            self._begun_m = driven_m
        left_m, left_s = change.room_m - (driven_m - self._begun_m), change.open_s - step * dt_s
        if step < round(change.start_s / dt_s) or left_s <= 0.0 or left_m < -NOSE_M:
            return None
        # Half of what is driven in this step is gone before it brakes.
        room_m = max(left_m - 0.5 * dt_s * now_mps, LEAST_ROOM_M)
        needed_mps2 = braking_to_give_way_mps2(now_mps, room_m, left_s)
        return min(now_mps - dt_s * min(needed_mps2, change.hardest_mps2), own_mps)


def braking_to_give_way_mps2(speed_mps: float, room_m: float, time_s: float) -> float:
    """Even braking so as to drive a way in no less than a time, or to stop before its end.

    2 (v t - d) / t^2 for who still rolls then, v^2 / 2 d for who has to stop; 0 for who is slow
    enough. As `assist.risk.required_deceleration_mps2`, of one vehicle.
    """
    even_mps2 = 2.0 * (speed_mps * time_s - room_m) / time_s**2
    if even_mps2 <= 0.0:
        return 0.0
    return even_mps2 if even_mps2 * time_s <= speed_mps else speed_mps**2 / (2.0 * room_m)
