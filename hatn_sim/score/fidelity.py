"""How near vehicles are to the lines that are drawn for them: of any simulator, from its frames.

Two ways of choosing the line are measured: along the simulator's own routes, and inferred from what
a camera sees. Vehicles that leave their lane on purpose or by force are told apart, by what the
simulator says of them: a change of lanes is a change of route that moves the line more than
`JUMP_M` aside, and lasts from `CHANGE_S` before it to `CHANGE_S` after; a vehicle that touched
another counts as crashed from then on.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, Frame, Kind
from hatn_sim.perception import begin, perceive
from hatn_sim.road import Road

JUMP_M: Final = 1.0
"""No vehicle moves so far aside within a tenth of a second: its line did."""
CHANGE_S: Final = 3.0
MODES: Final = ("route", "inferred")
STATES: Final = ("keeping lane", "changing lanes", "crashed")


@dataclass(frozen=True)
class Closeness:
    """Distances of vehicle-frames to their lines; None where there is none."""

    mode: str  # of MODES
    state: str  # of STATES, or "all"
    n: int  # vehicle-frames
    without_line: float | None  # share of them
    median_m: float | None
    q99_m: float | None
    q999_m: float | None
    max_m: float | None
    within_1_m: float | None  # share of those with a line


def measure_fidelity(
    frames: Iterable[Frame], road: Road, warm_up_s: float = 0.0
) -> list[Closeness]:
    """Closeness in every mode and state, over the frames after the first `warm_up_s` seconds."""
    states = [begin(road), begin(road)]
    rows: list[tuple[int, float, float, float]] = []  # vehicle, time, |d| by route and inferred
    signed: list[float] = []  # d by route
    crashed_s: dict[int, float] = {}
    numbers: dict[str, int] = {}
    for frame in frames:
        scene, truth = frame.scene, frame.truth
        off_m: list[FloatArray] = []
        for k, routes in enumerate((truth.routes, None)):
            states[k] = perceive(states[k], scene, routes)
            lines = states[k].seen.lines
            off_m.append(np.where(lines.line >= 0, lines.d_m, np.nan))
        for name in (name for pair in truth.collisions for name in pair):
            crashed_s.setdefault(numbers.setdefault(name, len(numbers)), scene.time_s)
        for i in np.flatnonzero(scene.kind != Kind.PEDESTRIAN).tolist():
            number = numbers.setdefault(scene.ids[i], len(numbers))
            rows.append((number, scene.time_s, abs(off_m[0][i]), abs(off_m[1][i])))
            signed.append(float(off_m[0][i]))
    table = np.array(rows, np.float64).reshape(-1, 4)
    changing = _changing(table[:, 0], table[:, 1], np.array(signed, np.float64))
    crash_s = np.array([crashed_s.get(number, np.inf) for number in range(len(numbers))])
    crashed = table[:, 1] >= crash_s[table[:, 0].astype(np.int64)] if len(table) else changing
    late = table[:, 1] >= (table[0, 1] if len(table) else 0.0) + warm_up_s
    masks = {
        "all": late,
        "keeping lane": late & ~changing & ~crashed,
        "changing lanes": late & changing & ~crashed,
        "crashed": late & crashed,
    }
    return [
        _closeness(mode, state, table[mask, 2 + k])
        for k, mode in enumerate(MODES)
        for state, mask in masks.items()
    ]


def _changing(vehicle: FloatArray, time_s: FloatArray, off_m: FloatArray) -> BoolArray:
    """Rows [R] of vehicles near in time to a jump of their line: by route, from row to row."""
    order = np.lexsort((time_s, vehicle))
    same = np.diff(vehicle[order]) == 0
    jumped = same & (np.abs(np.diff(off_m[order])) > JUMP_M)
    at = np.flatnonzero(jumped) + 1
    out = np.zeros(len(vehicle), np.bool_)
    for jump in order[at].tolist():
        near = np.abs(time_s - time_s[jump]) <= CHANGE_S
        out |= near & (vehicle == vehicle[jump])
    return out


def _closeness(mode: str, state: str, off_m: FloatArray) -> Closeness:
    seen = off_m[np.isfinite(off_m)]
    if not len(off_m):
        return Closeness(mode, state, 0, None, None, None, None, None, None)
    without = 1.0 - len(seen) / len(off_m)
    if not len(seen):
        return Closeness(mode, state, len(off_m), without, None, None, None, None, None)
    q = [float(value) for value in np.quantile(seen, (0.5, 0.99, 0.999, 1.0))]
    within = float((seen <= 1.0).mean())
    return Closeness(mode, state, len(off_m), without, q[0], q[1], q[2], q[3], within)
