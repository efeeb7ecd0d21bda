"""Signs of danger: what of a pair's moment foretells a collision or evasive braking.

Each vehicle has three futures: as predicted, going on as now (keeping its acceleration), and at
constant speed. `meet` is how surely the two are in their area at once, or nearly so, soon, if each
has one of these futures: two who set off at once meet if both go on, though both are predicted to
yield. The other signs say how hard it is to get out of it, and who does what at his line.

All signs are numbers of about 0 ... 1, and none depends on which of the pair is named first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Final

import numpy as np
from scipy.special import expit

from hatn_sim.assist.at_signals import standing_at_signals_m
from hatn_sim.assist.moment import Moment
from hatn_sim.assist.pairs import CROSS, FOLLOW, MERGE, Pairs
from hatn_sim.assist.risk import (
    Times,
    deceleration_to_avoid_mps2,
    path_length_m,
    times_at_speed,
    times_predicted,
)
from hatn_sim.datatypes import (
    DT_S,
    HORIZON_FRAMES,
    FloatArray,
    Gate,
    IntArray,
    Prediction,
)

REACTION_S: Final = 1.0
"""Everybody goes on for so long before anybody brakes."""
LOOKED_AHEAD_S: Final = 6.0
LOOKED_AHEAD_M: Final = 30.0
WAITS_M: Final = 12.0
"""Who comes later in every future and does not wait so near, or follows farther behind, is not
looked at."""
AT_ONCE_S: Final = 0.5
SOON_S: Final = 4.0
MOST_MPS2: Final = 9.0
"""More than a vehicle can brake at: worse is not told apart."""
HARD_MPS2: Final = 4.5
"""Braking beyond this is evasive: whoever would have to, to stop at his line, is taken not to."""
FASTEST_MPS: Final = 14.0
"""Nobody is taken to speed up beyond this, or beyond the speed he has."""
ACCELERATION_FRAMES: Final = 2
MOST_GAIN_MPS2: Final = 3.0
"""No car speeds up more in traffic: what is more is noise."""
BEFORE_CONFLICT_M: Final = 30.0
"""A line this near before a conflict is the conflict's."""
FAR_S: Final = 10.0
SOME_WEIGHT: Final = 0.05
"""Predicted modes with less are not reckoned with by themselves."""

FUTURES: Final = ("predicted", "going on", "at constant speed")
PREDICTED: Final = 0
GOING_ON: Final = 1
AT_SPEED: Final = 2
_MIXED: Final = tuple(combinations_with_replacement(range(len(FUTURES)), 2))
SIGNS: Final = (
    *(f"meet, one {FUTURES[a]}, one {FUTURES[b]}" for a, b in _MIXED),
    "meet, at most",
    "meet, mean",
    "meet, chance over the predicted modes of both",
    "meet within 3 s, chance over the predicted modes of both",
    "meet, at most, in predicted modes of some weight",
    "how far the predicted modes of one are apart",
    *(f"meet within 3 s, both {name}" for name in FUTURES),
    *(f"pass within 1.5 s of each other, both {name}" for name in FUTURES),
    "braking needed by the better placed, after the reaction time",
    "braking needed by the better placed, now",
    "braking needed by the better placed, at constant speed after the reaction time",
    "needs it and meets as predicted and going on",
    "both speed up",
    "one speeds up and meets",
    "one brakes",
    "one brakes and meets",
    "one creeps at its line, the other comes",
    "one sets off at its line, the other comes",
    "one cannot stop at its line and meets",
    "both are to yield",
    "both are to pass",
    "who goes first is in doubt",
    "who goes first is in doubt and meets",
    "who goes first has changed within a second",
    "who goes first is predicted",
    "crossing",
    "merging",
    "angle of the lines (cosine)",
    "following",
    "following, braking needed",
    "following closely and fast",
    "following, the leader brakes",
    "speed of the faster",
    "speed of the slower",
    "speed of the slower and meets",
)
_FIRST_OF_FOLLOW: Final = 0
_STOP_LINE, _GIVE_WAY_LINE = int(Gate.STOP_LINE), int(Gate.GIVE_WAY_LINE)


@dataclass(frozen=True, eq=False)
class Signs:
    """Signs of those pairs that may meet soon."""

    pairs: Pairs  # [P]
    going_on: Times  # [P, 2] of them
    of: FloatArray  # [P, len(SIGNS)]
    yielded: FloatArray  # [P, 2] `yield_probability` a while ago


def signs_of(moment: Moment) -> Signs:
    """The signs of a moment, by its prediction."""
    prediction = moment.prediction
    pairs, kept_m, steady = _looked_at(moment)
    modes_m = path_length_m(moment.scene.xy_m[:, None], prediction.xy_m)
    ways = times_predicted(pairs, np.concatenate((modes_m, kept_m[:, None]), axis=1))
    best = prediction.mode_probability.argmax(axis=1)[pairs.index]
    futures = Times(
        *(
            np.stack((np.take_along_axis(way, best[None], axis=0)[0], way[-1], at_speed))
            for way, at_speed in ((ways.enter_s, steady.enter_s), (ways.leave_s, steady.leave_s))
        )
    )
    near = _near(pairs, futures)
    pairs = pairs.of(near)
    weight = np.moveaxis(prediction.mode_probability[pairs.index], -1, 0)
    modes = _Modes(Times(ways.enter_s[:-1], ways.leave_s[:-1]).of(near), weight)
    yields, yielded = (
        np.full(pairs.index.shape, np.nan)
        if told is None
        else yield_probability(moment.scene.ids, pairs.index, told)
        for told in (prediction, moment.earlier)
    )
    return _signs(moment, pairs, kept_m, futures.of(near), modes, yields, yielded)


def signs_at_constant_velocity(moment: Moment) -> Signs:
    """The signs of a moment for whom constant velocity is the prediction, and nothing else is."""
    pairs, kept_m, steady = _looked_at(moment)
    kept = times_predicted(pairs, kept_m[:, None])
    futures = Times(
        np.stack((steady.enter_s, kept.enter_s[0], steady.enter_s)),
        np.stack((steady.leave_s, kept.leave_s[0], steady.leave_s)),
    )
    near = _near(pairs, futures)
    pairs, futures = pairs.of(near), futures.of(near)
    unknown = np.full(pairs.index.shape, np.nan)
    modes = _Modes(
        Times(futures.enter_s[:1], futures.leave_s[:1]), np.ones((1, *pairs.index.shape))
    )
    return _signs(moment, pairs, kept_m, futures, modes, unknown, unknown)


def _looked_at(moment: Moment) -> tuple[Pairs, FloatArray, Times]:
    """Pairs [Q] but for those who follow far behind or stand at a closed signal, how far [N, F]
    everybody comes keeping his acceleration, and times [Q, 2] at constant speed."""
    pairs, speed = moment.pairs, moment.scene.speed_mps
    behind = (pairs.room_m[:, 1] < LOOKED_AHEAD_M) & (speed[pairs.index[:, 1]] > 1)
    closed_m = standing_at_signals_m(moment.road, moment.scene, moment.seen.lines)
    waits = (closed_m[pairs.index] <= pairs.to_point_m).any(axis=1)
    pairs = pairs.of(np.flatnonzero(np.where(pairs.type == FOLLOW, behind, ~waits)))
    return pairs, kept_travel_m(speed, acceleration_mps2(moment)), times_at_speed(pairs, speed)


def _near(pairs: Pairs, futures: Times) -> IntArray:
    near = (futures.second_s() < LOOKED_AHEAD_S).any(axis=0)
    # Who waits may set off at any time.
    comes = futures.enter_s[AT_SPEED, :, ::-1] < LOOKED_AHEAD_S
    near |= (comes & (pairs.room_m < WAITS_M)).any(axis=1)
    return np.flatnonzero(near | (pairs.type == FOLLOW))


# ---------------------------------------------------------------------------------------------
# The signs


def _signs(
    moment: Moment,
    pairs: Pairs,
    kept_m: FloatArray,
    futures: Times,
    modes: _Modes,
    yields: FloatArray,
    yielded: FloatArray,
) -> Signs:
    """Of pairs [P] by `FUTURES` [3, P, 2] and predicted modes; columns are made as rows here."""
    v, a = moment.scene.speed_mps[pairs.index], acceleration_mps2(moment)[pairs.index]
    slower, faster = np.minimum(v[:, 0], v[:, 1]), np.maximum(v[:, 0], v[:, 1])
    follows = pairs.type == FOLLOW
    meets = ~follows

    mixed = futures.mixed()
    encroachment, second = mixed.encroachment_s(), mixed.second_s()
    at_once, soon = _below(encroachment, AT_ONCE_S, 0.25), _below(second, SOON_S, 0.5)
    surely = at_once * soon * meets
    together = np.array([np.maximum(surely[a, b], surely[b, a]) for a, b in _MIXED])
    same = np.arange(len(FUTURES))
    within_3_s = (at_once * _below(second, 3.0, 0.5) * meets)[same, same]
    narrowly = (_below(encroachment, 1.5, 0.25) * soon * meets)[same, same]
    most = together.max(axis=0)

    needed = _needed(pairs, moment.scene.speed_mps, kept_m, futures) / MOST_MPS2
    speeds_up = np.minimum(np.maximum(a, 0.0), MOST_GAIN_MPS2) / MOST_GAIN_MPS2
    brakes = np.minimum(np.maximum(-a, 0.0), MOST_MPS2) / MOST_MPS2
    to_line_m = _to_line_m(moment, pairs)
    comes = _below(futures.enter_s[AT_SPEED], SOON_S, 0.7) * (v > 3.0)
    creeps = _below(np.abs(to_line_m), 1.5, 0.5) * _below(v, 2.5, 0.5) * comes[:, ::-1]
    creeps *= meets[:, None]
    ahead = (to_line_m > 0.0) & (to_line_m < BEFORE_CONFLICT_M) & (v > 2.0)
    overruns = ahead & (v**2 > 2.0 * HARD_MPS2 * np.maximum(to_line_m, 0.1))
    known, was_known = (~np.isnan(chance).any(axis=1) for chance in (yields, yielded))
    chance, before = (np.where(np.isnan(one), 0.5, one) for one in (yields, yielded))
    doubt = np.where(known, 1.0 - 2.0 * np.abs(chance - 0.5).min(axis=1), 0.0)
    gap_m = np.where(follows, pairs.room_m[:, 1], np.inf)
    of = np.vstack(
        (
            together,
            most,
            together.sum(axis=0) / len(together),
            modes.meet() * meets,
            modes.spread() * meets,
            within_3_s,
            narrowly,
            needed,
            needed[0] * surely[0, 0] * surely[1, 1],
            speeds_up.sum(axis=1),
            speeds_up.max(axis=1) * most,
            brakes.max(axis=1),
            brakes.max(axis=1) * most,
            creeps.max(axis=1),
            (creeps * (a > 0.5)).max(axis=1),
            overruns.any(axis=1) * most,
            np.where(known, chance.min(axis=1), 0.0),
            np.where(known, 1.0 - chance.max(axis=1), 0.0),
            doubt,
            doubt * most,
            np.abs(chance - before).max(axis=1) * (known & was_known),
            known,
            pairs.type == CROSS,
            pairs.type == MERGE,
            np.where(follows, 0.0, np.cos(pairs.angle_rad)),
            follows,
            follows * needed[1],
            _below(gap_m, 8.0, 2.0) * slower / FASTEST_MPS,
            follows * brakes[:, _FIRST_OF_FOLLOW],
            faster / FASTEST_MPS,
            slower / FASTEST_MPS,
            slower / FASTEST_MPS * most,
        )
    )
    going_on = Times(futures.enter_s[GOING_ON], futures.leave_s[GOING_ON])
    return Signs(pairs, going_on, np.asarray(of.T, dtype=np.float64), yielded)


def _below(value: FloatArray, bound: float, blur: float) -> FloatArray:
    """1 far below the bound, 0 far above it (logistic)."""
    return np.asarray(expit((bound - value) / blur))


def _needed(pairs: Pairs, speed_mps: FloatArray, kept_m: FloatArray, futures: Times) -> FloatArray:
    """[3, P] the braking that the better placed of the two needs to give way; at most `MOST_MPS2`.

    Begun after a time in which everybody keeps his acceleration, as the other is predicted to go
    on; begun now; and begun after a time, if all keep their speeds.
    """
    after = round(REACTION_S / DT_S)
    standing = np.zeros(len(speed_mps))
    gone_m = np.stack((kept_m[:, after - 1], standing, REACTION_S * speed_mps))[:, pairs.index]
    then_mps = (kept_m[:, after - 1] - kept_m[:, after - 2]) / DT_S
    room_m = pairs.room_m - gone_m
    room_m[..., 1] += (pairs.type == FOLLOW) * gone_m[..., 0]  # the leader has gone on as well
    leave_s = futures.leave_s[[PREDICTED, PREDICTED, AT_SPEED]]
    leave_s = np.maximum(leave_s - np.array([REACTION_S, 0.0, REACTION_S])[:, None, None], 0.0)
    each = deceleration_to_avoid_mps2(
        replace(pairs, room_m=room_m, to_point_m=pairs.to_point_m - gone_m),
        np.stack((then_mps, speed_mps, speed_mps)),
        leave_s,
    )
    return np.minimum(np.minimum(each[..., 0], each[..., 1]), MOST_MPS2)


def kept_travel_m(speed_mps: FloatArray, acceleration_mps2: FloatArray) -> FloatArray:
    """Path length [N, F] at constant acceleration, from a standstill to `FASTEST_MPS` at most."""
    time_s = DT_S * np.arange(1, HORIZON_FRAMES + 1)
    speed = speed_mps[:, None] + acceleration_mps2[:, None] * time_s
    fastest = np.maximum(speed_mps, FASTEST_MPS)[:, None]
    return np.cumsum(np.minimum(np.maximum(speed, 0.0), fastest) * DT_S, axis=1)


def acceleration_mps2(moment: Moment) -> FloatArray:
    """[N] the mean of the last 0.2 s; 0 for who was not in view then."""
    tracks, back = moment.seen.tracks, -1 - ACCELERATION_FRAMES
    gained = tracks.speed_mps[:, -1] - tracks.speed_mps[:, back]
    return np.where(tracks.valid[:, back], gained / (ACCELERATION_FRAMES * DT_S), 0.0)


def _to_line_m(moment: Moment, pairs: Pairs) -> FloatArray:
    """From front bumpers [P, 2] to the last stop or give-way line before the conflict; infinite
    where there is none within `BEFORE_CONFLICT_M`."""
    road, lines = moment.road, moment.seen.lines
    line, s = np.maximum(lines.line[pairs.index], 0), lines.s_m[pairs.index]
    gate_s, kind = road.gate_s_m[line], road.gate_type[line]
    point = (s + pairs.to_point_m)[..., None]
    own = (kind == _STOP_LINE) | (kind == _GIVE_WAY_LINE)
    own &= (gate_s <= point) & (gate_s > point - BEFORE_CONFLICT_M)
    way_m = np.where(own, gate_s - s[..., None], np.inf).min(axis=-1, initial=np.inf)
    return np.asarray(way_m - 0.5 * pairs.length_m)


@dataclass(frozen=True, eq=False)
class _Modes:
    """When the two of each pair are in their area, in each of K predicted modes [K, P, 2]."""

    times: Times
    weight: FloatArray

    def meet(self) -> FloatArray:
        """The chance that they meet soon, that they do within 3 s, and how surely they do at most,
        in modes of some weight [3, P]."""
        mixed = self.times.mixed()
        second = mixed.second_s()
        at_once = _below(mixed.encroachment_s(), AT_ONCE_S, 0.25)
        surely, soon = at_once * _below(second, SOON_S, 0.5), at_once * _below(second, 3.0, 0.5)
        one, other = self.weight[:, None, :, 0], self.weight[:, :, 1]
        chance, has_weight = one * other, np.minimum(one, other) >= SOME_WEIGHT
        return np.stack(
            (
                (chance * surely).sum(axis=(0, 1)),
                (chance * soon).sum(axis=(0, 1)),
                (has_weight * surely).max(axis=(0, 1), initial=0.0),
            )
        )

    def spread(self) -> FloatArray:
        """[P] how far apart the modes are of the one whose are farther."""
        enters = np.minimum(self.times.enter_s, FAR_S)
        mean = (self.weight * enters).sum(axis=0)
        spread = np.sqrt((self.weight * (enters - mean) ** 2).sum(axis=0))
        return spread.max(axis=1) / FAR_S


def yield_probability(ids: tuple[str, ...], index: IntArray, prediction: Prediction) -> FloatArray:
    """How surely each of pairs [P, 2] was predicted to let somebody go, where the other is of its
    focus group; elsewhere NaN. `ids` are those of `index`, the prediction may be of another frame.
    """
    graphs, chances = prediction.graphs, prediction.slot_probability
    if graphs is None or chances is None or not len(graphs.ego):
        return np.full(index.shape, np.nan)
    then = index
    if prediction.ids != ids:
        place = {name: number for number, name in enumerate(prediction.ids)}
        then = np.array([place.get(name, -1) for name in ids], dtype=np.int64)[index]
    row_of = np.full(len(prediction.ids) + 1, -1, dtype=np.int64)  # the last: found by -1
    row_of[graphs.ego] = np.arange(len(graphs.ego))
    row, other = row_of[then], then[:, ::-1]
    met = (graphs.rear[row] == other[..., None]) & graphs.focus_mask[row]
    known = (row >= 0) & (other >= 0) & met[..., 1:].any(axis=-1)
    return np.where(known, chances[row, 0], np.nan)
