"""Slot probabilities -> one suggestion for every ego that has a choice (METHOD section 7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hatn_sim.assist.risk import Encounters, required_deceleration_mps2
from hatn_sim.datatypes import Kind, Prediction, Scene, Suggestion

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
    out: list[Suggestion] = []
    slot_of: dict[str, str] = {}
    for e in np.flatnonzero(choice).tolist():
        ego_id = scene.ids[graphs.ego[e]]
        if egos is not None and ego_id not in egos:
            continue
        nodes = np.flatnonzero(graphs.focus_mask[e])
        chance = chances[e, nodes]
        order = np.argsort(-chance, kind="stable")
        best = int(nodes[order[0]])
        names = {int(m): scene.ids[graphs.rear[e, m]] for m in nodes}
        told = next((m for m, name in names.items() if name == state.slot_of.get(ego_id)), None)
        if told is not None and chances[e, best] - chances[e, told] < SWITCH_MARGIN:
            best = told
        rest = np.delete(chance, np.flatnonzero(nodes == best))
        margin = float(chances[e, best] - rest.max())
        slot_of[ego_id] = names[best]
        out.append(_make(scene, prediction, meeting, e, best, nodes, margin))
    return SuggestionState(slot_of), tuple(out)


def _make(
    scene: Scene,
    prediction: Prediction,
    meeting: Encounters,
    e: int,
    slot: int,
    nodes: np.ndarray,
    margin: float,
) -> Suggestion:
    graphs, chances = prediction.graphs, prediction.slot_probability
    assert graphs is not None and chances is not None
    ego = int(graphs.ego[e])
    others = nodes[nodes > 0]
    # On yield: the one that is predicted to come first is let go.
    node = slot if slot else int(others[np.argmin(meeting.other_enter_s[e, others])])
    other = int(graphs.rear[e, node])
    distance_m = float(max(graphs.ego_to_conflict_m[e, node], 0.1))
    speed_mps = float(scene.speed_mps[ego])
    if slot == 0:
        target_s = float(meeting.other_leave_s[e, node])
        brake = required_deceleration_mps2(
            np.array(distance_m), np.array(speed_mps), np.array(target_s)
        )
        feasible = float(brake) <= COMFORT_BRAKING_MPS2
    else:
        # Be gone before the other comes; no later than one would be there anyhow.
        target_s = float(min(meeting.ego_enter_s[e, node], meeting.other_enter_s[e, node]))
        needed = 2.0 * (distance_m - speed_mps * target_s) / max(target_s, 0.1) ** 2
        feasible = needed <= COMFORT_ACCELERATION_MPS2
    action = "abstain" if margin < ABSTAIN_MARGIN else ("pass" if slot else "yield")
    advised_mps = distance_m / max(target_s, 0.1)
    limit_mps = max(speed_mps, float(graphs.context[e, 0, 0]))
    return Suggestion(
        ego_id=scene.ids[ego],
        time_s=scene.time_s,
        action=action,
        slot_id=scene.ids[other],
        probability=float(chances[e, slot]),
        margin=margin,
        target_time_s=target_s,
        advised_speed_mps=min(advised_mps, limit_mps),
        feasible=feasible,
        text=_words(scene, ego, other, action, target_s, feasible),
    )


def _words(
    scene: Scene, ego: int, other: int, action: str, target_s: float, feasible: bool
) -> str:
    who = f"the {_colour(scene.colour[other])} {Kind(int(scene.kind[other])).name.lower()}"
    who += f" {_side(scene, ego, other)}"
    if action == "abstain":
        return f"Watch {who}: too close to call"
    if action == "pass":
        return f"Pass before {who}" + ("" if feasible else ", if you can: the gap is tight")
    if not feasible:
        return f"Brake hard: yield to {who}"
    return f"Yield to {who}; go after it in {target_s:.1f} s"


def _side(scene: Scene, ego: int, other: int) -> str:
    away = scene.xy_m[other] - scene.xy_m[ego]
    bearing = np.arctan2(away[1], away[0]) - scene.yaw_rad[ego]
    bearing = float((bearing + np.pi) % (2 * np.pi) - np.pi)
    if abs(bearing) < np.pi / 8:
        return "ahead"
    if abs(bearing) > 7 * np.pi / 8:
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


def _colour(rgb: np.ndarray) -> str:
    return min(_COLOURS, key=lambda name: float(((np.array(_COLOURS[name]) - rgb) ** 2).sum()))
