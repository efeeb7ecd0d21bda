"""The log of a run -> what befell its egos: encounters at conflicts, one after the other.

An encounter is the stretch of an ego's way to one conflict: as long as its focus stays within
`PLACE_M` of where it was first. Who went first is what happened, the likeliest slot what was said.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray
from hatn_sim.errors import InputError
from hatn_sim.labels import FOLLOW_FRAMES, NEXT_FRAMES, crossing_frame, slot_label
from hatn_sim.log import PredictionTable, Run
from hatn_sim.report.moment import main_predictions

PLACE_M: Final = 4.0
"""Conflicts within this of each other are one focus, as in the graphs."""
GAP_FRAMES: Final = 10
"""Without a choice for longer than this, the next focus is another encounter."""
MIN_ROWS: Final = 5
"""Shorter encounters are left out: half a second is no story."""


@dataclass(frozen=True, eq=False)
class Choices:
    """The rows of a predictor in which an ego had slots to choose from: by ego, then by frame.

    Letters: R rows, M nodes; nodes as in the log, the ego's own first. Vehicles are indices.
    """

    run: Run
    ego: IntArray  # [R]
    frame: IntArray  # [R]
    node: IntArray  # [R, M] the vehicle behind each slot, -1: none
    focus: BoolArray  # [R, M] slots to choose from
    chance: FloatArray  # [R, M] 0 where not in focus
    ego_m: FloatArray  # [R, M] from the ego to each conflict
    other_m: FloatArray  # [R, M] from the vehicle behind the slot
    conflict_xy_m: FloatArray  # [R, M, 2]
    taken: IntArray  # [R] the slot really taken, -1: nobody can say

    @property
    def yields(self) -> FloatArray:
        """[R] probability of yielding."""
        return self.chance[:, 0]

    @cached_property
    def likeliest(self) -> IntArray:
        """[R] vehicle behind the likeliest slot; the ego itself: it yields."""
        best = np.where(self.focus, self.chance, -1.0).argmax(axis=1)
        return np.take_along_axis(self.node, best[:, None], axis=1)[:, 0]

    @cached_property
    def known(self) -> BoolArray:
        """[R] somebody crossed soon, so that it can be said which slot was taken."""
        return self.taken >= 0

    @cached_property
    def right(self) -> BoolArray:
        """[R] the likeliest slot was the one taken."""
        taken = np.take_along_axis(self.node, np.maximum(self.taken, 0)[:, None], axis=1)[:, 0]
        return self.known & (taken == self.likeliest)

    @cached_property
    def nearest_m(self) -> FloatArray:
        """[R] from the ego to its focus."""
        others = self.focus.copy()
        others[:, 0] = False
        nearest: FloatArray = np.where(others, self.ego_m, np.inf).min(axis=1)
        return nearest


@dataclass(frozen=True, eq=False)
class Encounter:
    """An ego on its way to one conflict, and how it ended. Vehicles are indices into Run.ids."""

    rows: IntArray  # [R] of Choices, by frame
    first_frame: int
    last_frame: int
    crossed_frame: int | None  # the ego is at the conflict; None: it took another way, or the end
    let_go: tuple[int, ...]  # who crossed before the ego, in this order
    let_go_frame: tuple[int, ...]
    passed: tuple[int, ...]  # who crossed after it, in this order
    passed_frame: tuple[int, ...]

    @property
    def decided(self) -> bool:
        """The ego crossed, and somebody before or after it."""
        return self.crossed_frame is not None and bool(self.let_go or self.passed)


def read_choices(run: Run) -> Choices:
    """All choices of a run, of its main predictor.

    Raises:
        InputError: nothing was predicted, or nothing about slots.
    """
    table = main_predictions(run)
    focus = table.slot_in_focus & table.slot_mask
    rows = np.flatnonzero(table.has_slot_probability & table.has_conflict & _others(focus))
    if not len(rows):
        raise InputError(
            f"{run.path}: {table.predictor} gives no ego of this run slots to choose from; "
            "make a run with `--predictor hatn` in denser traffic"
        )
    rows = rows[np.lexsort((table.frame[rows], table.vehicle[rows]))]
    return _choices_at(run, table, rows)


def _others(focus: BoolArray) -> BoolArray:
    """[R] there is a slot beside the ego's own."""
    return np.asarray(focus[:, 1:].any(axis=1))


def _choices_at(run: Run, table: PredictionTable, rows: IntArray) -> Choices:
    focus = (table.slot_in_focus & table.slot_mask)[rows]
    ego, frame, node = table.vehicle[rows], table.frame[rows], table.slot_vehicle[rows]
    ego_m, other_m = table.ego_to_conflict_m[rows], table.rear_to_conflict_m[rows]
    conflict_xy_m = table.conflict_xy_m[rows]
    return Choices(
        run=run,
        ego=ego,
        frame=frame,
        node=node,
        focus=focus,
        chance=np.where(focus, table.slot_probability[rows], 0.0),
        ego_m=ego_m,
        other_m=other_m,
        conflict_xy_m=conflict_xy_m,
        taken=slot_label(run.trajectories, ego, frame, node, focus, ego_m, other_m, conflict_xy_m),
    )


def stories(choices: Choices) -> Iterator[tuple[int, list[Encounter]]]:
    """Every ego of a run with its encounters, one after the other."""
    starts = np.flatnonzero(np.diff(choices.ego, prepend=-1))
    for rows in np.split(np.arange(len(choices.ego)), starts[1:]):
        met = [_encounter(choices, part) for part in _parts(choices, rows) if len(part) >= MIN_ROWS]
        if met:
            yield int(choices.ego[rows[0]]), met


def _parts(choices: Choices, rows: IntArray) -> Iterator[IntArray]:
    """The rows of an ego, cut where its focus is another place on its way."""
    frame = choices.frame[rows]
    travelled_m = choices.run.trajectories.travelled_at(choices.ego[rows], frame)
    place_m = travelled_m + choices.nearest_m[rows]
    begin = 0
    for k in range(1, len(rows)):
        elsewhere = abs(place_m[k] - place_m[begin]) > PLACE_M
        if elsewhere or frame[k] - frame[k - 1] > GAP_FRAMES:
            yield rows[begin:k]
            begin = k
    yield rows[begin:]


def _encounter(choices: Choices, rows: IntArray) -> Encounter:
    # Everybody met is judged from the last time that both were still before their conflict.
    row, m = np.nonzero(choices.focus[rows][:, 1:])
    row, m = rows[row], m + 1
    ahead = (choices.ego_m[row, m] >= 0.0) & (choices.other_m[row, m] >= 0.0)
    order = np.lexsort((choices.frame[row], ahead))
    last = {int(choices.node[row[k], m[k]]): int(k) for k in order}
    at = np.array(list(last.values()))
    row, m = row[at], m[at]
    other = choices.node[row, m]
    trajectories, limit = choices.run.trajectories, NEXT_FRAMES + FOLLOW_FRAMES
    frame, where = choices.frame[row], choices.conflict_xy_m[row, m]
    ego_m, other_m = choices.ego_m[row, m], choices.other_m[row, m]
    other_at = crossing_frame(trajectories, other, frame, other_m, where, limit)
    ego_at = crossing_frame(trajectories, choices.ego[row], frame, ego_m, where, limit)
    before = (other_at >= 0) & ((ego_at < 0) | (other_at <= ego_at))
    after = (ego_at >= 0) & (other_at > ego_at) & (other_at - ego_at <= FOLLOW_FRAMES)
    order = np.argsort(other_at, kind="stable")
    first, then = order[before[order]], order[after[order]]
    crossed = ego_at[(frame == frame.max()) & (ego_at >= 0)]
    return Encounter(
        rows=rows,
        first_frame=int(choices.frame[rows[0]]),
        last_frame=int(choices.frame[rows[-1]]),
        crossed_frame=int(crossed.min()) if len(crossed) else None,
        let_go=tuple(other[first].tolist()),
        let_go_frame=tuple(other_at[first].tolist()),
        passed=tuple(other[then].tolist()),
        passed_frame=tuple(other_at[then].tolist()),
    )
