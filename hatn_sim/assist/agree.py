"""Suggestions beside alerts: what an alert tells an ego to do wins."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from hatn_sim.assist.choice import Why
from hatn_sim.assist.evade import BRAKE, CLEAR
from hatn_sim.assist.words import names, words
from hatn_sim.datatypes import Scene, Suggestion

CONTRARY: Final = {"pass": BRAKE, "yield": CLEAR}
"""What an ego is not told to do while an alert tells it the other."""
ALERTED: Final = Why.ALERTED.name.lower()


def agreeing(
    suggestions: Sequence[Suggestion], told: Collection[tuple[str, str]], scene: Scene
) -> tuple[Suggestion, ...]:
    """The suggestions of a moment, silent where they contradict an alert that goes on.

    `told` are egos and what alerts tell them to do (`AlertState.told`). Whoever the two name: who
    brakes for one vehicle cannot pass before another.
    """
    if not told:
        return tuple(suggestions)
    return tuple(
        _silent(one, scene) if (one.ego_id, CONTRARY.get(one.action)) in told else one
        for one in suggestions
    )


def _silent(suggestion: Suggestion, scene: Scene) -> Suggestion:
    ego, other = (scene.ids.index(name) for name in (suggestion.ego_id, suggestion.slot_id or ""))
    (who,) = names(scene, np.array([ego]), np.array([other]))
    return replace(
        suggestion,
        action="abstain",
        text=words(who, "abstain", reason=ALERTED),
        profile_mps=(),
        reason=ALERTED,
    )
