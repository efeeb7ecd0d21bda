"""Slot probabilities -> one suggestion for every ego that has a choice (METHOD section 7)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

import numpy as np

from hatn_sim.assist.risk import Encounters, required_deceleration_mps2
from hatn_sim.datatypes import (
    BoolArray,
    FloatArray,
    IntArray,
    Kind,
    Prediction,
    Scene,
    SemanticGraphs,
    Suggestion,
)

SPEAK_MARGIN: Final = 0.25
"""Advice begins where the best slot leads the next by this much ..."""
SILENT_MARGIN: Final = -0.15
"""... and ends where another leads the one advised by this much."""
FEASIBLE_BAND: Final = 0.2
"""A suggestion stays feasible, or infeasible, within this share of the comfort limit."""
COMFORT_ACCELERATION_MPS2: Final = 2.0
COMFORT_BRAKING_MPS2: Final = 3.0


@dataclass(frozen=True)
class Told:
    """What an ego was told last."""

    slot_id: str  # the rear vehicle of the slot: the ego itself for a yield
    action: str
    feasible: bool


@dataclass(frozen=True)
class SuggestionState:
    """What every advised ego was told last, by its id."""

    told: Mapping[str, Told] = field(default_factory=dict[str, Told])


def suggest(
    state: SuggestionState,
    scene: Scene,
    prediction: Prediction,
    meeting: Encounters,
    egos: frozenset[str] | None,
) -> tuple[SuggestionState, tuple[Suggestion, ...]]:
    """Suggestions of this moment for `egos` (None: all) with at least two slots to choose from."""
    graphs, chances = prediction.graphs, prediction.slot_probability
    assert graphs is not None and chances is not None
    # At a red light there is nothing to choose.
    choice = graphs.has_conflict & (graphs.focus_mask.sum(axis=1) > 1) & ~graphs.ego_at_red
    rows = [
        e
        for e in np.flatnonzero(choice).tolist()
        if egos is None or scene.ids[graphs.ego[e]] in egos
    ]
    if not rows:
        return SuggestionState(), ()
    before = [state.told.get(scene.ids[graphs.ego[e]]) for e in rows]
    choices = [
        _choose(scene, graphs, chances[e], e, told) for e, told in zip(rows, before, strict=True)
    ]
    was_feasible = np.array([told is None or told.feasible for told in before])
    slots = np.array([choice.slot for choice in choices])
    plan = _plan(scene, graphs, meeting, np.array(rows), slots, was_feasible)
    out = tuple(
        _make(scene, int(graphs.ego[e]), choice, plan, k)
        for k, (e, choice) in enumerate(zip(rows, choices, strict=True))
    )
    told_now = {
        one.ego_id: Told(scene.ids[graphs.rear[e, choice.slot]], one.action, one.feasible)
        for one, e, choice in zip(out, rows, choices, strict=True)
    }
    return SuggestionState(told_now), out


@dataclass(frozen=True)
class _Choice:
    slot: int
    action: str
    probability: float
    margin: float  # to the best of the others


def _choose(
    scene: Scene, graphs: SemanticGraphs, chances: FloatArray, e: int, told: Told | None
) -> _Choice:
    """The slot to advise: the one told before, until another is clearly better.

    Where two slots are close, the advice that was given stands; where none was given, none is.
    """
    chance = {m: float(chances[m]) for m in np.flatnonzero(graphs.focus_mask[e]).tolist()}

    def margin(slot: int) -> float:
        return chance[slot] - max(value for m, value in chance.items() if m != slot)

    if told is not None and told.action != "abstain":
        for m in chance:
            if scene.ids[graphs.rear[e, m]] == told.slot_id and margin(m) > SILENT_MARGIN:
                return _Choice(m, told.action, chance[m], margin(m))
    best = max(chance, key=lambda m: chance[m])
    action = "abstain" if margin(best) < SPEAK_MARGIN else ("pass" if best else "yield")
    return _Choice(best, action, chance[best], margin(best))


@dataclass(frozen=True, eq=False)
class _Plan:
    """How each advised ego [R] would take its slot."""

    other: IntArray  # the vehicle to pass before, or to let go first
    target_s: FloatArray
    advised_mps: FloatArray
    feasible: BoolArray


def _plan(
    scene: Scene,
    graphs: SemanticGraphs,
    meeting: Encounters,
    row: IntArray,
    slot: IntArray,
    was_feasible: BoolArray,
) -> _Plan:
    others = graphs.focus_mask[row].copy()
    others[:, 0] = False
    # On yield: the one that is predicted to come first is let go.
    first = np.where(others, meeting.other_enter_s[row], np.inf).argmin(axis=1)
    yields = slot == 0
    node = np.where(yields, first, slot)
    room = np.maximum(meeting.ego_room_m[row, node], 0.1)
    speed = scene.speed_mps[graphs.ego[row]]
    comes = np.maximum(meeting.other_enter_s[row, node], 0.1)
    # To pass: be there no later than one would be anyhow, and before the other comes.
    before = np.minimum(meeting.ego_enter_s[row, node], comes)
    target = np.where(yields, meeting.other_leave_s[row, node], before)
    brake = required_deceleration_mps2(room, speed, target)
    # To be out of the area, as long after the conflict as its beginning is before it.
    clear = 2.0 * graphs.ego_to_conflict_m[row, node] - meeting.ego_room_m[row, node]
    push = 2.0 * (clear - speed * comes) / comes**2
    limit = np.maximum(speed, graphs.context[row, 0, 0])
    effort = np.where(yields, brake / COMFORT_BRAKING_MPS2, push / COMFORT_ACCELERATION_MPS2)
    return _Plan(
        other=graphs.rear[row, node],
        target_s=target,
        advised_mps=np.minimum(room / np.maximum(target, 0.1), limit),
        feasible=effort <= np.where(was_feasible, 1.0 + FEASIBLE_BAND, 1.0 - FEASIBLE_BAND),
    )


def _make(scene: Scene, ego: int, choice: _Choice, plan: _Plan, k: int) -> Suggestion:
    other, target_s = int(plan.other[k]), float(plan.target_s[k])
    feasible = bool(plan.feasible[k])
    return Suggestion(
        ego_id=scene.ids[ego],
        time_s=scene.time_s,
        action=choice.action,
        slot_id=scene.ids[other],
        probability=choice.probability,
        margin=choice.margin,
        target_time_s=target_s,
        advised_speed_mps=float(plan.advised_mps[k]),
        feasible=feasible,
        text=_words(scene, ego, other, choice.action, target_s, feasible),
    )


def _words(scene: Scene, ego: int, other: int, action: str, target_s: float, feasible: bool) -> str:
    colour, kind = _colour(*scene.colour[other].tolist()), Kind(int(scene.kind[other]))
    who = f"the {colour} {kind.name.lower()} {_side(scene, ego, other)}"
    if action == "abstain":
        return f"Watch {who}: too close to call"
    if action == "pass":
        return f"Pass before {who}" + ("" if feasible else ", if you can: the gap is tight")
    if not feasible:
        return f"Brake hard: yield to {who}"
    return f"Yield to {who}; go after it in {target_s:.1f} s"


def _side(scene: Scene, ego: int, other: int) -> str:
    x, y = (scene.xy_m[other] - scene.xy_m[ego]).tolist()
    bearing = math.remainder(math.atan2(y, x) - float(scene.yaw_rad[ego]), math.tau)
    if abs(bearing) < math.pi / 8:
        return "ahead"
    if abs(bearing) > 7 * math.pi / 8:
        return "behind"
    return "from the left" if bearing > 0 else "from the right"


_COLOURS: Final = {
    "white": (240, 240, 240),
    "silver": (180, 185, 190),
    "grey": (110, 110, 110),
    "black": (30, 30, 30),
    "red": (200, 30, 30),
    "blue": (40, 80, 190),
    "light blue": (110, 195, 245),
    "purple": (130, 60, 160),
    "green": (40, 140, 60),
    "yellow": (245, 215, 20),
    "orange": (240, 140, 20),
    "brown": (120, 75, 40),
    "beige": (220, 205, 170),
}


@lru_cache(maxsize=4096)
def _colour(red: int, green: int, blue: int) -> str:
    """The nearest of the named colours."""

    def distance(name: str) -> int:
        r, g, b = _COLOURS[name]
        return (r - red) ** 2 + (g - green) ** 2 + (b - blue) ** 2

    return min(_COLOURS, key=distance)
