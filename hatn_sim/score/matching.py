"""Alerts against what happened (METHOD 7): hits, duplicates, false alarms, and how early.

Pairs are unordered. An alert matches an event of its pair if its onset precedes the event's start
and it is still active then, or began at most 5 s earlier. Of the alerts that match an event the
earliest counts, the others are duplicates. Where METHOD is silent, this holds:

- One alert may match several events of its pair: an evasive braking, and the collision after it.
- An alert that counts for one event is a hit, also where it would be a duplicate for another.
- Alerts of any type match. A CONFLICT and a DEVIATION of one pair are two alerts.
- An event without a second vehicle (unattributed) is matched by nothing, and is no event to recall.
- Alerts that begin outside of the scored window are neither hit nor false, but may match.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from hatn_sim.datatypes import AlertInterval, BoolArray, FloatArray, IntArray, SafetyEvent

EARLIEST_S: Final = 5.0
SEVERE: Final = ("T1", "T2")
"""Tiers of the headline: recall and precision are on these."""
ROUNDING_S: Final = 1e-6


class Outcome(IntEnum):
    """What an alert turned out to be."""

    HIT = 0
    DUPLICATE = 1
    NEAR = 2  # it meets only events that are not severe
    FALSE = 3
    OUTSIDE = 4  # of the scored window


@dataclass(frozen=True, eq=False)
class Matching:
    """Events [E] and alerts [A] of a run, in the order that they were given in."""

    alert_of_event: IntArray  # [E] the earliest alert that matches, -1: none
    lead_s: FloatArray  # [E] from its onset to the event's start; NaN where there is none
    is_scored: BoolArray  # [E] attributed, and starts in the scored window
    outcome: IntArray  # [A] Outcome


def match(
    events: Sequence[SafetyEvent],
    alerts: Sequence[AlertInterval],
    window_s: tuple[float, float] = (-np.inf, np.inf),
) -> Matching:
    """Match the alerts of a run with its events.

    `window_s` is what is scored, its end excluded: events that start in it, alerts that begin in
    it. For nothing to be judged half, alerts should be there from before it, and events up to 5 s
    after it.
    """
    low_s, high_s = window_s
    of_pair: dict[tuple[str, str], list[int]] = {}
    for number, alert in enumerate(alerts):
        of_pair.setdefault((alert.first_id, alert.second_id), []).append(number)
    best = np.full(len(events), -1, dtype=np.int64)
    lead_s = np.full(len(events), np.nan)
    is_scored = np.zeros(len(events), dtype=np.bool_)
    outcome = np.full(len(alerts), Outcome.FALSE, dtype=np.int64)
    for place, event in enumerate(events):
        if event.second_id is None:
            continue
        is_scored[place] = low_s <= event.start_s < high_s
        pair = (event.first_id, event.second_id)
        matching = [k for k in of_pair.get(pair, ()) if matches(alerts[k], event)]
        if not matching:
            continue
        first = min(matching, key=lambda k: (alerts[k].onset_s, k))
        best[place], lead_s[place] = first, event.start_s - alerts[first].onset_s
        for k in matching:
            found = Outcome.HIT if k == first else Outcome.DUPLICATE
            found = found if event.tier in SEVERE else Outcome.NEAR
            outcome[k] = min(outcome[k], found)
    for k, alert in enumerate(alerts):
        if not low_s <= alert.onset_s < high_s:
            outcome[k] = Outcome.OUTSIDE
    return Matching(best, lead_s, is_scored, outcome)


def matches(alert: AlertInterval, event: SafetyEvent) -> bool:
    """Whether an alert of the event's pair warned of it."""
    before_s = event.start_s - alert.onset_s
    if before_s <= ROUNDING_S:
        return False
    is_active = alert.end_s >= event.start_s - ROUNDING_S
    return is_active or before_s <= EARLIEST_S + ROUNDING_S
