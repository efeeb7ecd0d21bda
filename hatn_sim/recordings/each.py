"""Recorded tracks taken apart into their recordings, so that each can be a job of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hatn_sim.config import RecordedSource, Scenario
from hatn_sim.recordings.interaction.files import group_files
from hatn_sim.recordings.interaction.table import InteractionTable
from hatn_sim.recordings.track_lines.source import one_by_one, with_track_lines


def each_recording(scenario: Scenario, lines: str) -> list[Scenario]:
    """A scene for each recording of recorded tracks, in order.

    One for each file where files have cases, or for all of them where some cases were chosen.
    `lines`: what reference lines are drawn along, see `track_lines.source.with_track_lines`.

    Raises InputError where a recording is wanted that is not there, or files are at fault.
    """
    source = scenario.recorded
    assert source is not None
    if _is_interaction(source) and not _has_cases(source):
        return one_by_one(scenario, lines)
    alone = [(path,) for path in source.tracks]
    if _is_interaction(source) and source.recordings:
        alone = [source.tracks]
    return [
        with_track_lines(replace(scenario, recorded=replace(source, tracks=paths)), (), lines)
        for paths in alone
    ]


def own_files(source: RecordedSource) -> tuple[Path, ...]:
    """The files of the recordings that are shown, of all tracks that were named."""
    if not _is_interaction(source) or _has_cases(source):
        return source.tracks
    found = group_files(source.tracks, source.recordings)
    return tuple(path for one in found for path in one.paths)


def own_cases(source: RecordedSource) -> tuple[str, ...]:
    """The cases that were chosen of files with cases; empty: all there is in the files."""
    has_cases = _is_interaction(source) and _has_cases(source)
    return source.recordings if has_cases else ()


def _is_interaction(source: RecordedSource) -> bool:
    return all(path.name.lower().endswith(".csv") for path in source.tracks)


def _has_cases(source: RecordedSource) -> bool:
    return InteractionTable(group_files(source.tracks, ())[0].paths[0]).has_cases
