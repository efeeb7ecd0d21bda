"""What an alert rule said of pairs, moment by moment, kept sparse: alerts at any threshold later.

A trace is of one run and one rule. Alerts are made of it by the hysteresis of `assist.alert`, for
all pairs at once, so that hundreds of runs can be swept over thresholds in seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hatn_sim.assist.moment import CONFLICT, TYPES, PairDangers
from hatn_sim.assist.settings import AssistSettings
from hatn_sim.datatypes import AlertInterval, BoolArray, FloatArray, IntArray, SafetyEvent

ROUNDING_S: Final = 1e-6


@dataclass(frozen=True, eq=False)
class DangerTrace:
    """Dangers of pairs [D], by pair and then by time; what is not there was no danger."""

    ids: tuple[str, ...]  # of vehicles that are meant
    time_s: FloatArray  # [D]
    first: IntArray  # [D] index into `ids`, of the id that sorts first
    second: IntArray  # [D]
    danger: FloatArray  # [D] higher is worse
    type: IntArray  # [D] index into `TYPES`
    touched: BoolArray  # [D] no alert begins any more


class DangerRecorder:
    """Takes in what a rule says, moment after moment."""

    def __init__(self) -> None:
        self._index: dict[str, int] = {}
        self._rows: list[FloatArray] = []

    def add(self, time_s: float, ids: Sequence[str], dangers: PairDangers) -> None:
        """Dangers of pairs of vehicles `ids`; in any order."""
        first, second = dangers.first, dangers.second
        if not len(first):
            return
        index = self._index
        named: list[int] = np.unique(np.concatenate([first, second])).tolist()
        number = {v: index.setdefault(ids[v], len(index)) for v in named}
        kind = np.full(len(first), CONFLICT) if dangers.type is None else dangers.type
        touched = np.zeros(len(first)) if dangers.touched is None else dangers.touched
        told = [
            [number[a], number[b]] for a, b in zip(first.tolist(), second.tolist(), strict=True)
        ]
        self._rows.append(
            np.column_stack([np.full(len(first), time_s), told, dangers.danger, kind, touched])
        )

    def trace(self) -> DangerTrace:
        """All that was taken in; of a pair that was named twice at a moment, the worse."""
        return worst_of_each(self.whole())

    def whole(self) -> DangerTrace:
        """All that was taken in; of a pair that was named twice at a moment, both."""
        ids = tuple(sorted(self._index))
        rows = np.concatenate([np.zeros((0, 6)), *self._rows])
        place = np.argsort(np.argsort(np.array(list(self._index), dtype=np.str_)))
        pair = np.sort(place[rows[:, 1:3].astype(np.int64)], axis=1)
        order = np.lexsort((rows[:, 0], pair[:, 1], pair[:, 0]))
        rows, pair = rows[order], pair[order]
        return DangerTrace(
            ids=ids,
            time_s=rows[:, 0],
            first=pair[:, 0],
            second=pair[:, 1],
            danger=rows[:, 3],
            type=rows[:, 4].astype(np.int64),
            touched=rows[:, 5] > 0.0,
        )


def worst_of_each(trace: DangerTrace) -> DangerTrace:
    """Each pair once at a moment, with its greatest danger; none where there is no danger."""
    some = np.flatnonzero(trace.danger > 0.0)
    key = np.column_stack([trace.first, trace.second, trace.time_s])[some]
    order = np.lexsort((-trace.danger[some], key[:, 2], key[:, 1], key[:, 0]))
    new = np.ones(len(some), dtype=np.bool_)
    new[1:] = (np.diff(key[order], axis=0) != 0.0).any(axis=1)
    kept = some[order[new]]
    columns = ("time_s", "first", "second", "danger", "type", "touched")
    return replace(trace, **{name: getattr(trace, name)[kept] for name in columns})


def alerts_at(
    trace: DangerTrace, threshold: float, settings: AssistSettings | None = None
) -> list[AlertInterval]:
    """The alerts of a rule at a threshold, by onset, as `assist.alert` would have raised them.

    What ends an alert is the same share of the threshold as in the settings, after the same pauses.
    Its type is that of its onset.
    """
    settings = settings or AssistSettings()
    release = settings.alert_end / settings.alert_onset
    row = np.flatnonzero(trace.danger >= release * threshold)
    if not len(row):
        return []
    pair = np.column_stack([trace.first, trace.second])[row]
    time_s, danger, kind = trace.time_s[row], trace.danger[row], trace.type[row]
    new_pair = (np.diff(pair, axis=0) != 0).any(axis=1)
    begins = np.concatenate(
        ([True], new_pair | (np.diff(time_s) > settings.end_after_s + ROUNDING_S))
    )
    start = np.flatnonzero(begins)
    stop = np.append(start[1:], len(row))
    reached = np.flatnonzero((danger >= threshold) & ~trace.touched[row])
    first = np.searchsorted(reached, start)
    alerts: list[AlertInterval] = []
    before: tuple[int, ...] = ()
    for end, at in zip(stop.tolist(), first.tolist(), strict=True):
        if at == len(reached) or reached[at] >= end:
            continue
        onset = int(reached[at])
        peak = onset + int(danger[onset:end].argmax())
        one, other = pair[onset].tolist()
        alert = AlertInterval(
            first_id=trace.ids[one],
            second_id=trace.ids[other],
            type=TYPES[int(kind[onset])],
            onset_s=float(time_s[onset]),
            end_s=float(time_s[end - 1]),
            peak_s=float(time_s[peak]),
            severity=min(float(danger[peak]), 1.0),
            danger=float(danger[peak]),
        )
        same = before == (one, other)
        pause_s = alert.onset_s - _told_until_s(alerts[-1], settings) if same else np.inf
        if pause_s <= settings.cool_down_s + ROUNDING_S:
            alert = _joined(alerts.pop(), alert)
        alerts.append(alert)
        before = (one, other)
    alerts = [replace(alert, end_s=_told_until_s(alert, settings)) for alert in alerts]
    return sorted(alerts, key=lambda one: (one.onset_s, one.first_id, one.second_id))


def _told_until_s(alert: AlertInterval, settings: AssistSettings) -> float:
    return max(alert.end_s, alert.onset_s + settings.least_s)


def _joined(one: AlertInterval, next_: AlertInterval) -> AlertInterval:
    worse = max(one, next_, key=lambda alert: alert.danger)
    return AlertInterval(
        one.first_id,
        one.second_id,
        one.type,
        one.onset_s,
        next_.end_s,
        worse.peak_s,
        worse.severity,
        worse.danger,
    )


def oracle_alerts(events: Sequence[SafetyEvent], lead_s: float) -> list[AlertInterval]:
    """What somebody who knows the future would say: each severe event, `lead_s` ahead."""
    return [
        AlertInterval(
            event.first_id,
            event.second_id,
            TYPES[CONFLICT],
            event.start_s - lead_s,
            event.start_s,
            event.start_s,
            1.0,
            1.0,
        )
        for event in events
        if event.second_id is not None and event.tier in ("T1", "T2")
    ]
