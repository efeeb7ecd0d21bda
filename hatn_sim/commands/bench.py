"""Time every stage of a tick side by side, and the memory it takes.

Every stage runs on the same frames of the same run, so that the ratios to SUMO's bare step hold
from machine to machine better than the milliseconds do. The demand of the scene is raised until it
holds as many vehicles as are asked for.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.options import whole_number, whole_numbers

if TYPE_CHECKING:
    from rich.table import Table

    from hatn_sim.bench import Bench
    from hatn_sim.config import Scenario

EXAMPLES = """examples:
  hatn-sim bench
  hatn-sim bench --scene intersection5 --vehicles 20 --steps 1000 --json
  hatn-sim bench --scaling
  hatn-sim bench --envs --scene intersection5
"""
STEPS: Final = 300
ENV_STEPS: Final = 1500
"""Of each kind, side by side of all together: episodes differ, and a few are no measure of how many
vehicles there are."""

FAR: Final = 0.05
"""Vehicles that differ by more are not as many."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim bench`."""
    parser.add_argument(
        "--scene", default="roundabout8", metavar="SCENE", help="(default: roundabout8)"
    )
    parser.add_argument(
        "--vehicles",
        type=whole_numbers,
        default=(10, 30, 100),
        metavar="N,N",
        help="vehicles at once (default: 10,30,100)",
    )
    parser.add_argument(
        "--steps",
        type=whole_number,
        metavar="N",
        help=f"to time (default: {STEPS}, with --envs {ENV_STEPS:,} of each)",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the traffic (default: 1)")
    parser.add_argument(
        "--weights", type=Path, metavar="FILE", help="weights of hatn (default: those that ship)"
    )
    parser.add_argument(
        "--scaling",
        action="store_true",
        help="instead: what seeing costs from 10 to 1,000 vehicles and in nets of all sizes",
    )
    parser.add_argument(
        "--envs",
        action="store_true",
        help="instead: frames a second of environments, beside highway-env's, and their resets",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def main(arguments: argparse.Namespace) -> int:
    """Time and print."""
    from hatn_sim.bench import bench
    from hatn_sim.config import load_scenario
    from hatn_sim.errors import InputError
    from hatn_sim.hatn.predictor import Hatn
    from hatn_sim.resources import weights_dir

    scenario = load_scenario(arguments.scene)
    if scenario.simulator != "sumo":
        raise InputError(
            f"--scene {arguments.scene}: times are told beside SUMO's bare step; expected a scene "
            f"simulated by SUMO, found {scenario.simulator}; choose another scene"
        )
    if arguments.scaling:
        return _scaling(arguments, scenario)
    if arguments.envs:
        return _environments(arguments, scenario)
    predictor = Hatn(arguments.weights or weights_dir() / "hatn.safetensors")
    # In rising order: the peak of this process's memory is the one so far.
    benches = [
        bench(scenario, predictor, vehicles, arguments.steps or STEPS, arguments.seed)
        for vehicles in sorted(arguments.vehicles)
    ]
    if arguments.json:
        import json
        from dataclasses import asdict

        print(json.dumps([asdict(one) for one in benches], indent=2))
        return 0
    from hatn_sim.commands.console import make_console

    print("milliseconds a tick (medians), and as a multiple of the bare libsumo step")
    make_console().print(_table(benches))
    for one in benches:
        print(
            f"{one.vehicles:.0f} vehicles: {one.scene} at {one.scale:g} times its demand, "
            f"{one.steps} steps; peak memory {_megabytes(one.peak_mb)}, "
            f"SUMO worker {_megabytes(one.worker_peak_mb)}"
        )
    return 0


def _scaling(arguments: argparse.Namespace, scenario: Scenario) -> int:
    from hatn_sim.bench_scaling import measure_scaling

    rows = measure_scaling(scenario, arguments.steps or STEPS, arguments.seed)
    if arguments.json:
        import json
        from dataclasses import asdict

        print(json.dumps([asdict(row) for row in rows], indent=2))
        return 0
    from rich.table import Table

    from hatn_sim.commands.console import make_console

    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="italic")
    for title in ("vehicles", "km of lanes", "tracks, lines, leaders", "graphs", "per vehicle"):
        table.add_column(title, justify="right")
    for row in rows:
        each_us = 1e3 * (row.perceive_ms + row.graphs_ms) / row.vehicles
        table.add_row(
            f"{row.vehicles:.0f}",
            f"{row.lane_km:.0f}",
            f"{row.perceive_ms:.2f} ms",
            f"{row.graphs_ms:.2f} ms",
            f"{each_us:.0f} us",
        )
    print(f"milliseconds a step (medians): copies of {scenario.name}, each with the same traffic")
    make_console().print(table)
    return 0


def _environments(arguments: argparse.Namespace, scenario: Scenario) -> int:
    from dataclasses import asdict, replace

    from hatn_sim.envs.speed import BESIDE, CHUNK_FRAMES, measure_resets, measure_speeds
    from hatn_sim.predictors.find import load_predictor

    predictor = load_predictor("hatn", arguments.weights)
    rounds = max((arguments.steps or ENV_STEPS) // CHUNK_FRAMES, 1)
    speeds = measure_speeds(scenario, predictor, rounds, arguments.seed)
    beside, alone, *_, several = speeds
    resets = measure_resets(replace(scenario, scale=alone.scale), predictor, arguments.seed)
    if arguments.json:
        import json

        told = {"speeds": list(map(asdict, speeds)), "resets": list(map(asdict, resets))}
        print(json.dumps(told, indent=2))
        return 0
    from rich.table import Table

    from hatn_sim.commands.console import make_console

    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="italic")
    table.add_column("environment")
    for title in ("vehicles", "frames/s", f"of {BESIDE}'s", "simulated s/s", f"of {BESIDE}'s"):
        table.add_column(title, justify="right")
    for one in speeds:
        per_s = one.frames_per_s
        table.add_row(
            *(one.what, f"{one.vehicles:.1f}", f"{per_s:.0f}", f"x{one.ratio:.2f}"),
            *(f"{per_s * one.frame_s:.1f}", f"x{one.ratio_of_time:.2f}"),
        )
    print("frames of the simulator a second, by turns in one run")
    if any(abs(one.vehicles / beside.vehicles - 1.0) > FAR for one in speeds):
        print("NOT of as many vehicles: no demand tried meets them; read rates beside the counts")
    print(f"a frame: {beside.frame_s:.3f} s in {BESIDE}, {alone.frame_s:.3f} s in all others")
    print(
        f"{scenario.name}: at {alone.scale:.2f} times its demand, {several.scale:.2f} side by side"
    )
    make_console().print(table)
    for one in resets:
        print(
            f"reset, {one.what}: {one.reset_ms:.0f} ms, {one.reset_ms - one.bare_ms:.0f} ms more "
            f"than SUMO's own steps of the warm-up ({one.bare_ms:.0f} ms)"
        )
    return 0


def _table(benches: Sequence[Bench]) -> Table:
    from rich.table import Table

    from hatn_sim.bench import STAGES

    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="italic")
    table.add_column("stage")
    for one in benches:
        table.add_column(f"{one.vehicles:.0f} vehicles", justify="right")
    by_stage = [{timing.stage: timing for timing in one.timings} for one in benches]
    for stage, title in STAGES.items():
        cells = [
            f"{at[stage].median_ms:.2f} x{at[stage].ratio:.1f}" if stage in at else "-"
            for at in by_stage
        ]
        table.add_row(title, *cells)
        if stage == "log":
            # Its median hides the tables, which it writes once in many steps.
            table.add_row("  mean", *(f"{at[stage].mean_ms:.2f}      " for at in by_stage))
    if all(one.branch is not None for one in benches):
        branches = [one.branch for one in benches if one.branch is not None]
        for title, cells in (
            (
                f"branch of {branches[0].steps} steps, beside bare libsumo for these",
                [f"{one.whole_ms:.2f} x{one.ratio:.1f}" for one in branches],
            ),
            ("  bare libsumo", [f"{one.bare_ms:.2f}      " for one in branches]),
            ("  above 1.3 times that", [f"{one.excess_ms:.2f}      " for one in branches]),
            ("  of it the run is held up", [f"{one.start_ms:.2f}      " for one in branches]),
        ):
            table.add_row(title, *cells)
    return table


def _megabytes(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.0f} MB"
