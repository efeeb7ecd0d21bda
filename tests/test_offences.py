"""Since when an offence could be seen, in futures made by hand."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hatn_sim.datatypes import DT_S, Branch, Lawful, SafetyEvent
from hatn_sim.score.offences import warnable_s

IDS = ("ego", "foe")
SPEED_MPS = 10.0


class Drives:
    """Both drive at 10 m/s; from 104 s on a lawful foe would slow down by 2 m/s2."""

    def __init__(self, lost: bool = False, offends: bool = True) -> None:
        self.lost, self.offends = lost, offends
        self.asked_s: list[float] = []

    def _frame(self) -> Any:
        scene = SimpleNamespace(time_s=100.0 + DT_S * self.tick, ids=IDS)
        return SimpleNamespace(scene=scene, done=self.tick > 100)

    def reset(self, seed: int) -> Any:
        self.tick = 0
        return self._frame()

    def step(self) -> Any:
        self.tick += 1
        return self._frame()

    def branch(self, futures: Sequence[Sequence[Lawful]], horizon_s: float) -> Any:
        self.asked_s.append(100.0 + DT_S * self.tick)
        return [SimpleNamespace(result=lambda f=f: self._future(f, horizon_s)) for f in futures]

    def _future(self, changes: Sequence[Lawful], horizon_s: float) -> Branch | None:
        if self.lost and changes:
            return None
        time_s = self.asked_s[0] + DT_S * np.arange(round(horizon_s / DT_S) + 1, dtype=np.float64)
        speed = np.full((len(time_s), 2), SPEED_MPS)
        if self.offends and any(one.ego_id == "foe" for one in changes):
            speed[:, 1] -= 2.0 * np.maximum(time_s - 104.0, 0.0)
        zero = np.zeros(speed.shape)
        valid = np.ones(speed.shape, dtype=np.bool_)
        xy, size = np.zeros((*speed.shape, 2)), np.ones((2, 2))
        return Branch(IDS, time_s, valid, xy, zero, speed, size, (), ())


def event(start_s: float, tier: str = "T2", second: str | None = "foe") -> SafetyEvent:
    return SafetyEvent(tier, "ego", second, start_s, "contact")


def known_s(simulator: Drives, *events: SafetyEvent) -> list[float]:
    found: list[float] = warnable_s(simulator, 1, events).tolist()  # type: ignore[arg-type]
    return found


def test_it_is_from_when_the_offender_drove_otherwise() -> None:
    simulator = Drives()
    # 0.5 m/s less at 104.25 s: seen at 104.3 s.
    assert known_s(simulator, event(106.0)) == pytest.approx([1.7])
    assert simulator.asked_s == pytest.approx([101.0])


def test_an_event_before_the_offence_or_without_one_had_another_cause() -> None:
    assert known_s(Drives(), event(104.2)) == [np.inf]
    assert known_s(Drives(offends=False), event(106.0)) == [np.inf]


def test_of_a_lost_branch_and_of_what_is_no_severe_event_of_a_pair_nothing_is_known() -> None:
    assert np.isnan(known_s(Drives(lost=True), event(106.0))).all()
    others = [event(106.0, "T3"), event(106.0, "brief"), event(106.0, second=None)]
    simulator = Drives()
    assert np.isnan(known_s(simulator, *others)).all() and not simulator.asked_s
