"""Whom a closed signal holds: about them there is nothing to choose.

To yield to them would be wrong, and to pass before them needs no advice. Who runs the signal is
for the alerts.

Letters as in `datatypes`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, Lines, Prediction, Scene, SemanticGraphs
from hatn_sim.graph import gates_ahead
from hatn_sim.road import Road

HARDEST_MPS2: Final = 4.5
"""Who would have to brake harder than this to stop at a signal is not held by it."""
LEAST_M: Final = 0.5
"""Who stands a little over the line waits nevertheless."""


def held_at_signals(road: Road, scene: Scene, lines: Lines, graphs: SemanticGraphs) -> BoolArray:
    """The nodes [E, M] of others who can stop at a closed signal that is before the conflict."""
    if not scene.signal_closed.any():
        return np.zeros(graphs.rear.shape, dtype=np.bool_)
    closed_m = gates_ahead(road, scene, lines).closed_m
    stops = scene.speed_mps**2 <= 2.0 * HARDEST_MPS2 * np.maximum(closed_m, LEAST_M)
    other = np.maximum(graphs.rear, 0)
    from_centre_m = np.where(stops, closed_m + 0.5 * scene.size_m[:, 0], np.inf)
    held = graphs.node_mask & (from_centre_m[other] <= graphs.rear_to_conflict_m)
    held[:, 0] = False
    return held


def without(prediction: Prediction, held: BoolArray) -> Prediction:
    """The prediction as if those of nodes `held` [E, M] were not there.

    A slot's probability is that of the ego going first and its vehicle being the first of the
    others: what was given to those held goes to the others in equal shares of what they have.
    """
    graphs, of = prediction.graphs, prediction.slot_probability
    assert graphs is not None and of is not None
    if not held.any():
        return prediction
    stays = graphs.focus_mask & ~held
    passes = stays.copy()
    passes[:, 0] = False
    return replace(
        prediction,
        graphs=replace(graphs, node_mask=graphs.node_mask & ~held, focus_mask=stays),
        slot_probability=_given_to(passes, of, np.where(held, of, 0.0).sum(axis=1)),
    )


def _given_to(passes: BoolArray, of: FloatArray, more: FloatArray) -> FloatArray:
    """Probabilities [E, M] with `more` [E] shared among `passes` in proportion."""
    has = np.where(passes, of, 0.0)
    total, count = has.sum(axis=1, keepdims=True), passes.sum(axis=1, keepdims=True)
    share = np.where(total > 0.0, has / np.maximum(total, 1e-12), passes / np.maximum(count, 1))
    return np.where(passes, of + more[:, None] * share, of)
