"""Evasive braking that is everyday braking is told of; danger is not."""

from __future__ import annotations

from hatn_sim.datatypes import SafetyEvent
from hatn_sim.score.everyday import everyday_braking


def events(braked: int, crashed: int) -> list[SafetyEvent]:
    tiers = ["T2"] * braked + ["T1"] * crashed + ["T3"] * 100 + ["brief"] * 100
    return [SafetyEvent(tier, "a", "b", 1.0 * k, "") for k, tier in enumerate(tiers)]


def test_many_brakings_and_no_collision_are_told_of() -> None:
    told = everyday_braking(events(60, 0), 2.0)
    assert told is not None
    assert told.startswith("60 brakings of 4.5 m/s2 or more in 2.00 vehicle-hours, and no coll")
    assert everyday_braking(events(100, 10), 2.0) is not None  # one in ten


def test_danger_is_not() -> None:
    assert everyday_braking(events(100, 11), 2.0) is None  # they do collide
    assert everyday_braking(events(29, 0), 2.0) is None  # no more than where nobody is hurried
    assert everyday_braking(events(9, 0), 0.01) is None  # too few to tell
    assert everyday_braking([], 0.0) is None
