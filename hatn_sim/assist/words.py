"""Suggestions in plain words, one line each."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from hatn_sim.assist.profile import COMFORT_BRAKING_MPS2
from hatn_sim.datatypes import DT_S, BoolArray, FloatArray, IntArray, Kind, Scene
from hatn_sim.geometry import wrap_angle


def names(scene: Scene, ego: IntArray, other: IntArray) -> list[str]:
    """How drivers of vehicles `ego` [R] would name vehicles `other` [R].

    By its colour only where another of its kind in view has another one.
    """
    x, y = (scene.xy_m[other] - scene.xy_m[ego]).T
    bearing = wrap_angle(np.arctan2(y, x) - scene.yaw_rad[ego])
    eighth = np.floor(bearing / (np.pi / 8)).astype(np.int64)
    colours = [_colour(*colour) for colour in scene.colour.tolist()]
    of_kind: dict[int, set[str]] = {}
    for kind, colour in zip(scene.kind.tolist(), colours, strict=True):
        of_kind.setdefault(kind, set()).add(colour)
    told = [
        f"{colour} {_KINDS[kind]}" if len(of_kind[kind]) > 1 else _KINDS[kind]
        for kind, colour in zip(scene.kind.tolist(), colours, strict=True)
    ]
    return [
        f"the {told[vehicle]} {_SIDES[of]}"
        for vehicle, of in zip(other.tolist(), eighth.tolist(), strict=True)
    ]


def words(
    who: str,
    action: str,
    *,
    more: int = 0,
    target_s: float | None = None,
    feasible: bool = True,
    brakes: str = "",
    reason: str = "",
) -> str:
    """What to tell a driver about another vehicle, named as `names` does.

    `more` others are let go with it on a yield, and the ego is there in `target_s` then. `brakes`
    is what `braking` makes of the profile, `reason` why this is told.
    """
    if action == "abstain":
        return f"Watch {who}: {_SILENT.get(reason, 'no advice')}"
    hard = "Brake hard: " if brakes == HARD_NOW else ""
    if action == "pass":
        text = f"Pass before {who}" + ("" if feasible else ", if you can: the gap is tight")
        return f"Brake hard for the one ahead; then pass before {who}" if hard else text
    also = "; to go first is not safe" if reason == "likely_unsafe" else ""
    if more:
        who += f" and {more} more"
    if hard:
        return f"Brake hard: yield to {who}{also}"
    if not feasible or brakes == HARD_LATER:
        return f"Yield to {who}; be ready to brake hard{also}"
    if target_s is None:
        return f"Yield to {who}; wait until the way is clear{also}"
    if target_s <= 0.0:
        return f"Yield to {who}{also}"
    return f"Yield to {who}; go after {'them' if more else 'it'} in {target_s:.1f} s{also}"


HARD_NOW: Final = "now"
HARD_LATER: Final = "later"
SOON_FRAMES: Final = 15
"""Braking within 1.5 s is to be begun now: a driver takes a second to react."""
BAND: Final = 0.15
"""What is said to be within comfort may be beyond it by this share, what is not, within it."""


def braking(speed_mps: FloatArray, profile_mps: FloatArray, feasible: BoolArray) -> list[str]:
    """Whether vehicles with speeds [R] brake harder than comfort on profiles [R, F]: soon, later
    or not ("")."""
    whole = np.column_stack((speed_mps, profile_mps))
    lost_mps2 = -np.diff(whole, axis=1) / DT_S
    limit = COMFORT_BRAKING_MPS2 * np.where(feasible, 1.0 + BAND, 1.0 - BAND)
    now = lost_mps2[:, :SOON_FRAMES].max(axis=1, initial=0.0) > limit
    later = lost_mps2.max(axis=1, initial=0.0) > COMFORT_BRAKING_MPS2 * (1.0 + BAND)
    said = np.where(now, HARD_NOW, np.where(later, HARD_LATER, ""))
    return [str(one) for one in said.tolist()]


_SILENT: Final = {
    "far": "it is far yet",
    "unsure": "hard to tell who goes first",
    "settling": "no advice yet",
    "unsafe_pass": "to go first may not be safe",
    "too_late": "too late to yield in comfort",
    "gone_in_time": "you are likely to be past before it comes",
    "in_the_way": "you are in its way",
    "other_waits": "it is likely to wait for you",
    "stands": "hard to tell which of you starts first",
    "mutual": "it is told to yield",
    "brief": "it is over in a moment",
    "alerted": "mind the warning",
}
"""Reasons for silence. Colons and names come before."""
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
