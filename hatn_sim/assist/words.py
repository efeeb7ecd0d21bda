"""Suggestions in plain words, one line each."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from hatn_sim.assist.profile import COMFORT_BRAKING_MPS2
from hatn_sim.datatypes import DT_S, BoolArray, FloatArray, IntArray, Kind, Scene
from hatn_sim.geometry import wrap_angle

CALM: Final = ""
HARD_NOW: Final = "brake hard now"
HARD_LATER: Final = "brake hard later"
STOP_NOW: Final = "stop now"
STOP_LATER: Final = "stop later"
HARD_MPS2: Final = 1.15 * COMFORT_BRAKING_MPS2
"""3.45 m/s2, the one limit of hard braking in words: what asks for no more may be told as feasible
(`choice.FEASIBLE_BAND`)."""
SOON_FRAMES: Final = 15
"""Braking within 1.5 s is to be begun now: a driver takes a second to react."""
AHEAD: Final = "ahead"
ONCOMING_RAD: Final = np.deg2rad(135.0)
LOW_MPS: Final = 2.0
"""Whoever is never faster than this stops; hard braking is over within half a second there."""


def braking(speed_mps: FloatArray, profile_mps: FloatArray) -> list[str]:
    """How vehicles with speeds [R] brake on profiles [R, F]: hard within 1.5 s, later or not.

    Hard is a tick that loses speed faster than `HARD_MPS2`. To whoever is no faster than `LOW_MPS`
    until then, it is a stop.
    """
    whole = np.column_stack((speed_mps, profile_mps))
    hard = -np.diff(whole, axis=1) / DT_S > HARD_MPS2
    soon = slice(None, SOON_FRAMES)
    now, later = hard[:, soon].any(axis=1), hard.any(axis=1)
    slow_now = whole[:, : SOON_FRAMES + 1].max(axis=1) <= LOW_MPS
    slow = whole.max(axis=1) <= LOW_MPS
    said_now = np.where(slow_now, STOP_NOW, HARD_NOW)
    said_later = np.where(later, np.where(slow, STOP_LATER, HARD_LATER), CALM)
    return [str(one) for one in np.where(now, said_now, said_later).tolist()]


def names(
    scene: Scene, ego: IntArray, other: IntArray, ahead: BoolArray | None = None
) -> list[str]:
    """How drivers of vehicles `ego` [R] would name vehicles `other` [R].

    By its colour only where another of its kind in view has another one. Those in the ego's own
    lane are `ahead` [R] of it, whatever way that bends; whoever else is ahead and comes its way
    is oncoming.
    """
    x, y = (scene.xy_m[other] - scene.xy_m[ego]).T
    bearing = wrap_angle(np.arctan2(y, x) - scene.yaw_rad[ego])
    eighth = np.floor(bearing / (np.pi / 8)).astype(np.int64)
    against = np.abs(wrap_angle(scene.yaw_rad[other] - scene.yaw_rad[ego])) > ONCOMING_RAD
    if ahead is not None:
        eighth[ahead], against[ahead] = 0, False
    colours = [colour_word(*colour) for colour in scene.colour.tolist()]
    of_kind: dict[int, set[str]] = {}
    for kind, colour in zip(scene.kind.tolist(), colours, strict=True):
        of_kind.setdefault(kind, set()).add(colour)
    told = [
        f"{colour} {_KINDS[kind]}" if len(of_kind[kind]) > 1 else _KINDS[kind]
        for kind, colour in zip(scene.kind.tolist(), colours, strict=True)
    ]
    return [
        f"the oncoming {told[vehicle]}"
        if comes and _SIDES[of] == AHEAD
        else f"the {told[vehicle]} {_SIDES[of]}"
        for vehicle, of, comes in zip(
            other.tolist(), eighth.tolist(), against.tolist(), strict=True
        )
    ]


def words(
    who: str,
    action: str,
    *,
    more: int = 0,
    target_s: float | None = None,
    feasible: bool = True,
    brakes: str = CALM,
    first: str = "",
    reason: str = "",
) -> str:
    """What to tell a driver about another vehicle, named as `names` does.

    `more` others are let go with it on a yield, and the ego is there in `target_s` then. `brakes`
    is what `braking` makes of the profile, `first` what hard braking is for where that is not who
    is let go (`because`), `reason` why this is told.
    """
    if action == "abstain":
        return f"Watch {who}: {_SILENT.get(reason, 'no advice')}"
    then = f"pass before {who}"
    if action == "yield":
        then = f"yield to {who}" + (f" and {more} more" if more else "")
    also = "; to go first is not safe" if action == "yield" and reason == "likely_unsafe" else ""
    if brakes in _NOW:
        apart = "; then " if first or action == "pass" else ": "
        return f"{_NOW[brakes]}{first}{apart}{then}{also}"
    then = then[0].upper() + then[1:]
    if action == "pass" and not feasible:
        then += ", if you can: the gap is tight"
    if brakes in _LATER:
        return f"{then}; {_LATER[brakes]}{also}"
    if action == "pass":
        return then
    if not feasible:
        return f"{then}; brake at once{also}"
    if target_s is None:
        return f"{then}; wait until the way is clear{also}"
    if target_s <= 0.0:
        return f"{then}{also}"
    return f"{then}; go after {'them' if more else 'it'} in {target_s:.1f} s{also}"


def because(who: str, stands: bool) -> str:
    """What hard braking is for, where that is not who is let go: a vehicle, or a line."""
    return f": {who} stands" if stands else f" for {who}"


def another(who: str) -> str:
    """What somebody is called after somebody else of the same name: another car from the left."""
    return "another" + who.removeprefix("the")


def told_apart(
    called: Sequence[str], ids: Sequence[str], last_called: Sequence[str], last_ids: Sequence[str]
) -> list[str]:
    """Names [R] of vehicles, where the last that was spoken of may have had the same: another."""
    apart: list[str] = []
    for who, name, last_who, last_name in zip(called, ids, last_called, last_ids, strict=True):
        is_same_name = last_who in (who, another(who))
        goes_on = last_who if name == last_name else another(who)
        apart.append(goes_on if is_same_name else who)
    return apart


LINE: Final = "the line ahead"
AT_ONCE: Final = (HARD_NOW, STOP_NOW)
_NOW: Final = {HARD_NOW: "Brake hard", STOP_NOW: "Stop"}
_LATER: Final = {HARD_LATER: "be ready to brake hard", STOP_LATER: "be ready to stop"}
_SILENT: Final = {
    "far": "it is still far",
    "unsure": "hard to tell who goes first",
    "which_gap": "hard to tell before whom you will go",
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
_SIDES: Final = dict(
    zip(
        range(-8, 9),
        (
            *("behind", "from behind on the right", *["from the right"] * 5, AHEAD),
            *(AHEAD, *["from the left"] * 5, "from behind on the left", "behind", "behind"),
        ),
        strict=True,
    )
)
"""Bearings of 22.5 degrees each, from straight behind over the right and the left to there."""
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
def colour_word(red: int, green: int, blue: int) -> str:
    """The nearest of the named colours, of parts from 0 to 255."""

    def distance(name: str) -> int:
        r, g, b = _COLOURS[name]
        return (r - red) ** 2 + (g - green) ** 2 + (b - blue) ** 2

    return min(_COLOURS, key=distance)
