"""Whom a closed signal holds: about them there is nothing to choose.

To yield to them would be wrong, and to pass before them needs no advice. Who runs the signal is
for the alerts. Slots are still those of the nearest conflicts, theirs among them: where all of a
focus group are held, whoever is met farther on has no slot until these are behind.

Letters as in `datatypes`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from hatn_sim.assist.risk import STANDING_MPS
from hatn_sim.datatypes import BoolArray, FloatArray, Lines, Prediction, Scene, SemanticGraphs
from hatn_sim.graph import gates_ahead
from hatn_sim.road import Road

HARDEST_MPS2: Final = 4.5
"""Who would have to brake harder than this to stop at a signal is not held by it."""


def choice_of(road: Road, scene: Scene, prediction: Prediction) -> Prediction:
    """The prediction as far as there is something to choose: `without` those held by signals."""
    graphs, lines = prediction.graphs, prediction.lines
    assert graphs is not None and lines is not None
    return without(prediction, held_at_signals(road, scene, lines, graphs))


def held_at_signals(road: Road, scene: Scene, lines: Lines, graphs: SemanticGraphs) -> BoolArray:
    """The nodes [E, M] of others who can stop at a closed signal that is before the conflict."""
    closed_m = _to_closed_m(road, scene, lines)
    held = graphs.node_mask & (closed_m[np.maximum(graphs.rear, 0)] <= graphs.rear_to_conflict_m)
    held[:, 0] = False
    return held


def standing_at_signals_m(road: Road, scene: Scene, lines: Lines) -> FloatArray:
    """[N] from the centre of who stands to a closed signal; inf: there is none, or it moves."""
    stands = scene.speed_mps < STANDING_MPS
    return np.where(stands, _to_closed_m(road, scene, lines), np.inf)


def _to_closed_m(road: Road, scene: Scene, lines: Lines) -> FloatArray:
    """[N] from the centre to a closed signal; inf: there is none, or one cannot stop at it."""
    if not scene.signal_closed.any():
        return np.full(len(scene.ids), np.inf)
    closed_m = gates_ahead(road, scene, lines).closed_m
    # Who stands a little over the line waits nevertheless.
    stops = scene.speed_mps**2 <= 2.0 * HARDEST_MPS2 * np.maximum(closed_m, 0.0) + STANDING_MPS**2
    return np.where(stops, closed_m + 0.5 * scene.size_m[:, 0], np.inf)


def without(prediction: Prediction, held: BoolArray) -> Prediction:
    """The prediction without the nodes `held` [E, M].

    A slot's probability is that of the ego going first and its vehicle being the first of the
    others: what was given to those held goes to the others in proportion to what they have.
    """
    graphs, of = prediction.graphs, prediction.slot_probability
    assert graphs is not None
    if not held.any():
        return prediction
    stays = graphs.focus_mask & ~held
    passes = stays.copy()
    passes[:, 0] = False
    if of is not None:
        more = np.where(held, of, 0.0).sum(axis=1)
        of = _given_to(passes, np.where(held, 0.0, of), more)
    return replace(
        prediction,
        graphs=replace(graphs, node_mask=graphs.node_mask & ~held, focus_mask=stays),
        slot_probability=of,
    )


def _given_to(passes: BoolArray, of: FloatArray, more: FloatArray) -> FloatArray:
    """Probabilities [E, M] with `more` [E] shared among `passes` in proportion."""
    has = np.where(passes, of, 0.0)
    total, count = has.sum(axis=1, keepdims=True), passes.sum(axis=1, keepdims=True)
    share = np.where(total > 0.0, has / np.maximum(total, 1e-12), passes / np.maximum(count, 1))
    return np.where(passes, of + more[:, None] * share, of)
