"""Asks a running simulation what would come of its advice, by sample, and tells it in lines.

Whoever steps the simulation shows it every moment with the advice given; what is asked then is
driven by branches beside the run, which goes on as if nobody had asked. The lines are those of
`counterfactuals.jsonl`.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from hatn_sim.assist.at_signals import choice_of
from hatn_sim.assist.evade import CLEAR
from hatn_sim.assist.likely import first_of_others
from hatn_sim.assist.outlook import look_ahead
from hatn_sim.assist.profile import HARD_BRAKING_MPS2, PROFILE_FRAMES
from hatn_sim.assist.suggest import SuggestionState, slot_profiles, stopped_at_line
from hatn_sim.datatypes import (
    DT_S,
    Advice,
    Alert,
    Branch,
    BranchFuture,
    Change,
    FloatArray,
    Frame,
    GiveWay,
    Plan,
    Prediction,
    SemanticGraphs,
    Simulator,
    Suggestion,
)
from hatn_sim.errors import InputError
from hatn_sim.labels import crossing_frame, trajectories_from_rows
from hatn_sim.score.counterfactual import (
    CounterfactualSettings,
    driven_in_branch,
    judge_alert,
    regret,
    slot_costs,
)

WAITED_FRAMES: Final = 2
"""Branches are asked for so many frames after they were started: by then most are done."""
YIELD: Final = 0
FIRST: Final = 1
"""Whoever it is passed before: who is to clear the place drives as fast as he may."""
Line = dict[str, Any]


def is_sampled(rate: float, seed: int, *names: object) -> bool:
    """Whether something falls into a sample of this rate: the same for the same names and seed."""
    text = "|".join(map(str, (seed, *names)))
    digest = hashlib.blake2b(text.encode(), digest_size=8).digest()
    return int.from_bytes(digest) < rate * 2**64


@dataclass(frozen=True, eq=False)
class _Asked:
    """Branches under way, and what to make of them: (as it is, the changed ones) -> a line."""

    frame: int
    facts: Line
    as_it_is: BranchFuture
    changed: Sequence[BranchFuture]
    judge: Callable[[Branch, list[Branch]], Line]


@dataclass(frozen=True)
class Rates:
    """Which share of advice is judged: alerts are rare, and worth more of it than suggestions."""

    alerts: float
    suggestions: float


class WhatIf:
    """Judges a sample of the alerts and suggestions of a run.

    Alerts are asked about at their onset, suggestions when another slot is advised than before,
    never those that abstain. A warned ego obeys by what the alert says: it brakes as little as
    keeps it out of the other's way, or goes on as fast as it may in comfort, or as its driver does.
    """

    def __init__(
        self, simulator: Simulator, rates: Rates, seed: int, settings: CounterfactualSettings
    ) -> None:
        """Raises InputError where a rate is no share, or the simulator cannot branch."""
        for rate in (rates.alerts, rates.suggestions):
            if not 0.0 < rate <= 1.0:
                raise InputError(
                    f"counterfactuals: expected a rate above 0 up to 1, found {rate:g}"
                )
        if simulator.cannot_branch is not None:
            raise InputError(f"{simulator.name}: no branches: {simulator.cannot_branch}")
        self._simulator = simulator
        self._rates, self._seed, self._settings = rates, seed, settings
        self._advised = SuggestionState()
        self._told: dict[str, tuple[str, str | None]] = {}
        self._asked: deque[_Asked] = deque()

    def see(self, index: int, frame: Frame, advice: Advice, asks: bool = True) -> list[Line]:
        """Starts what is to be asked of this moment, if anything is; lines of earlier ones."""
        graphs = advice.prediction.graphs
        if graphs is not None:
            self._advised = SuggestionState(
                stopped=stopped_at_line(self._advised.stopped, frame.scene, graphs)
            )
            changed = self._changed(advice.suggestions)
            if asks:
                self._ask(index, frame, advice, graphs, changed)
        return self._lines(index - WAITED_FRAMES)

    def finish(self) -> list[Line]:
        """The lines of all that is still under way."""
        return self._lines(None)

    def _ask(
        self,
        index: int,
        frame: Frame,
        advice: Advice,
        graphs: SemanticGraphs,
        changed: Sequence[Suggestion],
    ) -> None:
        row_of = {graphs.ids[v]: e for e, v in enumerate(graphs.ego.tolist())}
        alerts = [
            one
            for one in advice.alerts
            if one.action is not None and one.ego_id in row_of and self._samples(index, one)
        ]
        suggestions = [one for one in changed if self._samples(index, one)]
        if not alerts and not suggestions:
            return
        prediction = choice_of(self._simulator.road, frame.scene, advice.prediction)
        choice, chances = prediction.graphs, prediction.slot_probability
        assert choice is not None and chances is not None
        ways = {one: _ways(one, row_of[one.ego_id], choice, chances) for one in suggestions}
        of_slots = [way for many in ways.values() for way in many]
        clears = [_Way(row_of[one.ego_id], FIRST, FIRST) for one in alerts if one.action == CLEAR]
        plans = iter(self._plans(frame, prediction, of_slots + clears))
        changes: list[Change] = [next(plans) for _ in of_slots]
        changes += [
            replace(next(plans), at_least=True) if one.action == CLEAR else self._brake(one)
            for one in alerts
        ]
        futures = iter(
            self._simulator.branch([(), *((one,) for one in changes)], self._settings.horizon_s)
        )
        as_it_is = next(futures)
        now = {"frame": index, "time_s": frame.scene.time_s}
        for one in suggestions:
            facts: Line = now | {"ego_id": one.ego_id, "about": "suggestion"}
            facts |= {"action": one.action, "slot_id": one.slot_id}
            judge = _suggestion_judge(one, graphs, ways[one], self._settings)
            driven = [next(futures) for _ in ways[one]]
            self._asked.append(_Asked(index, facts, as_it_is, driven, judge))
        for one in alerts:
            facts = now | {"ego_id": one.ego_id, "about": "alert", "alert_id": one.alert_id}
            facts |= {"type": one.type, "other_id": one.other_id, "action": one.action}
            self._asked.append(
                _Asked(index, facts, as_it_is, [next(futures)], self._alert_judge(one))
            )

    def _brake(self, alert: Alert) -> GiveWay:
        assert alert.room_m is not None and alert.open_s is not None, "who brakes knows for what"
        return GiveWay(
            alert.ego_id, self._settings.reaction_s, alert.room_m, alert.open_s, HARD_BRAKING_MPS2
        )

    def _alert_judge(self, alert: Alert) -> Callable[[Branch, list[Branch]], Line]:
        reaction_s = self._settings.reaction_s
        back_s = reaction_s + DT_S * PROFILE_FRAMES if alert.open_s is None else alert.open_s

        def judge(as_it_is: Branch, changed: list[Branch]) -> Line:
            until_s = max(back_s, reaction_s) + reaction_s
            return asdict(judge_alert(as_it_is, changed[0], alert.ego_id, until_s))

        return judge

    def _samples(self, index: int, what: Alert | Suggestion) -> bool:
        is_alert = isinstance(what, Alert)
        other = what.other_id if is_alert else what.slot_id
        rate = self._rates.alerts if is_alert else self._rates.suggestions
        return is_sampled(rate, self._seed, type(what).__name__, index, what.ego_id, other)

    def _changed(self, suggestions: Sequence[Suggestion]) -> list[Suggestion]:
        """Those that say something else than the last time; whom to let go first may change."""
        now = {
            one.ego_id: (one.action, one.slot_id if one.action == "pass" else None)
            for one in suggestions
        }
        changed = [
            one
            for one in suggestions
            if one.action != "abstain" and self._told.get(one.ego_id) != now[one.ego_id]
        ]
        self._told = now
        return changed

    def _plans(self, frame: Frame, prediction: Prediction, ways: Sequence[_Way]) -> list[Plan]:
        if not ways:
            return []
        graphs, settings = prediction.graphs, self._settings
        assert graphs is not None
        row, slot, first = np.array([(way.row, way.slot, way.first) for way in ways], np.int64).T
        outlook = look_ahead(self._simulator.road, frame.scene, prediction)
        start_s = settings.reaction_s
        profiles = slot_profiles(self._advised, outlook, row, slot, first, start_s)
        return [
            Plan(
                graphs.ids[graphs.ego[e]],
                settings.reaction_s,
                speed_mps,
                settings.blend_s,
                follows=True,
            )
            for e, speed_mps in zip(row.tolist(), profiles.tick_speed_mps(), strict=True)
        ]

    def _lines(self, up_to: int | None) -> list[Line]:
        lines: list[Line] = []
        while self._asked and (up_to is None or self._asked[0].frame <= up_to):
            asked = self._asked.popleft()
            as_it_is = asked.as_it_is.result()
            changed = [future.result() for future in asked.changed]
            whole = [branch for branch in changed if branch is not None]
            if as_it_is is None or len(whole) < len(changed):
                lines.append(asked.facts | {"lost": True})
            else:
                lines.append(asked.facts | {"lost": False} | asked.judge(as_it_is, whole))
        return lines


@dataclass(frozen=True)
class _Way:
    """One way to go on: the ego of a graph takes a slot."""

    row: int
    slot: int
    first: int  # the node of whoever goes first on a yield

    def told(self, graphs: SemanticGraphs) -> Line:
        """As suggestions are: whom to pass before, or to let go first."""
        node = self.first if self.slot == YIELD else self.slot
        action = "yield" if self.slot == YIELD else "pass"
        return {"action": action, "slot_id": graphs.ids[int(graphs.rear[self.row, node])]}


def _ways(
    suggestion: Suggestion, row: int, graphs: SemanticGraphs, chances: FloatArray
) -> list[_Way]:
    """One for each slot; whom a suggestion lets go first goes first, else the most probable."""
    (first,) = first_of_others(graphs.focus_mask[[row]], chances[[row]]).tolist()
    if suggestion.action == "yield":
        first = _node(suggestion, row, graphs)
    return [_Way(row, slot, first) for slot in np.flatnonzero(graphs.focus_mask[row]).tolist()]


def _node(suggestion: Suggestion, row: int, graphs: SemanticGraphs) -> int:
    """The node of whom the suggestion names."""
    rear = [graphs.ids[v] if v >= 0 else None for v in graphs.rear[row].tolist()]
    return rear.index(suggestion.slot_id)


def _suggestion_judge(
    suggestion: Suggestion,
    graphs: SemanticGraphs,
    ways: Sequence[_Way],
    settings: CounterfactualSettings,
) -> Callable[[Branch, list[Branch]], Line]:
    other_id, row = suggestion.slot_id, ways[0].row
    assert other_id is not None, "who advises names somebody"
    slots = [way.slot for way in ways]
    advised = slots.index(YIELD if suggestion.action == "yield" else _node(suggestion, row, graphs))

    def judge(as_it_is: Branch, changed: list[Branch]) -> Line:
        *costs, drivers = slot_costs([*changed, as_it_is], suggestion.ego_id, settings)
        totals = [cost.total for cost in costs]
        best = min(*totals, drivers.total)
        return {
            "slots": [
                way.told(graphs) | asdict(cost) for way, cost in zip(ways, costs, strict=True)
            ],
            "driver": asdict(drivers),
            "driver_action": driver_action(as_it_is, graphs, row, other_id),
            "slots_differ": max(totals) > min(totals),
            "regret": regret(totals, advised),
            "always_yield_regret": regret(totals, slots.index(YIELD)),
            "driver_regret": drivers.total - min(totals),
            "best_total": best,
            "regret_to_best": totals[advised] - best,
        }

    return judge


def driver_action(branch: Branch, graphs: SemanticGraphs, row: int, other_id: str) -> str | None:
    """What an ego does about another vehicle in a branch of that moment: "pass" before it, "yield".

    Told at the conflict of the two (`labels.crossing_frame`), also where the one that comes second
    is still on its way there at the branch's end. None: the second has taken another way or left
    view before, or neither has crossed, or they have no conflict.
    """
    focus = graphs.focus_mask[row] & (graphs.rear[row] == graphs.ids.index(other_id))
    focus[YIELD] = False
    if not focus.any():
        return None
    node = int(focus.argmax())
    driven = driven_in_branch(branch)
    trajectories = trajectories_from_rows(
        driven.ids, driven.vehicle, driven.frame, driven.xy_m, len(driven.time_s)
    )
    ego_id, last = graphs.ids[int(graphs.ego[row])], len(driven.time_s) - 1
    both = np.array([driven.ids.index(ego_id), driven.ids.index(other_id)])
    now = np.zeros(2, np.int64)
    away_m = np.array([graphs.ego_to_conflict_m[row, node], graphs.rear_to_conflict_m[row, node]])
    place = np.stack([graphs.conflict_xy_m[row, node]] * 2)
    crosses_at = crossing_frame(trajectories, both, now, away_m, place, last)
    crosses = crosses_at >= 0
    comes = trajectories.seen(both, now, now + last)
    comes &= trajectories.travelled_at(both, last) < away_m
    if not crosses.any() or not (crosses | comes).all():
        return None
    mine, its = np.where(crosses, crosses_at, last + 1).tolist()
    return "pass" if mine < its else "yield"
