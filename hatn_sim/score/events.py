"""What really went wrong: collisions (T1) and evasive braking (T2), as METHOD 7 has them.

Found in what everybody drove and what only the simulator knows, so a run's log, a run in progress
and a branch are judged alike. Where METHOD is silent, this holds:

- T1: a pair that touches again is the same collision: SUMO repeats a contact while the two overlap.
  Pairs that touch in the first frame met before anybody looked, and are left out.
- T2: a braking is a stretch in which a vehicle loses speed beyond comfort, at 3 m/s² or more, in
  every frame. It is evasive if it loses 4.5 m/s² on the mean of some three frames (0.3 s), 1.35 m/s
  or more, whether SUMO calls it emergency braking or not. It starts when its stretch does, which is
  earlier than when it gets hard: an alert has to come before both. Stretches less than 1 s apart
  are one.
- METHOD does not say over what time deceleration is taken, and a single frame is too little: SUMO's
  drivers who creep forward at less than 1.35 m/s may stand again a tick later, at 9 m/s² and called
  emergency braking, in which a passenger feels the jolt of any halt: no vehicle's brakes and no
  body follow within 0.1 s. Such are told apart, as "brief", counted, and neither T2 nor nothing.
- Brakings for the same foe that start within 5 s are one event of the pair, whoever braked. Braking
  that starts with the contact of the pair or up to 5 s after it came of that and evades nothing.
- Vehicles that teleport, or were not in view in the frame before, have not braked.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, BoolArray, FloatArray, IntArray, SafetyEvent
from hatn_sim.score.attribution import foe_of_braking
from hatn_sim.score.driven import Driven

EVASIVE_MPS2: Final = 4.5
BEYOND_COMFORT_MPS2: Final = 3.0
"""The comfort limit of suggestions: braking from here on is no longer everyday."""
BRIEF: Final = "brief"
"""The tier of brakings that are hard, or SUMO's emergency braking, in single frames only."""
ROUNDING_MPS2: Final = 1e-6
"""A braking of exactly the threshold counts, whatever the last bit of a difference of speeds."""
SUSTAINED_FRAMES: Final = 3
SAME_BRAKING_S: Final = 1.0
SAME_EVENT_S: Final = 5.0


@dataclass(frozen=True)
class Braking:
    """An evasive braking of one vehicle."""

    vehicle: int  # index into Driven.ids
    start_frame: int  # the last frame before speed was lost
    emergency: bool
    brief: bool  # hard in single frames only


def severe_events(driven: Driven) -> list[SafetyEvent]:
    """All of T1, T2 and the brief ones, by start; those unattributed have no second vehicle."""
    crashed = collisions(driven)
    return sorted([*crashed, *evasions(driven, crashed)], key=_order)


def collisions(driven: Driven) -> list[SafetyEvent]:
    """T1: the first contact of every unordered pair, by time."""
    first: dict[tuple[str, str], int] = {}
    for frame, one, other in sorted(driven.contacts):
        first.setdefault((min(one, other), max(one, other)), frame)
    return [
        SafetyEvent("T1", one, other, float(driven.time_s[frame]), "contact")
        for (one, other), frame in first.items()
        if frame > 0
    ]


def evasions(driven: Driven, crashed: Iterable[SafetyEvent]) -> list[SafetyEvent]:
    """T2 and brief: braking, with the foe that it was for; `crashed` are the events of T1."""
    contact_s = {(event.first_id, event.second_id): event.start_s for event in crashed}
    started: dict[tuple[str, str, str], float] = {}
    events: list[SafetyEvent] = []
    for braking in sorted(brakings(driven), key=lambda one: (one.start_frame, one.vehicle)):
        name, start_s = driven.ids[braking.vehicle], float(driven.time_s[braking.start_frame])
        tier = BRIEF if braking.brief else "T2"
        cause = "emergency braking" if braking.emergency else "hard braking"
        found = foe_of_braking(driven, braking.vehicle, braking.start_frame)
        if found is None:
            events.append(SafetyEvent(tier, name, None, start_s, cause))
            continue
        other = driven.ids[found.foe]
        pair = (min(name, other), max(name, other))
        after_contact = 0.0 <= start_s - contact_s.get(pair, np.inf) <= SAME_EVENT_S
        if after_contact or start_s - started.get((tier, *pair), -np.inf) <= SAME_EVENT_S:
            continue
        started[tier, *pair] = start_s
        events.append(SafetyEvent(tier, *pair, start_s, cause, found.encroachment_s))
    return events


def brakings(driven: Driven) -> list[Braking]:
    """Every evasive braking, by vehicle and then by time."""
    lost_mps2 = deceleration_mps2(driven)
    emergency = _marked(driven, driven.emergency_braking) & (lost_mps2 > 0.0)
    hard = (lost_mps2 >= EVASIVE_MPS2 - ROUNDING_MPS2) | emergency
    evasive = sustained_mps2(driven, lost_mps2) >= EVASIVE_MPS2 - ROUNDING_MPS2
    row = np.flatnonzero(hard | (lost_mps2 >= BEYOND_COMFORT_MPS2 - ROUNDING_MPS2))
    if not len(row):
        return []
    # Rows of a vehicle follow each other; a hole in its view parts them like a pause.
    pause = (driven.vehicle[row[1:]] != driven.vehicle[row[:-1]]) | (
        driven.frame[row[1:]] - driven.frame[row[:-1]] >= round(SAME_BRAKING_S / DT_S)
    )
    stretches = np.split(row, np.flatnonzero(pause) + 1)
    return [
        Braking(
            vehicle=int(driven.vehicle[stretch[0]]),
            start_frame=int(driven.frame[stretch[0]]) - 1,
            emergency=bool(emergency[stretch].any()),
            brief=not evasive[stretch].any(),
        )
        for stretch in stretches
        if hard[stretch].any()
    ]


def deceleration_mps2(driven: Driven) -> FloatArray:
    """[R] speed lost since the frame before, over time; 0 where nothing is known of that."""
    known = driven.follows_on() & ~_marked(driven, driven.teleported)
    step_s = np.diff(driven.time_s[driven.frame], prepend=0.0)
    lost = -np.diff(driven.speed_mps, prepend=0.0)
    return np.where(known, lost / np.where(known, step_s, 1.0), 0.0)


def sustained_mps2(driven: Driven, lost_mps2: FloatArray) -> FloatArray:
    """[R] the largest mean over `SUSTAINED_FRAMES` frames in a row that the row is one of."""
    follows = driven.follows_on()
    mean, whole = lost_mps2.copy(), follows.copy()
    for back in range(1, SUSTAINED_FRAMES):
        mean[back:] += lost_mps2[:-back]
        whole[back:] &= follows[:-back]
        whole[:back] = False
    mean = np.where(whole, mean / SUSTAINED_FRAMES, 0.0)
    largest = mean.copy()
    for ahead in range(1, SUSTAINED_FRAMES):
        largest[:-ahead] = np.maximum(largest[:-ahead], mean[ahead:])
    return largest


def vehicle_hours(driven: Driven, from_s: float, to_s: float) -> float:
    """Time that vehicles were in view from `from_s` on, up to and without `to_s`."""
    time_s = driven.time_s[driven.frame]
    return float(((time_s >= from_s) & (time_s < to_s)).sum() * DT_S / 3600.0)


def _marked(driven: Driven, what: Iterable[tuple[int, str]]) -> BoolArray:
    """[R] the rows of (frame, id)."""
    index = {name: number for number, name in enumerate(driven.ids)}
    wanted = [(index[name], frame) for frame, name in what if name in index]
    keys = np.array([_key(driven, vehicle, frame) for vehicle, frame in wanted], dtype=np.int64)
    return np.isin(_key(driven, driven.vehicle, driven.frame), keys)


def _key(driven: Driven, vehicle: IntArray | int, frame: IntArray | int) -> IntArray:
    return np.asarray(vehicle * len(driven.time_s) + frame)


def _order(event: SafetyEvent) -> tuple[float, str, str, str]:
    return event.start_s, event.tier, event.first_id, event.second_id or ""
