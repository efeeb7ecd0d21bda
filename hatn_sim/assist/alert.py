"""Dangers of pairs, moment by moment -> alerts as intervals: onset, peak, end.

An alert begins where the danger of a pair reaches the onset threshold. It goes on while the danger
is at least the end threshold, not counting gaps of up to `end_after_s`; and if it reaches the onset
threshold again within `cool_down_s` of its end, that is the same alert. A pair has one alert at a
time; its type is that of its onset.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from hatn_sim.assist.moment import CONFLICT, TYPES, PairDangers
from hatn_sim.assist.settings import AssistSettings
from hatn_sim.datatypes import Alert, FloatArray, IntArray, Scene

WITHIN_S: Final = 5.0
"""Danger is of an event so soon."""
ROUNDING_S: Final = 1e-6
_Pair = tuple[str, str]
"""The ids of two vehicles, sorted."""


@dataclass(frozen=True)
class _Open:
    alert: Alert  # the peak so far
    danger: float  # at the peak
    last_s: float  # when the danger was last enough for the alert to go on
    deviates_id: str  # of a DEVIATION: who


@dataclass(frozen=True)
class AlertState:
    """The alerts that are open now, and how many there were."""

    open: Mapping[_Pair, _Open] = field(default_factory=dict[_Pair, _Open])
    count: int = 0


def alert(
    state: AlertState,
    scene: Scene,
    dangers: PairDangers,
    settings: AssistSettings,
    egos: frozenset[str] | None,
) -> tuple[AlertState, tuple[Alert, ...]]:
    """Edges of this moment, for pairs with one of `egos` (None: all).

    The ego of an alert is the first of its pair that is one of `egos`. Once it is known that an
    alert is over, its `peak` and its `end` are told, at the times when they were.
    """
    first, second, danger, type_ = _worst(dangers, settings.alert_end)
    edges: list[Alert] = []
    still = dict(state.open)
    count = state.count
    for key, held in list(still.items()):
        if scene.time_s - held.last_s > settings.cool_down_s + ROUNDING_S:
            edges.append(replace(held.alert, edge="peak"))
            edges.append(replace(held.alert, edge="end", time_s=held.last_s))
            del still[key]
    for a, b, value, kind in zip(
        first.tolist(), second.tolist(), danger.tolist(), type_.tolist(), strict=True
    ):
        ego_id, other_id = scene.ids[a], scene.ids[b]
        if egos is not None and ego_id not in egos:
            ego_id, other_id = other_id, ego_id
            if ego_id not in egos:
                continue
        key = (min(ego_id, other_id), max(ego_id, other_id))
        before = still.get(key)
        starts = value >= settings.alert_onset
        goes_on = (
            before is not None and scene.time_s - before.last_s <= settings.end_after_s + ROUNDING_S
        )
        if not starts and not goes_on:
            continue
        if before is None:
            count += 1
            onset = Alert(
                alert_id=f"a{count:05d}",
                edge="onset",
                type=TYPES[kind],
                time_s=scene.time_s,
                ego_id=ego_id,
                other_id=other_id,
                severity=value,
                reason=_reason(TYPES[kind], value, scene.ids[a]),
            )
            edges.append(onset)
            still[key] = _Open(onset, value, scene.time_s, scene.ids[a])
            continue
        peak = before
        if value > before.danger:
            worse = replace(
                before.alert,
                edge="peak",
                severity=value,
                time_s=scene.time_s,
                reason=_reason(before.alert.type, value, before.deviates_id),
            )
            peak = replace(before, alert=worse, danger=value)
        still[key] = replace(peak, last_s=scene.time_s)
    return AlertState(still, count), tuple(edges)


def _worst(dangers: PairDangers, least: float) -> tuple[IntArray, IntArray, FloatArray, IntArray]:
    """Pairs with a danger of `least` or more, each once, with its greatest danger."""
    some = np.flatnonzero(dangers.danger >= least)
    first, second, danger = dangers.first[some], dangers.second[some], dangers.danger[some]
    kind = np.full(len(some), CONFLICT) if dangers.type is None else dangers.type[some]
    low, high = np.minimum(first, second), np.maximum(first, second)
    order = np.lexsort((-danger, high, low))
    key = np.stack((low, high), axis=1)[order]
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (np.diff(key, axis=0) != 0).any(axis=1)
    best = order[new]
    return first[best], second[best], danger[best], kind[best]


def _reason(type_: str, danger: float, deviates_id: str) -> str:
    why = f"danger {danger:.2f} (of 1) to collide or to brake hard within {WITHIN_S:.0f} s"
    return why if type_ == TYPES[CONFLICT] else f"{deviates_id} was to give way; {why}"
