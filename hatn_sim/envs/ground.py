"""Which road the ego has been on: nobody comes nearer to anywhere by driving in circles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, Route

SPARE_M: Final = 0.5
"""Where a lane begins differs by less from one way to another."""


@dataclass(frozen=True)
class Ground:
    """How far along each lane the ego has been, on ways that it has left."""

    reached_m: Mapping[str, float] = field(default_factory=dict[str, float])

    def left(self, route: Route, ends_m: Sequence[float], s_m: float) -> Ground:
        """With a way, of lanes that end at `ends_m`, that is left at `s_m`."""
        reached_m = dict(self.reached_m)
        for name, start_m, end_m in _stretches(route, ends_m):
            here_m = min(s_m - SPARE_M, end_m) - start_m
            if here_m > 0.0:
                reached_m[name] = max(here_m, reached_m.get(name, 0.0))
        return Ground(reached_m)

    def known_m(self, route: Route, ends_m: Sequence[float]) -> FloatArray:
        """Where on a way it has been: arc lengths [K, 2] of begins and ends."""
        known = [
            (start_m, min(start_m + self.reached_m[name], end_m))
            for name, start_m, end_m in _stretches(route, ends_m)
            if name in self.reached_m
        ]
        return np.array(known).reshape(-1, 2)


def new_m(known_m: FloatArray, before_m: float, after_m: float) -> float:
    """How far a way from one arc length to another leads over new ground; less than 0: back."""
    moved_m = after_m - before_m
    if not len(known_m):
        return moved_m
    low_m, high_m = min(before_m, after_m), max(before_m, after_m)
    both_m = np.minimum(known_m[:, 1], high_m) - np.maximum(known_m[:, 0], low_m)
    return moved_m - float(np.copysign(np.maximum(both_m, 0.0).sum(), moved_m))


def _stretches(route: Route, ends_m: Sequence[float]) -> Iterator[tuple[str, float, float]]:
    for name, (start_m, end_m) in zip(route, pairwise((0.0, *ends_m)), strict=True):
        yield name, start_m, end_m
