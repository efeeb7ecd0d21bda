"""List the scenes that ship: what they are, how much traffic they carry and how safe it is.

The figures are those of each scene's card, in its scenario.toml. With --measure they are measured
anew, by running the scene, and stand beside the card's. Densities are measured with the default
drivers, risk profiles at normal density; the first 300 s, while traffic builds up, are left out.
Scenes to learn on come after those, under a heading of their own; their cards are of one seed and
300 s. The suites come last: scenes with scripted encounters, or with none on purpose, are measured
from their begin, 120 s for each of 40 seeds. Delays are known of SUMO's scenes only.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from hatn_sim.commands.options import seconds, seeds, whole_number
from hatn_sim.resources import LEARNING_PREFIX, SUITES

if TYPE_CHECKING:
    from rich.table import Table

    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Simulator
    from hatn_sim.score.encounters import EncounterCount
    from hatn_sim.score.traffic import TrafficCount

EXAMPLES = """examples:
  hatn-sim scenarios
  hatn-sim scenarios roundabout8 --measure
  hatn-sim scenarios --json
"""
WARM_UP_S: Final = 300.0
DENSITY_SEEDS: Final = (1, 2)
RISK_SEEDS: Final = (1, 2, 3, 4)
SUITE_SEEDS: Final = tuple(range(1, 41))
DURATION_S: Final = 900.0
SUITE_DURATION_S: Final = 120.0

DENSITY_TITLES: Final = {
    "vehicles_at_once": "vehicles at once",
    "throughput_per_h": "vehicles per hour",
    "mean_speed_mps": "mean speed, m/s",
    "mean_delay_s": "mean delay, s",
}
RISK_TITLES: Final = {
    "collisions_per_1000": "collisions",
    "emergency_brakings_per_1000": "emergency brakings",
    "hard_brakings_per_1000": "hard brakings",
}
SUITE_TITLES: Final = {
    "vehicle_hours": "vehicle-hours",
    "encounters_per_run": "encounters a run",
    "event_percent": "with an event, %",
    "collisions_per_run": "collisions a run",
    "hard_brakings_per_run": "hard brakings a run",
    "unscripted_per_run": "of both, unscripted",
}
TITLES: Final = {"density": DENSITY_TITLES, "risk": RISK_TITLES, "suite": SUITE_TITLES}
FIRST_COLUMN: Final = {
    "density": "density",
    "risk": "risk profile, per 1000 vehicles",
    "suite": "suite",
}
HEADINGS: Final = ("", "To learn on", *(f"Suite {suite}" for suite in SUITES))
Figures = Mapping[str, float | None]


@dataclass(frozen=True)
class Stretch:
    """A stretch of traffic to measure."""

    scene: str
    density: str | None
    risk: str | None
    seed: int
    duration_s: float


@dataclass(frozen=True)
class Group:
    """A density, a risk profile or the suite of a scene, its card, and what to measure for it."""

    table: str  # a key of TITLES
    name: str
    card: Figures
    stretches: tuple[Stretch, ...]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim scenarios`."""
    parser.add_argument(
        "names", metavar="NAME", nargs="*", help="scenes, or a scenario.toml (default: all shipped)"
    )
    parser.add_argument("--measure", action="store_true", help="run the scenes and measure anew")
    parser.add_argument(
        "--seeds",
        type=seeds,
        metavar="A-B",
        help="to measure (default: 1-2 for densities, 1-4 for risk profiles, 1-40 for suites)",
    )
    parser.add_argument(
        "--duration",
        type=seconds,
        metavar="S",
        help="seconds to measure for each seed (default: 900, of suites 120)",
    )
    parser.add_argument("--workers", type=whole_number, default=2, metavar="N", help="processes")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")


def main(arguments: argparse.Namespace) -> int:
    """Look up, measure if asked, print."""
    from hatn_sim.config import load_scenario
    from hatn_sim.resources import find_scenarios

    loaded = {name: load_scenario(name) for name in arguments.names or find_scenarios()}
    scenes = dict(sorted(loaded.items(), key=lambda item: HEADINGS.index(_heading(*item))))
    measured: dict[Stretch, TrafficCount | EncounterCount] = {}
    if arguments.measure:
        wanted = dict.fromkeys(
            stretch
            for name, scene in scenes.items()
            for group in _groups(name, scene, arguments)
            for stretch in group.stretches
        )
        measured = _measure_all(list(wanted), arguments.workers)
    found = {
        name: [(group, _pooled(group, measured)) for group in _groups(name, scene, arguments)]
        for name, scene in scenes.items()
    }
    if arguments.json:
        import json

        print(json.dumps([_as_json(scenes[name], found[name]) for name in scenes], indent=2))
    else:
        _print(scenes, found)
    return 0


def _heading(name: str, scene: Scenario) -> str:
    """What a scene is listed under."""
    if scene.suite is not None:
        return f"Suite {scene.suite}"
    return "To learn on" if name.startswith(LEARNING_PREFIX) else ""


def _groups(name: str, scene: Scenario, arguments: argparse.Namespace) -> list[Group]:
    """The densities of a scene and its risk profiles; of a suite's scene the suite alone."""

    def group(table: str, key: str, density: str | None, risk: str | None) -> Group:
        seeds = {"density": DENSITY_SEEDS, "risk": RISK_SEEDS, "suite": SUITE_SEEDS}[table]
        duration_s = SUITE_DURATION_S if table == "suite" else DURATION_S
        card = _figures(scene.card, table, key)
        stretches = tuple(
            Stretch(name, density, risk, seed, arguments.duration or duration_s)
            for seed in arguments.seeds or seeds
        )
        return Group(table, key, card, stretches)

    if scene.suite is not None:
        return [group("suite", scene.suite, scene.density, scene.risk)]
    return [group("density", key, key, scene.risk) for key in scene.densities] + [
        group("risk", key, scene.density, key) for key in scene.risks
    ]


def _figures(card: Mapping[str, Any], table: str, key: str) -> Figures:
    """A card is free-form: what is not there, or no number, is None."""
    at: Any = card
    for step in (table, key):
        at = at.get(step, {}) if isinstance(at, Mapping) else {}
    values = at if isinstance(at, Mapping) else {}
    return {
        figure: float(values[figure]) if isinstance(values.get(figure), int | float) else None
        for figure in TITLES[table]
    }


def measure(stretch: Stretch) -> TrafficCount | EncounterCount:
    """Run a stretch of traffic and count; a function of its own so that it can be sent away."""
    from hatn_sim.config import load_scenario

    scenario = load_scenario(stretch.scene, stretch.density, stretch.risk)
    if scenario.suite is None:
        return measure_traffic(scenario, stretch)
    return measure_suite(scenario, stretch)


def measure_suite(scenario: Scenario, stretch: Stretch) -> EncounterCount:
    """What comes of the encounters of a suite's scene, from its begin."""
    from hatn_sim.score.encounters import count_encounters
    from hatn_sim.traffic import open_traffic

    simulator = open_traffic(scenario)
    try:
        before = simulator.reset(stretch.seed)
        steps = range(round(stretch.duration_s / simulator.dt_s))
        return count_encounters(before, (simulator.step() for _ in steps), simulator.dt_s)
    finally:
        simulator.close()


def measure_traffic(scenario: Scenario, stretch: Stretch) -> TrafficCount:
    """How much traffic there is, and what goes wrong in it, after the warm-up."""
    import tempfile
    from pathlib import Path

    from hatn_sim.score.traffic import read_delays_s
    from hatn_sim.simulators.sumo import SumoSimulator
    from hatn_sim.traffic import open_traffic

    if scenario.simulator != "sumo":
        simulator = open_traffic(scenario)
        try:
            return _count(simulator, stretch)[0]
        finally:
            simulator.close()
    with tempfile.TemporaryDirectory() as folder:
        tripinfo = Path(folder) / "tripinfo.xml"
        with SumoSimulator(scenario, ("--tripinfo-output", str(tripinfo))) as simulator:
            count, begin_s = _count(simulator, stretch)
        # SUMO has finished the file now.
        return count.with_delays(read_delays_s(tripinfo, begin_s))


def _count(simulator: Simulator, stretch: Stretch) -> tuple[TrafficCount, float]:
    """The counts after the warm-up, and the time at which they begin."""
    from hatn_sim.score.traffic import count_traffic

    before = simulator.reset(stretch.seed)
    for _ in range(round(WARM_UP_S / simulator.dt_s)):
        before = simulator.step()
    steps = range(round(stretch.duration_s / simulator.dt_s))
    count = count_traffic(before, (simulator.step() for _ in steps), simulator.dt_s)
    return count, before.scene.time_s


def _measure_all(
    stretches: Sequence[Stretch], workers: int
) -> dict[Stretch, TrafficCount | EncounterCount]:
    import signal
    from multiprocessing import get_context

    measured: dict[Stretch, TrafficCount | EncounterCount] = {}
    # Ctrl-C is for this process, which then ends the others.
    ignore = (signal.SIGINT, signal.SIG_IGN)
    with get_context("spawn").Pool(workers, signal.signal, ignore) as pool:
        for stretch, count in zip(stretches, pool.imap(measure, stretches), strict=True):
            measured[stretch] = count
            print(
                f"hatn-sim: measured {len(measured)} of {len(stretches)}: {stretch.scene}, "
                f"{stretch.density}, {stretch.risk}, seed {stretch.seed}",
                file=sys.stderr,
            )
    return measured


def _pooled(
    group: Group, measured: Mapping[Stretch, TrafficCount | EncounterCount]
) -> Figures | None:
    """The figures over all seeds; None where nothing was measured."""
    from hatn_sim.score.encounters import EncounterCount, encounter_figures
    from hatn_sim.score.traffic import TrafficCount, density_figures, risk_figures

    counts = [measured[stretch] for stretch in group.stretches if stretch in measured]
    if not counts:
        return None
    if group.table == "suite":
        of_suite = (count for count in counts if isinstance(count, EncounterCount))
        return encounter_figures(sum(of_suite, EncounterCount()))
    figures = density_figures if group.table == "density" else risk_figures
    of_traffic = (count for count in counts if isinstance(count, TrafficCount))
    return figures(sum(of_traffic, TrafficCount()))


def _as_json(scene: Scenario, found: Iterable[tuple[Group, Figures | None]]) -> dict[str, Any]:
    content: dict[str, Any] = {
        "name": scene.name,
        "title": scene.title,
        "description": scene.description,
        **{table: {} for table in TITLES},
    }
    for group, measured in found:
        content[group.table][group.name] = {"card": group.card, "measured": measured}
    return content


def _print(
    scenes: Mapping[str, Scenario], found: Mapping[str, list[tuple[Group, Figures | None]]]
) -> None:
    from rich.text import Text

    from hatn_sim.commands.console import make_console

    console = make_console()
    heading = ""
    for name, scene in scenes.items():
        if _heading(name, scene) != heading:
            heading = _heading(name, scene)
            console.print(Text(heading, style="bold underline"), end="\n\n")
        console.print(Text.assemble((scene.name, "bold"), "  ", scene.title))
        console.print(Text(scene.description, style="dim"))
        for table, titles in TITLES.items():
            rows = [row for row in found[name] if row[0].table == table]
            if rows:
                console.print(_table(FIRST_COLUMN[table], titles, rows))
        console.print()


def _table(
    first: str, titles: Mapping[str, str], rows: Iterable[tuple[Group, Figures | None]]
) -> Table:
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="italic")
    table.add_column(first)
    for title in titles.values():
        table.add_column(title, justify="right")
    for group, measured in rows:
        table.add_row(group.name, *(_cell(group.card[figure]) for figure in titles))
        if measured is not None:
            table.add_row("  measured now", *(_cell(measured[figure]) for figure in titles))
    return table


def _cell(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 100.0 else f"{value:.1f}"
