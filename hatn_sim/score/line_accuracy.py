"""How often the inferred reference line is the right one (METHOD 1.1), against the true routes.

A sample is a vehicle at a moment, with a junction at most `REACH_M` ahead of its front bumper or
under it. Vehicles without a line are samples too: a missing line is never a right one.

| measure | unit | what it is |
|---|---|---|
| `line_right_inside` | share | inside a junction: right connection and right lane behind it |
| `line_right_20m` | share | on the last 20 m before it: right exit |
| `line_right_20m_blinker` | share | the same, while a blinker is on |
| `line_right_inside_choice`, `line_right_20m_choice` | share | where the approach has several exits |
| `line_right_when_given` | share | of the samples with a line, those that are right |
| `line_mean_probability` | share | what the probabilities of these lines claim |
| `line_fallback_share` | share | of samples: no line was found |
| `line_wrong_lane_share` | share | of samples inside with a line: right exit, but another lane |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Kind, Lines, Route, Scene, Score
from hatn_sim.road import Road
from hatn_sim.score import intervals

REACH_M: Final = 80.0
"""Further from the next junction a vehicle is no sample."""
BINS_M: Final = (0.0, 10.0, 20.0, 30.0, 50.0, 80.0)
"""Edges of the bins of distance before the junction; inside it is a bin of its own."""
LAST_M: Final = 20.0
INSIDE_M: Final = -1.0
"""Distance given to vehicles inside a junction."""
PREDICTOR: Final = "lines"


@dataclass(frozen=True)
class Passage:
    """One way through a junction, on a line."""

    approach: str  # edge before, "" where the line begins inside
    connections: Route
    exit_lane: str  # "" where the line ends inside
    exit: str  # its edge
    entry_s_m: float
    end_s_m: float
    turn: int  # +1 left, 0 straight, -1 right
    has_choice: bool  # the approach leads to more than one edge


@dataclass(frozen=True, eq=False)
class LineSamples:
    """Vehicles at moments, column by column, [Q] each."""

    vehicle: NDArray[np.str_]
    time_s: FloatArray
    distance_m: FloatArray  # front bumper to the junction, INSIDE_M inside
    blinks: BoolArray  # a blinker is on now
    turn: IntArray  # of the connection it will take or is on
    has_choice: BoolArray
    has_line: BoolArray
    right_exit: BoolArray
    right_lane: BoolArray  # right exit, by the right connection into the right lane
    probability: FloatArray  # of the line, 0 without one

    @property
    def inside(self) -> BoolArray:
        return self.distance_m < 0.0

    @property
    def right(self) -> BoolArray:
        """Inside a junction the lane counts, before it the exit."""
        return np.where(self.inside, self.right_lane, self.right_exit)


class PassageBook:
    """The passages of a road's lines, found once each.

    `edge_of` names the edge of a lane: lanes side by side share one.
    """

    def __init__(self, road: Road, edge_of: Callable[[str], str]) -> None:
        self._road, self._edge_of = road, edge_of
        self._exits: dict[str, set[str]] = {}
        for lane in road.lanes.values():
            if not lane.is_connection:
                self._exits.setdefault(edge_of(lane.id), set()).update(self._leads_to(lane.id))
        self._of_line: dict[int, tuple[Passage, ...]] = {}

    def _leads_to(self, lane_id: str) -> set[str]:
        """Edges behind the junction at the end of a lane."""
        found: set[str] = set()
        open_lanes, seen = list(self._road.lanes[lane_id].successors), {lane_id}
        while open_lanes:
            name = open_lanes.pop()
            if name in seen or name not in self._road.lanes:
                continue
            seen.add(name)
            if self._road.lanes[name].is_connection:
                open_lanes += self._road.lanes[name].successors
            else:
                found.add(self._edge_of(name))
        return found

    def passages(self, line: int) -> tuple[Passage, ...]:
        """Those of a line, in driving order."""
        if line not in self._of_line:
            self._of_line[line] = tuple(self._find(line))
        return self._of_line[line]

    def _find(self, line: int) -> list[Passage]:
        road, one = self._road, self._road.lines[line]
        route, start = one.route, [*one.lane_start_s_m.tolist(), np.inf]
        inside = [road.lanes[name].is_connection for name in route]
        found: list[Passage] = []
        first = 0
        while first < len(route):
            if not inside[first]:
                first += 1
                continue
            last = first
            while last + 1 < len(route) and inside[last + 1]:
                last += 1
            approach = self._edge_of(route[first - 1]) if first else ""
            exit_lane = route[last + 1] if last + 1 < len(route) else ""
            found.append(
                Passage(
                    approach=approach,
                    connections=route[first : last + 1],
                    exit_lane=exit_lane,
                    exit=self._edge_of(exit_lane) if exit_lane else "",
                    entry_s_m=start[first],
                    end_s_m=start[last + 1],
                    turn=road.lanes[route[first]].turn,
                    has_choice=len(self._exits.get(approach, ())) > 1,
                )
            )
            first = last + 1
        return found


def judge_lines(
    road: Road, book: PassageBook, scene: Scene, mine: Lines, true: Lines
) -> LineSamples:
    """The samples of one moment: `mine` held against `true`, both of the same road and scene."""
    rows: list[tuple[str, float, bool, int, bool, bool, bool, bool, float]] = []
    for k in np.flatnonzero((true.line >= 0) & (scene.kind != Kind.PEDESTRIAN)).tolist():
        front_m = float(true.s_m[k]) + 0.5 * float(scene.size_m[k, 0])
        ahead = (one for one in book.passages(int(true.line[k])) if one.end_s_m > front_m)
        passage = next(ahead, None)
        if passage is None or not passage.exit or passage.entry_s_m - front_m > REACH_M:
            continue
        line = int(mine.line[k])
        lane_now = road.lines[int(true.line[k])].route[_position(road, int(true.line[k]), front_m)]
        right_exit, right_lane = (
            _agrees(book.passages(line), road.lines[line].route, passage, lane_now)
            if line >= 0
            else (False, False)
        )
        inside = passage.entry_s_m <= front_m
        rows.append(
            (
                scene.ids[k],
                INSIDE_M if inside else passage.entry_s_m - front_m,
                bool(scene.blinker[k]),
                passage.turn,
                passage.has_choice,
                line >= 0,
                right_exit,
                right_lane,
                float(mine.probability[k]) if line >= 0 else 0.0,
            )
        )
    columns = list(zip(*rows, strict=True)) or [()] * 9
    kinds = (np.str_, np.float64, np.bool_, np.int64, np.bool_, np.bool_, np.bool_, np.bool_)
    vehicle, *rest = (
        np.array(column, dtype=kind)
        for column, kind in zip(columns, (*kinds, np.float64), strict=True)
    )
    return LineSamples(vehicle, np.full(len(rows), scene.time_s), *rest)


def _position(road: Road, line: int, s_m: float) -> int:
    start = road.lines[line].lane_start_s_m
    return max(int(np.searchsorted(start, s_m, side="right")) - 1, 0)


def _agrees(
    mine: Sequence[Passage], route: Route, true: Passage, lane_now: str
) -> tuple[bool, bool]:
    """Whether a line takes the true exit, and whether by the true connection and lane.

    Of a split connection only what is not yet driven counts.
    """
    right_exit = any(one.exit == true.exit and _same_way(one, true) for one in mine)
    done = true.connections.index(lane_now) if lane_now in true.connections else 0
    todo = (*true.connections[done:], true.exit_lane)
    right_lane = right_exit and any(
        route[at : at + len(todo)] == todo for at in range(len(route) - len(todo) + 1)
    )
    return right_exit, right_lane


def _same_way(mine: Passage, true: Passage) -> bool:
    return mine.approach == true.approach or not mine.approach or not true.approach


def pooled(parts: Sequence[LineSamples]) -> LineSamples:
    """Samples of several moments as one."""
    return LineSamples(
        *(
            np.concatenate([getattr(part, column.name) for part in parts])
            for column in fields(LineSamples)
        )
    )


def line_scores(samples: LineSamples, scene: str) -> list[Score]:
    """The measures of the table above, each with an interval over vehicles."""
    last = ~samples.inside & (samples.distance_m < LAST_M)
    with_line = samples.has_line
    wrong_lane = samples.right_exit & ~samples.right_lane
    measures: Mapping[str, tuple[NDArray[np.generic], BoolArray]] = {
        "line_right_inside": (samples.right, samples.inside),
        "line_right_inside_choice": (samples.right, samples.inside & samples.has_choice),
        "line_right_20m_blinker": (samples.right, last & samples.blinks),
        "line_right_20m": (samples.right, last),
        "line_right_20m_choice": (samples.right, last & samples.has_choice),
        "line_right_when_given": (samples.right, with_line),
        "line_mean_probability": (samples.probability, with_line),
        "line_fallback_share": (~with_line, np.ones(len(with_line), dtype=np.bool_)),
        "line_wrong_lane_share": (wrong_lane, samples.inside & with_line),
    }
    return [
        _score(name, scene, value[among], samples.vehicle[among])
        for name, (value, among) in measures.items()
    ]


def _score(
    measure: str, scene: str, value: NDArray[np.generic], vehicle: NDArray[np.str_]
) -> Score:
    mean = low = high = None
    if len(value):
        terms = np.column_stack((value.astype(np.float64), np.ones(len(value))))
        sums = intervals.cluster_sums(terms, np.unique(vehicle, return_inverse=True)[1])
        mean = float(intervals.ratio(sums.sum(axis=0)))
        low, high = intervals.interval(sums, intervals.ratio) or (None, None)
    return Score(measure, PREDICTOR, scene, "all", "none", mean, "share", len(value), low, high)


def share_by_distance(samples: LineSamples, among: BoolArray) -> tuple[FloatArray, IntArray]:
    """Share right and number of samples: inside, then each bin of BINS_M; nan where empty."""
    edge = np.array([-np.inf, *BINS_M])
    bin_of = np.searchsorted(edge, samples.distance_m[among], side="right") - 1
    bins = len(BINS_M)
    count = np.bincount(bin_of, minlength=bins)[:bins]
    right = np.bincount(bin_of, weights=samples.right[among], minlength=bins)[:bins]
    return np.where(count, right / np.maximum(count, 1), np.nan), count
