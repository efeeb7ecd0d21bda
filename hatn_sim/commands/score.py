"""Print the scores of one or more runs, read from their logs.

Several runs of a scene are pooled; from five runs on, or five recordings or cases in them, the
intervals are over these instead of over vehicles. Alerts and suggestions are scored as well, by
what really happened in the runs, with intervals over runs. With --json, the scores of a scene whose
runs lack something have a key `left_out` with the lines that say what.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from hatn_sim.log import Gap, Run

EXAMPLES = """examples:
  hatn-sim score runs/intersection5-1
  hatn-sim score runs/intersection5-* --json
"""
NOT_SCORED: Final = "alerts and suggestions are not scored"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim score`."""
    parser.add_argument("runs", metavar="RUN", nargs="+", type=Path, help="folders of runs")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")


def main(arguments: argparse.Namespace) -> int:
    """Score and print."""

    from hatn_sim.commands.console import make_console
    from hatn_sim.log import read_run
    from hatn_sim.report.assistance_table import assistance_table
    from hatn_sim.report.table import score_table, scores_json
    from hatn_sim.score.logged import assistance_scores
    from hatn_sim.score.pooling import by_scene
    from hatn_sim.score.prediction import score_runs
    from hatn_sim.score.samples import clustered_over

    runs = [read_run(path, whole=False) for path in arguments.runs]
    left_out = {
        scene: [line for run in of_scene for line in _left_out(run)]
        for scene, of_scene in by_scene(runs).items()
    }
    for line in chain.from_iterable(left_out.values()):
        print(f"hatn-sim: {line}", file=sys.stderr)
    scores = score_runs(runs)
    assistance = assistance_scores([run for run in runs if not _lost_advice(run)])
    if arguments.json:
        print(_saying(left_out, scores_json([*scores, *assistance])))
        return 0
    make_console().print(score_table(scores, clustered_over(runs)))
    if assistance:
        make_console().print(assistance_table(assistance))
    return 0


def _left_out(run: Run) -> list[str]:
    """A line for each thing that a run lacks of what is scored."""
    from hatn_sim.commands.reading import said_of
    from hatn_sim.log import Part

    lost = [f"{gap.file} {gap.found}: {NOT_SCORED}" for gap in _lost_advice(run)]
    cut = [str(gap) for gap in _gaps_of_advice(run) if gap.by_kill]
    said = said_of(run, {Part.PREDICTIONS, Part.ROUTES})
    return said + [f"{run.path}: {line}" for line in (*lost, *cut)]


def _lost_advice(run: Run) -> list[Gap]:
    """What is lost of what was advised and what befell; of a killed run nobody expects the end."""
    return [gap for gap in _gaps_of_advice(run) if not gap.by_kill]


def _gaps_of_advice(run: Run) -> list[Gap]:
    from hatn_sim.log import Part
    from hatn_sim.log.schema import predictor_folder

    # Advice is of the first predictor, and counted by the crossings that it saw.
    main_folder = f"{predictor_folder(run.predictors[0])}/"
    judged = Part.ADVICE, Part.ALERTS, Part.EVENTS
    return [
        gap
        for gap in run.gaps
        if gap.part in judged
        or (gap.file.startswith(main_folder) and bool(run.suggestions or run.alerts))
    ]


def _saying(left_out: Mapping[str, Sequence[str]], scores: str) -> str:
    """JSON of scores, in which those of a scene say what was left out of its runs, if anything."""
    if not any(left_out.values()):
        return scores
    rows = [
        row | ({"left_out": lines} if (lines := left_out.get(row["scene"])) else {})
        for row in json.loads(scores)
    ]
    return json.dumps(rows, indent=2, allow_nan=False)
