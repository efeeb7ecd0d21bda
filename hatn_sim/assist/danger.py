"""How dangerous each pair is now: our alert rule (METHOD section 7), in m/s2.

CONFLICT: both are predicted to be in their area at once, or nearly so, whether they drive as HATN
predicts or go on as they move now; and neither could avoid it in comfort, or neither is about to.
The danger of a pair is the braking that the better placed of the two would need if it began only
after a reaction time, in which everybody goes on as now. So it grows early where the two speed up
towards each other, and stays small where one already brakes, however near they are. But as long as
they speed up, it is at least `NOBODY_GIVES_WAY` of the sum of their accelerations: those who set
off at once, far and slow enough to stop with ease, startle each other into stopping dead.

It is a DEVIATION where one of the two does what the model was confident it would not: it goes
first, though a second ago it was all but sure to let somebody go. Deviations that endanger nobody
are not alerted of.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hatn_sim.assist.moment import CONFLICT, DEVIATION, Moment, PairDangers, pair_dangers
from hatn_sim.assist.pairs import FOLLOW, Pairs
from hatn_sim.assist.risk import (
    Times,
    deceleration_to_avoid_mps2,
    times_at_speed,
    times_predicted,
    travelled_m,
)
from hatn_sim.assist.settings import AssistSettings
from hatn_sim.datatypes import DT_S, HORIZON_FRAMES, BoolArray, FloatArray, IntArray, Prediction

MOST_MPS2: Final = 9.0
"""More than a vehicle can brake at: worse is not told apart."""
NOBODY_GIVES_WAY: Final = 0.75
ACCELERATION_FRAMES: Final = 2
MOST_GAIN_MPS2: Final = 3.0
"""No car speeds up more in traffic: what is more is noise."""
FASTEST_MPS: Final = 14.0
"""Nobody is taken to speed up beyond this, or beyond the speed he has."""


def hatn_rule(moment: Moment) -> PairDangers:
    """Ours: CONFLICT and DEVIATION, by HATN's prediction. In m/s2."""
    pairs, settings = moment.pairs, moment.settings
    now = moment.scene.speed_mps
    predicted = times_predicted(pairs, travelled_m(moment.scene, moment.prediction))
    outlook = outlook_of(pairs, now, _acceleration_mps2(moment), predicted, settings.reaction_s)
    danger = conflict_mps2(pairs, outlook, settings)
    some = np.flatnonzero(danger > 0.0)
    if moment.earlier is None or not len(some):
        return pair_dangers(pairs.index, danger)
    index, enter_s = pairs.index[some], outlook.going_on.enter_s[some]
    sure = yield_probability(moment.scene.ids, index, moment.earlier) > settings.confident
    deviates = sure & (enter_s < enter_s[:, ::-1])  # [P, 2] goes first all the same
    index = np.where(deviates[:, 1:] & ~deviates[:, :1], index[:, ::-1], index)
    return pair_dangers(index, danger[some], np.where(deviates.any(axis=1), DEVIATION, CONFLICT))


def constant_velocity_rule(moment: Moment) -> PairDangers:
    """The same rule for CONFLICT, were everybody to go on at constant velocity. In m/s2."""
    pairs, settings = moment.pairs, moment.settings
    speed = moment.scene.speed_mps
    times = times_at_speed(pairs, speed)
    outlook = outlook_of(pairs, speed, np.zeros(len(speed)), times, settings.reaction_s)
    return pair_dangers(pairs.index, conflict_mps2(pairs, outlook, settings))


# ---------------------------------------------------------------------------------------------
# What may come


@dataclass(frozen=True, eq=False)
class Outlook:
    """How vehicles may go on, and when they are in their areas then."""

    predicted: Times
    going_on: Times  # as everybody moves now
    needed_mps2: FloatArray  # [Q, 2] of braking to give way, begun after the reaction time
    gained_mps2: FloatArray  # [Q, 2] by who speeds up now, else 0


def outlook_of(
    pairs: Pairs,
    speed_mps: FloatArray,
    acceleration_mps2: FloatArray,
    predicted: Times,
    reaction_s: float,
) -> Outlook:
    """What may come: by a prediction, and if vehicles [N] keep the acceleration of now."""
    kept_m = kept_travel_m(speed_mps, acceleration_mps2)
    after = max(round(reaction_s / DT_S), 1)
    path_m = np.concatenate((np.zeros((len(speed_mps), 1)), kept_m), axis=1)
    gone_m = path_m[:, after][pairs.index]
    then = replace(
        pairs,
        room_m=pairs.room_m - gone_m,
        clear_m=pairs.clear_m - gone_m,
        to_point_m=pairs.to_point_m - gone_m,
    )
    behind = pairs.type == FOLLOW
    then.room_m[behind, 1] += gone_m[behind, 0]  # the leader has gone on as well
    needed = deceleration_to_avoid_mps2(
        then,
        (path_m[:, after] - path_m[:, after - 1]) / DT_S,
        np.maximum(predicted.leave_s - reaction_s, 0.0),
    )
    return Outlook(
        predicted,
        times_predicted(pairs, kept_m),
        np.minimum(needed, MOST_MPS2),
        np.clip(acceleration_mps2[pairs.index], 0.0, MOST_GAIN_MPS2),
    )


def kept_travel_m(speed_mps: FloatArray, acceleration_mps2: FloatArray) -> FloatArray:
    """Path length [N, F] at constant acceleration, from a standstill to `FASTEST_MPS` at most."""
    time_s = DT_S * np.arange(1, HORIZON_FRAMES + 1)
    speed = speed_mps[:, None] + acceleration_mps2[:, None] * time_s
    fastest = np.maximum(speed_mps, FASTEST_MPS)[:, None]
    return np.cumsum(np.clip(speed, 0.0, fastest) * DT_S, axis=1)


def conflict_mps2(pairs: Pairs, outlook: Outlook, settings: AssistSettings) -> FloatArray:
    """Danger [Q] of CONFLICT, 0 where there is none."""
    at_once: BoolArray = pairs.type != FOLLOW
    for times in (outlook.predicted, outlook.going_on):
        at_once = at_once & (times.encroachment_s() < settings.encroachment_s)
        at_once &= times.second_s() < settings.soon_s
    both_go = NOBODY_GIVES_WAY * outlook.gained_mps2.sum(axis=1)
    return np.where(at_once, np.maximum(outlook.needed_mps2.min(axis=1), both_go), 0.0)


def yield_probability(ids: tuple[str, ...], index: IntArray, prediction: Prediction) -> FloatArray:
    """How surely each of pairs [P, 2] was predicted to let somebody go, where the other is of its
    focus group; elsewhere 0. `ids` are those of `index`, the prediction may be of another frame.
    """
    graphs, chances = prediction.graphs, prediction.slot_probability
    out = np.zeros(index.shape)
    if graphs is None or chances is None or not len(graphs.ego):
        return out
    place = {name: number for number, name in enumerate(prediction.ids)}
    then = np.array([place.get(name, -1) for name in ids], dtype=np.int64)
    row_of = np.full(len(prediction.ids) + 1, -1, dtype=np.int64)  # the last: found by -1
    row_of[graphs.ego] = np.arange(len(graphs.ego))
    for k in (0, 1):
        row, other = row_of[then[index[:, k]]], then[index[:, 1 - k]]
        met = (graphs.rear[row] == other[:, None]) & graphs.focus_mask[row]
        known = (row >= 0) & (other >= 0) & met[:, 1:].any(axis=1)
        out[:, k] = np.where(known, chances[row, 0], 0.0)
    return out


def _acceleration_mps2(moment: Moment) -> FloatArray:
    tracks, back = moment.seen.tracks, -1 - ACCELERATION_FRAMES
    gained = tracks.speed_mps[:, -1] - tracks.speed_mps[:, back]
    return np.where(tracks.valid[:, back], gained / (ACCELERATION_FRAMES * DT_S), 0.0)
