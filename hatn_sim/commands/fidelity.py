"""`doctor --fidelity SCENE`: how near the vehicles of a scene are to the lines drawn for them."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from hatn_sim.datatypes import Frame, Simulator
    from hatn_sim.score.fidelity import Closeness

DEFAULT_DURATION_S: Final = 120.0
DEFAULT_WARM_UP_S: Final = 0.0
DEFAULT_SEED: Final = 1
COLUMNS: Final = ("vehicle-frames", "without line", "median, m", "99 %", "99.9 %", "max", "≤ 1 m")


def main(arguments: argparse.Namespace) -> int:
    """Run the scene and measure.

    `arguments`: `fidelity` the scene, `duration` and `warm_up` in seconds and `seed` (None: the
    defaults), `json`.
    """
    from hatn_sim.config import load_scenario
    from hatn_sim.score.fidelity import measure_fidelity
    from hatn_sim.traffic import open_traffic

    def chosen(name: str, default: float) -> float:
        value = getattr(arguments, name, None)
        return default if value is None else value

    duration_s = chosen("duration", DEFAULT_DURATION_S)
    warm_up_s = chosen("warm_up", DEFAULT_WARM_UP_S)
    seed = int(chosen("seed", DEFAULT_SEED))
    simulator = open_traffic(load_scenario(arguments.fidelity))
    try:
        frames = _frames(simulator, seed, warm_up_s + duration_s)
        found = measure_fidelity(frames, simulator.road, warm_up_s)
    finally:
        simulator.close()
    if arguments.json:
        said = {"scene": simulator.name, "seed": seed, "duration_s": duration_s}
        print(json.dumps(said | {"closeness": [asdict(row) for row in found]}, indent=2))
    else:
        _print(f"{simulator.name}, seed {seed}, {duration_s:g} s", found)
    return 0


def _frames(simulator: Simulator, seed: int, duration_s: float) -> Iterator[Frame]:
    frame = simulator.reset(seed)
    yield frame
    for _ in range(round(duration_s / simulator.dt_s)):
        if frame.done:
            return
        frame = simulator.step()
        yield frame


def _print(title: str, found: list[Closeness]) -> None:
    from rich.table import Table
    from rich.text import Text

    from hatn_sim.commands.console import make_console

    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="italic")
    table.add_column("line")
    table.add_column("vehicles")
    for column in COLUMNS:
        table.add_column(column, justify="right")
    for row in found:
        metres = (row.median_m, row.q99_m, row.q999_m, row.max_m)
        table.add_row(
            row.mode,
            row.state,
            str(row.n),
            _cell(row.without_line, "{:.2%}"),
            *(_cell(value, "{:.2f}") for value in metres),
            _cell(row.within_1_m, "{:.2%}"),
        )
    console = make_console()
    console.print(Text.assemble("distance of vehicles to their lines: ", (title, "bold")))
    console.print(table)


def _cell(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
