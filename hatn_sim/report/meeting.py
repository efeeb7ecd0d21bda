"""Where the two of an event met: the log's answer, for whoever looks at it. No drawing here."""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, FloatArray
from hatn_sim.log import Run

BEFORE_S: Final = 4.0
AFTER_S: Final = 8.0
"""Looked at of both ways, around the start of an event."""
ALIKE_FRAMES: Final = 6
"""Of places that differ in time by no more than this, the one where their centres were nearest."""


def meeting_place(run: Run, one: int, other: int, frame: int) -> FloatArray | None:
    """[2] where the one came the soonest after the other, around a frame.

    They are at one place where their centres are nearer than half of both lengths. None: their
    ways did not meet, as where one braked and took another way.

    Args:
        run: the log.
        one: index into its ids.
        other: the same.
        frame: of the event.
    """
    around = np.arange(frame - round(BEFORE_S / DT_S), frame + round(AFTER_S / DT_S) + 1)
    frames = around[(around >= 0) & (around < run.frame_count)]
    (a_xy_m, a_seen), (b_xy_m, b_seen) = (
        run.trajectories.xy_at(who, frames) for who in (one, other)
    )
    away_m = np.linalg.norm(a_xy_m[:, None] - b_xy_m[None], axis=2)
    tracks = run.tracks
    lengths_m = [tracks.size_m[tracks.vehicle == who][0, 0] for who in (one, other)]
    near = away_m < 0.5 * sum(lengths_m)
    k, m = np.nonzero(near & a_seen[:, None] & b_seen[None])
    if not len(k):
        return None
    apart = np.abs(k - m)
    soon = np.flatnonzero(apart <= apart.min() + ALIKE_FRAMES)
    best = soon[np.lexsort((np.maximum(k, m)[soon], away_m[k, m][soon]))[0]]
    place: FloatArray = 0.5 * (a_xy_m[k[best]] + b_xy_m[m[best]])
    return place
