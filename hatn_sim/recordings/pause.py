"""Moments at which nobody is there may be left out of a recording, up to a bound."""

from __future__ import annotations

from typing import Final

from hatn_sim.datatypes import DT_S
from hatn_sim.errors import InputError

LONGEST_PAUSE_S: Final = 3600.0
"""Every 0.1 s of a pause is played: a slip in a time must not become days of nothing."""


def check_pause(where: object, frames: int) -> None:
    """Raises InputError where so many frames without anybody would have to be played."""
    if frames * DT_S > LONGEST_PAUSE_S:
        raise InputError(
            f"{where}: expected pauses of at most {LONGEST_PAUSE_S:g} s, found nobody for "
            f"{frames * DT_S:.0f} s; correct the times, or cut the recording there"
        )
