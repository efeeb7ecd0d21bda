"""What of a run's folder is missing or damaged and can be done without, and what goes with it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any, Final

from hatn_sim.errors import InputError
from hatn_sim.log import schema
from hatn_sim.log.choice_file import CHOICE_FILE, read_run_choice
from hatn_sim.log.lines_file import read_lines, read_text
from hatn_sim.log.parts import check_part
from hatn_sim.log.road_file import ROAD_FILE, is_whole_road


class Part(Enum):
    """Of what a run tells; the value says that it is left out."""

    ADVICE = "advice is left out"
    ALERTS = "alerts are left out"
    EVENTS = "collisions, emergency braking and teleports are left out"
    ROUTES = "the routes that lines followed, and with them slots, are left out"
    TRUE_ROUTES = "the routes that were driven are left out"
    PREDICTIONS = "predictions are left out"
    ROAD = "the road and slots are left out"
    CHOICE = "slots are left out"
    COUNTERFACTUALS = "what branches said is left out"
    SCORES = "scores are left out"


NO_LINES: Final = frozenset({Part.ROUTES, Part.ROAD, Part.CHOICE})
"""Without any of these the lines of vehicles cannot be worked out again."""
LINES_OF: Final = {
    schema.SUGGESTIONS_FILE: Part.ADVICE,
    schema.ALERTS_FILE: Part.ALERTS,
    schema.COUNTERFACTUALS_FILE: Part.COUNTERFACTUALS,
    schema.EVENTS_FILE: Part.EVENTS,
    schema.ROUTES_FILE: Part.ROUTES,
}


@dataclass(frozen=True)
class Gap:
    """Something that a run's folder lacks."""

    file: str  # in the folder; a folder ends in /
    found: str  # what is amiss with it
    part: Part
    is_gone: bool = True  # nothing of it can be read; else all but its end
    by_kill: bool = False  # its end was being written when the run was killed
    lost_frames: tuple[int, int] | None = None  # how many of how many; None: of all

    def __str__(self) -> str:
        if self.lost_frames is not None:
            lost, frames = self.lost_frames
            what = f"{self.part.name.lower()} of {lost} of {frames} frames are left out"
            return f"{self.file} {self.found}: {what}"
        if self.is_gone:
            return f"{self.file} {self.found}: {self.part.value}"
        return f"{self.file} {self.found}: the rest is left out"


def find_gaps(
    path: Path,
    header: Mapping[str, Any],
    frames: int,
    parts: int,
    predictors: Sequence[str],
    *,
    by_route: bool,
) -> tuple[Gap, ...]:
    """What a run lacks that can be done without; tracks and frames cannot.

    Args:
        path: the run's folder.
        header: what `run.json` says.
        frames: how many are there.
        parts: how many there are of `frames/`.
        predictors: the main one first.
        by_route: lines came from the routes in `truth/`; else nothing hangs on these.

    Raises:
        InputError: a line of a file, other than its last one, is no JSON.
    """
    found = [
        *_gaps_of_lines(path, header),
        *_gaps_of_truth(path, parts),
        *(
            gap
            for name in predictors
            for gap in _gaps_of(path, name, frames, parts, name == predictors[0])
        ),
        *_gaps_of_wholes(path),
    ]
    is_other = not by_route
    return tuple(
        replace(gap, part=Part.TRUE_ROUTES) if is_other and gap.part is Part.ROUTES else gap
        for gap in found
    )


def noted_lines(header: Mapping[str, Any], name: str) -> int | None:
    """Lines that a file had when its run was closed; None: of a killed or an older run."""
    count: int | None = header.get(schema.LINE_COUNTS, {}).get(name)
    return count


def _gaps_of_lines(path: Path, header: Mapping[str, Any]) -> Iterator[Gap]:
    for name, part in LINES_OF.items():
        if not (path / name).parent.is_dir():
            continue  # told of the folder
        noted = noted_lines(header, name)
        if not (path / name).is_file():
            # Nobody has to ask for counterfactuals.
            if part is not Part.COUNTERFACTUALS or noted is not None:
                yield Gap(name, "is missing", part)
            continue
        lines, is_cut = read_lines(path / name, forgive_last=True)
        lost = 0 if noted is None else noted - len(lines)
        if not is_cut and lost <= 0:
            continue
        if part is Part.ROUTES:  # told by number: all or none
            yield Gap(name, "is cut off", part)
        elif lost > 0:
            found = f"has {len(lines)} of {noted} lines"
            yield Gap(name, found, part, is_gone=False)
        elif header["finished"]:  # no kill did that, so who knows how much is lost
            yield Gap(name, f"is cut off after {len(lines)} lines", part, is_gone=False)
        else:
            yield Gap(name, "ends in half a line", part, is_gone=False, by_kill=True)


def _gaps_of_truth(path: Path, parts: int) -> Iterator[Gap]:
    if not (path / schema.TRUTH_FOLDER).is_dir():
        yield Gap(f"{schema.TRUTH_FOLDER}/", "is missing", Part.EVENTS)
        yield Gap(f"{schema.TRUTH_FOLDER}/", "is missing", Part.ROUTES)
        return
    yield from _gaps_of_parts(path, schema.TRUTH_FOLDER, parts, Part.ROUTES)


def _gaps_of(path: Path, predictor: str, frames: int, parts: int, is_main: bool) -> Iterator[Gap]:
    folder = schema.predictor_folder(predictor)
    if parts and not any((path / folder).glob("part-*.parquet")):
        yield Gap(f"{folder}/", "is missing", Part.PREDICTIONS)
        return
    for gap in _gaps_of_parts(path, folder, parts, Part.PREDICTIONS, frames):
        # Others than the main one may have been asked for a few frames only.
        if is_main or (path / gap.file).exists():
            yield gap


def _gaps_of_parts(
    path: Path, folder: str, parts: int, part: Part, frames: int | None = None
) -> Iterator[Gap]:
    """Of a run of so many `frames`, if a part can be done without; None: all hangs on each."""
    for number in range(parts):
        name = f"{folder}/{schema.part_name(number)}"
        try:
            check_part(path / name)
        except InputError:
            found = "is damaged" if (path / name).is_file() else "is missing"
            lost = None
            if frames is not None and parts > 1:
                lost = min(frames - number * schema.PART_FRAMES, schema.PART_FRAMES), frames
            yield Gap(name, found, part, lost_frames=lost)


def _gaps_of_wholes(path: Path) -> Iterator[Gap]:
    if not (path / ROAD_FILE).is_file():
        yield Gap(ROAD_FILE, "is missing", Part.ROAD)
    elif not is_whole_road(path / ROAD_FILE):
        yield Gap(ROAD_FILE, "is damaged", Part.ROAD)
    try:
        read_run_choice(path)
    except InputError:
        yield Gap(CHOICE_FILE, "is damaged", Part.CHOICE)
    if not (path / schema.SCORES_FILE).is_file():
        yield Gap(schema.SCORES_FILE, "is missing", Part.SCORES)
        return
    try:
        json.loads(read_text(path / schema.SCORES_FILE))
    except (InputError, ValueError):
        yield Gap(schema.SCORES_FILE, "is damaged", Part.SCORES)
