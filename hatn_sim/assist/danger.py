"""How dangerous each pair is now: our alert rule (METHOD section 7).

The danger of a pair, 0 ... 1, is how surely a collision or evasive braking of the two begins within
`alert.WITHIN_S`: it ranks, and is no calibrated probability. A small network tells it from the
pair's signs (`signs`); it was fitted to simulated traffic by `hatn-sim assess --calibrate`.

It is a DEVIATION where one of the two does what the model was confident it would not: it goes
first, though a second ago it was all but sure to let somebody go. Deviations that endanger nobody
are not alerted of.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.assist.danger_network import danger_network
from hatn_sim.assist.moment import CONFLICT, DEVIATION, Moment, PairDangers, pair_dangers
from hatn_sim.assist.risk import deceleration_to_avoid_mps2
from hatn_sim.assist.signs import Signs, signs_at_constant_velocity, signs_of
from hatn_sim.datatypes import BoolArray, FloatArray, IntArray

HATN: Final = "hatn"
NO_PREDICTION: Final = "no_prediction"
SIGNS_OF: Final = {HATN: signs_of, NO_PREDICTION: signs_at_constant_velocity}
"""Rules that a network is fitted for, and what it sees."""


def hatn_rule(moment: Moment) -> PairDangers:
    """Ours: CONFLICT and DEVIATION, by HATN's prediction."""
    signs = signs_of(moment)
    danger = danger_network(moment.settings.danger_network, HATN).danger(signs.of)
    index = _better_placed_first(moment, signs)
    if moment.earlier is None or not len(danger):
        return pair_dangers(index, danger)
    return _deviations(moment, signs, index, danger)


def _better_placed_first(moment: Moment, signs: Signs) -> IntArray:
    """The pairs [P, 2], the first of each the one who can give way with less braking: of two who
    follow, the follower. Where both are warned, it is up to him."""
    index = signs.pairs.index
    leave_s = signs.going_on.leave_s
    needed = deceleration_to_avoid_mps2(signs.pairs, moment.scene.speed_mps, leave_s)
    return np.where(needed[:, 1:] < needed[:, :1], index[:, ::-1], index)


def _deviations(moment: Moment, signs: Signs, first: IntArray, danger: FloatArray) -> PairDangers:
    index, enter_s = signs.pairs.index, signs.going_on.enter_s
    sure = signs.yielded > moment.settings.confident  # nobody is, where it is not known
    # [P, 2] goes first all the same
    deviates: BoolArray = np.asarray(sure & (enter_s < enter_s[:, ::-1]))
    some: BoolArray = np.asarray(deviates.any(axis=1))
    by_who = np.where(deviates[:, 1:] & ~deviates[:, :1], index[:, ::-1], index)
    index = np.where(some[:, None], by_who, first)
    return pair_dangers(index, danger, np.where(some, DEVIATION, CONFLICT))


def constant_velocity_rule(moment: Moment) -> PairDangers:
    """The same rule for CONFLICT, told that all are predicted to go on at constant velocity."""
    return _conflicts(moment, HATN)


def no_prediction_rule(moment: Moment) -> PairDangers:
    """A network that was fitted likewise, but never saw a prediction: it tells what one adds."""
    return _conflicts(moment, NO_PREDICTION)


def _conflicts(moment: Moment, rule: str) -> PairDangers:
    signs = signs_at_constant_velocity(moment)
    network = danger_network(moment.settings.danger_network, rule)
    return pair_dangers(signs.pairs.index, network.danger(signs.of))
