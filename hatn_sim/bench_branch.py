"""What a branch costs beside the bare libsumo time of the very steps that it drives."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.simulators.sumo import SumoSimulator

HORIZON_S: Final = 6.0
"""A second of reaction and five of a profile."""
BRANCHES: Final = 15


@dataclass(frozen=True)
class BranchTiming:
    """Medians over branches, each waited for; the run then drives the same steps."""

    branches: int
    steps: int  # of each
    start_ms: float  # for which the run is held up
    whole_ms: float  # until the result is here
    bare_ms: float  # SUMO's own time for the same steps in the run
    ratio: float  # of the whole to the bare
    excess_ms: float  # of the whole over 1.3 times the bare: to be 15 at most


def time_branches(simulator: SumoSimulator) -> BranchTiming:
    """Branches the simulation as it is, again and again; it goes on for as long."""
    steps = round(HORIZON_S / simulator.dt_s)
    start_ms, whole_ms, bare_ms = np.zeros((3, BRANCHES))
    for k in range(BRANCHES):
        began = time.perf_counter()
        (future,) = simulator.branch([()], HORIZON_S)
        start_ms[k] = 1e3 * (time.perf_counter() - began)
        future.result()
        whole_ms[k] = 1e3 * (time.perf_counter() - began)
        for _ in range(steps):
            simulator.step()
            bare_ms[k] += 1e3 * simulator.sumo_s
    return BranchTiming(
        branches=BRANCHES,
        steps=steps,
        start_ms=float(np.median(start_ms)),
        whole_ms=float(np.median(whole_ms)),
        bare_ms=float(np.median(bare_ms)),
        ratio=float(np.median(whole_ms / bare_ms)),
        excess_ms=float(np.median(whole_ms - 1.3 * bare_ms)),
    )
