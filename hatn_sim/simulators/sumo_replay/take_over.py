"""Whom to take over, and since when, as a command line says it."""

from __future__ import annotations

import math

from hatn_sim.errors import InputError


def parse_take_over(text: str) -> dict[str, float | None]:
    """`12@3.5,13` -> vehicle 12 from 3.5 s on, 13 from its appearance on. Raises InputError."""
    wanted: dict[str, float | None] = {}
    for word in filter(None, (part.strip() for part in text.split(","))):
        vehicle, at, seconds = word.rpartition("@")
        name = vehicle if at else word
        try:
            at_s = float(seconds) if at else None
        except ValueError:
            at_s = math.nan
        if at_s is not None and not math.isfinite(at_s):
            raise InputError(
                f"take-over {word!r}: expected ID or ID@SECONDS, found {seconds!r} for the seconds"
            )
        if name in wanted:
            raise InputError(f"take-over {word!r}: {name!r} is named twice; name it once")
        wanted[name] = at_s
    return wanted
