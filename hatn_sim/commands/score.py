"""Print the scores of one or more runs, read from their logs.

Several runs of a scene are pooled; from five runs on, or five recordings or cases in them, the
intervals are over these instead of over vehicles. Alerts and suggestions are scored as well, by
what really happened in the runs, with intervals over runs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hatn_sim.log import Run

EXAMPLES = """examples:
  hatn-sim score runs/intersection5-1
  hatn-sim score runs/intersection5-* --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim score`."""
    parser.add_argument("runs", metavar="RUN", nargs="+", type=Path, help="folders of runs")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")


def main(arguments: argparse.Namespace) -> int:
    """Score and print."""

    from hatn_sim.commands.console import make_console
    from hatn_sim.commands.reading import read_and_tell
    from hatn_sim.log import Part
    from hatn_sim.report.assistance_table import assistance_table
    from hatn_sim.report.table import score_table, scores_json
    from hatn_sim.score.logged import assistance_scores
    from hatn_sim.score.prediction import score_runs
    from hatn_sim.score.samples import clustered_over

    runs = [read_and_tell(path, {Part.PREDICTIONS}) for path in arguments.runs]
    scores, assistance = score_runs(runs), assistance_scores(_with_all_advice(runs))
    if arguments.json:
        print(scores_json([*scores, *assistance]))
        return 0
    make_console().print(score_table(scores, clustered_over(runs)))
    if assistance:
        make_console().print(assistance_table(assistance))
    return 0


def _with_all_advice(runs: Sequence[Run]) -> list[Run]:
    """Runs that lack nothing of what was advised and what befell; the others are told."""
    from hatn_sim.log import Part

    judged = {Part.ADVICE, Part.ALERTS, Part.EVENTS}
    kept: list[Run] = []
    for run in runs:
        # Of an unfinished run nobody expects the end.
        lacks = [gap for gap in run.gaps if gap.part in judged and (gap.is_gone or run.finished)]
        for gap in lacks:
            what = f"{gap.file} {gap.found}: alerts and suggestions are not scored"
            print(f"hatn-sim: {run.path}: {what}", file=sys.stderr)
        if not lacks:
            kept.append(run)
    return kept
