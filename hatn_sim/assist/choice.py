"""Which slot an ego is advised: the likely one, where it is safe and within comfort; else silence.

The probabilities say what people would do. Unsafe is a pass where somebody may plausibly enter the
area before the ego is out of it, and a yield that comes too late to stay out.

Letters as in `datatypes`, and R egos that have a choice, P of them that may have to pass.
"""

from __future__ import annotations

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
from hatn_sim.assist.rings import weakest_of_rings
from hatn_sim.assist.told import ACTIONS, Before
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
SETTLE_S: Final = 0.3
"""Advice begins when it has been the best for so long; at once in place of what is unsafe."""
LEAST_S: Final = 1.0
"""Advice says the same for so long (action, whom it names, feasible), but where that is unsafe."""
HARD_MPS2: Final = 4.5
"""Braking that is evasive (METHOD section 7): it is told at once."""
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
    MUTUAL = 13  # the other is told to yield, to the ego or to somebody who is to yield to it
    BRIEF = 14  # it would be over before a driver could react
    ALERTED = 15  # an alert tells the opposite


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
    named: IntArray  # [R] the node of whoever has to be let go on a yield
    told: IntArray  # [R] the slot told before; -1: none, or it is done
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
    before: Before,
) -> Likely:
    """The slot told before, until another is clearly more probable."""
    focus = graphs.focus_mask[row]
    chances = _chances(focus, slot_probability[row])
    # Who waits, and had better wait for the next ones, too, is told one thing.
    nothing = np.zeros(len(row), dtype=np.int64)
    on_yield = (before.told < 0) & (before.action == 0) & (chances.margin(nothing) >= SPEAK_MARGIN)
    told = np.where(on_yield, 0, before.told)
    first = first_of_others(focus, slot_probability[row])
    stands = (told >= 0) & (chances.margin(np.maximum(told, 0)) > SILENT_MARGIN)
    slot = np.where(stands, told, chances.best)
    speed = scene.speed_mps[graphs.ego[row]]
    near = graphs.ego_to_conflict_m[row, 0] <= np.maximum(NEAR_S * speed, NEAR_M)
    speaks = stands | ((told >= 0) | near) & (chances.margin(slot) >= SPEAK_MARGIN)
    keeps_name = (before.about >= 0) & (scene.time_s - before.since_s < LEAST_S - ROUNDING_S)
    return Likely(
        chances,
        first,
        np.where(keeps_name, before.about, first),
        told,
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
    approach, open_s = approaches(outlook, row[which], slot, likely.named[which], stopped[which])
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


@dataclass(frozen=True, eq=False)
class Chosen:
    """What each ego [R] is advised."""

    slot: IntArray
    node: IntArray  # of the vehicle to pass before, or of one to let go ...
    other: IntArray  # ... that vehicle
    speaks: BoolArray
    feasible: BoolArray
    why: IntArray  # of Why
    since_s: FloatArray  # when it began to say the same
    doubted_s: FloatArray  # since when other advice would have been given, nan: not
    wanted: IntArray  # what waits to be the best for long enough, into ACTIONS; -1: nothing does
    wanted_s: FloatArray  # since when


def choose(
    outlook: Outlook, row: IntArray, likely: Likely, options: Options, before: Before
) -> Chosen:
    """The likely slot, if it is safe; once told, a slot stays for as long as it can.

    Advice begins only where it is what the driver is likely to do, and safe or at least within
    comfort: of danger, alerts warn. It is taken back by silence, not by its opposite: but for a
    pass that is not safe any more, while a yield still is within comfort.
    """
    rows, now_s, told = np.arange(len(row)), outlook.scene.time_s, likely.told
    graphs, own_yield = outlook.graphs, likely.chances.of[:, 0]
    wants_pass, free = likely.slot > 0, options.likely_margin_s > 0.0
    keeps = wants_pass & (likely.slot == told)
    safe = options.margin_s >= np.where(told > 0, KEEP_MARGIN_S, PASS_MARGIN_S)
    sure = likely.chances.of[rows, likely.slot] >= SURE
    safe |= keeps & (options.can_wait | (sure & (options.likely_margin_s >= SURE_KEEP_S)))
    band = np.where((told < 0) | before.feasible, 1.0 + FEASIBLE_BAND, 1.0 - FEASIBLE_BAND)
    gentle = options.stays_out & (options.braking_mps2 <= COMFORT_BRAKING_MPS2 * band)
    # Braking hard is worse than a pass that is only unlikely to be in somebody's way.
    may_pass = safe | (~gentle & free) | ~options.stays_out
    passes = np.where(wants_pass, may_pass, ~options.stays_out)
    slot = np.where(passes, np.where(wants_pass, likely.slot, likely.first), 0)
    slot = np.where(likely.speaks, slot, likely.slot)
    named = _named(outlook, row, likely, options, before)
    silent = _silences(outlook, row, likely, options, before, slot, named, safe, gentle)
    # What was told stays while it may, until other advice has been better for a while.
    is_doubted = (told >= 0) & ((slot != told) | np.any(list(silent.values()), axis=0))
    since_s = np.where(np.isnan(before.doubted_s), now_s, before.doubted_s)
    young = now_s - before.since_s < LEAST_S - ROUNDING_S
    holds = is_doubted & np.where(told > 0, may_pass, options.stays_out)
    holds &= young | (now_s - since_s < DOUBT_S - ROUNDING_S)
    slot = np.where(holds, told, slot)
    silent = {why: where & ~holds for why, where in silent.items()}
    goes = slot > 0
    goes_on = (told >= 0) & (goes == (told > 0))
    node = np.where(goes, slot, named)
    # A driver needs a while to do what he is told, and it should not be over by then.
    lasts_s = np.where(goes, options.done_s, options.open_s)
    silent[Why.BRIEF] = ~(goes_on & (node == before.about)) & (lasts_s < REACTION_S)
    wants = ~goes_on & (before.action != goes) & ~np.any(list(silent.values()), axis=0)
    wanted_s = np.where(before.wanted == goes, np.minimum(before.wanted_s, now_s), now_s)
    urgent = ((told > 0) & ~may_pass) | (goes & ~options.stays_out)
    silent[Why.SETTLING] = wants & ~urgent & (now_s - wanted_s < SETTLE_S - ROUNDING_S)
    speaks = ~np.any(list(silent.values()), axis=0)
    other = graphs.rear[row, node]
    silent[Why.MUTUAL] = weakest_of_rings(
        speaks & ~goes, graphs.ego[row], other, own_yield + 2.0 * goes_on
    )
    speaks &= ~silent[Why.MUTUAL]
    # How it is said stays, too.
    feasible = np.where(goes, safe, gentle)
    alarming = ~feasible & np.where(goes, ~free, options.braking_mps2 > HARD_MPS2)
    says_on = speaks & goes_on & (node == before.about)
    feasible = np.where(says_on & young & ~alarming, before.feasible, feasible)
    is_best, unsafe = slot == likely.chances.best, np.where(goes, ~gentle, ~may_pass)
    why = np.where(is_best, Why.LIKELY, np.where(unsafe, Why.LIKELY_UNSAFE, Why.HELD))
    return Chosen(
        slot=slot,
        node=node,
        other=other,
        speaks=speaks,
        feasible=feasible,
        why=np.select(list(silent.values()), list(silent), why),
        since_s=np.where(says_on & (feasible == before.feasible), before.since_s, now_s),
        doubted_s=np.where(holds, since_s, np.nan),
        wanted=np.where(silent[Why.SETTLING], goes, -1),
        wanted_s=wanted_s,
    )


def _named(
    outlook: Outlook, row: IntArray, likely: Likely, options: Options, before: Before
) -> IntArray:
    """The node [R] that a yield names: the same as before, while it is among those to let go.

    Else the likeliest to be first, of those that are not gone in no time, if there are any.
    """
    there = options.let_go & (outlook.leave_s[row] >= LEAST_S)
    chance = np.where(there, likely.chances.of, -1.0)
    named = np.where(there.any(axis=1), chance.argmax(axis=1), likely.named)
    stays = (likely.told == 0) & (before.about >= 0)
    stays &= options.let_go[np.arange(len(stays)), before.about]
    return np.where(stays, before.about, named)


def _silences(
    outlook: Outlook,
    row: IntArray,
    likely: Likely,
    options: Options,
    before: Before,
    slot: IntArray,
    named: IntArray,
    safe: BoolArray,
    gentle: BoolArray,
) -> dict[Why, BoolArray]:
    """What keeps the assistant from advising egos to take slots [R]; the first cause counts."""
    graphs, speed = outlook.graphs, outlook.scene.speed_mps
    own_yield, free = likely.chances.of[:, 0], options.likely_margin_s > 0.0
    goes, changes, wants_pass = slot > 0, slot != likely.told, likely.slot > 0
    fastest = np.maximum(speed[graphs.ego[row]], speed[graphs.rear[row, likely.first]])
    other = graphs.rear[row, np.where(goes, slot, named)]
    yields, begins_to_yield = ~goes, changes & ~goes
    return {
        Why.FAR: ~likely.speaks & ~likely.near & (likely.told < 0),
        Why.UNSURE: ~likely.speaks,
        Why.UNSAFE_PASS: (changes & goes & ~safe & options.stays_out)
        | (begins_to_yield & wants_pass & ~((likely.slot == likely.told) & gentle)),
        # A yield does not begin where it asks for more than comfort, ...
        Why.TOO_LATE: begins_to_yield & ~gentle,
        # ... or the ego is likely to be gone in time and might do otherwise, ...
        Why.GONE_IN_TIME: begins_to_yield & free & (own_yield < SURE),
        # ... nor where it is in the other's way already.
        Why.IN_THE_WAY: begins_to_yield & in_the_way(outlook, row)[np.arange(len(row)), named],
        # Nobody is told to yield to one who is likelier to wait for him.
        Why.OTHER_WAITS: yields & wants_pass & free & (likely.other_yields > own_yield),
        # Of two who wait for each other, nobody can tell who will go.
        Why.STANDS: (fastest < STANDING_MPS) & yields & (wants_pass | (own_yield < SURE)),
        Why.SAID_OTHERWISE: _contradicts(outlook, before, goes, other) & (goes | safe),
    }


def _contradicts(outlook: Outlook, before: Before, goes: BoolArray, other: IntArray) -> BoolArray:
    """Whether egos [R] have been told the opposite about the same other vehicles [R]."""
    ids = outlook.scene.ids
    return np.array(
        [
            (ACTIONS[not one], ids[v]) in said
            for said, one, v in zip(before.said, goes.tolist(), other.tolist(), strict=True)
        ],
        dtype=np.bool_,
    )
