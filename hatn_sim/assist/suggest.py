"""Slot probabilities -> one suggestion for every ego that has a choice (METHOD section 7).

The probabilities say what people would do. The advice is the same, unless that is unsafe (somebody
may plausibly enter the area before the ego is out of it) or asks for more than comfort.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hatn_sim.assist.outlook import Outlook, approaches, look_ahead, pass_margin_s
from hatn_sim.assist.pairs import Pairs
from hatn_sim.assist.profile import (
    COMFORT_BRAKING_MPS2,
    KNOT_S,
    KNOTS,
    SHORT_M,
    Profiles,
    drive,
)
from hatn_sim.assist.words import words
from hatn_sim.datatypes import (
    BoolArray,
    FloatArray,
    Front,
    IntArray,
    Prediction,
    Scene,
    SemanticGraphs,
    Suggestion,
)
from hatn_sim.road import Road

SPEAK_MARGIN: Final = 0.4
"""Advice begins where the best slot leads the next by this much ..."""
NEAR_S: Final = 4.0
NEAR_M: Final = 20.0
"""Nor does it begin farther than either from the conflict, at the present speed."""
SILENT_MARGIN: Final = -0.4
"""... and is doubted where another leads the one advised by this much."""
DOUBT_S: Final = 0.5
"""Advice that is doubted for so long changes; at once where it would be unsafe."""
PASS_MARGIN_S: Final = 0.1
"""A pass is advised where the ego is out so long before anybody may plausibly come in ..."""
KEEP_PASS_MARGIN_S: Final = 0.0
"""... and stays advised while it is out before."""
WAIT_KNOT: Final = 2
"""Whoever can still stop in comfort after so many knots of a pass need not give it up yet."""
FEASIBLE_BAND: Final = 0.15
"""A suggestion stays feasible, or infeasible, within this share of the comfort limit."""
ROUNDING_S: Final = 1e-6
HORIZON_S: Final = KNOTS * KNOT_S
OUT_M: Final = 0.25
"""A yield works if the ego gets no farther than this into an area before it opens."""
AT_LINE_M: Final = 3.0
STANDING_MPS: Final = 0.3


@dataclass(frozen=True)
class Told:
    """What an ego was told last."""

    slot_id: str  # the rear vehicle of the slot: the ego itself for a yield
    action: str
    feasible: bool
    doubted_s: float | None = None  # since when another slot would have been advised


@dataclass(frozen=True)
class SuggestionState:
    """What every advised ego was told last, by its id, and who has stopped at the line ahead."""

    told: Mapping[str, Told] = field(default_factory=dict[str, Told])
    stopped: frozenset[str] = frozenset()


def suggest(
    state: SuggestionState,
    road: Road,
    scene: Scene,
    prediction: Prediction,
    egos: frozenset[str] | None,
    pairs: Pairs | None = None,
) -> tuple[SuggestionState, tuple[Suggestion, ...]]:
    """Suggestions of this moment for `egos` (None: all) with at least two slots to choose from.

    `pairs` are those of the moment, if they are known already.
    """
    graphs, chances = prediction.graphs, prediction.slot_probability
    assert graphs is not None and chances is not None
    stopped = stopped_at_line(state.stopped, scene, graphs)
    # At a red light there is nothing to choose.
    choice = graphs.has_conflict & (graphs.focus_mask.sum(axis=1) > 1) & ~graphs.ego_at_red
    if egos is not None:
        choice &= np.array([scene.ids[v] in egos for v in graphs.ego.tolist()], dtype=np.bool_)
    row = np.flatnonzero(choice)
    if not len(row):
        return SuggestionState(stopped=stopped), ()
    names = [scene.ids[v] for v in graphs.ego[row].tolist()]
    before = [state.told.get(name) for name in names]
    outlook = look_ahead(road, scene, prediction, pairs)
    likely = _likely(scene, graphs, chances, row, before)
    has_stopped = np.array([name in stopped for name in names])
    options = _options(outlook, row, likely.first, has_stopped)
    chosen = _choose(outlook, row, likely, options, before)
    out = _suggestions(outlook, row, likely, options, chosen)
    told = {
        one.ego_id: Told(scene.ids[graphs.rear[e, m]], one.action, one.feasible, doubted_s)
        for one, e, m, doubted_s in zip(
            out, row.tolist(), chosen.slot.tolist(), chosen.doubted_s, strict=True
        )
    }
    return SuggestionState(told, stopped), out


def slot_profiles(
    state: SuggestionState,
    outlook: Outlook,
    row: IntArray,
    slot: IntArray,
    chances: FloatArray,
    start_s: float = 0.0,
) -> Profiles:
    """How egos of graphs [R] take slots [R], advised or not, from `start_s` on.

    `state` is what `suggest` gave for the moment, `chances` are the slot probabilities [E, M]. The
    speeds of a plan are `tick_speed_mps()`.
    """
    names = [outlook.scene.ids[v] for v in outlook.graphs.ego[row].tolist()]
    has_stopped = np.array([name in state.stopped for name in names], dtype=np.bool_)
    first = first_of_others(outlook.graphs.focus_mask[row], chances[row])
    return drive(approaches(outlook, row, slot, first, has_stopped, start_s)[0])


def first_of_others(focus_mask: BoolArray, chances: FloatArray) -> IntArray:
    """The node [R] of whoever is most probably the first of the others at the focus.

    The chance to pass before j is that of the ego being first and j the first of the others.
    """
    others = np.where(focus_mask, chances, -1.0)
    others[:, 0] = -1.0
    return others.argmax(axis=1)


def stopped_at_line(before: frozenset[str], scene: Scene, graphs: SemanticGraphs) -> frozenset[str]:
    """Who has stood at the stop line ahead: told once, until the line is behind."""
    line = graphs.front_type[:, 0] == Front.STOP
    near = line & (graphs.x[:, 0, -1, 6] < AT_LINE_M)
    stands = near & (scene.speed_mps[graphs.ego] < STANDING_MPS)
    now = {scene.ids[v] for v in graphs.ego[stands].tolist()}
    if before:
        now |= before & {scene.ids[v] for v in graphs.ego[near].tolist()}
    return frozenset(now)


@dataclass(frozen=True, eq=False)
class _Likely:
    """The slot that each ego [R] is to take if nothing speaks against it."""

    chance: FloatArray  # [R, M], -1 where there is no slot
    first: IntArray  # [R] the node of whoever is most probably the first of the others
    told: IntArray  # [R] the slot told before, -1: none, or it is gone
    slot: IntArray  # [R]
    speaks: BoolArray  # [R] clearly enough to say so

    def margin(self, slot: IntArray) -> FloatArray:
        """[R] by which slots [R] lead the best of the others."""
        return _margin(self.chance, slot)


def _likely(
    scene: Scene,
    graphs: SemanticGraphs,
    chances: FloatArray,
    row: IntArray,
    before: Sequence[Told | None],
) -> _Likely:
    """The slot told before, until another is clearly more probable."""
    chance = np.where(graphs.focus_mask[row], chances[row], -1.0)
    index = {name: v for v, name in enumerate(scene.ids)}
    rear = [
        -2 if told is None or told.action == "abstain" else index.get(told.slot_id, -2)
        for told in before
    ]
    same = graphs.focus_mask[row] & (graphs.rear[row] == np.array(rear)[:, None])
    first = first_of_others(graphs.focus_mask[row], chances[row])
    told = np.where(same.any(axis=1), same.argmax(axis=1), -1)
    stands = (told >= 0) & (_margin(chance, np.maximum(told, 0)) > SILENT_MARGIN)
    slot = np.where(stands, told, chance.argmax(axis=1))
    speed = scene.speed_mps[graphs.ego[row]]
    near = graphs.ego_to_conflict_m[row, 0] <= np.maximum(NEAR_S * speed, NEAR_M)
    speaks = stands | ((told >= 0) | near) & (_margin(chance, slot) >= SPEAK_MARGIN)
    return _Likely(chance, first, told, slot, speaks)


def _margin(chance: FloatArray, slot: IntArray) -> FloatArray:
    rows = np.arange(len(chance))
    others = chance.copy()
    others[rows, slot] = -1.0
    return np.asarray(chance[rows, slot] - others.max(axis=1))


@dataclass(frozen=True, eq=False)
class _Options:
    """What becomes of each ego [R] if it yields, and if it passes first of all."""

    yields: Profiles
    passes: Profiles
    open_s: FloatArray  # [R] when the way is open on a yield
    let_go: IntArray  # [R] how many go first then
    stays_out: BoolArray  # [R] on a yield, if need be by braking hard
    can_wait: BoolArray  # [R] a pass can still be given up for a while, in comfort
    margin_s: FloatArray  # [R] of the pass, at the earliest plausible entry of anybody
    likely_margin_s: FloatArray  # [R] of the pass, at the predicted one


def _options(outlook: Outlook, row: IntArray, first: IntArray, stopped: BoolArray) -> _Options:
    count = len(row)
    both = np.concatenate((row, row))
    # Whoever it is passed before, the ego drives as fast as it may.
    slot = np.concatenate((np.zeros(count, dtype=np.int64), first))
    firsts, stops = np.concatenate((first, first)), np.concatenate((stopped, stopped))
    approach, open_s = approaches(outlook, both, slot, firsts, stops)
    driven = drive(approach)
    half = (slice(None, count), slice(count, None))
    yields, passes = (
        Profiles(
            driven.start_s,
            driven.speed_mps[part],
            driven.acceleration_mps2[part],
            driven.travelled_m[part],
        )
        for part in half
    )
    group = outlook.graphs.focus_mask[row].copy()
    group[:, 0] = False
    nodes = group.shape[1]
    area_m, opens = approach.area_m[:count, :nodes], approach.open_s[:count, :nodes]
    # At the focus: what is further on can be seen to when this is behind.
    ahead = group & np.isfinite(area_m)
    enters_s = yields.arrival_s(np.where(ahead, np.maximum(area_m, 0.0) + OUT_M, np.inf))
    return _Options(
        yields=yields,
        passes=passes,
        open_s=open_s[:count],
        can_wait=_can_wait(passes, np.where(group, outlook.room_m[row], np.inf).min(axis=1)),
        let_go=ahead.sum(axis=1),
        stays_out=np.asarray((enters_s >= np.minimum(opens, HORIZON_S) - 0.1).all(axis=1)),
        margin_s=pass_margin_s(outlook, row, passes, outlook.soonest_s),
        likely_margin_s=pass_margin_s(outlook, row, passes, outlook.enter_s),
    )


def _can_wait(passes: Profiles, room_m: FloatArray) -> BoolArray:
    speed = passes.speed_mps[:, WAIT_KNOT]
    left_m = np.maximum(room_m - passes.travelled_m[:, WAIT_KNOT] - SHORT_M, 0.05)
    return speed**2 <= 2.0 * COMFORT_BRAKING_MPS2 * left_m


@dataclass(frozen=True, eq=False)
class _Chosen:
    """What each ego [R] is advised."""

    slot: IntArray
    action: tuple[str, ...]
    feasible: BoolArray
    doubted_s: tuple[float | None, ...]  # since when another slot would have been advised


def _choose(
    outlook: Outlook,
    row: IntArray,
    likely: _Likely,
    options: _Options,
    before: Sequence[Told | None],
) -> _Chosen:
    was_feasible = np.array([told is None or told.feasible for told in before])
    now_s = outlook.scene.time_s
    since = [None if told is None else told.doubted_s for told in before]
    since_s = np.array([now_s if one is None else one for one in since])
    told = likely.told
    safe = options.margin_s >= np.where(told > 0, KEEP_PASS_MARGIN_S, PASS_MARGIN_S)
    safe |= options.can_wait
    band = np.where(was_feasible, 1.0 + FEASIBLE_BAND, 1.0 - FEASIBLE_BAND)
    gentle = options.stays_out & (options.yields.braking_mps2 <= COMFORT_BRAKING_MPS2 * band)
    # Braking hard is worse than a pass that is only unlikely to be in somebody's way.
    open_to_pass = safe | (~gentle & (options.likely_margin_s > 0.0)) | ~options.stays_out
    wants_pass = likely.slot > 0
    passes = np.where(wants_pass, open_to_pass, ~options.stays_out)
    slot = np.where(passes, np.where(wants_pass, likely.slot, likely.first), 0)
    slot = np.where(likely.speaks, slot, likely.slot)
    holds = (told >= 0) & (slot != told) & (now_s - since_s < DOUBT_S - ROUNDING_S)
    holds &= np.where(told > 0, open_to_pass, options.stays_out)
    slot = np.where(holds, told, slot)
    doubted = tuple(
        one if held else None for one, held in zip(since_s.tolist(), holds.tolist(), strict=True)
    )
    action = tuple(
        "abstain" if not speaks else ("pass" if goes else "yield")
        for speaks, goes in zip((likely.speaks | holds).tolist(), (slot > 0).tolist(), strict=True)
    )
    return _Chosen(slot, action, np.where(slot > 0, safe, gentle), doubted)


def _suggestions(
    outlook: Outlook, row: IntArray, likely: _Likely, options: _Options, chosen: _Chosen
) -> tuple[Suggestion, ...]:
    graphs, scene = outlook.graphs, outlook.scene
    rows, goes = np.arange(len(row)), chosen.slot > 0
    node = np.where(goes, chosen.slot, likely.first)
    room = outlook.room_m[row, node][:, None]
    profile = np.where(
        goes[:, None], options.passes.tick_speed_mps(), options.yields.tick_speed_mps()
    )
    target = np.where(
        goes, options.passes.arrival_s(room)[:, 0], options.yields.arrival_s(room)[:, 0]
    )
    mean_mps = np.maximum(room[:, 0], 0.0) / np.maximum(target, 0.1)
    chance, margin = likely.chance[rows, chosen.slot], likely.margin(chosen.slot)
    speeds = np.round(profile, 3).tolist()
    return tuple(
        Suggestion(
            ego_id=scene.ids[ego],
            time_s=scene.time_s,
            action=action,
            slot_id=scene.ids[other],
            probability=float(chance[k]),
            margin=float(margin[k]),
            target_time_s=float(target[k]),
            advised_speed_mps=float(mean_mps[k]),
            feasible=bool(chosen.feasible[k]),
            text=words(
                scene,
                ego,
                other,
                action,
                more=int(options.let_go[k]) - 1,
                open_s=float(options.open_s[k]),
                feasible=bool(chosen.feasible[k]),
            ),
            profile_mps=() if action == "abstain" else tuple(speeds[k]),
        )
        for k, (ego, other, action) in enumerate(
            zip(
                graphs.ego[row].tolist(),
                graphs.rear[row, node].tolist(),
                chosen.action,
                strict=True,
            )
        )
    )
