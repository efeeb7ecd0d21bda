"""What `info` holds of a moment, so that it can be compared with that of another run."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from hatn_sim.datatypes import Advice, Scene


@dataclass(frozen=True, eq=False)
class Seen:
    """A moment as a planner may see it: nothing of `Truth` is in it."""

    ego_id: str
    scene: Scene
    advice: Advice | None  # None: nothing is predicted, or the ego is gone

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Seen) and _same(self, other)

    def __repr__(self) -> str:
        said = "nothing predicted" if self.advice is None else repr(self.advice)
        count, time_s = len(self.scene.ids), self.scene.time_s
        return f"Seen({self.ego_id!r} at {time_s:.1f} s, {count} vehicles, {said})"

    __hash__ = None  # type: ignore[assignment]  # equal by content that can be changed


def _same(one: Any, other: Any) -> bool:
    """Equal in all that they hold, arrays to the last bit."""
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return bool(np.array_equal(one, other, equal_nan=one.dtype.kind == "f"))
    if is_dataclass(one):
        names = [part.name for part in fields(one)]
        return all(_same(getattr(one, name), getattr(other, name)) for name in names)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    return bool(one == other)
