"""Which slot people are likely to take; the one told before, until another clearly is likelier.

Letters as in `datatypes`, and R egos that have a choice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.assist.told import LEAST_S, ROUNDING_S, Before
from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Scene, SemanticGraphs

SPEAK_MARGIN: Final = 0.4
"""Advice begins where the best slot leads the next by this much ..."""
SILENT_MARGIN: Final = -0.4
"""... and is doubted where another leads the one advised by this much."""
NEAR_S: Final = 4.0
NEAR_M: Final = 20.0
"""Nor does it begin farther than either from the conflict, at the present speed."""


def first_of_others(focus_mask: BoolArray, chances: FloatArray) -> IntArray:
    """The node [R] of whoever is most probably the first of the others at the focus.

    The chance to pass before j is that of the ego being first and j the first of the others.
    """
    others = np.where(focus_mask, chances, -1.0)
    others[:, 0] = -1.0
    return others.argmax(axis=1)


@dataclass(frozen=True, eq=False)
class _Chances:
    """Probabilities of the slots of each ego [R]."""

    of: FloatArray  # [R, M], -1 where there is no slot
    best: IntArray  # [R]
    second: FloatArray  # [R] of the best but one

    def margin(self, slot: IntArray) -> FloatArray:
        """[R] by which slots [R] lead the best of the others."""
        rows = np.arange(len(slot))
        others = np.where(slot == self.best, self.second, self.of[rows, self.best])
        return np.asarray(self.of[rows, slot] - others)


def _chances(focus_mask: BoolArray, chances: FloatArray) -> _Chances:
    of = np.where(focus_mask, chances, -1.0)
    best = of.argmax(axis=1)
    others = of.copy()
    others[np.arange(len(of)), best] = -1.0
    return _Chances(of, best, others.max(axis=1))


@dataclass(frozen=True, eq=False)
class Likely:
    """The slot that each ego [R] is to take if nothing speaks against it."""

    chances: _Chances
    first: IntArray  # [R] the node of whoever is most probably the first of the others
    named: IntArray  # [R] the node of whoever has to be let go on a yield
    told: IntArray  # [R] the slot told before; -1: none, or it is done
    slot: IntArray  # [R]
    near: BoolArray  # [R] the conflict
    speaks: BoolArray  # [R] clearly enough to say so
    begins: BoolArray  # [R] it is a yield not told before
    other_yields: FloatArray  # [R] how probably whoever is first lets the ego go


def likely_slots(
    scene: Scene,
    graphs: SemanticGraphs,
    slot_probability: FloatArray,
    row: IntArray,
    before: Before,
) -> Likely:
    """The slot told before, until another is clearly more probable."""
    focus = graphs.focus_mask[row]
    chances = _chances(focus, slot_probability[row])
    # Who waits, and had better wait for the next ones, too, is told one thing.
    nothing = np.zeros(len(row), dtype=np.int64)
    on_yield = (before.told < 0) & (before.action == 0) & (chances.margin(nothing) >= SPEAK_MARGIN)
    told = np.where(on_yield, 0, before.told)
    first = first_of_others(focus, slot_probability[row])
    stands = (told >= 0) & (chances.margin(np.maximum(told, 0)) > SILENT_MARGIN)
    slot = np.where(stands, told, chances.best)
    speed = scene.speed_mps[graphs.ego[row]]
    near = graphs.ego_to_conflict_m[row, 0] <= np.maximum(NEAR_S * speed, NEAR_M)
    speaks = stands | ((told >= 0) | near) & (chances.margin(slot) >= SPEAK_MARGIN)
    keeps_name = (before.about >= 0) & (scene.time_s - before.since_s < LEAST_S - ROUNDING_S)
    return Likely(
        chances,
        first,
        np.where(keeps_name, before.about, first),
        told,
        slot,
        near,
        speaks,
        (told != 0) & (slot == 0) & speaks,
        _yields_to(graphs, slot_probability, row, first),
    )


def _yields_to(
    graphs: SemanticGraphs, slot_probability: FloatArray, row: IntArray, first: IntArray
) -> FloatArray:
    """How probably the vehicles of nodes [R] yield, each to the ego of its graph [R].

    0 where one has no graph of its own, or somebody else is the first of the others there.
    """
    row_of = np.full(len(graphs.ids), -1)
    row_of[graphs.ego] = np.arange(len(graphs.ego))
    its = row_of[graphs.rear[row, first]]
    its_first = first_of_others(graphs.focus_mask[its], slot_probability[its])
    meets = (its >= 0) & graphs.focus_mask[its, its_first]
    meets &= graphs.rear[its, its_first] == graphs.ego[row]
    return np.where(meets, slot_probability[its, 0], 0.0)
