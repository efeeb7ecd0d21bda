"""`hatn-sim evaluate --table runtime`: how long the networks take, beside the paper's figure."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.folders import free_or_own_folder

if TYPE_CHECKING:
    from rich.table import Table

    from hatn_sim.bench_runtime import Runtime

SCENE: Final = "roundabout8"
STEPS: Final = 100
CSV_FILE: Final = "runtime.csv"


def main(arguments: argparse.Namespace) -> int:
    """Time and print."""
    from hatn_sim.bench_runtime import measure_runtime
    from hatn_sim.commands.console import make_console
    from hatn_sim.config import load_scenario
    from hatn_sim.errors import InputError
    from hatn_sim.hatn.predictor import Hatn
    from hatn_sim.predictors.find import weights_of
    from hatn_sim.whole_file import save_csv

    scenes, seeds = arguments.scenes or (SCENE,), arguments.seeds or (1,)
    if len(scenes) > 1 or len(seeds) > 1:
        raise InputError("--table runtime: expected one scene and one seed, found more")
    scenario = load_scenario(scenes[0])
    if scenario.simulator != "sumo":
        raise InputError(
            f"--scenes {scenes[0]}: expected a scene simulated by SUMO, found {scenario.simulator}"
        )
    predictor = Hatn(weights_of("hatn", arguments.weights))
    rows = measure_runtime(scenario, predictor, STEPS, seeds[0])
    out = free_or_own_folder(arguments.out, "runtime")
    numbers = ((row.stage, row.agents, f"{row.median_ms:.4f}") for row in rows)
    save_csv(out / CSV_FILE, [("stage", "agents", "median_ms"), *numbers])
    if arguments.json:
        print(json.dumps([asdict(row) for row in rows], indent=2))
        return 0
    make_console().print(_table(rows))
    print(
        "paper: one NVIDIA RTX 2060, for 1 to 100 agents alike, the adaptation for each; "
        "ours: one CPU core, medians"
    )
    print(f"numbers in {out / CSV_FILE}")
    return 0


def _table(rows: Sequence[Runtime]) -> Table:
    from hatn_sim.bench_runtime import STAGES
    from hatn_sim.evaluation.paper import RUNTIME_MS
    from hatn_sim.report.plain_table import plain_table

    agents = list(dict.fromkeys(row.agents for row in rows))
    taken = {(row.stage, row.agents): f"{row.median_ms:.2f}" for row in rows}
    table = plain_table("Running time in milliseconds")
    table.add_column("")
    table.add_column("paper", justify="right")
    for number in agents:
        table.add_column(f"{number} agent{'s' if number > 1 else ''}", justify="right")
    for stage, title in STAGES.items():
        paper = f"{RUNTIME_MS[stage]:g}" if stage in RUNTIME_MS else "-"
        table.add_row(title, paper, *(taken.get((stage, number), "-") for number in agents))
    return table
