"""Say what is installed, what is missing and how to get it.

The exit code is 1 if something is missing that hatn-sim does not work without. With --oracle, hold
the conflicts of a scene's reference lines against those that SUMO itself sees, once a second. With
--fidelity, say how far the vehicles of a scene of any simulator are from their reference lines.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import asdict, dataclass
from importlib import metadata, util

from hatn_sim.commands.options import seconds, seconds_or_none

EXAMPLES = """examples:
  hatn-sim doctor
  hatn-sim doctor --oracle intersection5 --duration 600
  hatn-sim doctor --fidelity highway_roundabout
  hatn-sim doctor --oracle my/town.sumocfg --duration 600 --warm-up 300 --json
"""


@dataclass(frozen=True)
class Check:
    """One thing looked at."""

    name: str
    ok: bool
    needed: bool  # the core does not work without it
    found: str
    remedy: str


_CORE = (
    "libsumo",
    "highway-env",
    "gymnasium",
    "numpy",
    "scipy",
    "torch",
    "pyarrow",
    "pyproj",
    "safetensors",
    "matplotlib",
    "rich",
    "pillow",
)
_EXTRAS = {
    "eclipse-sumo": ("gui", "netconvert to build nets"),
    "stable-baselines3": ("rl", "reinforcement learning"),
    "rerun-sdk": ("viz", "the rerun viewer"),
    "pytest": ("test", "the tests"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim doctor`."""
    parser.add_argument("--json", action="store_true", help="print JSON instead of lines")
    parser.add_argument(
        "--oracle", metavar="SCENE", help="compare with SUMO: a scene's name, or a .sumocfg"
    )
    parser.add_argument(
        "--fidelity",
        metavar="SCENE",
        help="measure how near a scene's vehicles are to the lines drawn for them",
    )
    parser.add_argument(
        "--duration",
        type=seconds,
        metavar="S",
        help="of the comparison (default: 600 of --oracle, 120 of --fidelity)",
    )
    parser.add_argument(
        "--warm-up",
        type=seconds_or_none,
        metavar="S",
        help="before it (default: 60 in a shipped scene, 0 in yours and of --fidelity)",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the traffic (default: 1)")


def main(arguments: argparse.Namespace) -> int:
    """Look and tell."""
    if arguments.fidelity is not None:
        from hatn_sim.commands import fidelity

        return fidelity.main(arguments)
    if arguments.oracle is not None:
        from hatn_sim.commands import oracle

        return oracle.main(arguments)
    checks = look()
    if arguments.json:
        print(json.dumps([asdict(check) for check in checks], indent=2))
    else:
        for check in checks:
            mark = "ok  " if check.ok else ("MISS" if check.needed else "-   ")
            line = f"{mark} {check.name:<18} {check.found}"
            print(line if check.ok or not check.remedy else f"{line}; {check.remedy}")
    return 0 if all(check.ok for check in checks if check.needed) else 1


def look() -> list[Check]:
    """Everything checked, in reading order."""
    python = ".".join(map(str, sys.version_info[:3]))
    supported = (3, 11) <= sys.version_info[:2] <= (3, 13)
    checks = [Check("python", supported, True, python, "3.11 to 3.13 are supported")]
    checks += [_package(name, "pip install hatn-sim", True) for name in _CORE]
    checks += [_starts_sumo(), _resources(), _weights()]
    checks += [
        _package(name, f"pip install 'hatn-sim[{extra}]' for {purpose}", False)
        for name, (extra, purpose) in _EXTRAS.items()
    ]
    checks.append(_display())
    return checks


def _package(name: str, remedy: str, needed: bool) -> Check:
    try:
        return Check(name, True, needed, metadata.version(name), "")
    except metadata.PackageNotFoundError:
        return Check(name, False, needed, "not installed", remedy)


def _starts_sumo() -> Check:
    from hatn_sim.errors import HatnSimError

    if util.find_spec("libsumo") is None:
        return Check("SUMO worker", False, True, "no libsumo", "pip install libsumo")
    from hatn_sim.config import load_scenario
    from hatn_sim.simulators.sumo import SumoSimulator

    try:
        with SumoSimulator(load_scenario("intersection5")) as simulator:
            simulator.reset(1)
            simulator.step()
    except HatnSimError as error:
        remedy = "pip install --force-reinstall libsumo"
        return Check("SUMO worker", False, True, str(error), remedy)
    return Check("SUMO worker", True, True, "starts, steps and ends", "")


def _resources() -> Check:
    from hatn_sim.errors import HatnSimError
    from hatn_sim.resources import find_agents, find_scenarios

    try:
        scenes, agents = find_scenarios(), find_agents()
    except HatnSimError as error:
        return Check("scenes, agents", False, True, str(error), "install hatn-sim again")
    found = f"scenes {', '.join(sorted(scenes))}; agents {', '.join(sorted(agents))}"
    return Check("scenes, agents", bool(scenes), True, found, "install hatn-sim again")


def _weights() -> Check:
    from hatn_sim.errors import HatnSimError
    from hatn_sim.resources import weights_dir

    if util.find_spec("torch") is None:
        return Check("weights", False, True, "no torch to read them", "pip install hatn-sim")
    from hatn_sim.hatn.weights_io import load_weights

    try:
        weights = load_weights(weights_dir() / "hatn.safetensors")
    except HatnSimError as error:
        return Check("weights", False, True, str(error), "install hatn-sim again")
    return Check("weights", True, True, f"hatn, sha256 {weights.sha256[:12]}", "")


def _display() -> Check:
    """Whether `run --gui` has a screen; the window itself comes with libsumo."""
    from hatn_sim.simulators.sumo_window import display_trouble

    if sys.platform == "win32":
        return Check("display", False, False, "libsumo has no window on Windows", "")
    trouble = display_trouble(os.environ.get("DISPLAY", ""))
    remedy = "`run --gui` opens SUMO's window on a desktop, or under `xvfb-run -a`"
    return Check("display", not trouble, False, trouble or os.environ["DISPLAY"], remedy)
