"""Arguments that several verbs share, and the types that check them."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from hatn_sim.config import Scenario
    from hatn_sim.recordings.track_lines.source import Drawing
    from hatn_sim.score.what_if import Rates

WARM_UP_S: Final = 60.0
"""For traffic to build up in a shipped scene, unless told otherwise."""
LINES_FROM: Final = ("lanes", "tracks", "auto")
CHOICE_FROM: Final = ("weights", "tracks", "auto")
ADAPTATIONS: Final = ("none", "mekf", "rls", "sgd")
"""What --adapt may be."""
SIMULATORS_OWN: Final = "sumo_driver"
"""The agent that leaves a vehicle to the simulator's driver."""


def seconds(text: str) -> float:
    """A duration in seconds, more than 0."""
    value = _number(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"expected seconds above 0, found {text!r}")
    return value


def rates(text: str) -> Rates:
    """`RATE` of all advice, or `ALERTS,SUGGESTIONS`."""
    from hatn_sim.score.what_if import Rates

    parts = [share(part) for part in text.split(",")]
    if len(parts) > 2:
        raise argparse.ArgumentTypeError(f"expected RATE or ALERTS,SUGGESTIONS, found {text!r}")
    return Rates(parts[0], parts[-1])


def share(text: str) -> float:
    """A share, more than 0 and up to 1."""
    value = _number(text)
    if not 0.0 < value <= 1.0:
        raise argparse.ArgumentTypeError(f"expected a share above 0 and up to 1, found {text!r}")
    return value


def part(text: str) -> float:
    """A part of a whole, 0 up to 1."""
    value = _number(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"expected a share, 0 up to 1, found {text!r}")
    return value


def seconds_or_none(text: str) -> float:
    """A duration in seconds, 0 or more."""
    value = _number(text)
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"expected seconds, 0 or more, found {text!r}")
    return value


def milliseconds(text: str) -> float:
    """A duration in milliseconds, 0 or more."""
    value = _number(text)
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"expected milliseconds, 0 or more, found {text!r}")
    return value


def names(text: str) -> tuple[str, ...]:
    """Names parted by commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def seeds(text: str) -> tuple[int, ...]:
    """Seeds as `7`, `1-12` or `1-4,9`."""
    from hatn_sim.config import seed_numbers
    from hatn_sim.errors import InputError

    try:
        return seed_numbers(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def whole_number(text: str) -> int:
    """A whole number above 0."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number above 0, found {text!r}")
    return value


def whole_numbers(text: str) -> tuple[int, ...]:
    """Whole numbers above 0, parted by commas."""
    return tuple(whole_number(part.strip()) for part in text.split(","))


def add_scene(parser: argparse.ArgumentParser) -> None:
    """SCENE, or recorded tracks in its place."""
    parser.add_argument(
        "scene", metavar="SCENE", nargs="?", help="a scene's name, a .sumocfg or a run's folder"
    )
    add_tracks(parser, "instead of SCENE")


def add_tracks(parser: argparse.ArgumentParser, place: str) -> None:
    """`--tracks`, `--map` and `--recordings`."""
    parser.add_argument(
        "--tracks",
        nargs="+",
        metavar="FILE",
        help=f"recorded tracks {place}: INTERACTION .csv or SUMO's FCD; patterns may be quoted",
    )
    parser.add_argument(
        "--map", type=Path, metavar="FILE", help="that they were driven on: .osm or .net.xml"
    )
    parser.add_argument(
        "--recordings", metavar="000-004", help="only these of the tracks (default: all)"
    )


def add_lines_from(parser: argparse.ArgumentParser, default: str | None, said: str = "") -> None:
    """`--lines-from`; `said` of its default."""
    parser.add_argument(
        "--lines-from",
        choices=LINES_FROM,
        default=default,
        help="reference lines of INTERACTION tracks along the lanes of the map, or along those "
        "drawn from the tracks of the other recordings of --tracks; auto: from tracks where there "
        f"are enough (default: {said or default})",
    )


def add_choice_from(parser: argparse.ArgumentParser, default: str | None, said: str = "") -> None:
    """`--choice-from`; `said` of its default."""
    parser.add_argument(
        "--choice-from",
        choices=CHOICE_FROM,
        default=default,
        help="what chooses among the lines drawn from tracks, for all predictors: what each has in "
        "its weights, or that fitted to the tracks of the same other recordings, where it does "
        "better on those held out; auto: fitted where there are three "
        f"(default: {said or default})",
    )


def add_driving(parser: argparse.ArgumentParser) -> None:
    """`--drive` and `--agent`, and the net that recorded vehicles need to be driven in."""
    parser.add_argument(
        "--drive",
        metavar="ID[@S],ID",
        help="vehicles that --agent drives, from S seconds of the scene's clock on (default: from "
        "their appearance on); recorded ones are taken over",
    )
    parser.add_argument(
        "--agent",
        metavar="NAME",
        default=SIMULATORS_OWN,
        help="sumo_driver (default: the simulator's own driver), constant_speed, idm, heed, "
        "hatn_planner, mpc, or your own as module:Class",
    )
    parser.add_argument(
        "--net",
        type=Path,
        metavar="FILE",
        help="replay the tracks inside SUMO, in this net of the same place (see `hatn-sim net`)",
    )
    parser.add_argument(
        "--react-from",
        type=seconds_or_none,
        metavar="S",
        help="with --net: from then on every recorded vehicle is driven by SUMO",
    )


def add_networks(parser: argparse.ArgumentParser) -> None:
    """`--weights` and `--adapt`."""
    parser.add_argument(
        "--weights",
        type=Path,
        metavar="FILE",
        help="weights of hatn, and with -paper behind FILE's name those of hatn-paper (default: "
        "those that ship)",
    )
    parser.add_argument(
        "--adapt",
        choices=ADAPTATIONS,
        default="none",
        help="how networks learn on from every vehicle while it is seen: by the paper's modified "
        "extended Kalman filter, or, to compare, by recursive least squares or gradient descent "
        "(default: none)",
    )


def add_lines(parser: argparse.ArgumentParser) -> None:
    """`--lines`."""
    parser.add_argument(
        "--lines",
        choices=("inferred", "route"),
        default="inferred",
        help="reference lines from motion (default), or from the simulator's routes, which no "
        "camera can see: an upper bound",
    )


def with_driving(scenario: Scenario, arguments: argparse.Namespace) -> Scenario:
    """The scene, replayed inside SUMO if that is asked for. Raises InputError."""
    from dataclasses import replace

    from hatn_sim.config import ReplaySource
    from hatn_sim.errors import InputError

    if arguments.drive is not None and not arguments.drive.strip(" ,"):
        raise InputError(f"--drive {arguments.drive!r}: expected ID or ID@SECONDS; leave it out")
    if arguments.drive is None and arguments.agent != SIMULATORS_OWN:
        raise InputError(f"--agent {arguments.agent} drives nobody; add --drive ID")
    if arguments.net is None:
        if arguments.react_from is not None:
            raise InputError(f"--react-from {arguments.react_from:g} goes with --net; add it")
        if scenario.recorded is not None and arguments.drive is not None:
            raise InputError(
                f"--drive {arguments.drive}: recorded vehicles are taken over inside SUMO; add "
                "--net FILE, a net of the same place (`hatn-sim net MAP` builds one)"
            )
        return scenario
    if scenario.recorded is None:
        raise InputError(f"--net {arguments.net} is for recorded tracks; leave it out")
    replay = ReplaySource(arguments.net, arguments.drive or "", arguments.react_from)
    return replace(scenario, recorded=replace(scenario.recorded, replay=replay))


def with_lines_from(
    scenario: Scenario, arguments: argparse.Namespace, drawing: Drawing
) -> Scenario:
    """The scene with the reference lines of --lines-from. Raises InputError."""
    if arguments.lines_from == "lanes":
        return scenario
    from hatn_sim.recordings.track_lines.source import other_recordings, with_track_lines

    others = other_recordings(scenario)
    return with_track_lines(scenario, others, arguments.lines_from, drawing)


def chosen_scenario(arguments: argparse.Namespace) -> Scenario:
    """The scene that was named, or that of the tracks. Raises InputError."""
    from hatn_sim.config import load_scenario, load_tracks, recording_names
    from hatn_sim.errors import InputError

    if arguments.tracks is None:
        if arguments.scene is None:
            raise InputError("name a SCENE, or give --tracks FILE --map FILE")
        for option, value in (("--map", arguments.map), ("--recordings", arguments.recordings)):
            if value is not None:
                raise InputError(f"{option} {value} goes with --tracks; leave it out")
        return load_scenario(arguments.scene, arguments.density, arguments.risk)
    if arguments.scene is not None:
        raise InputError(f"either SCENE or --tracks, found both ({arguments.scene!r}); drop one")
    for option, value in (("--density", arguments.density), ("--risk", arguments.risk)):
        if value is not None:
            raise InputError(f"{option} {value} is for shipped scenes; leave it out with --tracks")
    wanted = () if arguments.recordings is None else recording_names(arguments.recordings)
    return load_tracks(arguments.tracks, arguments.map, wanted)


def scene_words(arguments: argparse.Namespace) -> list[str]:
    """The words of a command that name the same scene."""
    if arguments.tracks is None:
        return [arguments.scene]
    words = ["--tracks", *arguments.tracks]
    words += [] if arguments.map is None else ["--map", str(arguments.map)]
    return words + ([] if arguments.recordings is None else ["--recordings", arguments.recordings])


def chosen_seed(arguments: argparse.Namespace, scenario: Scenario) -> int | None:
    """The seed of the traffic; None where it is recorded."""
    from hatn_sim.errors import InputError

    recorded = scenario.recorded
    if recorded is not None and arguments.lines == "route" and recorded.map_path is not None:
        raise InputError("--lines route: recorded tracks know no routes; leave it out")
    if recorded is None or recorded.replay is not None:
        return 1 if arguments.seed is None else int(arguments.seed)
    if arguments.seed is not None:
        raise InputError(f"--seed {arguments.seed}: recorded traffic has no seed; leave it out")
    return None


def default_warm_up_s(scenario: Scenario, drive: str | None = None) -> float:
    """A shipped scene begins empty; recorded traffic does not, and a user's may be long.

    With `drive`, vehicles to be driven, neither is there time in highway-env, whose ego is on the
    road from the beginning and soon gone.
    """
    if scenario.is_user_config or scenario.recorded is not None:
        return 0.0
    return 0.0 if scenario.highway is not None and drive is not None else WARM_UP_S


def add_traffic(parser: argparse.ArgumentParser) -> None:
    """`--density` and `--risk` of a shipped scene."""
    parser.add_argument(
        "--density", metavar="light|normal|dense", help="how much traffic (default: normal)"
    )
    parser.add_argument(
        "--risk",
        metavar="PROFILE",
        help="who drives: courteous, assertive or inattentive (default: courteous)",
    )


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a number of seconds, found {text!r}") from None
