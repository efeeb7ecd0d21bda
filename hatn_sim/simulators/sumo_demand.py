"""What a scene of SUMO says before it runs: when it ends, and who comes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from hatn_sim.config import Scenario
from hatn_sim.errors import InputError
from hatn_sim.safe_xml import parse_xml
from hatn_sim.simulators.sumo_config import named_files, read_sumocfg

SINGLE: Final = ("vehicle", "trip")
FOREIGN: Final = ("include", "routeDistribution", "vTypeProbe", "calibrator")
"""Where one of these is in a file, others may come as well."""


def is_of_sumo(scenario: Scenario) -> bool:
    """Whether SUMO's own demand is simulated."""
    return scenario.highway is None and scenario.recorded is None


def lasts_s(scenario: Scenario) -> float | None:
    """From begin to end, as the configuration has them in seconds; None: it does not say."""
    if not is_of_sumo(scenario):
        return None
    options = read_sumocfg(scenario.config_path)
    try:
        begin_s, end_s = (float(options.get(key, no)) for key, no in (("begin", 0), ("end", -1)))
    except ValueError:  # a time of day
        return None
    return end_s - begin_s if end_s >= 0.0 else None


def coming(scenario: Scenario) -> tuple[Callable[[str], bool], tuple[str, ...]] | None:
    """Whether a name is one that comes, and the names; None: that cannot be told.

    Vehicles of a flow are told by it and a number: `north.12`; so are the further ones of a vehicle
    that SUMO's --scale multiplies.
    """
    if not is_of_sumo(scenario) or "load-state" in read_sumocfg(scenario.config_path):
        return None  # a state has vehicles of its own
    names, flows = set[str](), set[str]()
    try:
        for path in named_files(scenario.config_path):
            if path.name.endswith((".net.xml", ".net.xml.gz")):
                continue
            for element in parse_xml(path).iter():
                if element.tag in FOREIGN:
                    return None
                if element.tag in SINGLE:
                    names.add(element.get("id", ""))
                elif element.tag == "flow":
                    flows.add(element.get("id", ""))
    except InputError:  # named by a variable, or fetched by SUMO from elsewhere
        return None

    def comes(name: str) -> bool:
        flow, _, number = name.rpartition(".")
        return name in names or (flow in flows | names and number.isdecimal())

    return comes, (*names, *(f"{flow}.0" for flow in flows))
