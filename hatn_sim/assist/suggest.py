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

ABSTAIN_MARGIN: Final = 0.2
"""No advice where the best two slots are nearer than this."""
SWITCH_MARGIN: Final = 0.15
"""A new slot must be this much more probable than the one suggested."""
COMFORT_ACCELERATION_MPS2: Final = 2.0
COMFORT_BRAKING_MPS2: Final = 3.0


@dataclass(frozen=True)
class SuggestionState:
    """Which slot every ego was told to take: vehicle id of the slot, the ego's own for a yield."""

    slot_of: Mapping[str, str] = field(default_factory=dict[str, str])


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
    choice = graphs.has_conflict & (graphs.focus_mask.sum(axis=1) > 1)
    rows = [
        e
        for e in np.flatnonzero(choice).tolist()
        if egos is None or scene.ids[graphs.ego[e]] in egos
    ]
    if not rows:
        return SuggestionState(), ()
    slots = [
        _choose(state, scene, graphs, chances[e], e, np.flatnonzero(graphs.focus_mask[e]).tolist())
        for e in rows
    ]
    plan = _plan(scene, graphs, meeting, np.array(rows), np.array([slot for slot, _ in slots]))
    out = tuple(
        _make(scene, graphs.ego[e], slot, float(chances[e, slot]), margin, plan, k)
        for k, (e, (slot, margin)) in enumerate(zip(rows, slots, strict=True))
    )
    told = {
        one.ego_id: scene.ids[graphs.rear[e, slot]]
        for one, e, (slot, _) in zip(out, rows, slots, strict=True)
    }
    return SuggestionState(told), out


def _choose(
    state: SuggestionState,
    scene: Scene,
    graphs: SemanticGraphs,
    chances: FloatArray,
    e: int,
    nodes: list[int],
) -> tuple[int, float]:
    """The slot of an ego and its margin to the next best; the one told before unless beaten."""
    chance = {m: float(chances[m]) for m in nodes}
    best = max(nodes, key=lambda m: chance[m])
    before = state.slot_of.get(scene.ids[graphs.ego[e]])
    for m in nodes:
        if scene.ids[graphs.rear[e, m]] == before and chance[best] - chance[m] < SWITCH_MARGIN:
            best = m
    return best, chance[best] - max(chance[m] for m in nodes if m != best)


@dataclass(frozen=True, eq=False)
class _Plan:
    """How each advised ego [R] would take its slot."""

    other: IntArray  # the vehicle to pass before, or to let go first
    target_s: FloatArray
    advised_mps: FloatArray
    feasible: BoolArray


def _plan(
    scene: Scene, graphs: SemanticGraphs, meeting: Encounters, row: IntArray, slot: IntArray
) -> _Plan:
    others = graphs.focus_mask[row].copy()
    others[:, 0] = False
    # On yield: the one that is predicted to come first is let go.
    first = np.where(others, meeting.other_enter_s[row], np.inf).argmin(axis=1)
    yields = slot == 0
    node = np.where(yields, first, slot)
    distance = np.maximum(graphs.ego_to_conflict_m[row, node], 0.1)
    speed = scene.speed_mps[graphs.ego[row]]
    # To pass: be there before the other comes, no later than one would be there anyhow.
    before = np.minimum(meeting.ego_enter_s[row, node], meeting.other_enter_s[row, node])
    target = np.where(yields, meeting.other_leave_s[row, node], before)
    brake = required_deceleration_mps2(meeting.ego_room_m[row, node], speed, target)
    push = 2.0 * (distance - speed * target) / np.maximum(target, 0.1) ** 2
    limit = np.maximum(speed, graphs.context[row, 0, 0])
    return _Plan(
        other=graphs.rear[row, node],
        target_s=target,
        advised_mps=np.minimum(distance / np.maximum(target, 0.1), limit),
        feasible=np.where(yields, brake <= COMFORT_BRAKING_MPS2, push <= COMFORT_ACCELERATION_MPS2),
    )


def _make(
    scene: Scene,
    ego: int,
    slot: int,
    probability: float,
    margin: float,
    plan: _Plan,
    k: int,
) -> Suggestion:
    action = "abstain" if margin < ABSTAIN_MARGIN else ("pass" if slot else "yield")
    other, target_s = int(plan.other[k]), float(plan.target_s[k])
    feasible = bool(plan.feasible[k])
    return Suggestion(
        ego_id=scene.ids[ego],
        time_s=scene.time_s,
        action=action,
        slot_id=scene.ids[other],
        probability=probability,
        margin=margin,
        target_time_s=target_s,
        advised_speed_mps=float(plan.advised_mps[k]),
        feasible=feasible,
        text=_words(scene, ego, other, action, target_s, feasible),
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
