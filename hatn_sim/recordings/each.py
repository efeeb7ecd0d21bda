"""Recorded tracks taken apart into their recordings, so that each can be a job of its own."""

from __future__ import annotations

from dataclasses import replace

from hatn_sim.config import RecordedSource


def each_recording(source: RecordedSource) -> list[RecordedSource]:
    """A source for each recording, in order; one for all where cases of files were chosen.

    Raises InputError where a recording is wanted that is not there, or files are at fault.
    """
    if not source.tracks[0].name.lower().endswith(".csv"):
        return [replace(source, tracks=(path,)) for path in source.tracks]
    from hatn_sim.recordings.interaction.files import group_files
    from hatn_sim.recordings.interaction.table import InteractionTable

    found = group_files(source.tracks, ())
    if not InteractionTable(found[0].paths[0]).has_cases:
        chosen = group_files(source.tracks, source.recordings)
        return [replace(source, tracks=one.paths, recordings=()) for one in chosen]
    if source.recordings:
        return [source]
    return [replace(source, tracks=one.paths) for one in found]
