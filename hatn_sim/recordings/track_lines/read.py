"""Recordings in INTERACTION format -> whole tracks."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.datatypes import Kind
from hatn_sim.recordings.interaction.files import Recorded
from hatn_sim.recordings.interaction.table import InteractionTable, Rows
from hatn_sim.recordings.track_lines.paths import DrivenTrack

_KEPT_FILES: Final = 256


def read_tracks(recorded: Recorded) -> tuple[DrivenTrack, ...]:
    """All tracks of a recording. Raises InputError where its files are at fault."""
    return tuple(
        track for path in recorded.paths for track in _read_file(path, recorded.name)
    )
