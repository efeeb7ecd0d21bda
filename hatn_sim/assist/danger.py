"""How dangerous each pair is now: our alert rule (METHOD section 7).

The danger of a pair is the chance that a collision or evasive braking of the two begins within
`WITHIN_S`. A small network tells it from the pair's signs (`signs`); it was fitted to simulated
traffic by `hatn-sim assess --calibrate`.

It is a DEVIATION where one of the two does what the model was confident it would not: it goes
first, though a second ago it was all but sure to let somebody go. Deviations that endanger nobody
are not alerted of.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.assist.danger_network import danger_network
from hatn_sim.assist.moment import CONFLICT, DEVIATION, Moment, PairDangers, pair_dangers
from hatn_sim.assist.signs import Signs, signs_at_constant_velocity, signs_of, yield_probability
from hatn_sim.datatypes import FloatArray

HATN: Final = "hatn"
NO_PREDICTION: Final = "no_prediction"
SIGNS_OF: Final = {HATN: signs_of, NO_PREDICTION: signs_at_constant_velocity}
"""Rules that a network is fitted for, and what it sees."""


def hatn_rule(moment: Moment) -> PairDangers:
    """Ours: CONFLICT and DEVIATION, by HATN's prediction."""
    signs = signs_of(moment)
    chance = danger_network(moment.settings.danger_network, HATN).chance(signs.of)
    if moment.earlier is None or not len(chance):
        return pair_dangers(signs.pairs.index, chance)
    return _deviations(moment, signs, chance)


def _deviations(moment: Moment, signs: Signs, chance: FloatArray) -> PairDangers:
    assert moment.earlier is not None
    index, enter_s = signs.pairs.index, signs.going_on.enter_s
    yielded = yield_probability(moment.scene.ids, index, moment.earlier)
    sure = np.nan_to_num(yielded, nan=0.0) > moment.settings.confident
    deviates = sure & (enter_s < enter_s[:, ::-1])  # [P, 2] goes first all the same
    index = np.where(deviates[:, 1:] & ~deviates[:, :1], index[:, ::-1], index)
    return pair_dangers(index, chance, np.where(deviates.any(axis=1), DEVIATION, CONFLICT))


def constant_velocity_rule(moment: Moment) -> PairDangers:
    """The same rule for CONFLICT, told that all are predicted to go on at constant velocity."""
    return _conflicts(moment, HATN)


def no_prediction_rule(moment: Moment) -> PairDangers:
    """A network that was fitted likewise, but never saw a prediction: it tells what one adds."""
    return _conflicts(moment, NO_PREDICTION)


def _conflicts(moment: Moment, rule: str) -> PairDangers:
    signs = signs_at_constant_velocity(moment)
    network = danger_network(moment.settings.danger_network, rule)
    return pair_dangers(signs.pairs.index, network.chance(signs.of))
