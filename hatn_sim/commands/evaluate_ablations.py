"""`hatn-sim evaluate --table sgn|edn|intention|adaptation|summary`: the paper's ablations."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from hatn_sim.commands.evaluate_predictors import free_or_own_folder

ROWS_FILE: Final = "ablations.json"
"""Beside the weights that ship: what their variants reached."""


def main(arguments: argparse.Namespace) -> int:
    """Read what was reached and print it beside the paper's numbers."""
    from hatn_sim.commands.console import make_console
    from hatn_sim.errors import InputError
    from hatn_sim.evaluation.paper import TABLES
    from hatn_sim.evaluation.table import (
        compare,
        entries_json,
        read_rows,
        with_summary,
        write_csv,
    )
    from hatn_sim.report.paper_table import paper_table
    from hatn_sim.resources import weights_dir

    path: Path = arguments.rows or weights_dir() / ROWS_FILE
    if not path.is_file():
        raise InputError(
            f"{path}: there are no rows of ablations; give those of yours with --rows FILE"
        )
    rows = with_summary(read_rows(path))
    parts = [(part, compare(part, rows)) for part in TABLES[arguments.table]]
    entries = [entry for _, of_part in parts for entry in of_part]
    out = free_or_own_folder(arguments.out, arguments.table)
    out.mkdir(parents=True, exist_ok=True)
    csv_path = out / f"{arguments.table}.csv"
    write_csv(csv_path, entries)
    if arguments.json:
        print(entries_json(entries))
        return 0
    for part, of_part in parts:
        make_console().print(paper_table(part, of_part, "runs"))
        print()
    print(f"numbers in {csv_path}")
    return 0
