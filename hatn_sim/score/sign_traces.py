"""The signs of danger of all pairs of a run, kept to fit danger networks to.

A trace of dangers holds the number of a row of signs where the danger would be, so that a network
makes dangers of it in one go.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hatn_sim.assist.danger_network import DangerNetwork
from hatn_sim.assist.moment import PairDangers
from hatn_sim.assist.signs import SIGNS, Signs
from hatn_sim.score.dangers import DangerRecorder, DangerTrace, worst_of_each


@dataclass(frozen=True, eq=False)
class SignTrace:
    """Signs of pairs, by pair and then by time; a pair may be there twice at a moment."""

    pairs: DangerTrace  # its danger is the number of a row of `signs`
    signs: NDArray[np.float16]  # [D, len(SIGNS)]

    def dangers(self, network: DangerNetwork) -> DangerTrace:
        """What a network says of them."""
        chance = network.danger(self.signs.astype(np.float64))[self.pairs.danger.astype(np.int64)]
        return worst_of_each(replace(self.pairs, danger=chance))


class SignRecorder:
    """Takes in signs, moment after moment."""

    def __init__(self) -> None:
        self._dangers = DangerRecorder()
        self._signs: list[NDArray[np.float16]] = []
        self._count = 0

    def add(self, time_s: float, ids: Sequence[str], signs: Signs) -> None:
        """Signs of pairs of vehicles `ids`."""
        index, count = signs.pairs.index, len(signs.of)
        numbers = np.arange(self._count, self._count + count, dtype=np.float64)
        self._dangers.add(time_s, ids, PairDangers(index[:, 0], index[:, 1], numbers))
        self._signs.append(signs.of.astype(np.float16))
        self._count += count

    def trace(self) -> SignTrace:
        """All that was taken in."""
        none = np.zeros((0, len(SIGNS)), dtype=np.float16)
        return SignTrace(self._dangers.whole(), np.concatenate([none, *self._signs]))
