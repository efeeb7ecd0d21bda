"""Vehicles of a branch that do as they are told, in a make-believe simulation and in SUMO."""

from __future__ import annotations

import numpy as np
import pytest
from test_branch import after, one_branch, with_risk

from hatn_sim.assist.risk import required_deceleration_mps2
from hatn_sim.datatypes import DT_S, GiveWay, Plan
from hatn_sim.simulators.sumo import SumoSimulator
from hatn_sim.simulators.sumo_obey import Obedience, braking_to_give_way_mps2


class Car:
    """One vehicle; its own driver, if he is let, accelerates by `own_mps2`."""

    def __init__(self, speed_mps: float, own_mps2: float = 0.0) -> None:
        self.speed_mps, self.own_mps2, self.way_m = speed_mps, own_mps2, 0.0
        self.wanted_mps = -1.0
        self.would_mps = speed_mps
        self.vehicle = self.simulation = self

    def getIDList(self) -> tuple[str, ...]:  # noqa: N802
        return ("a",)

    def getDeltaT(self) -> float:  # noqa: N802
        return DT_S

    def getSpeed(self, name: str) -> float:  # noqa: N802
        return self.speed_mps

    def getSpeedWithoutTraCI(self, name: str) -> float:  # noqa: N802
        return self.would_mps

    def getDistance(self, name: str) -> float:  # noqa: N802
        return 100.0 + self.way_m

    def setSpeedMode(self, name: str, mode: int) -> None:  # noqa: N802
        pass

    def setSpeed(self, name: str, speed_mps: float) -> None:  # noqa: N802
        self.wanted_mps = speed_mps

    def step(self) -> None:
        self.would_mps = max(self.speed_mps + DT_S * self.own_mps2, 0.0)
        now_mps = self.would_mps if self.wanted_mps < 0.0 else self.wanted_mps
        self.speed_mps = now_mps
        self.way_m += DT_S * now_mps


def driven(car: Car, change: GiveWay | Plan, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Speed and way [B] at the end of each step."""
    obedience, rows = Obedience(car, (change,), ()), []
    for step in range(round(seconds / DT_S)):
        obedience.drive(step)
        car.step()
        rows.append((car.speed_mps, car.way_m))
    speed, way = np.array(rows).T
    return speed, way


@pytest.mark.parametrize(
    ("speed_mps", "room_m", "open_s"), [(10.0, 30.0, 4.0), (10.0, 40.0, 4.5), (6.0, 9.0, 5.0)]
)
def test_giving_way_is_as_gentle_as_it_can_be(
    speed_mps: float, room_m: float, open_s: float
) -> None:
    """It reaches the place as it is free, having braked evenly; or it stands before it."""
    speed, way = driven(Car(speed_mps), GiveWay("a", 1.0, room_m, open_s, 8.0), open_s)
    assert way[-1] <= room_m + 0.3
    np.testing.assert_allclose(speed[:10], speed_mps)  # reacting
    needed = required_deceleration_mps2(
        np.array(room_m - speed_mps), np.array(speed_mps), np.array(open_s - 1.0)
    )
    lost = -np.diff(speed[10:-1]) / DT_S
    assert lost.max() < 1.25 * float(needed) + 0.1
    if speed[-1] > 0.5:
        np.testing.assert_allclose(way[-1], room_m, atol=0.5)


def test_braking_of_one_is_that_of_the_measure_of_risk() -> None:
    rng = np.random.default_rng(3)
    v, d, t = rng.uniform((0.0, 0.5, 0.2), (15.0, 60.0, 8.0), (200, 3)).T
    one = [braking_to_give_way_mps2(*row) for row in zip(v, d, t, strict=True)]
    np.testing.assert_allclose(one, required_deceleration_mps2(d, v, t), rtol=1e-9)


def test_who_brakes_harder_by_himself_does_and_is_free_afterwards() -> None:
    speed, _ = driven(Car(10.0, own_mps2=-5.0), GiveWay("a", 0.0, 100.0, 1.0, 8.0), 2.0)
    np.testing.assert_allclose(speed[5], speed[4] - 0.5)
    free, _ = driven(Car(2.0, own_mps2=2.0), GiveWay("a", 0.0, 100.0, 1.0, 8.0), 2.0)
    assert free[:10].max() <= 2.01  # it does not speed up while it gives way
    assert free[-1] == pytest.approx(2.0 + 1.0 * 2.0, abs=0.25)


def test_whose_nose_is_in_the_place_does_not_stop_there() -> None:
    speed, _ = driven(Car(5.0), GiveWay("a", 1.0, 4.0, 5.0, 8.0), 3.0)
    np.testing.assert_allclose(speed, 5.0)


def test_a_plan_that_is_the_least() -> None:
    plan = np.full(20, 6.0)
    held, _ = driven(Car(5.0, own_mps2=3.0), Plan("a", 0.0, plan), 2.0)
    np.testing.assert_allclose(held, 6.0)
    least, _ = driven(Car(5.0, own_mps2=3.0), Plan("a", 0.0, plan, at_least=True), 2.0)
    assert least[0] == 6.0 and least[-1] > 9.0


def test_in_sumo_a_vehicle_stays_out_until_the_place_is_free() -> None:
    with SumoSimulator(with_risk("roundabout8", "assertive")) as simulator:
        scene = after(simulator, 500).scene
        fast = np.flatnonzero(scene.speed_mps > 5.0)
        ego = scene.ids[int(fast[0])]
        speed_mps = float(scene.speed_mps[fast[0]])
        room_m = 3.0 * speed_mps
        branch = one_branch(simulator, GiveWay(ego, 1.0, room_m, 5.0, 8.0), horizon_s=6.0)
    column = branch.ids.index(ego)
    seen = branch.valid[:51, column]
    way = np.append(0.0, np.cumsum(DT_S * branch.speed_mps[1:51, column]))
    assert seen.all()
    assert way[-1] <= room_m + 0.2
    lost = -np.diff(branch.speed_mps[10:50, column]) / DT_S
    assert lost.max() < 8.1
