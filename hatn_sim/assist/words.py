"""Suggestions in plain words, one line each."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from hatn_sim.datatypes import IntArray, Kind, Scene
from hatn_sim.geometry import wrap_angle

UNKNOWN_S: Final = 10.0
"""Later than this nobody can say when the other will be gone."""


def names(scene: Scene, ego: IntArray, other: IntArray) -> list[str]:
    """How drivers of vehicles `ego` [R] would name vehicles `other` [R]."""
    x, y = (scene.xy_m[other] - scene.xy_m[ego]).T
    bearing = wrap_angle(np.arctan2(y, x) - scene.yaw_rad[ego])
    eighth = np.floor(bearing / (np.pi / 8)).astype(np.int64)
    return [
        f"the {_colour(*colour)} {_KINDS[kind]} {_SIDES[of]}"
        for colour, kind, of in zip(
            scene.colour[other].tolist(), scene.kind[other].tolist(), eighth.tolist(), strict=True
        )
    ]


def words(
    who: str, action: str, *, more: int = 0, open_s: float = 0.0, feasible: bool = True
) -> str:
    """What to tell a driver about another vehicle, named as `names` does.

    `more` others are let go with it on a yield, and the way is open in `open_s`.
    """
    if action == "abstain":
        return f"Watch {who}: no advice yet"
    if action == "pass":
        return f"Pass before {who}" + ("" if feasible else ", if you can: the gap is tight")
    if more:
        who += f" and {more} more"
    if not feasible:
        return f"Brake hard: yield to {who}"
    if open_s > UNKNOWN_S:
        return f"Yield to {who}; wait until the way is clear"
    return f"Yield to {who}; go after {'them' if more else 'it'} in {open_s:.1f} s"


_SIDES: Final = {
    eighth: "behind"
    if eighth in (-8, 7, 8)
    else "ahead"
    if eighth in (-1, 0)
    else "from the left"
    if eighth > 0
    else "from the right"
    for eighth in range(-8, 9)
}
"""Bearings of 22.5 degrees each, from behind on the right to behind on the left."""
_KINDS: Final = {int(kind): kind.name.lower() for kind in Kind}
_COLOURS: Final = {
    "white": (240, 240, 240),
    "silver": (180, 185, 190),
    "grey": (110, 110, 110),
    "black": (30, 30, 30),
    "red": (200, 30, 30),
    "blue": (40, 80, 190),
    "light blue": (110, 195, 245),
    "purple": (130, 60, 160),
    "green": (40, 140, 60),
    "yellow": (245, 215, 20),
    "orange": (240, 140, 20),
    "brown": (120, 75, 40),
    "beige": (220, 205, 170),
}


@lru_cache(maxsize=4096)
def _colour(red: int, green: int, blue: int) -> str:
    """The nearest of the named colours."""

    def distance(name: str) -> int:
        r, g, b = _COLOURS[name]
        return (r - red) ** 2 + (g - green) ** 2 + (b - blue) ** 2

    return min(_COLOURS, key=distance)
