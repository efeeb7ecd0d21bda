"""Suggestions in plain words, one line each."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

from hatn_sim.datatypes import Kind, Scene

UNKNOWN_S: Final = 10.0
"""Later than this nobody can say when the other will be gone."""


def words(
    scene: Scene,
    ego: int,
    other: int,
    action: str,
    *,
    more: int = 0,
    open_s: float = 0.0,
    feasible: bool = True,
) -> str:
    """What to tell the driver of vehicle `ego` about vehicle `other`.

    `more` others are let go with it on a yield, and the way is open in `open_s`.
    """
    colour, kind = _colour(*scene.colour[other].tolist()), Kind(int(scene.kind[other]))
    who = f"the {colour} {kind.name.lower()} {_side(scene, ego, other)}"
    if action == "abstain":
        return f"Watch {who}: too close to call"
    if action == "pass":
        return f"Pass before {who}" + ("" if feasible else ", if you can: the gap is tight")
    if more:
        who += f" and {more} more"
    if not feasible:
        return f"Brake hard: yield to {who}"
    them = "them" if more else "it"
    if open_s > UNKNOWN_S:
        return f"Yield to {who}; wait until the way is clear"
    return f"Yield to {who}; go after {them} in {open_s:.1f} s"


def _side(scene: Scene, ego: int, other: int) -> str:
    x, y = (scene.xy_m[other] - scene.xy_m[ego]).tolist()
    bearing = math.remainder(math.atan2(y, x) - float(scene.yaw_rad[ego]), math.tau)
    if abs(bearing) < math.pi / 8:
        return "ahead"
    if abs(bearing) > 7 * math.pi / 8:
        return "behind"
    return "from the left" if bearing > 0 else "from the right"


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
