"""What of a run's folder is missing or damaged and can be done without, and what goes with it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Final

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

    def __str__(self) -> str:
        if self.is_gone:
            return f"{self.file} {self.found}: {self.part.value}"
        return f"{self.file} {self.found}: what followed is left out"


def find_gaps(
    path: Path, parts: int, predictors: Sequence[str], *, by_route: bool, finished: bool
) -> tuple[Gap, ...]:
    """What a run lacks that can be done without; tracks and frames cannot.

    Args:
        path: the run's folder.
        parts: how many there are of `frames/`.
        predictors: the main one first.
        by_route: lines came from the routes in `truth/`; else these are not missed.
        finished: by what its head says.

    Raises:
        InputError: a line of a file, other than its last one, is no JSON.
    """
    found = [
        *_gaps_of_lines(path, finished),
        *_gaps_of_truth(path, parts),
        *(gap for name in predictors for gap in _gaps_of(path, name, parts, name == predictors[0])),
        *_gaps_of_wholes(path),
    ]
    return tuple(gap for gap in found if by_route or gap.part is not Part.ROUTES)


def _gaps_of_lines(path: Path, finished: bool) -> Iterator[Gap]:
    for name, part in LINES_OF.items():
        if not (path / name).parent.is_dir():
            continue  # told of the folder
        if not (path / name).is_file():
            if part is not Part.COUNTERFACTUALS:  # nobody has to ask for them
                yield Gap(name, "is missing", part)
            continue
        lines, is_cut = read_lines(path / name, forgive_last=True)
        if not is_cut:
            continue
        if part is Part.ROUTES:  # told by number: all or none
            yield Gap(name, "is cut off", part)
        elif finished:  # no kill did that, so who knows how much is lost
            yield Gap(name, f"is cut off after {len(lines)} lines", part, is_gone=False)
        else:
            yield Gap(name, "ends in half a line", part, is_gone=False)


def _gaps_of_truth(path: Path, parts: int) -> Iterator[Gap]:
    if not (path / schema.TRUTH_FOLDER).is_dir():
        yield Gap(f"{schema.TRUTH_FOLDER}/", "is missing", Part.EVENTS)
        yield Gap(f"{schema.TRUTH_FOLDER}/", "is missing", Part.ROUTES)
        return
    yield from _gaps_of_parts(path, schema.TRUTH_FOLDER, parts, Part.ROUTES)


def _gaps_of(path: Path, predictor: str, parts: int, is_main: bool) -> Iterator[Gap]:
    folder = schema.predictor_folder(predictor)
    if parts and not any((path / folder).glob("part-*.parquet")):
        yield Gap(f"{folder}/", "is missing", Part.PREDICTIONS)
        return
    for gap in _gaps_of_parts(path, folder, parts, Part.PREDICTIONS):
        # Others than the main one may have been asked for a few frames only.
        if is_main or (path / gap.file).exists():
            yield gap


def _gaps_of_parts(path: Path, folder: str, parts: int, part: Part) -> Iterator[Gap]:
    for number in range(parts):
        name = f"{folder}/{schema.part_name(number)}"
        try:
            check_part(path / name)
        except InputError:
            found = "is damaged" if (path / name).is_file() else "is missing"
            yield Gap(name, found, part)


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
