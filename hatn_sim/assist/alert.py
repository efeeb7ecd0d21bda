"""Dangers of pairs, moment by moment -> alerts as intervals: onset, peak, end.

An alert begins where the danger of a pair reaches the onset threshold. It goes on while the danger
is at least the end threshold, not counting gaps of up to `end_after_s`, and for `least_s` at least;
if the danger reaches the onset threshold again within `cool_down_s` of its end, that is the same
alert. A pair has one alert at a time; its type is that of its onset.

Dangers are looked at every `LOOK_S`, as they were when the thresholds were calibrated: whoever
looked more often would be alarmed more often. For those who touch, or did a little while ago,
no alert begins: they are past warning.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from hatn_sim.assist.moment import CONFLICT, TYPES, PairDangers
from hatn_sim.assist.outlines import Boxes, overlap
from hatn_sim.assist.settings import AssistSettings
from hatn_sim.datatypes import Alert, BoolArray, FloatArray, IntArray, Scene

LOOK_S: Final = 0.2
WITHIN_S: Final = 5.0
"""Danger is of an event so soon."""
AFTER_CONTACT_S: Final = 5.0
"""What is dangerous between two so soon after they touched came of that."""
ROUNDING_S: Final = 1e-6
_Pair = tuple[str, str]
"""The ids of two vehicles, sorted."""


@dataclass(frozen=True)
class Warned:
    """Who of a pair is warned, by index into the scene, and what it had better do (`Alert`)."""

    ego: int
    other: int
    action: str | None = None
    room_m: float | None = None
    open_s: float | None = None
    text: str | None = None


Warn = Callable[[int, int, bool], Warned]
"""Whom to warn of two vehicles: the first, or the second too if the flag says that it may be."""


def warn_first(first: int, second: int, either: bool) -> Warned:
    """The first, of nothing in particular."""
    return Warned(first, second)


@dataclass(frozen=True)
class Met:
    """When pairs last touched."""

    at_s: Mapping[_Pair, float] = field(default_factory=dict[_Pair, float])


@dataclass(frozen=True)
class _Open:
    alert: Alert  # the peak so far
    danger: float  # at the peak
    onset_s: float
    last_s: float  # when the danger was last enough for the alert to go on
    deviates_id: str  # of a DEVIATION: who
    action: str | None  # what its ego was told to do

    def end_s(self, settings: AssistSettings) -> float:
        return max(self.last_s, self.onset_s + settings.least_s)


@dataclass(frozen=True)
class AlertState:
    """The alerts that are open now, and how many there were."""

    open: Mapping[_Pair, _Open] = field(default_factory=dict[_Pair, _Open])
    count: int = 0
    met: Met = field(default_factory=Met)
    looked_s: float = -np.inf  # when dangers were last looked at

    def looks(self, time_s: float) -> bool:
        """Whether dangers are looked at then."""
        return time_s - self.looked_s > LOOK_S - ROUNDING_S

    def told(self, time_s: float, settings: AssistSettings) -> frozenset[tuple[str, str]]:
        """Egos and what they are told to do (`Alert.action`), by alerts that may still go on."""
        return frozenset(
            (one.alert.ego_id, one.action)
            for one in self.open.values()
            if one.action is not None
            and time_s <= max(one.last_s + settings.end_after_s, one.end_s(settings)) + ROUNDING_S
        )


def alert(
    state: AlertState,
    scene: Scene,
    dangers: PairDangers,
    settings: AssistSettings,
    egos: frozenset[str] | None,
    warn: Warn = warn_first,
) -> tuple[AlertState, tuple[Alert, ...]]:
    """Edges of this moment, for pairs with one of `egos` (None: all); for when `state.looks`.

    The ego of an alert is one of `egos`; where both are, `warn` chooses. Once it is known that an
    alert is over, its `peak` and its `end` are told, at the times when they were.
    """
    met, dangers = with_touched(state.met, scene, dangers)
    first, second, danger, type_, touched = _worst(dangers, settings.alert_end)
    edges: list[Alert] = []
    still = dict(state.open)
    count = state.count
    for key, held in list(still.items()):
        end_s = held.end_s(settings)
        if scene.time_s - end_s > settings.cool_down_s + ROUNDING_S:
            edges.append(replace(held.alert, edge="peak"))
            edges.append(replace(held.alert, edge="end", time_s=end_s))
            del still[key]
    for a, b, value, kind, is_past in zip(
        *(of.tolist() for of in (first, second, danger, type_, touched)), strict=True
    ):
        is_ego = [egos is None or scene.ids[v] in egos for v in (a, b)]
        if not any(is_ego):
            continue
        key = min(scene.ids[a], scene.ids[b]), max(scene.ids[a], scene.ids[b])
        before = still.get(key)
        starts = value >= settings.alert_onset and not is_past
        goes_on = (
            before is not None and scene.time_s - before.last_s <= settings.end_after_s + ROUNDING_S
        )
        if not starts and not goes_on:
            continue
        if before is None:
            count += 1
            told = warn(a, b, is_ego[1]) if is_ego[0] else warn(b, a, False)
            onset = Alert(
                alert_id=f"a{count:05d}",
                edge="onset",
                type=TYPES[kind],
                time_s=scene.time_s,
                ego_id=scene.ids[told.ego],
                other_id=scene.ids[told.other],
                severity=value,
                reason=_reason(TYPES[kind], value, scene.ids[a]),
            )
            still[key] = _Open(onset, value, scene.time_s, scene.time_s, scene.ids[a], told.action)
            edges.append(
                replace(
                    onset,
                    action=told.action,
                    room_m=told.room_m,
                    open_s=told.open_s,
                    text=told.text,
                )
            )
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
    return AlertState(still, count, met, scene.time_s), tuple(edges)


def with_touched(met: Met, scene: Scene, dangers: PairDangers) -> tuple[Met, PairDangers]:
    """Who of the pairs touch, or did within `AFTER_CONTACT_S`."""
    first, second = dangers.first, dangers.second
    boxes = Boxes(scene.xy_m, scene.yaw_rad, scene.size_m)
    touch = overlap(boxes[first], boxes[second])
    if not met.at_s and not touch.any():
        return met, dangers
    now_s = scene.time_s
    at_s = {pair: s for pair, s in met.at_s.items() if now_s - s <= AFTER_CONTACT_S + ROUNDING_S}
    names = [
        (min(scene.ids[a], scene.ids[b]), max(scene.ids[a], scene.ids[b]))
        for a, b in zip(first.tolist(), second.tolist(), strict=True)
    ]
    at_s |= {pair: now_s for pair, is_met in zip(names, touch.tolist(), strict=True) if is_met}
    touched = np.array([pair in at_s for pair in names], dtype=np.bool_)
    return Met(at_s), replace(dangers, touched=touched)


def _worst(
    dangers: PairDangers, least: float
) -> tuple[IntArray, IntArray, FloatArray, IntArray, BoolArray]:
    """Pairs with a danger of `least` or more, each once, with its greatest danger."""
    some = np.flatnonzero(dangers.danger >= least)
    first, second, danger = dangers.first[some], dangers.second[some], dangers.danger[some]
    kind = np.full(len(some), CONFLICT) if dangers.type is None else dangers.type[some]
    nobody = np.zeros(len(some), dtype=np.bool_)
    touched = nobody if dangers.touched is None else dangers.touched[some]
    low, high = np.minimum(first, second), np.maximum(first, second)
    order = np.lexsort((-danger, high, low))
    key = np.stack((low, high), axis=1)[order]
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (np.diff(key, axis=0) != 0).any(axis=1)
    best = order[new]
    return first[best], second[best], danger[best], kind[best], touched[best]


def _reason(type_: str, danger: float, deviates_id: str) -> str:
    why = f"danger {danger:.2f} (of 1) to collide or to brake hard within {WITHIN_S:.0f} s"
    return why if type_ == TYPES[CONFLICT] else f"{deviates_id} was to give way; {why}"
