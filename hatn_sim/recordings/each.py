"""Recorded tracks taken apart into their recordings, so that each can be a job of its own.

A recording under test never has a part in its own reference lines. Where many are looked at one by
one, they are dealt into groups, and the lines of a group are drawn from the recordings of all
others: so lines are drawn at most `GROUPS` times.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Final

from hatn_sim.config import RecordedSource, Scenario
from hatn_sim.recordings.interaction.files import group_files
from hatn_sim.recordings.interaction.table import InteractionTable
from hatn_sim.recordings.track_lines.source import Drawing, other_recordings, with_track_lines

GROUPS: Final = 5


def each_recording(
    scenario: Scenario, lines: str, drawing: Drawing | None = None
) -> dict[str, Scenario]:
    """A scene for each recording of recorded tracks, by name, in order.

    One for each file where files have cases, or for all of them where some cases were chosen.
    `lines`, `drawing`: of reference lines, see `track_lines.source.with_track_lines`. The
    tracks of each scene are its own and those that its lines come from.

    Raises InputError where a recording is wanted that is not there, or files are at fault.
    """
    source = scenario.recorded
    assert source is not None
    if _is_interaction(source) and not _has_cases(source):
        return _with_lines_of_others(scenario, source, lines, drawing)
    if _is_interaction(source):
        alone = {one.name: one.paths for one in group_files(source.tracks, ())}
        if source.recordings:
            alone = {next(iter(alone)): source.tracks}
    else:
        uses = Counter(path.name for path in source.tracks)
        alone = {
            path.name if uses[path.name] == 1 else str(path): (path,) for path in source.tracks
        }
    return {
        name: with_track_lines(replace(scenario, recorded=replace(source, tracks=paths)), (), lines)
        for name, paths in alone.items()
    }


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


def _with_lines_of_others(
    scenario: Scenario, source: RecordedSource, lines: str, drawing: Drawing | None
) -> dict[str, Scenario]:
    """Recordings in INTERACTION format, each with lines from those of the other groups."""
    every = {one.name: one.paths for one in group_files(source.tracks, ())}
    tested = [one.name for one in group_files(source.tracks, source.recordings)]
    scenes: dict[str, Scenario] = {}
    for k, name in enumerate(tested):
        group = tested[k % GROUPS :: GROUPS]
        others = [] if lines == "lanes" else [one for one in every if one not in group]
        files = {path for one in (name, *others) for path in every[one]}
        named = tuple(path for path in source.tracks if path in files)
        alone = replace(scenario, recorded=replace(source, tracks=named, recordings=(name,)))
        scenes[name] = with_track_lines(alone, other_recordings(alone), lines, drawing)
    return scenes


def _is_interaction(source: RecordedSource) -> bool:
    return all(path.name.lower().endswith(".csv") for path in source.tracks)


def _has_cases(source: RecordedSource) -> bool:
    return InteractionTable(group_files(source.tracks, ())[0].paths[0]).has_cases
