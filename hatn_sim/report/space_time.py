"""The log of a run -> an ego and those it meets, each on its way to where the two meet, over time.

No drawing here. Everybody's place is told along the ego's way: who is 10 m before its conflict with
the ego lies 10 m before that conflict on the ego's way, however it gets there. Where it is on that
way itself is told, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES, BoolArray, FloatArray, IntArray
from hatn_sim.errors import InputError
from hatn_sim.geometry import resample
from hatn_sim.labels import FOLLOW_FRAMES, NEXT_FRAMES, crossing_frame
from hatn_sim.log import PredictionTable, Run
from hatn_sim.report.moment import main_predictions, named_at
from hatn_sim.report.story import PLACE_M, Choices, read_choices

BEFORE_FRAMES: Final = 40
AFTER_FRAMES: Final = 100
"""What is told begins so long before the moment, and ends at most so long after it ..."""
REST_FRAMES: Final = 15
"""... and otherwise so long after the last of them has crossed."""
MOST_OTHERS: Final = 6
HALF_LANE_M: Final = 1.75
WAY_STEP_M: Final = 0.5
LEAST_CHANCE: Final = 0.05
"""Modes that are less probable are left out."""


@dataclass(frozen=True, eq=False)
class Forecast:
    """What was predicted of a vehicle at a frame."""

    frame: int
    chance: FloatArray  # [K]
    s_m: FloatArray  # [K, F + 1] from that frame on


@dataclass(frozen=True, eq=False)
class Strand:
    """A vehicle along the ego's way."""

    vehicle_id: str
    length_m: float
    s_m: FloatArray  # [T] of its centre; NaN: out of view
    conflict_s_m: float | None  # where it meets the ego; None: it is the ego
    crosses: bool  # it came to that conflict; else it took another way, or was not seen to
    ego_crosses: bool  # the ego came there
    is_named: bool  # the ego's advice or alerts at the moment are about it
    forecasts: tuple[Forecast, ...]  # one a second, the moment's among them
    on_way: (
        BoolArray  # [T] it is on the way that the ego takes, not only as far from their conflict
    )

    def occupied_s(self, time_s: FloatArray, at_m: float) -> tuple[float, float] | None:
        """When it covers a place, from front to rear bumper; None: it does not, or not all seen."""
        half_m = 0.5 * self.length_m
        first, last = (passing_time_s(time_s, self.s_m, at_m + d) for d in (-half_m, half_m))
        return None if first is None or last is None else (first, last)


@dataclass(frozen=True, eq=False)
class SpaceTime:
    """An ego, those it meets, and what it was said to do."""

    run: Run
    frame: int  # the moment
    frames: IntArray  # [T]
    ego: Strand
    others: tuple[Strand, ...]  # as they meet the ego's way, the nearest first
    chance: FloatArray  # [T, 1 + others] of the ego's slots, to yield first; NaN: no such slot
    unplaced: tuple[str, ...]  # named by its advice or alerts, but in no slot of it around then

    @property
    def time_s(self) -> FloatArray:
        """[T]"""
        return np.asarray(self.run.times_s[self.frames], dtype=np.float64)


def passing_time_s(time_s: FloatArray, s_m: FloatArray, at_m: float) -> float | None:
    """When a place is reached first, linearly between frames; None: not seen to be."""
    there = np.flatnonzero(s_m >= at_m)
    if not len(there) or not there[0] or np.isnan(s_m[there[0] - 1]):
        return None
    k = int(there[0])
    share = (at_m - s_m[k - 1]) / (s_m[k] - s_m[k - 1])
    return float(time_s[k - 1] + share * (time_s[k] - time_s[k - 1]))


def space_time(run: Run, frame: int, ego_id: str) -> SpaceTime:
    """An ego around a moment, and whom it has to choose about there or soon before and after.

    Those that its advice and alerts name go before those of its choice at the moment, the likeliest
    slot first, and these before those met the longest; `MOST_OTHERS` of them at most.

    Raises:
        InputError: the ego has no slots to choose from around this moment.
    """
    choices, table = read_choices(run), main_predictions(run)
    ego = run.ids.index(ego_id)
    near = np.abs(choices.frame - frame) <= BEFORE_FRAMES
    rows = np.flatnonzero((choices.ego == ego) & near)
    if not len(rows):
        raise InputError(
            f"{run.path}: vehicle {ego_id!r} has no slots to choose from around "
            f"{run.times_s[frame]:.1f} s; name another --ego or --time"
        )
    travelled = run.trajectories.travelled_at
    origin_m = float(travelled(ego, frame))
    named = [run.ids.index(name) for name in named_at(run, frame, ego_id)]
    met = list(_met(choices, rows, frame, named))
    last = frame + HORIZON_FRAMES
    meetings: list[tuple[int, float, float, bool, bool]] = []
    for vehicle, row, m in met:
        at, there_xy_m = int(choices.frame[row]), choices.conflict_xy_m[row, m]
        ego_m, other_m = float(choices.ego_m[row, m]), float(choices.other_m[row, m])
        conflict_m = float(travelled(ego, at)) - origin_m + ego_m
        zero_m = conflict_m - other_m - float(travelled(vehicle, at))
        limit = NEXT_FRAMES + FOLLOW_FRAMES
        ego_at, other_at = (
            int(
                crossing_frame(
                    run.trajectories,
                    np.array([who]),
                    np.array([at]),
                    np.array([away_m]),
                    there_xy_m[None],
                    limit,
                )[0]
            )
            for who, away_m in ((ego, ego_m), (vehicle, other_m))
        )
        last = max(last, ego_at + REST_FRAMES, other_at + REST_FRAMES)
        meetings.append((vehicle, conflict_m, zero_m, other_at >= 0, ego_at >= 0))
    # Who was met at another time and never came there explains nothing.
    here = rows[choices.frame[rows] == frame]
    now = choices.node[here][choices.focus[here]]
    told = [one for one in meetings if one[0] in named or one[0] in now or one[3]]
    meetings = told or meetings
    first = max(frame - BEFORE_FRAMES, 0)
    frames = np.arange(first, min(last, frame + AFTER_FRAMES, run.frame_count - 1) + 1)
    others = sorted(
        (
            replace(
                _strand(run, table, frames, frame, ego, vehicle, zero_m),
                conflict_s_m=conflict_m,
                crosses=crosses,
                ego_crosses=ego_crosses,
                is_named=vehicle in named,
            )
            for vehicle, conflict_m, zero_m, crosses, ego_crosses in meetings
        ),
        key=lambda one: one.conflict_s_m or 0.0,
    )
    return SpaceTime(
        run=run,
        frame=frame,
        frames=frames,
        ego=_strand(run, table, frames, frame, ego, ego, -origin_m),
        others=tuple(others),
        chance=_chances(choices, ego, frames, [run.ids.index(one.vehicle_id) for one in others]),
        unplaced=tuple(run.ids[who] for who in named if who not in {one[0] for one in meetings}),
    )


def free_spans(story: SpaceTime) -> list[tuple[tuple[float, float], float]]:
    """For how long a conflict is free between the ego and the next before it and after it.

    ((the first leaves, the second comes) [s], where), both as `Strand.occupied_s` has them; one of
    each where several meet the ego at one place.
    """
    best: dict[tuple[int, bool], tuple[tuple[float, float], float]] = {}
    place, place_m = -1, -np.inf
    for other in story.others:
        assert other.conflict_s_m is not None
        at_m = other.conflict_s_m
        if at_m - place_m > PLACE_M:
            place, place_m = place + 1, at_m
        spans = [who.occupied_s(story.time_s, at_m) for who in (other, story.ego)]
        both_cross = other.crosses and other.ego_crosses
        if not both_cross or spans[0] is None or spans[1] is None:
            continue
        is_before = spans[0] < spans[1]
        first, second = sorted((spans[0], spans[1]))
        free = (first[1], second[0]), at_m
        length_s = second[0] - first[1]
        held = best.get((place, is_before))
        if length_s > 0.0 and (held is None or length_s < held[0][1] - held[0][0]):
            best[place, is_before] = free
    return list(best.values())


def _met(
    choices: Choices, rows: IntArray, frame: int, named: Sequence[int]
) -> Iterator[tuple[int, int, int]]:
    """(vehicle, row, node) of those to be told of, at the last row with both before it."""
    shown = choices.focus[rows] | np.isin(choices.node[rows], named)
    row, m = np.nonzero(shown[:, 1:])
    row, m = rows[row], m + 1
    vehicle = choices.node[row, m]
    ahead = (choices.ego_m[row, m] >= 0.0) & (choices.other_m[row, m] >= 0.0)
    now = np.flatnonzero(choices.frame[row] == frame)
    likeliest = now[np.argsort(-choices.chance[row, m][now], kind="stable")]
    found, count = np.unique(vehicle, return_counts=True)
    longest = found[np.argsort(-count, kind="stable")]
    order = dict.fromkeys([*named, *vehicle[likeliest].tolist(), *longest.tolist()])
    for one in [who for who in order if who in found][:MOST_OTHERS]:
        mine = np.flatnonzero(vehicle == one)
        best = mine[np.lexsort((choices.frame[row[mine]], ahead[mine]))[-1]]
        yield one, int(row[best]), int(m[best])


def _strand(
    run: Run,
    table: PredictionTable,
    frames: IntArray,
    moment: int,
    ego: int,
    vehicle: int,
    zero_m: float,
) -> Strand:
    """`zero_m` of the way of `ego` lies where this vehicle had travelled nothing; whom it meets is
    not told."""
    tracks, trajectories = run.tracks, run.trajectories
    _, seen = trajectories.xy_at(vehicle, frames)
    s_m = np.where(seen, zero_m + trajectories.travelled_at(vehicle, frames), np.nan)
    row = int(np.flatnonzero(tracks.vehicle == vehicle)[0])
    told: list[Forecast] = []
    every = round(1.0 / DT_S)
    for frame in frames[(frames - moment) % every == 0].tolist():
        at = slice(*np.searchsorted(table.frame, [frame, frame + 1]))
        rows = np.flatnonzero(table.vehicle[at] == vehicle)
        if not len(rows):
            continue
        k = at.start + int(rows[0])
        here_xy_m, _ = trajectories.xy_at(vehicle, frame)
        modes = table.mode_probability[k] > LEAST_CHANCE
        ways = table.xy_m[k][modes]
        start = np.broadcast_to(here_xy_m, (len(ways), 1, 2))
        steps_m = np.linalg.norm(np.diff(np.concatenate((start, ways), axis=1), axis=1), axis=2)
        ahead_m = np.pad(np.cumsum(steps_m, axis=1), ((0, 0), (1, 0)))
        now_m = zero_m + float(trajectories.travelled_at(vehicle, frame))
        told.append(Forecast(frame, table.mode_probability[k][modes], now_m + ahead_m))
    return Strand(
        vehicle_id=run.ids[vehicle],
        length_m=float(tracks.size_m[row, 0]),
        s_m=s_m,
        conflict_s_m=None,
        crosses=True,
        ego_crosses=True,
        is_named=False,
        forecasts=tuple(told),
        on_way=_on_way(run, ego, vehicle, frames),
    )


def _on_way(run: Run, ego: int, vehicle: int, frames: IntArray) -> BoolArray:
    """[T] whether the middle of a vehicle is within half a lane of where the ego ever was."""
    way_xy_m = resample(run.tracks.xy_m[run.tracks.vehicle == ego], WAY_STEP_M)
    xy_m, seen = run.trajectories.xy_at(vehicle, frames)
    near = np.zeros(len(frames), dtype=np.bool_)
    if seen.any():
        away_m, _ = KDTree(way_xy_m).query(xy_m[seen])
        near[seen] = away_m <= HALF_LANE_M
    return near


def _chances(choices: Choices, ego: int, frames: IntArray, others: list[int]) -> FloatArray:
    chance = np.full((len(frames), 1 + len(others)), np.nan)
    rows = np.flatnonzero((choices.ego == ego) & np.isin(choices.frame, frames))
    column = {vehicle: k for k, vehicle in enumerate([ego, *others])}
    for row in rows.tolist():
        for m in np.flatnonzero(choices.focus[row]).tolist():
            vehicle = int(choices.node[row, m])
            if vehicle in column:
                at = int(choices.frame[row]) - int(frames[0])
                chance[at, column[vehicle]] = choices.chance[row, m]
    # To yield to somebody else is another story.
    chance[np.isnan(chance[:, 1:]).all(axis=1)] = np.nan
    return chance
