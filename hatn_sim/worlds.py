"""Moments of several worlds on one road as one moment, and what was made of it as theirs again.

Arrays of all vehicles at once take hardly longer than those of a few. Where the place is the same,
simulations that run side by side are seen at once: their vehicles one after another, and nobody
meets anybody of another world.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import accumulate, pairwise
from typing import Final, TypeVar

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import BoolArray, IntArray, Scene

Joined = TypeVar("Joined")
APART_M: Final = 1e6
"""Between worlds, where pairs of vehicles are looked for."""


@dataclass(frozen=True, eq=False)
class Worlds(Scene):
    """Scenes of W worlds as one; signals, of which every world has as many, are those of all."""

    scenes: tuple[Scene, ...]  # [W]
    world: IntArray  # [N]

    @property
    def rows(self) -> Iterator[slice]:
        """Of the vehicles of each."""
        return parts([len(scene.ids) for scene in self.scenes])


def worlds_joined(scenes: Sequence[Scene]) -> Worlds:
    """The vehicles of scenes, one after another; their ids say which they are of."""
    arrays = {
        one.name: np.concatenate([getattr(scene, one.name) for scene in scenes])
        for one in fields(Scene)
        if one.name not in ("time_s", "ids")
    }
    return Worlds(
        time_s=scenes[0].time_s,
        ids=ids_joined([scene.ids for scene in scenes]),
        **arrays,
        scenes=tuple(scenes),
        world=np.repeat(np.arange(len(scenes)), [len(scene.ids) for scene in scenes]),
    )


def ids_joined(ids: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Names of the vehicles of each world that no two of them share."""
    return tuple(f"{k}:{name}" for k, own in enumerate(ids) for name in own)


def world_of(scene: Scene) -> IntArray:
    """The world [N] of every vehicle; of an ordinary scene there is one."""
    return scene.world if isinstance(scene, Worlds) else np.zeros(len(scene.ids), dtype=np.int64)


def near_pairs(scene: Scene, among: IntArray, reach_m: float) -> IntArray:
    """Pairs [P, 2] of the vehicles `among` [K] within reach of each other, in their order."""
    if len(among) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    place = scene.xy_m[among]
    if isinstance(scene, Worlds):
        place = np.column_stack((place, APART_M * scene.world[among]))
    return among[KDTree(place).query_pairs(reach_m, output_type="ndarray")]


def is_closed(scene: Scene, signal: IntArray) -> BoolArray:
    """Whether signals [N, G] of vehicles [N] are closed; of -1, which is none, it is False.

    A recording may know nothing of the signals of its map: these count as open.
    """
    worlds = len(scene.scenes) if isinstance(scene, Worlds) else 1
    of_each = scene.signal_closed.reshape(worlds, -1)
    known = of_each.shape[1]
    # The last is open: it is found by -1.
    closed = np.zeros((worlds, max(int(signal.max(initial=-1)) + 2, known + 1)), dtype=np.bool_)
    closed[:, :known] = of_each
    return closed[world_of(scene)[:, None], signal]


def parts(counts: Sequence[int]) -> Iterator[slice]:
    """The rows of each, of several one after another."""
    return (slice(begin, end) for begin, end in pairwise((0, *accumulate(counts))))


def joined(kind: type[Joined], each: Sequence[Joined], **whole: object) -> Joined:
    """A dataclass of arrays by vehicle, those of each one after another; `whole` stands as told."""
    names = [one.name for one in fields(kind) if one.name not in whole]  # type: ignore[arg-type]
    arrays = {name: np.concatenate([getattr(one, name) for one in each]) for name in names}
    return kind(**arrays, **whole)


def part(of: Joined, rows: slice, **whole: object) -> Joined:
    """The rows of one of those that `joined` put together."""
    names = [one.name for one in fields(of) if one.name not in whole]  # type: ignore[arg-type]
    return type(of)(**{name: getattr(of, name)[rows] for name in names}, **whole)
