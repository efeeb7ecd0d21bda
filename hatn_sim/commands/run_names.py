"""The vehicles named to `hatn-sim run`: whether they can come, and whether they came."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection, Iterable, Iterator
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Simulator

NOBODY_CAME: Final = 2
"""Exit status of a run in which none of the vehicles of --egos, or of --drive, was there."""
WATCHED: Final = "--ego"
"""Whom the window follows is without effect on the run."""


def driven(arguments: argparse.Namespace) -> dict[str, float | None]:
    """The vehicles of --drive, and from when on. Raises InputError."""
    from hatn_sim.simulators.sumo_replay.take_over import parse_take_over

    return parse_take_over(arguments.drive or "")


def check_egos(arguments: argparse.Namespace) -> None:
    """Raises InputError where --egos is there and names nobody."""
    from hatn_sim.errors import InputError

    if arguments.egos is not None and not arguments.egos:
        raise InputError("--egos: expected names, found none; name some as A,B, or leave it out")


def check_routes(arguments: argparse.Namespace, scenario: Scenario) -> None:
    """Raises InputError for a name that the scene's route files rule out.

    Which vehicle of a flow comes, and whom highway-env or a loaded state brings, is seen in the run
    alone; so are persons, whom a window may follow.
    """
    from hatn_sim.datatypes import PEDESTRIAN_PREFIX
    from hatn_sim.errors import InputError, nearest_vehicle
    from hatn_sim.simulators.sumo_demand import coming

    known = coming(scenario)
    for option, name in _named(arguments):
        if option == WATCHED and name.startswith(PEDESTRIAN_PREFIX):
            continue  # persons can be watched, and vehicles alone are known
        if known is not None and not known[0](name):
            raise InputError(
                f"{option}: no vehicle called {name!r} is in the route files of "
                f"{scenario.name}{nearest_vehicle(name, known[1])}"
            )


def check_recording(arguments: argparse.Namespace, simulator: Simulator) -> None:
    """Raises InputError for a name that is not in the recording, if one is replayed."""
    from hatn_sim.errors import InputError, nearest_vehicle
    from hatn_sim.simulators.recorded import RecordedSimulator
    from hatn_sim.simulators.sumo_replay.simulator import SumoReplay

    if not isinstance(simulator, RecordedSimulator | SumoReplay):
        return
    missing = dict.fromkeys(name for _, name in _named(arguments))
    recorded = set[str]()
    for frame in simulator.recording.frames() if missing else ():
        recorded.update(frame.scene.ids)
        for name in frame.scene.ids:
            missing.pop(name, None)
        if not missing:
            return
    for option, name in _named(arguments):
        if name in missing:
            raise InputError(
                f"{option}: no vehicle called {name!r} is in {simulator.name}"
                f"{nearest_vehicle(name, recorded)}"
            )


def exit_status(arguments: argparse.Namespace, seen: Collection[str]) -> int:
    """Of a run in which vehicles were `seen`: who never came is told.

    Who asked for vehicles, and had none of them, has another run than he asked for.
    """
    status = 0
    for option, wanted in _by_option(arguments):
        never = [name for name in wanted if name not in seen]
        if never:
            print(f"hatn-sim: never seen in this run: {option} {','.join(never)}", file=sys.stderr)
        if wanted and len(never) == len(wanted) and option != WATCHED:
            status = NOBODY_CAME
    return status


def _by_option(arguments: argparse.Namespace) -> Iterable[tuple[str, tuple[str, ...]]]:
    followed = () if arguments.ego is None else (arguments.ego,)
    return (
        ("--egos", tuple(arguments.egos or ())),
        ("--drive", tuple(driven(arguments))),
        (WATCHED, followed),
    )


def _named(arguments: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """(option, name)"""
    for option, wanted in _by_option(arguments):
        for name in wanted:
            yield option, name
