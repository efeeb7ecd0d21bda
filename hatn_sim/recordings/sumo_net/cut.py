"""Long lanes of a junction are cut where nothing else is near: only the rest is inside. Pure.

Maps mark a lane as part of a junction over all of its length, though it meets another one only at
an end (a slip road that merges). In SUMO, who gives way decides so at the junction's border: it
must not be far from where the ways meet.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import BoolArray, FloatArray, Gate, Lane
from hatn_sim.geometry import arc_length_m

STEP_M: Final = 1.0
NEAR_M: Final = 2.0
"""Centre lines nearer than this to each other meet."""
MARGIN_M: Final = 4.0
"""A lane stays inside the junction for this far beyond where it meets another."""
FREE_M: Final = 12.0
"""What lies free for less than this is not worth an edge of its own."""


def cut_long(lanes: Mapping[str, Lane]) -> dict[str, Lane]:
    """The lanes, the free stretches of those inside junctions being lanes of their own.

    The first part of a cut lane keeps its name, further ones are named `NAME~1` and so on.
    """
    neighbours = {name: {name, *lane.successors} for name, lane in lanes.items()}
    for name, lane in lanes.items():
        for successor in lane.successors:
            neighbours[successor].add(name)
    names = list(lanes)
    number = {name: index for index, name in enumerate(names)}
    points = [_along(lane.xy_m, np.arange(0.0, _length_m(lane), STEP_M)) for lane in lanes.values()]
    owner = np.repeat(np.arange(len(names)), [len(part) for part in points])
    tree = KDTree(np.concatenate(points)) if points else None
    out: dict[str, Lane] = {}
    for name, lane in lanes.items():
        parts = [lane]
        if tree is not None and lane.is_connection and _length_m(lane) > FREE_M:
            ours = {number[other] for other in neighbours[name]}
            found = tree.query_ball_point(points[number[name]], NEAR_M)
            meets = [any(int(owner[i]) not in ours for i in near) for near in found]
            parts = _parts(lane, _inside(np.array(meets, np.bool_)))
        out.update((part.id, part) for part in parts)
    return out


def _inside(meets: BoolArray) -> BoolArray:
    """Which samples stay inside, from those that meet another lane: with margin, no slivers."""
    margin = round(MARGIN_M / STEP_M)
    inside = np.convolve(meets, np.ones(2 * margin + 1), mode="full")[margin:-margin] > 0
    for start, stop in _runs(~inside):
        if (stop - start) * STEP_M < FREE_M:
            inside[start:stop] = True
    return inside


def _runs(mask: BoolArray) -> list[tuple[int, int]]:
    """First index and the one after the last of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _parts(lane: Lane, inside: BoolArray) -> list[Lane]:
    changes = np.flatnonzero(np.diff(inside.astype(np.int8))) + 1
    cuts_m = [0.0, *(changes * STEP_M).tolist(), _length_m(lane)]
    names = [lane.id, *(f"{lane.id}~{part}" for part in range(1, len(cuts_m) - 1))]
    parts: list[Lane] = []
    for part, name in enumerate(names):
        low_m, high_m = cuts_m[part], cuts_m[part + 1]
        is_last = part == len(names) - 1
        within = bool(inside[min(int(low_m / STEP_M), len(inside) - 1)])
        parts.append(
            replace(
                lane,
                id=name,
                xy_m=_stretch(lane.xy_m, low_m, high_m),
                successors=lane.successors if is_last else (names[part + 1],),
                gate=lane.gate if is_last else Gate.NONE,
                signals=lane.signals if is_last else None,
                is_connection=within,
                turn=lane.turn if within else 0,
            )
        )
    return parts


def _length_m(lane: Lane) -> float:
    return float(arc_length_m(lane.xy_m)[-1])


def _along(xy_m: FloatArray, at_m: FloatArray) -> FloatArray:
    """The points [K, 2] of a polyline at arc lengths [K]."""
    s_m = arc_length_m(xy_m)
    return np.stack([np.interp(at_m, s_m, xy_m[:, axis]) for axis in (0, 1)], axis=1)


def _stretch(xy_m: FloatArray, low_m: float, high_m: float) -> FloatArray:
    """A polyline from one arc length to another, its vertices between included."""
    s_m = arc_length_m(xy_m)
    between = xy_m[(s_m > low_m + 1e-6) & (s_m < high_m - 1e-6)]
    ends = _along(xy_m, np.array([low_m, high_m]))
    return np.concatenate([ends[:1], between, ends[1:]])
