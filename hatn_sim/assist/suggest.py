"""Slot probabilities -> one suggestion for every ego that has a choice (METHOD section 7).

Which slot that is, `choice` says; here it gets its words and its profile, and what was told is
remembered.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hatn_sim.assist.at_signals import choice_of
from hatn_sim.assist.braked_for import braked_for_first
from hatn_sim.assist.choice import PASS_MARGIN_S, Chosen, Why, choose
from hatn_sim.assist.likely import Likely, likely_slots
from hatn_sim.assist.options import Options, weigh_options
from hatn_sim.assist.outlook import Outlook, approaches, look_ahead
from hatn_sim.assist.pairs import MERGE, Pairs
from hatn_sim.assist.profile import (
    COMFORT_ACCELERATION_MPS2,
    COMFORT_BRAKING_MPS2,
    PROFILE_FRAMES,
    Profiles,
    drive,
)
from hatn_sim.assist.risk import STANDING_MPS
from hatn_sim.assist.told import LEAST_S, ROUNDING_S, Told, recall, remember
from hatn_sim.assist.words import braking, names, told_apart, words
from hatn_sim.datatypes import (
    DT_S,
    HORIZON_FRAMES,
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

PAUSE_S: Final = 1.0
"""Who has no choice for longer than this has another encounter then."""
AT_LINE_M: Final = 3.0
FORESEEN_S: Final = 10.0
"""Later than this nobody can say when the ego will be at the conflict."""
PROFILE_S: Final = DT_S * PROFILE_FRAMES
TOLD_S: Final = DT_S * HORIZON_FRAMES
"""Later than predictions reach, somebody may come whom nobody sees yet: no time is told."""


@dataclass(frozen=True)
class SuggestionState:
    """What egos were told within `PAUSE_S`, by id, and who has stopped at the line ahead."""

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
    assert prediction.graphs is not None
    stopped = stopped_at_line(state.stopped, scene, prediction.graphs)
    prediction = choice_of(road, scene, prediction)
    graphs, chances = prediction.graphs, prediction.slot_probability
    assert graphs is not None and chances is not None
    # At a red light there is nothing to choose, for the ego as for those whom it might meet.
    choice = graphs.has_conflict & (graphs.focus_mask.sum(axis=1) > 1) & ~graphs.ego_at_red
    if egos is not None:
        choice &= np.array([scene.ids[v] in egos for v in graphs.ego.tolist()], dtype=np.bool_)
    row = np.flatnonzero(choice)
    recent = {
        name: told
        for name, told in state.told.items()
        if scene.time_s - told.time_s <= PAUSE_S + ROUNDING_S
    }
    if not len(row):
        return SuggestionState(recent, stopped), ()
    egos_now = [scene.ids[v] for v in graphs.ego[row].tolist()]
    before = recall([recent.get(name) for name in egos_now], scene, graphs, row, chances)
    outlook = look_ahead(road, scene, prediction, pairs)
    likely = likely_slots(scene, graphs, chances, row, before)
    has_stopped = np.array([name in stopped for name in egos_now])
    options = weigh_options(outlook, row, likely, has_stopped)
    chosen = choose(outlook, row, likely, options, before)
    plans = _plans(outlook, row, options, chosen)
    now_s, fresh = scene.time_s, chosen.since_s == scene.time_s
    # A time is taken back at once, and told where it holds: not now and then.
    settled = before.timed | (now_s - before.timed_s >= LEAST_S - ROUNDING_S)
    timed = plans.is_timed & (fresh | settled)
    timed_s = np.where(fresh | (timed != before.timed), now_s, before.timed_s)
    called = names(scene, graphs.ego[row], chosen.other)
    of_others = [scene.ids[v] for v in chosen.other.tolist()]
    called = told_apart(called, of_others, before.called, before.other)
    out = _suggestions(outlook, row, likely, options, chosen, plans, timed, called)
    group = graphs.focus_mask[row] & (np.arange(graphs.rear.shape[1]) > 0)
    concerns = np.where((chosen.slot > 0)[:, None], group, options.let_go)
    told = remember(before, scene, graphs, row, concerns, chosen, timed, timed_s, called)
    return SuggestionState(recent | dict(zip(egos_now, told, strict=True)), stopped), out


def slot_profiles(
    state: SuggestionState,
    outlook: Outlook,
    row: IntArray,
    slot: IntArray,
    named: IntArray,
    start_s: float = 0.0,
) -> Profiles:
    """How egos of graphs [R] take slots [R], advised or not, from `start_s` on.

    `state` is what `suggest` gave for the moment; `named` [R] are the nodes that go first where an
    ego yields (`first_of_others`, if it is not told whom). The speeds of a plan are
    `tick_speed_mps()`.
    """
    names = [outlook.scene.ids[v] for v in outlook.graphs.ego[row].tolist()]
    has_stopped = np.array([name in state.stopped for name in names], dtype=np.bool_)
    return drive(approaches(outlook, row, slot, named, has_stopped, start_s)[0])


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
class _Plans:
    """How egos [R] drive what they are advised."""

    profiles: Profiles
    target_s: FloatArray  # [R] when they are at the conflict
    is_timed: BoolArray  # [R] it is known well enough to be told on a yield


def _plans(outlook: Outlook, row: IntArray, options: Options, chosen: Chosen) -> _Plans:
    goes = chosen.slot > 0
    room = outlook.room_m[row, chosen.node][:, None]
    profiles = options.driven.of(np.where(goes, options.of_pass, np.arange(len(row))))
    arrival = profiles.arrival_s(room)[:, 0]
    # Beyond the profile nobody goes before the way is open.
    waits = ~goes & (arrival > PROFILE_S)
    target = np.where(waits, np.maximum(arrival, options.open_s), arrival)
    is_timed = ~goes & (target <= TOLD_S)
    is_timed &= _gap_is_there(outlook, row, options, chosen, profiles, target)
    return _Plans(profiles, target, is_timed)


def _suggestions(
    outlook: Outlook,
    row: IntArray,
    likely: Likely,
    options: Options,
    chosen: Chosen,
    plans: _Plans,
    timed: BoolArray,
    called: Sequence[str],
) -> tuple[Suggestion, ...]:
    graphs, scene = outlook.graphs, outlook.scene
    rows, goes = np.arange(len(row)), chosen.slot > 0
    speeds = plans.profiles.tick_speed_mps()
    target_s: list[float] = plans.target_s.tolist()
    known = np.where(goes, plans.target_s <= FORESEEN_S, timed)
    mean_mps = plans.profiles.mean_mps(np.where(known, plans.target_s, PROFILE_S))
    ego, other = graphs.ego[row], chosen.other
    brakes = braking(scene.speed_mps[ego], speeds)
    firsts, called = braked_for_first(outlook, row, options, chosen, brakes, called)
    columns = zip(
        ego.tolist(),
        other.tolist(),
        called,
        np.where(chosen.speaks, np.where(goes, "pass", "yield"), "abstain").tolist(),
        likely.chances.of[rows, chosen.slot].tolist(),
        likely.chances.margin(chosen.slot).tolist(),
        [one if is_known else None for one, is_known in zip(target_s, known.tolist(), strict=True)],
        mean_mps.tolist(),
        chosen.feasible.tolist(),
        options.let_go.sum(axis=1).tolist(),
        brakes,
        firsts,
        [Why(one).name.lower() for one in chosen.why.tolist()],
        np.round(speeds, 3).tolist(),
        strict=True,
    )
    return tuple(
        Suggestion(
            ego_id=scene.ids[mine],
            time_s=scene.time_s,
            action=action,
            slot_id=scene.ids[its],
            probability=chance,
            margin=margin,
            target_time_s=target_s,
            advised_speed_mps=advised_mps,
            feasible=feasible,
            text=words(
                who,
                action,
                more=max(let_go - 1, 0),
                target_s=target_s,
                feasible=feasible,
                brakes=hard,
                first=first,
                reason=reason,
            ),
            profile_mps=() if action == "abstain" else tuple(profile_mps),
            reason=reason,
        )
        for (
            mine,
            its,
            who,
            action,
            chance,
            margin,
            target_s,
            advised_mps,
            feasible,
            let_go,
            hard,
            first,
            reason,
            profile_mps,
        ) in columns
    )


def _gap_is_there(
    outlook: Outlook,
    row: IntArray,
    options: Options,
    chosen: Chosen,
    profiles: Profiles,
    target_s: FloatArray,
) -> BoolArray:
    """Whether nobody else may plausibly come before egos [R] that yield are out of the way.

    They are at the area of whom they let go at `target_s` [R], and drive on as the profile does, or
    from a stand; where lines merge, whoever comes is to brake in comfort, as for a pass. A driver
    who is told a time looks for no further gap.
    """
    graphs = outlook.graphs
    others = graphs.focus_mask[row] & (np.arange(graphs.rear.shape[1]) > 0) & ~options.let_go
    from_m = np.maximum(outlook.room_m[row, chosen.node], 0.0)[:, None]
    within_m = np.maximum(outlook.clear_m[row] - from_m, 0.0)
    from_stand_s = np.sqrt(2.0 * within_m / COMFORT_ACCELERATION_MPS2)
    clear_s = profiles.arrival_s(np.where(others, outlook.clear_m[row], 0.0))
    out_s = np.minimum(clear_s, target_s[:, None] + from_stand_s)
    other_mps = outlook.scene.speed_mps[np.maximum(graphs.rear[row], 0)]
    faster_mps = np.maximum(other_mps - np.sqrt(2.0 * within_m * COMFORT_ACCELERATION_MPS2), 0.0)
    brakes_s = faster_mps**2 / (2.0 * COMFORT_BRAKING_MPS2 * np.maximum(other_mps, 1.0))
    out_s += PASS_MARGIN_S + np.where(graphs.conflict_type[row] == MERGE, brakes_s, 0.0)
    return np.asarray(~(others & (outlook.soonest_s[row] < out_s)).any(axis=1))
