"""Check a predictor or an agent of your own against what the protocols ask of it.

NAME is module:Class, looked for in the working directory first, or the name of one that ships. It
is tried on a few seconds of two scenes. Every point is one line; where it fails, it says what was
expected, what was found and what to do. A fault is told once: points that it hides are "not
reached". An agent has init(road), which returns its first state, and
step(state, ego_id, scene, advice), which returns its new state and a Command or None (the
simulator drives). The exit code is 2 if a point failed.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import TYPE_CHECKING

from hatn_sim.commands.options import names

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hatn_sim.conformance.points import Point
    from hatn_sim.conformance.scenes import Footage

EXAMPLES = """examples:
  hatn-sim check-predictor my_predictor:Mine
  hatn-sim check-predictor my_agent:Mine --agent
  hatn-sim check-predictor my_predictor:Mine --scenes intersection5 --json
"""
FAILED = 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim check-predictor`."""
    parser.add_argument("name", metavar="NAME", help="module:Class, or the name of one that ships")
    parser.add_argument("--agent", action="store_true", help="NAME is an agent, not a predictor")
    parser.add_argument(
        "--scenes",
        type=names,
        metavar="A,B",
        help="scenes that ship to try it on (default: tjunction,roundabout8)",
    )
    parser.add_argument("--json", action="store_true", help="print the points as JSON")


def main(arguments: argparse.Namespace) -> int:
    """Try everything, say everything."""
    from hatn_sim.conformance.scenes import SCENES, film

    said: list[dict[str, object]] = []
    failed = hidden = 0
    for scene in arguments.scenes or SCENES:
        for point in _points(arguments, film(scene)):
            failed += not point.ok and point.reached
            hidden += not point.reached
            said.append({"scene": scene, **asdict(point)})
            if not arguments.json:
                told = f": {point.said}" if point.said else ""
                print(f"{_mark(point)}  {scene}, {point.name}{told}")
    if arguments.json:
        print(json.dumps({"name": arguments.name, "failed": failed, "points": said}, indent=2))
    else:
        also = f", {hidden} not reached" if hidden else ""
        result = f"{failed} points failed{also}" if failed else "all points kept"
        print(f"{arguments.name}: {result}")
    return FAILED if failed else 0


def _mark(point: Point) -> str:
    if not point.reached:
        return "not reached"
    return "ok    " if point.ok else "FAILED"


def _points(arguments: argparse.Namespace, footage: Footage) -> Iterator[Point]:
    from hatn_sim.conformance.agents import check_agent
    from hatn_sim.conformance.predictors import check_predictor
    from hatn_sim.plugins import load_agent
    from hatn_sim.predictors.find import load_predictor

    name: str = arguments.name
    own = load_predictor("hatn")
    if arguments.agent:
        advisers = (load_predictor("constant_velocity"), own)
        return check_agent(lambda: load_agent(name), footage, advisers)
    return check_predictor(lambda: load_predictor(name), footage, own)
