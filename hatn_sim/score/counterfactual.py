"""Would the advice have helped? Verdicts on alerts and costs of slots, from branches of the run.

The definitions are METHOD 7's. Where it is silent, this holds:

- Events that count for an alert are T1 and T2 with the ego that is warned in them, whoever is the
  second. What becomes of others, the one warned of included, differs by chance too: branches draw
  random numbers in another order. What obeying costs them is told apart.
- Braking that is under way when the alert begins, and is an event whatever the ego does, was not
  warned of: it counts for neither branch.
- What begins later than a reaction time after the driver has his vehicle back is of his own
  doing, and counts for neither branch: drivers who break rules at random do so again. That hides
  late harm, and late events that the alert was of: what the whole of the branches says is told too.
- T1 is worse than T2. Obeying is harmful if any pair is worse off by it, else useful if any is
  better off, else unneeded if there was no event, else unavailing.
- Costs of slots are told over the whole branch. Whose time is lost is told in m: how much farther
  the vehicle got elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.assist.encroachment import encroachments
from hatn_sim.assist.outlines import Boxes
from hatn_sim.datatypes import DT_S, Branch, FloatArray, SafetyEvent
from hatn_sim.score.driven import Driven, driven_from_arrays
from hatn_sim.score.events import severe_events

SEVERITY: Final = {"T1": 2, "T2": 1}
USEFUL, UNNEEDED, HARMFUL, UNAVAILING = "useful", "unneeded", "harmful", "unavailing"
AFFECTED_M: Final = 0.5
"""Who is somewhere else than in another branch by so much is affected by what differs."""
ROUNDING_S: Final = 1e-6
SLOWEST_MPS: Final = 1.0
"""Delay is told at the mean speed of the best slot, but at no less."""


@dataclass(frozen=True)
class CounterfactualSettings:
    """How advice is driven, and what makes a future costly.

    The cost of a slot is the sum of `per_...` times what they are per.
    """

    reaction_s: float = 1.0
    horizon_s: float = 8.0  # a second of reaction, five of the profile, two to see what comes of it
    # For the difference between the speeds foreseen and had after reacting. Drivers change by 3 m/s
    # in that second; to take that back at once would be evasive braking of our own making.
    blend_s: float = 2.0
    per_delay_s: float = 1.0
    per_missing_gap_s: float = 2.0  # of the ego's least encroachment time under `gap_s`
    gap_s: float = 1.5
    per_others_braking_mps2: float = 0.5  # of the hardest beyond `others_braking_mps2`
    others_braking_mps2: float = 2.0
    per_discomfort_mps2: float = 0.5  # of the ego's root mean square of acceleration
    per_evasion: float = 10.0  # T2 with the ego in it
    per_collision: float = 100.0  # T1


@dataclass(frozen=True)
class SlotCost:
    """What a future costs; `total` is in the unit that weights are per."""

    delay_s: float  # against the candidate that gets farthest
    least_gap_s: float | None  # least encroachment time of the ego, 0 where it touched; None: none
    others_braking_mps2: float  # the hardest of those affected
    discomfort_mps2: float
    evasions: int
    collisions: int
    total: float
    events: tuple[SafetyEvent, ...] = ()  # these: with whom, and when


@dataclass(frozen=True)
class AlertVerdict:
    """What obeying an alert would have made of it."""

    verdict: str  # USEFUL, UNNEEDED, HARMFUL or UNAVAILING
    ignored: tuple[SafetyEvent, ...]
    obeyed: tuple[SafetyEvent, ...]
    others_lost_m: float  # by obeying, all others together; negative: they got farther
    others_braking_mps2: float  # by obeying, the hardest of those affected
    others_braked_mps2: float  # of the same vehicles without
    to_the_end: str = UNNEEDED  # the verdict if all events of both branches count


def driven_in_branch(branch: Branch) -> Driven:
    """The motion in a branch, as events are found in it."""
    return driven_from_arrays(
        branch.ids,
        branch.time_s,
        branch.valid,
        branch.xy_m,
        branch.yaw_rad,
        branch.speed_mps,
        branch.size_m,
        branch.collisions,
        branch.emergency_braking,
    )


def events_in_branch(branch: Branch) -> list[SafetyEvent]:
    """T1 and T2 of a branch."""
    found = severe_events(driven_in_branch(branch))
    return [event for event in found if event.tier in SEVERITY]


def concerning(events: Iterable[SafetyEvent], vehicle: str) -> tuple[SafetyEvent, ...]:
    """The events with a vehicle in them."""
    return tuple(event for event in events if vehicle in (event.first_id, event.second_id))


def _what(event: SafetyEvent) -> tuple[str, str, str | None]:
    return event.tier, event.first_id, event.second_id


def verdict(ignored: Iterable[SafetyEvent], obeyed: Iterable[SafetyEvent]) -> str:
    """Of the events without and with obeying, pair by pair."""
    before, after = _worst(ignored), _worst(obeyed)
    change = [after.get(pair, 0) - before.get(pair, 0) for pair in before.keys() | after.keys()]
    if any(worse > 0 for worse in change):
        return HARMFUL
    if any(worse < 0 for worse in change):
        return USEFUL
    return UNAVAILING if before else UNNEEDED


def _worst(events: Iterable[SafetyEvent]) -> Mapping[tuple[str, str | None], int]:
    worst: dict[tuple[str, str | None], int] = {}
    for event in events:
        pair = event.first_id, event.second_id
        worst[pair] = max(worst.get(pair, 0), SEVERITY[event.tier])
    return worst


def judge_alert(
    ignored: Branch, obeyed: Branch, ego_id: str, until_s: float = np.inf
) -> AlertVerdict:
    """The verdict on an alert, from the unmodified branch and the one in which the ego obeys.

    Events count that start no later than `until_s` after the alert.
    """
    end_s = ignored.time_s[0] + until_s + ROUNDING_S
    found = [concerning(events_in_branch(branch), ego_id) for branch in (ignored, obeyed)]
    under_way = {_what(one) for one in found[0] if one.start_s <= ignored.time_s[0]}
    found = [tuple(one for one in of if _what(one) not in under_way) for of in found]
    events = [tuple(one for one in of if one.start_s <= end_s) for of in found]
    others = _affected((ignored, obeyed)) - {ego_id}
    lost_m = [
        _way_m(ignored, name) - _way_m(obeyed, name)
        for name in set(ignored.ids) & set(obeyed.ids) - {ego_id}
    ]
    return AlertVerdict(
        verdict=verdict(*events),
        ignored=events[0],
        obeyed=events[1],
        others_lost_m=float(sum(lost_m)),
        others_braking_mps2=_hardest_braking_mps2(obeyed, others),
        others_braked_mps2=_hardest_braking_mps2(ignored, others),
        to_the_end=verdict(*found),
    )


def slot_costs(
    branches: Sequence[Branch], ego_id: str, settings: CounterfactualSettings
) -> list[SlotCost]:
    """What each of several futures of an ego costs; they have to be of the same moment."""
    ways_m = [_way_m(branch, ego_id) for branch in branches]
    farthest_m = max(ways_m)
    seconds = float(branches[0].time_s[-1] - branches[0].time_s[0])
    reference_mps = max(farthest_m / seconds, SLOWEST_MPS)
    others = _affected(branches) - {ego_id}
    return [
        _slot_cost(branch, ego_id, (farthest_m - way_m) / reference_mps, others, settings)
        for branch, way_m in zip(branches, ways_m, strict=True)
    ]


def _slot_cost(
    branch: Branch, ego_id: str, delay_s: float, others: set[str], settings: CounterfactualSettings
) -> SlotCost:
    gap_s = _least_gap_s(branch, ego_id)
    braking_mps2 = _hardest_braking_mps2(branch, others)
    acceleration = np.diff(_speeds_mps(branch, ego_id)) / DT_S
    discomfort_mps2 = float(np.sqrt(np.mean(acceleration**2))) if len(acceleration) else 0.0
    events = concerning(events_in_branch(branch), ego_id)
    evasions = sum(event.tier == "T2" for event in events)
    collisions = sum(event.tier == "T1" for event in events)
    missing_s = 0.0 if gap_s is None else max(settings.gap_s - gap_s, 0.0)
    beyond_mps2 = max(braking_mps2 - settings.others_braking_mps2, 0.0)
    return SlotCost(
        delay_s=delay_s,
        least_gap_s=gap_s,
        others_braking_mps2=braking_mps2,
        discomfort_mps2=discomfort_mps2,
        evasions=evasions,
        collisions=collisions,
        total=settings.per_delay_s * delay_s
        + settings.per_missing_gap_s * missing_s
        + settings.per_others_braking_mps2 * beyond_mps2
        + settings.per_discomfort_mps2 * discomfort_mps2
        + settings.per_evasion * evasions
        + settings.per_collision * collisions,
        events=events,
    )


def regret(totals: Sequence[float], chosen: int) -> float:
    """What the slot chosen costs more than the best one; 0 for the best."""
    return totals[chosen] - min(totals)


def first_difference_s(
    branch: Branch, lawful: Branch, vehicle_id: str, speed_mps: float = 0.5
) -> float | None:
    """When a vehicle's speed first differs by so much from what it would have been lawfully.

    None: it never does while both are in view. For lead times: nobody can warn before.
    """
    column = branch.ids.index(vehicle_id), lawful.ids.index(vehicle_id)
    both = branch.valid[:, column[0]] & lawful.valid[:, column[1]]
    apart = np.abs(branch.speed_mps[:, column[0]] - lawful.speed_mps[:, column[1]])
    found = np.flatnonzero(both & (apart >= speed_mps))
    return float(branch.time_s[found[0]]) if len(found) else None


def _affected(branches: Sequence[Branch]) -> set[str]:
    """Vehicles that are somewhere else in some branch than in the first."""
    first, affected = branches[0], set[str]()
    for branch in branches[1:]:
        names = [name for name in branch.ids if name in set(first.ids)]
        one = np.array([first.ids.index(name) for name in names], np.int64)
        two = np.array([branch.ids.index(name) for name in names], np.int64)
        both = first.valid[:, one] & branch.valid[:, two]
        away_m = np.hypot(*np.moveaxis(first.xy_m[:, one] - branch.xy_m[:, two], -1, 0))
        moved = (both & (away_m > AFFECTED_M)).any(axis=0)
        affected |= {name for name, far in zip(names, moved.tolist(), strict=True) if far}
    return affected


def _speeds_mps(branch: Branch, name: str) -> FloatArray:
    column = branch.ids.index(name)
    return branch.speed_mps[branch.valid[:, column], column]


def _way_m(branch: Branch, name: str) -> float:
    """How far a vehicle gets; who leaves does so at its last speed until the end."""
    column = branch.ids.index(name)
    seen = np.flatnonzero(branch.valid[:, column])
    if not len(seen):
        return 0.0
    steps_m = np.hypot(*np.diff(branch.xy_m[seen, column], axis=0).T)
    beyond_s = float(branch.time_s[-1] - branch.time_s[seen[-1]])
    return float(steps_m.sum()) + beyond_s * float(branch.speed_mps[seen[-1], column])


def _hardest_braking_mps2(branch: Branch, names: Iterable[str]) -> float:
    hardest = 0.0
    for name in names:
        if name in branch.ids:
            lost = -np.diff(_speeds_mps(branch, name)) / DT_S
            hardest = max(hardest, float(lost.max(initial=0.0)))
    return hardest


def _least_gap_s(branch: Branch, ego_id: str) -> float | None:
    frame, vehicle = np.nonzero(branch.valid)
    boxes = Boxes(
        branch.xy_m[frame, vehicle], branch.yaw_rad[frame, vehicle], branch.size_m[vehicle]
    )
    met = encroachments(vehicle, frame, boxes)
    ego = branch.ids.index(ego_id)
    own = met.pet_s[(met.first == ego) | (met.second == ego)]
    return max(float(own.min()), 0.0) if len(own) else None
