"""What becomes of egos that yield, or pass first of all.

Letters as in `datatypes`, and R egos that have a choice, P of them that may have to pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.assist.likely import Likely
from hatn_sim.assist.outlook import Outlook, approaches, in_the_way, pass_margins_s, travel_at
from hatn_sim.assist.profile import (
    COMFORT_BRAKING_MPS2,
    KNOT_AT_S,
    SHORT_M,
    Approach,
    Profiles,
    drive,
)
from hatn_sim.datatypes import BoolArray, FloatArray, IntArray

WAIT_KNOT: Final = 4
"""Whoever can still stop in comfort after so many knots of a pass, a second, need not give it up
yet."""
REACTION_S: Final = 1.0
"""A driver who is told to yield begins to brake after so long (METHOD section 7)."""
EDGE_M: Final = 0.1
"""Whose nose gets no farther than this into an area stays out of it."""
HORIZON_S: Final = float(KNOT_AT_S[-1])


@dataclass(frozen=True, eq=False)
class Options:
    """What becomes of each ego [R] if it yields, or passes first of all.

    A pass is driven only where it is in question; elsewhere its margins are minus infinity.
    """

    driven: Profiles  # [R + P] all yields, then the passes
    approach: Approach  # [R + P] what these keep to
    leader: IntArray  # [R + P, G] who is ahead at their knots, -1: nobody
    of_pass: IntArray  # [R] the row in `driven`, of the yield where no pass is driven
    open_s: FloatArray  # [R] when the way is open on a yield
    let_go: BoolArray  # [R, M] who goes first then
    done_s: FloatArray  # [R] when the ego is past all conflicts on a pass; 0 where none is driven
    stays_out: BoolArray  # [R] on a yield, if need be by braking hard
    can_wait: BoolArray  # [R] a pass can still be given up for a while, in comfort
    braking_mps2: FloatArray  # [R] of the yield; evenly, after reacting, where it would be new
    margin_s: FloatArray  # [R] of the pass, at the earliest plausible entry of anybody
    likely_margin_s: FloatArray  # [R] of the pass, at the predicted one


def weigh_options(outlook: Outlook, row: IntArray, likely: Likely, stopped: BoolArray) -> Options:
    graphs, count = outlook.graphs, len(row)
    group = graphs.focus_mask[row] & (np.arange(graphs.rear.shape[1]) > 0)
    still_ahead = group & ~in_the_way(outlook, row)
    has_begun = ~still_ahead.any(axis=1)
    room_m = np.where(group, outlook.room_m[row], np.inf).min(axis=1)
    speed = outlook.scene.speed_mps[graphs.ego[row]]
    asks = (likely.slot > 0) | likely.begins | has_begun | ~_stops(speed, room_m)
    driven_m, then_mps = _after_reacting(outlook, graphs.ego[row])
    asks |= (likely.told != 0) & ~_stops(then_mps, room_m - driven_m)
    passing = np.flatnonzero(asks)
    # Whoever it is passed before, the ego drives as fast as it may.
    which = np.concatenate((np.arange(count), passing))
    slot = np.concatenate((np.zeros(count, dtype=np.int64), likely.first[passing]))
    approach, open_s, ahead_of = approaches(
        outlook, row[which], slot, likely.named[which], stopped[which]
    )
    driven = drive(approach)
    yields, passes = driven.of(np.arange(count)), driven.of(np.arange(count, len(which)))
    area_m, opens = (of[:count, : group.shape[1]] for of in (approach.area_m, approach.open_s))
    # At the focus: what is further on can be seen to when this is behind.
    ahead = group & np.isfinite(area_m)
    enters_s = yields.arrival_s(np.where(ahead, np.maximum(area_m, 0.0) + EDGE_M, np.inf))
    margin, likely_margin = np.full((2, count), -np.inf)
    margin[passing], likely_margin[passing] = pass_margins_s(outlook, row[passing], passes)
    done_s = np.zeros(count)
    way_m = np.where(group[passing], graphs.ego_to_conflict_m[row[passing]], 0.0).max(axis=1)
    done_s[passing] = passes.arrival_s(way_m[:, None])[:, 0]
    left_m = room_m[passing] - passes.travelled_m[:, WAIT_KNOT]
    can_wait = ~asks
    can_wait[passing] = _stops(passes.speed_mps[:, WAIT_KNOT], left_m)
    late_mps2 = _even_braking_mps2(
        then_mps[:, None], approach.area_m[:count] - driven_m[:, None], approach.open_s[:count]
    )
    late_mps2[likely.told == 0] = 0.0
    of_pass = np.arange(count)
    of_pass[passing] = np.arange(count, len(which))
    return Options(
        driven=driven,
        approach=approach,
        leader=ahead_of,
        of_pass=of_pass,
        open_s=open_s[:count],
        let_go=ahead,
        done_s=done_s,
        stays_out=(enters_s >= np.minimum(opens, HORIZON_S) - 0.1).all(axis=1) & ~has_begun,
        can_wait=can_wait,
        braking_mps2=np.maximum(yields.braking_mps2, late_mps2),
        margin_s=margin,
        likely_margin_s=likely_margin,
    )


def _after_reacting(outlook: Outlook, vehicle: IntArray) -> tuple[FloatArray, FloatArray]:
    """Way and speed [R] of vehicles as predicted, when their drivers have reacted."""
    way_m, speed_mps = travel_at(outlook.travelled_m[vehicle], np.array([REACTION_S]))
    return way_m[:, 0], speed_mps[:, 0]


def _even_braking_mps2(speed_mps: FloatArray, room_m: FloatArray, open_s: FloatArray) -> FloatArray:
    """[R] evenly, after reacting, so as to reach areas [R, K] as they open, or to stop before."""
    left_s = np.maximum(open_s - REACTION_S, 1e-3)
    even = np.maximum(2.0 * (speed_mps * left_s - room_m) / left_s**2, 0.0)
    stopping = speed_mps**2 / (2.0 * np.maximum(room_m - 0.5 * SHORT_M, 0.05))
    needed = np.where(even * left_s > speed_mps, stopping, even)
    closed = np.isfinite(room_m) & (open_s > REACTION_S)
    return np.asarray(np.where(closed, needed, 0.0).max(axis=1))


def _stops(speed_mps: FloatArray, room_m: FloatArray) -> BoolArray:
    """Whether one can stop in comfort, a little before the end of the room."""
    left_m = np.maximum(room_m - 0.5 * SHORT_M, 0.05)
    return np.asarray(speed_mps**2 <= 2.0 * COMFORT_BRAKING_MPS2 * left_m)
