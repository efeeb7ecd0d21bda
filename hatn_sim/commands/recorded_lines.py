"""What `run` takes for lines of recorded tracks, and to choose among them: what its weights know.

Weights that were trained on lines drawn from tracks are met by such lines again, as `evaluate` has
them; all others by the lanes of the map. What a user says wins.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from hatn_sim.commands.options import with_lines_from

if TYPE_CHECKING:
    from hatn_sim.config import RecordedSource, Scenario
    from hatn_sim.datatypes import Predictor
    from hatn_sim.recordings.track_lines.source import Drawing

LANES: Final = ("lanes", "weights")
AS_EVALUATE: Final = ("auto", "auto")
"""--lines-from and --choice-from."""


def with_lines_for(
    scenario: Scenario,
    predictors: Sequence[Predictor],
    arguments: argparse.Namespace,
    drawing: Drawing,
) -> tuple[Scenario, str]:
    """The scene with its reference lines, and in a few words why it has these.

    Of `arguments`, --lines-from and --choice-from are filled in where they were not given.

    Raises InputError as `with_lines_from` does.
    """
    source = scenario.recorded
    known = source is not None and source.replay is None and trained_on_tracks(predictors)
    asked = (arguments.lines_from, arguments.choice_from)
    taken = AS_EVALUATE if known else LANES
    arguments.lines_from, arguments.choice_from = (
        one or other for one, other in zip(asked, taken, strict=True)
    )
    return with_lines_from(scenario, arguments, drawing), _why(arguments, asked, predictors, source)


def with_lines_said(scenario: Scenario, is_fitted: bool, why: str) -> Scenario:
    """The scene with one notice on lines and choice, and why; `is_fitted`: so is the choice."""
    source = scenario.recorded
    if source is None or source.map_path is None:
        return scenario
    if source.drawn is not None:
        lines = f"reference lines drawn from {source.drawn.words}"
    else:
        road = "map" if source.replay is None else "net"
        lines = source.lines_notice or f"reference lines along the lanes of the {road}"
    choice = "fitted to the same recordings" if is_fitted else "as in the weights"
    notice = f"{lines}; choice among them {choice}; {why}"
    return replace(scenario, recorded=replace(source, lines_notice=notice))


def trained_on_tracks(predictors: Sequence[Predictor]) -> bool:
    """Whether the card of some weights says that they learnt on lines drawn from tracks."""
    return any(
        entry.get("lines") == "tracks"
        for predictor in predictors
        for entry in _card(predictor).get("split", {}).get("train", [])
    )


def _card(predictor: Predictor) -> Mapping[str, Any]:
    return getattr(getattr(predictor, "weights", None), "card", {})


def _why(
    arguments: argparse.Namespace,
    asked: tuple[str | None, str | None],
    predictors: Sequence[Predictor],
    source: RecordedSource | None,
) -> str:
    if all(asked):
        return "as asked for"
    if source is not None and source.replay is not None:
        return "inside SUMO there are no others"
    if not any(_card(one) for one in predictors):
        why = "no weights ask for others"
    else:
        whose = "these weights" if arguments.weights is None else arguments.weights.name
        were = "were" if arguments.weights is None else "was"
        told = "" if trained_on_tracks(predictors) else "not "
        why = f"{whose} {were} {told}trained on lines from tracks"
    return f"{why} (otherwise: --lines-from, --choice-from)"
