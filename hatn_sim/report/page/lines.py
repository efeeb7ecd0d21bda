"""The reference line of every vehicle of a log, worked out again from scenes and lanes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import FloatArray, IntArray, ReferenceLine
from hatn_sim.log import Run
from hatn_sim.log.choice_file import read_run_choice
from hatn_sim.perception import begin, perceive
from hatn_sim.report.moment import SLOT_REACH_M
from hatn_sim.report.page.pack import second_differences
from hatn_sim.road import LINE_STEP_M, Road

STRIDE: Final = max(1, round(1.0 / LINE_STEP_M))
"""Every so manieth vertex of a line is kept: one each metre."""
GRID_PER_M: Final = 50
"""Vertices of lines, as positions of vehicles, are rounded to 2 cm."""
ROOM_M: Final = 15.0
"""Half the longest vehicle: slots start at its bumper."""


@dataclass(frozen=True, eq=False)
class LinesDriven:
    """R rows as in the run's `tracks`."""

    line: IntArray  # [R] index into `lines`, -1: on none
    s_m: FloatArray  # [R]
    lines: tuple[ReferenceLine, ...]


def no_lines(rows: int) -> LinesDriven:
    """Nobody is on a line."""
    return LinesDriven(np.full(rows, -1), np.zeros(rows), ())


def lines_driven(run: Run) -> LinesDriven:
    """The lines of all rows; what perception made of the scenes when the run was made."""
    state = begin(Road(run.lanes), read_run_choice(run.path))
    numbers: dict[ReferenceLine, int] = {}
    line: list[IntArray] = [np.zeros(0, dtype=np.int64)]
    s_m: list[FloatArray] = [np.zeros(0)]
    for frame in run.frames():
        state = perceive(state, frame.scene, frame.truth.routes if run.by_route else None)
        lines = state.seen.lines
        # Numbers of lines are given anew after a while; the lines themselves stay what they are.
        used = {i: state.road.lines[i] for i in np.unique(lines.line).tolist() if i >= 0}
        table = np.full(len(state.road.lines) + 1, -1)  # the last is found by -1
        for i, one in used.items():
            table[i] = numbers.setdefault(one, len(numbers))
        line.append(table[lines.line])
        s_m.append(lines.s_m)
    return LinesDriven(np.concatenate(line), np.concatenate(s_m), tuple(numbers))


def line_shapes(driven: LinesDriven, origin_m: FloatArray) -> list[dict[str, Any]]:
    """For each line its vertices, as second differences, as far as slots lie on it."""
    shapes: list[dict[str, Any]] = []
    for number, line in enumerate(driven.lines):
        s_m = driven.s_m[driven.line == number]
        first = max(int((s_m.min() - ROOM_M) / LINE_STEP_M), 0) // STRIDE * STRIDE
        last = int((s_m.max() + SLOT_REACH_M + 2.0 * ROOM_M) / LINE_STEP_M) + STRIDE
        xy = np.rint((line.xy_m[first : last + 1 : STRIDE] - origin_m) * GRID_PER_M)
        starts = np.arange(len(xy)) == 0
        x, y = (second_differences(xy[:, k].astype(np.int64), starts) for k in (0, 1))
        shapes.append({"s": first * LINE_STEP_M, "x": x.tolist(), "y": y.tolist()})
    return shapes
