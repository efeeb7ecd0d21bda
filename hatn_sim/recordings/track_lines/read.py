"""A recording in INTERACTION format -> whole tracks of its road users."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hatn_sim.datatypes import Kind
from hatn_sim.recordings.interaction.files import Recorded
from hatn_sim.recordings.interaction.table import InteractionTable, Rows
from hatn_sim.recordings.track_lines.paths import DrivenTrack


def read_tracks(recorded: Recorded) -> Iterator[DrivenTrack]:
    """The tracks of a recording without cases, each whole. Raises InputError for faulty files."""
    for path in recorded.paths:
        table = InteractionTable(path)
        held: Rows | None = None
        for rows in table.rows():
            joined = rows if held is None else np.concatenate((held, rows))
            *whole, held = np.split(joined, np.flatnonzero(np.diff(joined["track"])) + 1)
            for part in whole:
                yield _track(recorded, table, part)
        if held is not None:
            yield _track(recorded, table, held)


def _track(recorded: Recorded, table: InteractionTable, rows: Rows) -> DrivenTrack:
    return DrivenTrack(
        recording=recorded.name,
        name=table.track_ids[int(rows["track"][0])],
        kind=Kind(int(rows["kind"][0])),
        xy_m=np.stack([rows["x_m"], rows["y_m"]], axis=1),
        yaw_rad=rows["yaw_rad"].copy(),
    )
