"""`hatn-sim evaluate --table sota`: the paper's comparison with other methods, ours beside it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.evaluate_predictors import said_clusters, scored_runs
from hatn_sim.commands.folders import free_or_own_folder

if TYPE_CHECKING:
    from hatn_sim.datatypes import Score
    from hatn_sim.evaluation.table import AblationRow

SCENES: Final = ("intersection5", "roundabout8")
"""The shipped scenes that are like the paper's two."""
CSV_FILE: Final = "sota.csv"


def main(arguments: argparse.Namespace) -> int:
    """Make the runs, score them, print."""
    from hatn_sim.commands.console import make_console
    from hatn_sim.evaluation.paper import SOTA
    from hatn_sim.evaluation.table import compare, entries_json, write_csv
    from hatn_sim.predictors.find import PREDICTORS, READS_WEIGHTS
    from hatn_sim.report.paper_table import paper_table
    from hatn_sim.report.table import notes, write_scores

    if arguments.tracks is None:
        arguments.scenes = arguments.scenes or SCENES
    arguments.predictors = arguments.predictors or (*sorted(READS_WEIGHTS), *PREDICTORS)
    out = free_or_own_folder(arguments.out, "sota")
    logged, scores, _ = scored_runs(arguments, out)
    write_scores(out, scores)
    entries = compare(SOTA, _rows(scores))
    write_csv(out / CSV_FILE, entries)
    if arguments.json:
        print(entries_json(entries))
        return 0
    console = make_console()
    console.print(paper_table(SOTA, entries, said_clusters(logged)))
    for line in notes(scores):
        console.print(line, markup=False, style="dim")
    if arguments.adapt == "none":
        print("the paper's HATN adapts online, ours does not here: --adapt mekf")
    print(f"numbers in {out / CSV_FILE}")
    return 0


def _rows(scores: Sequence[Score]) -> list[AblationRow]:
    """A row for each predictor, by the paper's name where it has one."""
    from hatn_sim.evaluation.paper import SOTA, SOTA_PREDICTORS
    from hatn_sim.evaluation.table import AblationRow

    called = {predictor: name for name, predictor in SOTA_PREDICTORS.items()}
    return [
        AblationRow(
            SOTA.key,
            called.get(predictor, predictor),
            tuple(score for score in scores if score.predictor == predictor),
        )
        for predictor in dict.fromkeys(score.predictor for score in scores)
    ]
