"""Since when an event could be seen coming: its offender did otherwise than lawfully.

The run is driven again, and beside it, from `LOOKED_BACK_S` before an event or from when a vehicle
of its pair comes into view, a future in which that vehicle keeps the rules. Who of the two is the
offender is not asked: the one whose speed differs first tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, BranchFuture, FloatArray, Lawful, SafetyEvent, Simulator
from hatn_sim.score.counterfactual import SEVERITY, first_difference_s

LOOKED_BACK_S: Final = 5.0
"""As long before an event as alerts are held to be of it."""
ROUNDING_S: Final = 1e-6


@dataclass(frozen=True, eq=False)
class _Asked:
    event: int
    vehicle_id: str
    as_it_is: BranchFuture
    lawful: BranchFuture


def warnable_s(simulator: Simulator, seed: int, events: Sequence[SafetyEvent]) -> FloatArray:
    """[E] from when the offender's speed first differed by 0.5 m/s until the event.

    `simulator` is that of the run with this seed; it is driven anew. Infinite where neither of the
    pair ever differs, so that the event had another cause; NaN where it is not known: a branch was
    lost, or the event is not severe or has no pair.
    """
    found_s = np.array(
        [-np.inf if one.tier in SEVERITY and one.second_id else np.nan for one in events]
    )
    waiting = [
        (one.start_s, number, name)
        for number, one in enumerate(events)
        for name in (one.first_id, one.second_id)
        if name is not None and not np.isnan(found_s[number])
    ]
    frame = simulator.reset(seed)
    asked: list[_Asked] = []
    while waiting and not frame.done:
        now_s, there = frame.scene.time_s, frozenset(frame.scene.ids)
        due = [
            (start_s, number, name)
            for start_s, number, name in waiting
            if name in there and start_s - now_s <= LOOKED_BACK_S + ROUNDING_S
        ]
        waiting = [one for one in waiting if one not in due and one[0] > now_s]
        if due:
            horizon_s = max(max(start_s for start_s, _, _ in due) - now_s, DT_S)
            futures = [(), *((Lawful(name),) for _, _, name in due)]
            as_it_is, *lawful = simulator.branch(futures, horizon_s)
            asked += [
                _Asked(number, name, as_it_is, future)
                for (_, number, name), future in zip(due, lawful, strict=True)
            ]
        frame = simulator.step()
    for one in asked:
        as_it_is, lawful = one.as_it_is.result(), one.lawful.result()
        if as_it_is is None or lawful is None:
            found_s[one.event] = np.nan
            continue
        start_s = events[one.event].start_s
        differs_s = first_difference_s(as_it_is, lawful, one.vehicle_id)
        if differs_s is not None and differs_s < start_s:
            found_s[one.event] = np.maximum(found_s[one.event], start_s - differs_s)
    return np.where(np.isneginf(found_s), np.inf, found_s)
