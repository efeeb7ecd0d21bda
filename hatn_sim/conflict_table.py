"""The conflicts of the pairs of lines met so far, looked up for many pairs at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, Conflict, FloatArray, IntArray

_KEY: Final = 1 << 31
"""A pair of lines i <= j has the key i * _KEY + j."""


@dataclass(frozen=True, eq=False)
class PairConflicts:
    """The conflicts of pairs of lines, one row each; columns are (first, second) of the pair."""

    pair: IntArray  # [C] index of the pair asked for, rising
    rows: FloatArray  # [C, 7] as they are kept: for the pair with the lower line first
    turned: BoolArray  # [C] the pair was asked for the other way round

    @property
    def entry_s_m(self) -> FloatArray:
        """[C, 2]"""
        return self._sides(0)

    @property
    def point_s_m(self) -> FloatArray:
        """[C, 2]"""
        return self._sides(2)

    @property
    def exit_s_m(self) -> FloatArray:
        """[C, 2]"""
        return self._sides(4)

    @property
    def type(self) -> IntArray:
        """[C] ConflictType"""
        return self.rows[:, 6].astype(np.int64)

    def _sides(self, column: int) -> FloatArray:
        values = self.rows[:, column : column + 2]
        return np.where(self.turned[:, None], values[:, ::-1], values)


class ConflictTable:
    """Finds the conflicts of a pair of lines once, and keeps them until a line is dropped.

    Args:
        find: the conflicts of two lines, s on (first, second).
        may_meet: for pairs [Q] and [Q] of lines, whether they come near each other at all; a cheap
            look that spares most calls of `find`.
    """

    def __init__(
        self,
        find: Callable[[int, int], Sequence[Conflict]],
        may_meet: Callable[[IntArray, IntArray], BoolArray],
    ) -> None:
        self._find = find
        self._may_meet = may_meet
        self._keys: IntArray = np.zeros(0, dtype=np.int64)  # sorted
        self._start: IntArray = np.zeros(0, dtype=np.int64)  # of the pair's conflicts in _rows
        self._number: IntArray = np.zeros(0, dtype=np.int64)
        self._rows: FloatArray = np.zeros((64, 7))  # entry, point, exit on each line; the type
        self._used = 0

    def __len__(self) -> int:
        """Pairs that are known."""
        return len(self._keys)

    def of_pairs(self, first: IntArray, second: IntArray) -> PairConflicts:
        """The conflicts of the pairs (first[q], second[q])."""
        key = np.minimum(first, second) * _KEY + np.maximum(first, second)
        at, known = self._look_up(key)
        if not known.all():
            self._add(np.unique(key[~known]))
            at, _ = self._look_up(key)
        some = np.flatnonzero(self._number[at] > 0) if len(at) else at
        number = self._number[at[some]]
        pair = np.repeat(some, number)
        within = np.arange(len(pair)) - np.repeat(np.cumsum(number) - number, number)
        rows = self._rows[np.repeat(self._start[at[some]], number) + within]
        return PairConflicts(pair, rows, (first > second)[pair])

    def drop(self, lines: IntArray) -> None:
        """Forget every pair with one of these lines."""
        gone = np.isin(self._keys // _KEY, lines) | np.isin(self._keys % _KEY, lines)
        keep = ~gone
        number = self._number[keep]
        old = np.repeat(self._start[keep], number)
        start = np.cumsum(number) - number
        within = np.arange(int(number.sum())) - np.repeat(start, number)
        rows = self._rows[old + within]
        self._keys, self._start, self._number = self._keys[keep], start, number
        self._used = len(rows)
        self._rows = np.concatenate((rows, np.zeros((64, 7))))

    def _look_up(self, key: IntArray) -> tuple[IntArray, BoolArray]:
        """Where every key [Q] is, and whether it is there."""
        if not len(self._keys):
            return np.zeros(len(key), dtype=np.int64), np.zeros(len(key), dtype=np.bool_)
        at = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
        return at, self._keys[at] == key

    def _add(self, keys: IntArray) -> None:
        """Work out the conflicts of new pairs, given by their keys in rising order."""
        low, high = keys // _KEY, keys % _KEY
        near = (low != high) & self._may_meet(low, high)
        start, number = np.full(len(keys), self._used), np.zeros(len(keys), dtype=np.int64)
        for k in np.flatnonzero(near).tolist():
            found = self._find(int(low[k]), int(high[k]))
            start[k], number[k] = self._used, len(found)
            self._append(found)
        place = np.searchsorted(self._keys, keys)
        self._keys = np.insert(self._keys, place, keys)
        self._start = np.insert(self._start, place, start)
        self._number = np.insert(self._number, place, number)

    def _append(self, found: Sequence[Conflict]) -> None:
        while self._used + len(found) > len(self._rows):
            self._rows = np.concatenate((self._rows, np.zeros_like(self._rows)))
        for c in found:
            self._rows[self._used] = (*c.entry_s_m, *c.point_s_m, *c.exit_s_m, float(c.type))
            self._used += 1
