"""Which slot an ego is advised: the likely one, where it is safe and within comfort; else silence.

The probabilities say what people would do. Unsafe is a pass where somebody may plausibly enter the
area before the ego is out of it, and a yield that comes too late to stay out.

Letters as in `datatypes`, and R egos that have a choice, P of them that may have to pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from hatn_sim.assist.outlook import (
    Outlook,
    approaches,
    in_the_way,
    pass_margins_s,
    travel_at,
)
from hatn_sim.assist.profile import (
    COMFORT_BRAKING_MPS2,
    KNOT_AT_S,
    SHORT_M,
    Profiles,
    drive,
)
from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Scene, SemanticGraphs

SPEAK_MARGIN: Final = 0.4
"""Advice begins where the best slot leads the next by this much ..."""
NEAR_S: Final = 4.0
NEAR_M: Final = 20.0
"""Nor does it begin farther than either from the conflict, at the present speed."""
SILENT_MARGIN: Final = -0.4
"""... and is doubted where another leads the one advised by this much."""
DOUBT_S: Final = 0.5
"""Advice that is doubted for so long changes; at once where it would be unsafe."""
PASS_MARGIN_S: Final = 0.3
"""A pass is advised where the ego is out so long before anybody may plausibly come in ..."""
KEEP_MARGIN_S: Final = 0.0
"""... and stays advised while it is out before, or could still be given up."""
SURE: Final = 0.95
SURE_KEEP_S: Final = 0.3
"""A pass as probable as this stays advised where the predicted entries leave so much time, whoever
might plausibly come sooner. Where there is time for a pass, a yield begins only if as probable."""
WAIT_KNOT: Final = 4
"""Whoever can still stop in comfort after so many knots of a pass, a second, need not give it up
yet."""
REACTION_S: Final = 1.0
"""A driver who is told to yield begins to brake after so long (METHOD section 7)."""
FEASIBLE_BAND: Final = 0.15
"""A suggestion stays feasible, or infeasible, within this share of the comfort limit."""
EDGE_M: Final = 0.1
"""Whose nose gets no farther than this into an area stays out of it."""
STANDING_MPS: Final = 0.3
ROUNDING_S: Final = 1e-6
HORIZON_S: Final = float(KNOT_AT_S[-1])


class Why(IntEnum):
    """Why an ego is told what it is told, or nothing."""

    LIKELY = 0  # told: the most probable slot
    LIKELY_UNSAFE = 1  # told, as the most probable slot is not safe, or asks for more than comfort
    HELD = 2  # told before, and kept, though another slot is more probable now
    FAR = 3  # silent, as the following: the conflict is far
    UNSURE = 4  # no slot leads the next by enough
    SETTLING = 5  # the slot has not been the best for long enough
    UNSAFE_PASS = 6  # the likely pass is not safe
    TOO_LATE = 7  # a yield would ask for more than comfort
    GONE_IN_TIME = 8  # the ego is likely to be out before the other comes
    IN_THE_WAY = 9  # the ego is in the other's way already
    OTHER_WAITS = 10  # the other is likelier to wait for the ego
    STANDS = 11  # both stand, and nobody can tell who will go
    SAID_OTHERWISE = 12  # the opposite has been said in this encounter
    MUTUAL = 13  # the other is told to yield
    AGAINST_LIKELY = 14  # the likely pass is possible, and a yield would be told


@dataclass(frozen=True)
class Told:
    """What an ego was told last."""

    slot_id: str  # the rear vehicle of the slot: the ego itself for a yield
    other_id: str  # whom to pass before, or to let go first
    action: str
    feasible: bool
    doubted_s: float | None = None  # since when another slot would have been advised
    said: frozenset[tuple[str, str]] = frozenset()  # (action, other vehicle) of all that was said
    time_s: float = 0.0


def first_of_others(focus_mask: BoolArray, chances: FloatArray) -> IntArray:
    """The node [R] of whoever is most probably the first of the others at the focus.

    The chance to pass before j is that of the ego being first and j the first of the others.
    """
    others = np.where(focus_mask, chances, -1.0)
    others[:, 0] = -1.0
    return others.argmax(axis=1)


@dataclass(frozen=True, eq=False)
class _Chances:
    """Probabilities of the slots of each ego [R]."""

    of: FloatArray  # [R, M], -1 where there is no slot
    best: IntArray  # [R]
    second: FloatArray  # [R] of the best but one

    def margin(self, slot: IntArray) -> FloatArray:
        """[R] by which slots [R] lead the best of the others."""
        rows = np.arange(len(slot))
        others = np.where(slot == self.best, self.second, self.of[rows, self.best])
        return np.asarray(self.of[rows, slot] - others)


def _chances(focus_mask: BoolArray, chances: FloatArray) -> _Chances:
    of = np.where(focus_mask, chances, -1.0)
    best = of.argmax(axis=1)
    others = of.copy()
    others[np.arange(len(of)), best] = -1.0
    return _Chances(of, best, others.max(axis=1))


@dataclass(frozen=True, eq=False)
class Likely:
    """The slot that each ego [R] is to take if nothing speaks against it."""

    chances: _Chances
    first: IntArray  # [R] the node of whoever is most probably the first of the others
    told: IntArray  # [R] the slot told before, -1: none, or it is gone
    still_there: BoolArray  # [R] whom it was about
    slot: IntArray  # [R]
    near: BoolArray  # [R] the conflict
    speaks: BoolArray  # [R] clearly enough to say so
    begins: BoolArray  # [R] it is a yield not told before
    other_yields: FloatArray  # [R] how probably whoever is first lets the ego go


def likely_slots(
    scene: Scene,
    graphs: SemanticGraphs,
    slot_probability: FloatArray,
    row: IntArray,
    before: Sequence[Told | None],
) -> Likely:
    """The slot told before, until another is clearly more probable."""
    focus = graphs.focus_mask[row]
    chances = _chances(focus, slot_probability[row])
    index = {name: v for v, name in enumerate(scene.ids)}
    rear = [
        -2 if told is None or told.action == "abstain" else index.get(told.slot_id, -2)
        for told in before
    ]
    same = focus & (graphs.rear[row] == np.array(rear)[:, None])
    about = [-2 if told is None else index.get(told.other_id, -2) for told in before]
    still_there = (focus & (graphs.rear[row] == np.array(about)[:, None])).any(axis=1)
    first = first_of_others(focus, slot_probability[row])
    told = np.where(same.any(axis=1), same.argmax(axis=1), -1)
    stands = (told >= 0) & (chances.margin(np.maximum(told, 0)) > SILENT_MARGIN)
    slot = np.where(stands, told, chances.best)
    speed = scene.speed_mps[graphs.ego[row]]
    near = graphs.ego_to_conflict_m[row, 0] <= np.maximum(NEAR_S * speed, NEAR_M)
    speaks = stands | ((told >= 0) | near) & (chances.margin(slot) >= SPEAK_MARGIN)
    return Likely(
        chances,
        first,
        told,
        still_there,
        slot,
        near,
        speaks,
        (told != 0) & (slot == 0) & speaks,
        _yields_to(graphs, slot_probability, row, first),
    )


def _yields_to(
    graphs: SemanticGraphs, slot_probability: FloatArray, row: IntArray, first: IntArray
) -> FloatArray:
    """How probably the vehicles of nodes [R] yield, each to the ego of its graph [R].

    0 where one has no graph of its own, or somebody else is the first of the others there.
    """
    row_of = np.full(len(graphs.ids), -1)
    row_of[graphs.ego] = np.arange(len(graphs.ego))
    its = row_of[graphs.rear[row, first]]
    its_first = first_of_others(graphs.focus_mask[its], slot_probability[its])
    meets = (its >= 0) & graphs.focus_mask[its, its_first]
    meets &= graphs.rear[its, its_first] == graphs.ego[row]
    return np.where(meets, slot_probability[its, 0], 0.0)


@dataclass(frozen=True, eq=False)
class Options:
    """What becomes of each ego [R] if it yields, or passes first of all.

    A pass is driven only where it is in question; elsewhere its margins are minus infinity.
    """

    driven: Profiles  # [R + P] all yields, then the passes
    of_pass: IntArray  # [R] the row in `driven`, of the yield where no pass is driven
    open_s: FloatArray  # [R] when the way is open on a yield
    let_go: IntArray  # [R] how many go first then
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
    approach, open_s = approaches(outlook, row[which], slot, likely.first[which], stopped[which])
    driven = drive(approach)
    yields, passes = driven.of(np.arange(count)), driven.of(np.arange(count, len(which)))
    area_m, opens = (of[:count, : group.shape[1]] for of in (approach.area_m, approach.open_s))
    # At the focus: what is further on can be seen to when this is behind.
    ahead = group & np.isfinite(area_m)
    enters_s = yields.arrival_s(np.where(ahead, np.maximum(area_m, 0.0) + EDGE_M, np.inf))
    margin, likely_margin = np.full((2, count), -np.inf)
    margin[passing], likely_margin[passing] = pass_margins_s(outlook, row[passing], passes)
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
        of_pass=of_pass,
        open_s=open_s[:count],
        let_go=ahead.sum(axis=1),
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


@dataclass(frozen=True, eq=False)
class Chosen:
    """What each ego [R] is advised."""

    slot: IntArray
    other: IntArray  # the vehicle to pass before, or the first to let go
    speaks: BoolArray
    feasible: BoolArray
    doubted_s: tuple[float | None, ...]  # since when another slot would have been advised
    why: IntArray  # of Why


def choose(
    outlook: Outlook,
    row: IntArray,
    likely: Likely,
    options: Options,
    before: Sequence[Told | None],
) -> Chosen:
    """The likely slot, if it is safe; once told, a slot stays for as long as it can.

    Advice begins only where it is what the driver is likely to do, and safe or at least within
    comfort: of danger, alerts warn. It is taken back by silence, not by its opposite: but for a
    pass that is not safe any more, while a yield still is within comfort.
    """
    was_feasible = np.array([told is None or told.feasible for told in before])
    now_s = outlook.scene.time_s
    since = [None if told is None else told.doubted_s for told in before]
    since_s = np.array([now_s if one is None else one for one in since])
    told, wants_pass = likely.told, likely.slot > 0
    keeps = wants_pass & (likely.slot == told)
    safe = options.margin_s >= np.where(told > 0, KEEP_MARGIN_S, PASS_MARGIN_S)
    sure = likely.chances.of[np.arange(len(row)), likely.slot] >= SURE
    safe |= keeps & (options.can_wait | (sure & (options.likely_margin_s >= SURE_KEEP_S)))
    band = np.where(was_feasible, 1.0 + FEASIBLE_BAND, 1.0 - FEASIBLE_BAND)
    gentle = options.stays_out & (options.braking_mps2 <= COMFORT_BRAKING_MPS2 * band)
    # Braking hard is worse than a pass that is only unlikely to be in somebody's way.
    may_pass = safe | (~gentle & (options.likely_margin_s > 0.0)) | ~options.stays_out
    passes = np.where(wants_pass, may_pass, ~options.stays_out)
    slot = np.where(passes, np.where(wants_pass, likely.slot, likely.first), 0)
    slot = np.where(likely.speaks, slot, likely.slot)
    holds = (
        (told >= 0) & likely.still_there & (slot != told) & (now_s - since_s < DOUBT_S - ROUNDING_S)
    )
    holds &= np.where(told > 0, may_pass, options.stays_out)
    slot = np.where(holds, told, slot)
    doubted = tuple(
        one if held else None for one, held in zip(since_s.tolist(), holds.tolist(), strict=True)
    )
    goes, begins = slot > 0, slot != told
    own_yield, likely_free = likely.chances.of[:, 0], options.likely_margin_s > 0.0
    graphs, speed = outlook.graphs, outlook.scene.speed_mps
    fastest = np.maximum(speed[graphs.ego[row]], speed[graphs.rear[row, likely.first]])
    other = graphs.rear[row, np.where(goes, slot, likely.first)]
    names = [outlook.scene.ids[v] for v in other.tolist()]
    yields, begins_to_yield = ~goes, begins & ~goes
    in_way = in_the_way(outlook, row)[np.arange(len(row)), likely.first]
    silent = {
        Why.FAR: ~(likely.speaks | holds) & ~likely.near & (told < 0),
        Why.UNSURE: ~(likely.speaks | holds),
        Why.UNSAFE_PASS: begins & goes & ~safe & options.stays_out,
        # A yield does not begin where it asks for more than comfort, ...
        Why.TOO_LATE: begins_to_yield & ~gentle,
        Why.AGAINST_LIKELY: begins_to_yield & wants_pass & ~(keeps & gentle),
        # ... or the ego is likely to be gone in time and might do otherwise, ...
        Why.GONE_IN_TIME: begins_to_yield & likely_free & (own_yield < SURE),
        # ... nor where it is in the other's way already.
        Why.IN_THE_WAY: begins_to_yield & in_way,
        # Nobody is told to yield to one who is likelier to wait for him.
        Why.OTHER_WAITS: yields
        & ~holds
        & wants_pass
        & likely_free
        & (likely.other_yields > own_yield),
        # Of two who wait for each other, nobody can tell who will go.
        Why.STANDS: (fastest < STANDING_MPS) & yields & (wants_pass | (own_yield < SURE)),
        Why.SAID_OTHERWISE: _contradicts(before, goes, names) & (goes | safe),
    }
    speaks = ~np.any(list(silent.values()), axis=0)
    silent[Why.MUTUAL] = _less_likely_of_two(speaks & yields, graphs.ego[row], other, own_yield)
    is_best, is_unsafe = slot == likely.chances.best, np.where(wants_pass, ~safe, ~gentle)
    told_as = np.where(is_best, Why.LIKELY, np.where(is_unsafe, Why.LIKELY_UNSAFE, Why.HELD))
    why = np.select(list(silent.values()), list(silent), told_as)
    speaks &= ~silent[Why.MUTUAL]
    return Chosen(slot, other, speaks, np.where(goes, safe, gentle), doubted, why)


def _contradicts(before: Sequence[Told | None], goes: BoolArray, names: list[str]) -> BoolArray:
    """Whether egos [R] have been told the opposite about the same other vehicle."""
    opposite = ["yield" if one else "pass" for one in goes.tolist()]
    return np.array(
        [
            told is not None and pair in told.said
            for told, pair in zip(before, zip(opposite, names, strict=True), strict=True)
        ],
        dtype=np.bool_,
    )


def _less_likely_of_two(
    yields: BoolArray, ego: IntArray, other: IntArray, chance: FloatArray
) -> BoolArray:
    """Of each two who are told to yield to one another, the one [R] less likely to."""
    if not len(ego):
        return yields
    count = int(max(ego.max(), other.max())) + 1
    lets_go, chance_of = np.full(count, -1), np.zeros(count)
    lets_go[ego[yields]] = other[yields]
    chance_of[ego] = chance
    mutual = yields & (lets_go[other] == ego)
    its = chance_of[other]
    return np.asarray(mutual & ((chance < its) | ((chance == its) & (ego < other))))
