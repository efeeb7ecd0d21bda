"""Whom hard braking is for, where that is not the vehicle to be let go: what asks for it most.

Letters as in `profile`, and R egos that have a choice, B of them that brake hard at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hatn_sim.assist.choice import Chosen
from hatn_sim.assist.options import Options
from hatn_sim.assist.outlook import Outlook
from hatn_sim.assist.profile import LEADER_ASKS, hardest_asked
from hatn_sim.assist.risk import STANDING_MPS
from hatn_sim.assist.words import AT_ONCE, LINE, SOON_FRAMES, another, because, names
from hatn_sim.datatypes import DT_S, BoolArray, IntArray


def braked_for_first(
    outlook: Outlook,
    row: IntArray,
    options: Options,
    chosen: Chosen,
    brakes: Sequence[str],
    called: Sequence[str],
) -> tuple[list[str], list[str]]:
    """What egos [R] are to brake hard for before they do as advised, in words ("": nothing else),
    and the names [R] of those whom the advice is about: another one, after one of the same name.

    `brakes` [R] is what `braking` makes of their profiles, `called` [R] what `names` makes of those
    whom the advice is about.
    """
    said, after = [""] * len(row), list(called)
    hard = np.array([one in AT_ONCE for one in brakes], dtype=np.bool_)
    told = np.flatnonzero(hard & chosen.speaks)
    if not len(told):
        return said, after
    graphs, scene = outlook.graphs, outlook.scene
    who = _asks(outlook, row, options, chosen, told)
    vehicle, ahead = np.maximum(who, 0), who == graphs.leader[row[told]]
    stands = scene.speed_mps[vehicle] < STANDING_MPS
    let_go = _is_let_go(outlook, row, options, chosen, told, who)
    for place, name in enumerate(names(scene, graphs.ego[row[told]], vehicle, ahead)):
        if who[place] < 0:
            said[told[place]] = because(LINE, stands=False)
        elif not let_go[place]:
            of = int(told[place])
            said[of] = because(name, bool(stands[place]))
            if name == called[of] and who[place] != chosen.other[of]:
                after[of] = another(name)
    return said, after


def _asks(
    outlook: Outlook, row: IntArray, options: Options, chosen: Chosen, told: IntArray
) -> IntArray:
    """The vehicles [B] that ask for the hardest braking soon; -1: the line does."""
    profile = np.where(chosen.slot[told] > 0, options.of_pass[told], told)
    approach, driven = options.approach.of(profile), options.driven.of(profile)
    knot, asks = hardest_asked(approach, driven, DT_S * SOON_FRAMES)
    # The areas of an approach are those of the nodes, then the one that somebody is in.
    of_area = np.column_stack((outlook.graphs.rear[row[told]], outlook.taken_by[row[told]]))
    in_area = of_area[np.arange(len(told)), np.maximum(asks, 0)]
    ahead = np.where(asks == LEADER_ASKS, options.leader[profile, knot], -1)
    return np.where(asks >= 0, in_area, ahead)


def _is_let_go(
    outlook: Outlook,
    row: IntArray,
    options: Options,
    chosen: Chosen,
    told: IntArray,
    who: IntArray,
) -> BoolArray:
    """Whether vehicles [B] are among those whom a yield speaks of."""
    rear = outlook.graphs.rear[row[told]]
    spoken_of = options.let_go[told] | (np.arange(rear.shape[1]) == chosen.node[told][:, None])
    yields = chosen.slot[told] == 0
    return np.asarray(yields & (spoken_of & (rear == who[:, None])).any(axis=1))
