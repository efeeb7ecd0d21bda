"""The frames of `hatn-sim run`: advised, logged, shown, judged by branches."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.scenarios import WARM_UP_S as CARD_WARM_UP_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hatn_sim.assist.settings import AssistSettings
    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Advice, Frame, Predictor, Simulator
    from hatn_sim.log import RunWriter
    from hatn_sim.loop import Driver
    from hatn_sim.report.window import Window
    from hatn_sim.score.what_if import WhatIf
    from hatn_sim.simulators.sumo_replay.figures import Divergence, Fidelity


FEW: Final = 0.5
"""Of the vehicles that a density stands for."""


@dataclass(frozen=True)
class Simulated:
    """A run that has been simulated and logged."""

    frames: int
    began: float  # time.monotonic() after the warm-up
    seconds: float  # from then on, of the wall clock
    replay: tuple[Fidelity, Divergence] | None  # of tracks replayed inside SUMO


def simulate(
    arguments: argparse.Namespace,
    scenario: Scenario,
    simulator: Simulator,
    frame: Frame,
    predictors: Sequence[Predictor],
    drivers: Mapping[str, Driver],
    writer: RunWriter,
) -> Simulated:
    """Warm up, then log frame by frame, with a bar and a window where these are wanted."""
    from hatn_sim.commands.progress import Progress
    from hatn_sim.errors import WindowClosedError
    from hatn_sim.loop import Adviser, run, warm_up
    from hatn_sim.simulators.sumo_replay.simulator import SumoReplay

    egos = None if arguments.egos is None else frozenset(arguments.egos)
    settings: AssistSettings = arguments.assist
    advisers = [Adviser(predictor, arguments.lines, egos, settings) for predictor in predictors]
    frame = warm_up(simulator, frame, round(arguments.warm_up / simulator.dt_s))
    thin = said_of_density(scenario, len(frame.scene.ids), arguments.warm_up)
    if thin is not None and arguments.density is not None and not arguments.quiet:
        print(f"hatn-sim: {thin}", file=sys.stderr)
    duration_s: float | None = arguments.duration
    total = None if duration_s is None else max(1, round(duration_s / simulator.dt_s))
    began = time.monotonic()
    what_if, main = _what_if(arguments, simulator), predictors[0].name
    window, frames = _window(arguments, simulator), 0
    with Progress(simulator.name, total, simulator.dt_s, arguments.quiet) as progress:

        def write(index: int, frame: Frame, advice: Mapping[str, Advice]) -> None:
            writer.write(index, frame, advice)
            if what_if is not None:
                writer.write_counterfactuals(what_if.see(index, frame, advice[main]))
            progress.show(index + 1, len(frame.scene.ids))
            nonlocal frames
            frames = index + 1
            if window is not None:
                window.show(frame.scene, advice[main])

        try:
            run(simulator, advisers, frame, total or sys.maxsize, write, drivers)
        except WindowClosedError as error:
            print(f"hatn-sim: {error}: the run ends here", file=sys.stderr)
            total = None
        if what_if is not None:
            writer.write_counterfactuals(what_if.finish())
    seconds = time.monotonic() - began
    if total is not None and frames < total and not arguments.quiet:
        print(f"hatn-sim: the scene was over after {frames} of {total} steps", file=sys.stderr)
    replay = None
    if isinstance(simulator, SumoReplay):
        replay = simulator.fidelity, simulator.divergence
    return Simulated(frames, began, seconds, replay)


def said_of_density(scenario: Scenario, vehicles: int, warm_up_s: float) -> str | None:
    """Where a run begins with far fewer vehicles than its density stands for.

    What that is, the scene's card tells: a mean over minutes, after `CARD_WARM_UP_S`.
    """
    card = scenario.card.get("density", {}).get(scenario.density, {})
    usual = card.get("vehicles_at_once", 0.0)
    if vehicles >= FEW * usual or warm_up_s >= CARD_WARM_UP_S:
        return None
    return (
        f"{scenario.name} fills up slowly: after {warm_up_s:g} s of warm-up {vehicles} vehicles "
        f"are there, of about {usual:.0f} later on in {scenario.density} traffic; for more of them "
        f"--warm-up {CARD_WARM_UP_S:g} or longer"
    )


def _window(arguments: argparse.Namespace, simulator: Simulator) -> Window | None:
    """SUMO's window, if the run is to be watched in it."""
    if not arguments.gui:
        return None
    from hatn_sim.report.window import Window
    from hatn_sim.simulators.sumo import SumoSimulator

    assert isinstance(simulator, SumoSimulator)
    return Window(simulator, frozenset(arguments.egos or ()), arguments.ego)


def _what_if(arguments: argparse.Namespace, simulator: Simulator) -> WhatIf | None:
    """What judges a sample of the advice; None where none is wanted, or nothing can be branched."""
    from hatn_sim.score.counterfactual import CounterfactualSettings
    from hatn_sim.score.what_if import WhatIf

    if arguments.counterfactuals is None:
        return None
    if simulator.cannot_branch is not None:
        print(f"hatn-sim: run without counterfactuals: {simulator.cannot_branch}", file=sys.stderr)
        return None
    settings = CounterfactualSettings()
    return WhatIf(simulator, arguments.counterfactuals, arguments.seed or 0, settings)
