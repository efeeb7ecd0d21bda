"""The end of a recording is only known when it has come."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from hatn_sim.datatypes import Frame


def with_end(frames: Iterator[Frame]) -> Iterator[Frame]:
    """The same frames, of which the last one, and no other, says that it is."""
    held: Frame | None = None
    for frame in frames:
        if held is not None:
            yield replace(held, done=False)
        held = frame
    if held is not None:
        yield replace(held, done=True)
