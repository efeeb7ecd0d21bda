"""Whether evasive braking (T2) is everyday braking in a scene, and tells nothing of danger there.

Drivers who brake at the threshold of T2 whenever they stop, as SUMO's default ones do, seldom
collide. In the scenes that ship T2 happens up to 7 times in an hour of a vehicle, where many
drivers break rules; where violations are scripted, more often, and one in five to seven ends in
contact.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

from hatn_sim.datatypes import SafetyEvent
from hatn_sim.score.driven import Driven
from hatn_sim.score.events import severe_events, vehicle_hours

MANY_PER_HOUR: Final = 15.0
"""Evasive brakings in an hour of a vehicle ..."""
LEAST: Final = 10
"""... and in all that is looked at ..."""
PER_COLLISION: Final = 10
"""... with no more than one collision in so many of them: drivers brake so in ordinary traffic."""


def everyday_braking(events: Iterable[SafetyEvent], vehicle_hours: float) -> str | None:
    """A line for the user where T2 is everyday braking; None where it may be what it is for."""
    tiers = [event.tier for event in events]
    braked, crashed = tiers.count("T2"), tiers.count("T1")
    if braked < max(LEAST, MANY_PER_HOUR * vehicle_hours) or crashed * PER_COLLISION > braked:
        return None
    return (
        f"{braked} brakings of 4.5 m/s2 or more in {vehicle_hours:.2f} vehicle-hours, and "
        f"{crashed or 'no'} collisions: these drivers brake so every day, and recall and precision "
        "of alerts tell little here; look at recall of T1 and at close passes (near), or give the "
        "drivers a lower decel"
    )


def everyday_braking_in(driven: Driven) -> str | None:
    """The same of all that was driven."""
    return everyday_braking(severe_events(driven), vehicle_hours(driven, -math.inf, math.inf))
