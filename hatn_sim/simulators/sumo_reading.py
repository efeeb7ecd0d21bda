"""What a worker has read of moments -> frames, as they are told."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate

import numpy as np

from hatn_sim.simulators.sumo_messages import COLUMNS, RawFrame
from hatn_sim.simulators.sumo_rows import centred

Row = tuple[float, ...]
"""Of a road user: front x, y, compass angle, and from there on as in `RawFrame`."""
Read = tuple[list[Row], Callable[..., RawFrame]]
"""What was read of a moment: the rows, and the frame when it is given its rows."""


def frames_of(read: Sequence[Read]) -> tuple[RawFrame, ...]:
    """What was read, box centre and yaw in place of SUMO's front bumper and compass angle."""
    every = np.array([row for rows, _ in read for row in rows], np.float64).reshape(-1, COLUMNS)
    every[:, :2], every[:, 2] = centred(every[:, :2], every[:, 2], every[:, 5])
    ends = accumulate(len(rows) for rows, _ in read)
    return tuple(
        frame(rows=every[end - len(rows) : end].tobytes())
        for (rows, frame), end in zip(read, ends, strict=True)
    )
