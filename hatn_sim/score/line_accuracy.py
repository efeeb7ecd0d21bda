"""How often the inferred reference line is the right one (METHOD 1.1), against the true routes.

A sample is a vehicle at a moment, with a junction at most `REACH_M` ahead of its front bumper or
under it. Vehicles without a line are samples too: a missing line is never a right one.

| measure | unit | what it is |
|---|---|---|
| `line_right_inside` | share | inside a junction: right connection and right lane behind it |
| `line_right_20m` | share | on the last 20 m before it: right exit |
| `line_right_20m_blinker` | share | the same, while a blinker is on |
| `line_told_20m_blinker` | share | what approach and blinker tell of these: see `told_share` |
| `line_right_inside_choice` | share | those inside whose approach has several exits |
| `line_right_20m_choice` | share | the same of the last 20 m |
| `line_right_when_given` | share | of the samples with a line, those that are right |
| `line_mean_probability` | share | what the probabilities of these lines claim |
| `line_fallback_share` | share | of samples: no line was found |
| `line_wrong_lane_share` | share | of samples inside with a line: right exit, but another lane |
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hatn_sim.datatypes import (
    BoolArray,
    FloatArray,
    Frame,
    IntArray,
    Kind,
    Lines,
    ReferenceLine,
    Route,
    Scene,
    Score,
)
from hatn_sim.line_choice import LineChoice
from hatn_sim.lines import empty_lines, follow_lines
from hatn_sim.loop import RELEASE_FRAMES
from hatn_sim.road import Road
from hatn_sim.score import intervals
from hatn_sim.tracks import empty_tracks, extend

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
    approach: NDArray[np.str_]  # edge before the junction
    exit: NDArray[np.str_]  # edge behind it, of the true route
    distance_m: FloatArray  # front bumper to the junction, INSIDE_M inside
    blinker: IntArray  # now: +1 left, 0 none, -1 right
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
    def last(self) -> BoolArray:
        """On the last metres before a junction."""
        return ~self.inside & (self.distance_m < LAST_M)

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
        self._of_line: dict[int, tuple[ReferenceLine, tuple[Passage, ...]]] = {}

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
        one = self._road.lines[line]
        known = self._of_line.get(line)
        if known is None or known[0] is not one:  # the number may mean another line by now
            known = self._of_line[line] = one, tuple(self._find(one))
        return known[1]

    def _find(self, one: ReferenceLine) -> list[Passage]:
        road = self._road
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


class LineJudge:
    """Follows a run frame by frame, by inference and by the true routes, and collects samples.

    `run` names the run, so that vehicles of several runs stay apart. Lines are chosen by `choice`,
    None: the one that ships.
    """

    def __init__(
        self,
        road: Road,
        edge_of: Callable[[str], str],
        run: str,
        choice: LineChoice | None = None,
    ) -> None:
        self._road, self._book, self._run = road, PassageBook(road, edge_of), run
        self._choice = choice
        self._tracks = empty_tracks()
        self._mine, self._true = empty_lines(), empty_lines()
        self._frames = 0
        self._parts: list[LineSamples] = [_samples([])]

    def see(self, frame: Frame, *, counts: bool) -> None:
        """One frame on; with `counts` it is judged."""
        road, scene, routes = self._road, frame.scene, frame.truth.routes
        self._tracks = extend(self._tracks, scene)
        self._mine, mine = follow_lines(self._mine, road, self._tracks, scene, choice=self._choice)
        self._true, true = follow_lines(self._true, road, self._tracks, scene, routes)
        if counts:
            self._parts.append(judge_lines(road, self._book, scene, mine, true))
        road.touch(np.concatenate((self._mine.line.ravel(), self._true.line.ravel())))
        self._frames += 1
        if self._frames % RELEASE_FRAMES == 0:
            road.release(idle_frames=RELEASE_FRAMES)

    def samples(self) -> LineSamples:
        """Those of all frames so far."""
        samples = pooled(self._parts)
        names = [f"{self._run}: {vehicle}" for vehicle in samples.vehicle.tolist()]
        return replace(samples, vehicle=np.array(names, dtype=np.str_))


_Row = tuple[str, str, str, float, int, int, bool, bool, bool, bool, float]


def judge_lines(
    road: Road, book: PassageBook, scene: Scene, mine: Lines, true: Lines
) -> LineSamples:
    """The samples of one moment: `mine` held against `true`, both of the same road and scene."""
    rows: list[_Row] = []
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
                passage.approach,
                passage.exit,
                INSIDE_M if inside else passage.entry_s_m - front_m,
                int(scene.blinker[k]),
                passage.turn,
                passage.has_choice,
                line >= 0,
                right_exit,
                right_lane,
                float(mine.probability[k]) if line >= 0 else 0.0,
            )
        )
    return _samples(rows)


def _samples(rows: Sequence[_Row]) -> LineSamples:
    """The columns of rows in the order of the fields."""
    columns = list(zip(*rows, strict=True)) or [()] * len(fields(LineSamples))
    vehicle, approach, way, distance_m, blinker, turn, *flags, probability = columns
    has_choice, has_line, exits, lanes = (np.array(flag, dtype=np.bool_) for flag in flags)
    return LineSamples(
        vehicle=np.array(vehicle, dtype=np.str_),
        approach=np.array(approach, dtype=np.str_),
        exit=np.array(way, dtype=np.str_),
        distance_m=np.array(distance_m, dtype=np.float64),
        blinker=np.array(blinker, dtype=np.int64),
        turn=np.array(turn, dtype=np.int64),
        has_choice=has_choice,
        has_line=has_line,
        right_exit=exits,
        right_lane=lanes,
        probability=np.array(probability, dtype=np.float64),
    )


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
    ahead = (*true.connections[done:], true.exit_lane)
    right_lane = right_exit and any(
        route[at : at + len(ahead)] == ahead for at in range(len(route) - len(ahead) + 1)
    )
    return right_exit, right_lane


def _same_way(mine: Passage, true: Passage) -> bool:
    return mine.approach == true.approach or not mine.approach or not true.approach


def pooled(parts: Sequence[LineSamples]) -> LineSamples:
    """Samples of several moments or runs as one."""
    return LineSamples(
        *(
            np.concatenate([getattr(part, column.name) for part in parts])
            for column in fields(LineSamples)
        )
    )


def line_scores(samples: LineSamples, scene: str) -> list[Score]:
    """The measures of the table above, each with an interval over vehicles."""
    last, with_line = samples.last, samples.has_line
    wrong_lane = samples.right_exit & ~samples.right_lane
    measures: Mapping[str, tuple[NDArray[np.generic], BoolArray]] = {
        "line_right_inside": (samples.right, samples.inside),
        "line_right_inside_choice": (samples.right, samples.inside & samples.has_choice),
        "line_right_20m_blinker": (samples.right, last & (samples.blinker != 0)),
        "line_right_20m": (samples.right, last),
        "line_right_20m_choice": (samples.right, last & samples.has_choice),
        "line_right_when_given": (samples.right, with_line),
        "line_mean_probability": (samples.probability, with_line),
        "line_fallback_share": (~with_line, np.ones(len(with_line), dtype=np.bool_)),
        "line_wrong_lane_share": (wrong_lane, samples.inside & with_line),
    }
    scores = [
        _score(name, scene, value[among], samples.vehicle[among])
        for name, (value, among) in measures.items()
    ]
    told, n = told_share(samples)
    told_score = Score(
        "line_told_20m_blinker", PREDICTOR, scene, "all", "none", told, "share", n, None, None
    )
    return [*scores, told_score]


def told_share(samples: LineSamples) -> tuple[float | None, int]:
    """What the approach and a set blinker tell of the exit, and the number of samples.

    The share of samples on the last metres with a blinker on that one would get right who knew, in
    hindsight, which exit most of them take who come that way and signal to that side. Where two
    exits lie on one side, this is far from 1, whatever is made of the signal.
    """
    among = samples.last & (samples.blinker != 0)
    exits: dict[tuple[str, int], Counter[str]] = {}
    columns = (samples.approach[among], samples.blinker[among], samples.exit[among])
    for approach, side, way in zip(*(column.tolist() for column in columns), strict=True):
        exits.setdefault((approach, side), Counter())[way] += 1
    n = int(among.sum())
    return (sum(max(ways.values()) for ways in exits.values()) / n if n else None), n


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
