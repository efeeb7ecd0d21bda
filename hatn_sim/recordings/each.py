"""Recorded tracks taken apart into their recordings, so that each can be a job of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hatn_sim.config import RecordedSource, Scenario


def each_recording(scenario: Scenario) -> list[Scenario]:
    """A scene for each recording of recorded tracks, in order.

    One for each file where files have cases, or for all of them where some cases were chosen.

    Raises InputError where a recording is wanted that is not there, or files are at fault.
    """
    source = scenario.recorded
    assert source is not None
    if not _is_interaction(source) or _has_cases(source):
        alone = [(path,) for path in source.tracks]
        if _is_interaction(source) and source.recordings:
            alone = [source.tracks]
        return [replace(scenario, recorded=replace(source, tracks=paths)) for paths in alone]
    from hatn_sim.recordings.interaction.files import group_files

    return [
        replace(scenario, recorded=replace(source, recordings=(one.name,)))
        for one in group_files(source.tracks, source.recordings)
    ]


def own_files(source: RecordedSource) -> tuple[Path, ...]:
    """The files of the recordings that are shown, of all tracks that were named."""
    if not _is_interaction(source) or _has_cases(source):
        return source.tracks
    from hatn_sim.recordings.interaction.files import group_files

    found = group_files(source.tracks, source.recordings)
    return tuple(path for one in found for path in one.paths)


def own_cases(source: RecordedSource) -> tuple[str, ...]:
    """The cases that were chosen of files with cases; empty: all there is in the files."""
    has_cases = _is_interaction(source) and _has_cases(source)
    return source.recordings if has_cases else ()


def _is_interaction(source: RecordedSource) -> bool:
    return all(path.name.lower().endswith(".csv") for path in source.tracks)


def _has_cases(source: RecordedSource) -> bool:
    from hatn_sim.recordings.interaction.files import group_files
    from hatn_sim.recordings.interaction.table import InteractionTable

    return InteractionTable(group_files(source.tracks, ())[0].paths[0]).has_cases
