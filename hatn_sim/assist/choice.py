"""Which slot an ego is advised: the likely one, where it is safe and within comfort; else silence.

The probabilities say what people would do. Unsafe is a pass where somebody may plausibly enter the
area before the ego is out of it, and a yield that comes too late to stay out.

Letters as in `datatypes`, and R egos that have a choice.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from hatn_sim.assist.likely import Likely
from hatn_sim.assist.options import REACTION_S, Options
from hatn_sim.assist.outlook import Outlook, in_the_way
from hatn_sim.assist.profile import COMFORT_BRAKING_MPS2
from hatn_sim.assist.rings import weakest_of_rings
from hatn_sim.assist.risk import STANDING_MPS
from hatn_sim.assist.told import ACTIONS, LEAST_S, ROUNDING_S, Before
from hatn_sim.datatypes import BoolArray, FloatArray, IntArray

DOUBT_S: Final = 0.5
"""Advice that is doubted for so long changes; at once where it would be unsafe."""
SETTLE_S: Final = 0.3
"""Advice begins when it has been the best for so long; at once in place of what is unsafe."""
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
FEASIBLE_BAND: Final = 0.15
"""A suggestion stays feasible, or infeasible, within this share of the comfort limit."""
GOES: Final = 0.9
"""Who is as likely as this to pass before somebody, whoever that is, is likely to go first."""


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
    WHICH_GAP = 16  # the ego is likely to go before somebody, and nobody can tell before whom


@dataclass(frozen=True, eq=False)
class Chosen:
    """What each ego [R] is advised."""

    slot: IntArray
    node: IntArray  # of the vehicle to pass before, or of one to let go ...
    other: IntArray  # ... that vehicle
    speaks: BoolArray
    feasible: BoolArray
    why: IntArray  # of Why
    why_s: FloatArray  # since when silence is explained so
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
    # What was told stays while it is safe, until other advice has been better for a while.
    urgent = (told >= 0) & ~np.where(told > 0, may_pass, options.stays_out)
    is_doubted = (told >= 0) & ((slot != told) | np.any(list(silent.values()), axis=0))
    since_s = np.where(np.isnan(before.doubted_s), now_s, before.doubted_s)
    young = now_s - before.since_s < LEAST_S - ROUNDING_S
    holds = is_doubted & ~urgent
    holds &= young | (now_s - since_s < DOUBT_S - ROUNDING_S)
    slot = np.where(holds, told, slot)
    silent = {why: where & ~holds for why, where in silent.items()}
    goes = slot > 0
    goes_on = (told >= 0) & (goes == (told > 0))
    node = np.where(goes, slot, named)
    # What is unsafe is taken back at once. Else a driver needs a while to do what he is told, and
    # it should not be over by then.
    lasts_s = np.where(goes, options.done_s, options.open_s)
    says_on = goes_on & (node == before.about)
    silent[Why.BRIEF] = ~says_on & ~urgent & (lasts_s < REACTION_S)
    wants = ~goes_on & (before.action != goes) & ~np.any(list(silent.values()), axis=0)
    wanted_s = np.where(before.wanted == goes, np.minimum(before.wanted_s, now_s), now_s)
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
    says_on &= speaks
    feasible = np.where(says_on & young & ~alarming, before.feasible, feasible)
    is_best, unsafe = slot == likely.chances.best, np.where(goes, ~gentle, ~may_pass)
    why = np.where(is_best, Why.LIKELY, np.where(unsafe, Why.LIKELY_UNSAFE, Why.HELD))
    why = np.select(list(silent.values()), list(silent), why)
    # Whoever is told why there is no advice can read it before it is something else.
    watches_on = ~speaks & (other == before.watched)
    stays = watches_on & (now_s - before.why_s < LEAST_S - ROUNDING_S)
    stays &= (why != Why.MUTUAL) & (before.why != Why.MUTUAL)
    why = np.where(stays, before.why, why)
    return Chosen(
        slot=slot,
        node=node,
        other=other,
        speaks=speaks,
        feasible=feasible,
        why=why,
        why_s=np.where(watches_on & (why == before.why), before.why_s, now_s),
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
    # Who can no longer stay out, but is likely to wait, has nothing to be told that is safe.
    astray, stands = goes & ~wants_pass & ~safe, speed[graphs.ego[row]] < STANDING_MPS
    there = in_the_way(outlook, row)[np.arange(len(row)), np.where(goes, slot, named)]
    astray_there = astray & (stands | (changes & there))
    return {
        Why.FAR: ~likely.speaks & ~likely.near & (likely.told < 0),
        Why.WHICH_GAP: ~likely.speaks & wants_pass & (own_yield <= 1.0 - GOES),
        Why.UNSURE: ~likely.speaks,
        Why.UNSAFE_PASS: (changes & goes & ~safe & options.stays_out)
        | (begins_to_yield & wants_pass & ~((likely.slot == likely.told) & gentle)),
        # A yield does not begin where it asks for more than comfort, ...
        Why.TOO_LATE: (begins_to_yield & ~gentle) | (astray & changes & ~astray_there),
        # ... or the ego is likely to be gone in time and might do otherwise, ...
        Why.GONE_IN_TIME: begins_to_yield & free & (own_yield < SURE),
        # ... nor where it is in the other's way already.
        Why.IN_THE_WAY: (begins_to_yield & there) | astray_there,
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
