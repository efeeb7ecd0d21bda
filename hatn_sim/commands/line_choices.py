"""What `--choice-from` asks for: choices of lines fitted to other recordings."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Predictor
    from hatn_sim.learn.others_choice import OthersChoice
    from hatn_sim.line_choice import LineChoice
    from hatn_sim.recordings.track_lines.source import Drawing

LINES_STAGE: Final = "reference lines from tracks"
ENOUGH: Final = 3
"""Other recordings from which on "auto" fits a choice to them."""


@contextmanager
def drawing_lines(cache: str | None, quiet: bool) -> Generator[Drawing, None, None]:
    """How lines are drawn for a command with this --cache: kept, and with progress."""
    from hatn_sim.commands.train_progress import TrainProgress
    from hatn_sim.kept import LINES, folder_for
    from hatn_sim.recordings.track_lines.source import Drawing

    with TrainProgress(quiet) as watch:
        yield Drawing(folder_for(LINES, cache), partial(watch.step, LINES_STAGE))


def choices_for(
    scenes: Mapping[str, Scenario],
    predictors: Sequence[Predictor],
    choice_from: str,
    cache: str | None,
    workers: int,
    quiet: bool,
) -> Mapping[str, OthersChoice]:
    """The choice of lines for recordings by name; those that are not there keep to the weights.

    What was fitted is kept, and found by the next command like this: `cache` is its --cache.

    Raises:
        InputError: with "tracks", where there are too few others; a recording is at fault.
    """
    counts = {name: _others(scene) for name, scene in scenes.items()}
    if choice_from == "weights" or (choice_from == "auto" and not _any_enough(counts.values())):
        return {}
    from hatn_sim.commands.train_progress import TrainProgress
    from hatn_sim.kept import LINES, folder_for
    from hatn_sim.learn.others_choice import LEAST, choices_of_others

    if choice_from == "tracks":
        _refuse_few(counts, LEAST)
    least = LEAST if choice_from == "tracks" else ENOUGH
    keep = folder_for(LINES, cache)
    with TrainProgress(quiet) as watch:
        return choices_of_others(scenes, _starts(predictors), least, keep, workers, watch)


def choice_header(found: OthersChoice | None) -> Mapping[str, Any]:
    """What `run.json` says of who chose among the lines."""
    return {"source": "weights"} if found is None else found.about()


def _others(scene: Scenario) -> int:
    """How many recordings drew the lines of a scene."""
    drawn = None if scene.recorded is None else scene.recorded.drawn
    return 0 if drawn is None else len(drawn.recordings)


def _any_enough(counts: Iterable[int]) -> bool:
    return max(counts, default=0) >= ENOUGH


def _refuse_few(counts: Mapping[str, int], least: int) -> None:
    from hatn_sim.errors import InputError

    for name, count in counts.items():
        if count < least:
            raise InputError(
                f"--choice-from tracks: expected lines drawn from {least} other recordings or more "
                f"to fit a choice of lines to, found {count} for {name}; name more with --tracks "
                "and choose with --recordings, or leave the option out"
            )


def _starts(predictors: Sequence[Predictor]) -> list[LineChoice]:
    """What the predictors choose lines by otherwise; choices that came with weights first."""
    from hatn_sim.line_choice import shipped_line_choice

    own = [getattr(getattr(one, "weights", None), "line_choice", None) for one in predictors]
    with_weights = [one for one in own if one is not None]
    shipped = [shipped_line_choice()] if len(with_weights) < len(own) else []
    return list(dict.fromkeys([*with_weights, *shipped]))
