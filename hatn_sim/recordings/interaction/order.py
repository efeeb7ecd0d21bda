"""Rows of tracks in any order -> track by track, in each by frame, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np

from hatn_sim.recordings.interaction.checks import Columns
from hatn_sim.recordings.interaction.spool import Spool

BUCKET_TRACKS: Final = 64
"""Tracks sorted at a time."""


def by_track(blocks: Iterable[Columns]) -> Iterator[Columns]:
    """The rows of blocks sorted by track and frame; there must be one block, all with frames."""
    blocks = iter(blocks)
    first = next(blocks)
    names = list(first.values)
    dtype = np.dtype(
        [("line", np.int64), ("track", np.int64), ("kind", np.int64)]
        + [(name, np.float64) for name in names]
    )
    with Spool(dtype) as spool:
        block: Columns | None = first
        while block is not None:
            rows = np.zeros(len(block), dtype=dtype)
            rows["line"], rows["track"], rows["kind"] = block.line, block.track, block.kind
            for name in names:
                rows[name] = block.values[name]
            spool.add(block.track // BUCKET_TRACKS, rows)
            block = next(blocks, None)
        for bucket in spool.buckets:
            rows = spool.read(bucket)
            rows = rows[np.lexsort((rows["frame_id"], rows["track"]))]
            values = {name: rows[name].copy() for name in names}
            yield Columns(rows["line"].copy(), rows["track"].copy(), rows["kind"].copy(), values)
