"""What an alert rule said of pairs, moment by moment, kept sparse: alerts at any threshold later.

A trace is of one run and one rule. Alerts are made of it by the hysteresis of `assist.alert`, for
all pairs at once, so that hundreds of runs can be swept over thresholds in seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import AlertInterval, FloatArray, IntArray, SafetyEvent

TYPES: Final = ("CONFLICT", "DEVIATION")
RELEASE: Final = 0.8
"""An alert ends when its danger stays under this share of the threshold ..."""
END_AFTER_S: Final = 0.5
"""... for longer than this."""
COOL_DOWN_S: Final = 2.0
"""A pair warned of is not warned of again so soon: the alert goes on."""
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


class DangerRecorder:
    """Takes in what a rule says, moment after moment."""

    def __init__(self) -> None:
        self._index: dict[str, int] = {}
        self._rows: list[FloatArray] = []

    def add(
        self,
        time_s: float,
        ids: Sequence[str],
        first: IntArray,
        second: IntArray,
        danger: FloatArray,
        type_: IntArray | None = None,
    ) -> None:
        """Dangers [P] of pairs of vehicles, each by its place in `ids`; in any order."""
        if not len(first):
            return
        index = self._index
        named: list[int] = np.unique(np.concatenate([first, second])).tolist()
        number = {v: index.setdefault(ids[v], len(index)) for v in named}
        kind = np.zeros(len(first), dtype=np.int64) if type_ is None else type_
        told = [
            [number[a], number[b]] for a, b in zip(first.tolist(), second.tolist(), strict=True)
        ]
        self._rows.append(np.column_stack([np.full(len(first), time_s), told, danger, kind]))

    def trace(self) -> DangerTrace:
        """All that was taken in; of a pair that was named twice at a moment, the worse."""
        ids = tuple(sorted(self._index))
        rows = np.concatenate([np.zeros((0, 5)), *self._rows])
        place = np.argsort(np.argsort(np.array(list(self._index), dtype=np.str_)))
        pair = np.sort(place[rows[:, 1:3].astype(np.int64)], axis=1)
        order = np.lexsort((-rows[:, 3], rows[:, 0], rows[:, 4], pair[:, 1], pair[:, 0]))
        rows, pair = rows[order], pair[order]
        key = np.column_stack([pair, rows[:, 4], rows[:, 0]])
        keep = np.ones(len(rows), dtype=np.bool_)
        keep[1:] = (np.diff(key, axis=0) != 0.0).any(axis=1)
        rows, pair = rows[keep], pair[keep]
        return DangerTrace(
            ids, rows[:, 0], pair[:, 0], pair[:, 1], rows[:, 3], rows[:, 4].astype(np.int64)
        )


def alerts_at(trace: DangerTrace, threshold: float) -> list[AlertInterval]:
    """The alerts of a rule at a threshold, by onset.

    An alert begins where a pair's danger reaches the threshold, and ends at the last moment at
    which it was at least `RELEASE` of that, if that was `END_AFTER_S` ago or the run is over.
    """
    row = np.flatnonzero(trace.danger >= RELEASE * threshold)
    if not len(row):
        return []
    key = np.column_stack([trace.first, trace.second, trace.type])[row]
    time_s, danger = trace.time_s[row], trace.danger[row]
    new_pair = (np.diff(key, axis=0) != 0).any(axis=1)
    begins = np.concatenate(([True], new_pair | (np.diff(time_s) > END_AFTER_S + ROUNDING_S)))
    start = np.flatnonzero(begins)
    stop = np.append(start[1:], len(row))
    reached = np.flatnonzero(danger >= threshold)
    first = np.searchsorted(reached, start)
    alerts: list[AlertInterval] = []
    before: tuple[int, ...] = ()
    for end, at in zip(stop.tolist(), first.tolist(), strict=True):
        if at == len(reached) or reached[at] >= end:
            continue
        onset = int(reached[at])
        peak = onset + int(danger[onset:end].argmax())
        one, other, kind = key[onset].tolist()
        alert = AlertInterval(
            first_id=trace.ids[one],
            second_id=trace.ids[other],
            type=TYPES[kind],
            onset_s=float(time_s[onset]),
            end_s=float(time_s[end - 1]),
            peak_s=float(time_s[peak]),
            severity=0.0,
            danger=float(danger[peak]),
        )
        if before == (one, other, kind) and alert.onset_s - alerts[-1].end_s < COOL_DOWN_S:
            alert = _joined(alerts.pop(), alert)
        alerts.append(alert)
        before = (one, other, kind)
    return sorted(alerts, key=lambda one: (one.onset_s, one.first_id, one.second_id))


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
            TYPES[0],
            event.start_s - lead_s,
            event.start_s,
            event.start_s,
            1.0,
            1.0,
        )
        for event in events
        if event.second_id is not None and event.tier in ("T1", "T2")
    ]
