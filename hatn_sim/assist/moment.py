"""What alert rules look at, and what they say: the seam between rules, alerts and scores."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from hatn_sim.assist.pairs import Pairs, pairs_of
from hatn_sim.assist.settings import AssistSettings
from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Prediction, Scene
from hatn_sim.perception import Perception
from hatn_sim.road import Road

TYPES: Final = ("CONFLICT", "DEVIATION")
CONFLICT: Final = 0
DEVIATION: Final = 1
EARLIER_S: Final = 1.0
"""Deviations are from what was predicted so long ago."""
ROUNDING_S: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Moment:
    """All that a rule may look at."""

    road: Road
    seen: Perception
    prediction: Prediction  # of HATN
    earlier: Prediction | None = None  # of HATN, `EARLIER_S` ago; None: no DEVIATION is seen
    settings: AssistSettings = field(default_factory=AssistSettings)

    @property
    def scene(self) -> Scene:
        return self.seen.scene

    @cached_property
    def pairs(self) -> Pairs:
        """Everybody who may meet; the same for all rules."""
        seen = self.seen
        return pairs_of(self.road, seen.scene, seen.lines, seen.leader, seen.leader_s_m)


@dataclass(frozen=True, eq=False)
class PairDangers:
    """Pairs [P] of vehicles of the scene and how dangerous they are; higher is worse.

    Of a DEVIATION, the first is the one who deviates; else it is whoever had better be warned, if
    both can be.
    """

    first: IntArray
    second: IntArray
    danger: FloatArray  # 0: none
    type: IntArray | None = None  # index into TYPES; None: all CONFLICT
    touched: BoolArray | None = None  # a little while ago, or now; None: nobody


AlertRule = Callable[[Moment], PairDangers]


def pair_dangers(index: IntArray, danger: FloatArray, type_: IntArray | None = None) -> PairDangers:
    """Those of the pairs [Q, 2] whose danger [Q] is above 0."""
    some = np.flatnonzero(danger > 0.0)
    of = index[some]
    return PairDangers(of[:, 0], of[:, 1], danger[some], None if type_ is None else type_[some])


@dataclass(frozen=True, eq=False)
class Recent:
    """The predictions of the last second."""

    kept: tuple[tuple[float, Prediction], ...] = ()

    def earlier(self, time_s: float) -> Prediction | None:
        """What was predicted `EARLIER_S` ago or, at the latest, longer ago; None: nothing was."""
        then_s = time_s - EARLIER_S + ROUNDING_S
        old = [prediction for when_s, prediction in self.kept if when_s <= then_s]
        return old[-1] if old else None

    def with_newest(self, time_s: float, prediction: Prediction) -> Recent:
        """With one more, and without what will not be asked for any more."""
        then_s = time_s - EARLIER_S + ROUNDING_S
        old = [k for k, (when_s, _) in enumerate(self.kept) if when_s <= then_s]
        return Recent((*self.kept[old[-1] if old else 0 :], (time_s, prediction)))
