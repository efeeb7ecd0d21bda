"""Which moments of a story are drawn: where something is decided, neither too near nor too few."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from hatn_sim.report.story import Choices, Encounter

MIN_PANELS: Final = 4
APART_FRAMES: Final = 6
STAYS_FRAMES: Final = 3
"""The likeliest slot has changed when it stays so for this long."""


class Beat(NamedTuple):
    """A moment that a story may be told by."""

    rank: int  # 0: goes before all others
    frame: int


def beats_of(choices: Choices, encounters: Sequence[Encounter], first: int) -> Iterator[Beat]:
    """The moments of encounters: met, let go, changed, and shortly before the ego crosses."""
    for one in encounters:
        low, high = max(one.first_frame, first), one.last_frame
        yield Beat(0 if len(encounters) > 1 else 1, min(low + 4, high))
        if one.crossed_frame is not None:
            yield Beat(0, int(np.clip(one.crossed_frame - 6, low, high)))
        for frame in one.let_go_frame[-2:]:
            if frame >= low:
                yield Beat(2, int(np.clip(frame - 10, low, high)))
        rows = one.rows[choices.frame[one.rows] >= low]
        likeliest, frames = choices.likeliest[rows], choices.frame[rows]
        turns = [0, *(np.flatnonzero(np.diff(likeliest)) + 1).tolist(), len(rows)]
        for (begin, turn), (_, end) in pairwise(pairwise(turns)):
            if min(turn - begin, end - turn) >= STAYS_FRAMES:
                yield Beat(1, int(frames[turn]) + 2)
                yield Beat(2, int(frames[turn]) - 3)


def key_frames(beats: Sequence[Beat], first: int, last: int, most: int) -> tuple[int, ...]:
    """Frames in rising order: by rank and time, apart from each other.

    At least four and an even number, so that rows of panels are full, where there is room.

    Args:
        beats: to choose from.
        first: no frame is before this one.
        last: nor behind this one.
        most: as many frames at most.
    """
    chosen: list[int] = []
    for beat in sorted(beats):
        inside = first <= beat.frame <= last
        if inside and len(chosen) < most and _apart(beat.frame, chosen):
            chosen.append(beat.frame)
    ends = [first, *sorted(chosen), last]
    while len(chosen) < most and (len(chosen) < MIN_PANELS or len(chosen) % 2):
        low, high = max(pairwise(ends), key=lambda gap: gap[1] - gap[0])
        middle = (low + high) // 2
        if not _apart(middle, chosen):
            break
        chosen.append(middle)
        ends = sorted([*ends, middle])
    return tuple(sorted(chosen))


def _apart(frame: int, chosen: Sequence[int]) -> bool:
    return all(abs(frame - other) >= APART_FRAMES for other in chosen)
