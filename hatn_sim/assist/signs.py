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

from hatn_sim.assist.moment import Moment
from hatn_sim.assist.pairs import FOLLOW, Pairs
from hatn_sim.assist.risk import (
    Times,
    arrival_s,
    deceleration_to_avoid_mps2,
    times_at_speed,
    times_predicted,
    travelled_m,
)
from hatn_sim.datatypes import (
    DT_S,
    HORIZON_FRAMES,
    BoolArray,
    ConflictType,
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


@dataclass(frozen=True, eq=False)
class Signs:
    """Signs of those pairs that may meet soon."""

    pairs: Pairs  # [P]
    going_on: Times  # of them
    of: FloatArray  # [P, len(SIGNS)]


def signs_of(moment: Moment) -> Signs:
    """The signs of a moment, by its prediction."""
    way_m = travelled_m(moment.scene, moment.prediction)
    pairs, going_on, steady = _futures(moment)
    predicted = times_predicted(pairs, way_m)
    near = _near(moment, pairs, (predicted, going_on, steady))
    pairs = pairs.of(near)
    futures = predicted.of(near), going_on.of(near), steady.of(near)
    now = _slots(moment, pairs, moment.prediction)
    before = now if moment.earlier is None else _slots(moment, pairs, moment.earlier)
    return _signs(moment, pairs, futures, _modes(moment, pairs), now, before)


def signs_at_constant_velocity(moment: Moment) -> Signs:
    """The signs of a moment for whom constant velocity is the prediction, and nothing else is."""
    pairs, going_on, steady = _futures(moment)
    near = _near(moment, pairs, (going_on, steady))
    pairs, going_on, steady = pairs.of(near), going_on.of(near), steady.of(near)
    unknown = _Slots(np.full(pairs.index.shape, 0.5), np.zeros(len(near), dtype=np.bool_))
    one = _Modes(steady.enter_s[..., None], steady.leave_s[..., None], np.ones((len(near), 2, 1)))
    return _signs(moment, pairs, (steady, going_on, steady), one, unknown, unknown)


def _futures(moment: Moment) -> tuple[Pairs, Times, Times]:
    pairs, speed = moment.pairs, moment.scene.speed_mps
    kept_m = kept_travel_m(speed, acceleration_mps2(moment))
    return pairs, times_predicted(pairs, kept_m), times_at_speed(pairs, speed)


def _near(moment: Moment, pairs: Pairs, futures: tuple[Times, ...]) -> IntArray:
    both_soon = np.min([times.second_s() for times in futures], axis=0) < LOOKED_AHEAD_S
    # Who waits may set off at any time.
    comes = futures[-1].enter_s[:, ::-1] < LOOKED_AHEAD_S
    both_soon |= (comes & (pairs.room_m < WAITS_M)).any(axis=1)
    follows = pairs.type == FOLLOW
    behind = (pairs.room_m[:, 1] < LOOKED_AHEAD_M) & (moment.scene.speed_mps[pairs.index[:, 1]] > 1)
    return np.flatnonzero(np.where(follows, behind, both_soon))


# ---------------------------------------------------------------------------------------------
# The signs


def _signs(
    moment: Moment,
    pairs: Pairs,
    futures: tuple[Times, ...],
    modes: _Modes,
    now: _Slots,
    before: _Slots,
) -> Signs:
    speed = moment.scene.speed_mps
    gain_mps2 = acceleration_mps2(moment)
    v, a = speed[pairs.index], gain_mps2[pairs.index]
    follows = pairs.type == FOLLOW
    meets = ~follows

    def there(one: Times, other: Times, at_once_s: float, soon_s: float) -> FloatArray:
        times = Times(
            np.column_stack((one.enter_s[:, 0], other.enter_s[:, 1])),
            np.column_stack((one.leave_s[:, 0], other.leave_s[:, 1])),
        )
        return np.where(meets, _surely(times, at_once_s, soon_s), 0.0)

    mixed = [
        np.maximum(
            there(futures[a], futures[b], AT_ONCE_S, SOON_S),
            there(futures[b], futures[a], AT_ONCE_S, SOON_S),
        )
        for a, b in _MIXED
    ]
    most = np.max(mixed, axis=0)
    needed = _needed(pairs, speed, gain_mps2, futures[0], REACTION_S)
    steady = _needed(pairs, speed, np.zeros(len(speed)), futures[2], REACTION_S)
    at_once = _needed(pairs, speed, gain_mps2, futures[0], 0.0)
    speeds_up = np.clip(a, 0.0, MOST_GAIN_MPS2)
    brakes = np.clip(-a.min(axis=1), 0.0, MOST_MPS2)
    to_line_m = _to_line_m(moment, pairs)
    comes = _below(futures[2].enter_s, SOON_S, 0.7) * (v > 3.0)
    creeps = _below(np.abs(to_line_m), 1.5, 0.5) * _below(v, 2.5, 0.5) * comes[:, ::-1]
    creeps = np.where(meets[:, None], creeps, 0.0)
    ahead = (to_line_m > 0.0) & (to_line_m < BEFORE_CONFLICT_M) & (v > 2.0)
    overruns = ahead & (v**2 > 2.0 * HARD_MPS2 * np.maximum(to_line_m, 0.1))
    doubt = np.where(now.known, 1.0 - 2.0 * np.abs(now.yields - 0.5).min(axis=1), 0.0)
    changed = np.abs(now.yields - before.yields).max(axis=1) * (now.known & before.known)
    gap_m = np.where(follows, pairs.room_m[:, 1], np.inf)
    columns = (
        *mixed,
        most,
        np.mean(mixed, axis=0),
        *np.where(meets, modes.meet(), 0.0),
        *(there(one, one, AT_ONCE_S, 3.0) for one in futures),
        *(there(one, one, 1.5, SOON_S) for one in futures),
        needed / MOST_MPS2,
        at_once / MOST_MPS2,
        steady / MOST_MPS2,
        needed / MOST_MPS2 * there(futures[0], futures[0], AT_ONCE_S, SOON_S)
        * there(futures[1], futures[1], AT_ONCE_S, SOON_S),
        speeds_up.sum(axis=1) / MOST_GAIN_MPS2,
        speeds_up.max(axis=1) / MOST_GAIN_MPS2 * most,
        brakes / MOST_MPS2,
        brakes / MOST_MPS2 * most,
        creeps.max(axis=1),
        (creeps * (a > 0.5)).max(axis=1),
        overruns.any(axis=1) * most,
        np.where(now.known, now.yields.min(axis=1), 0.0),
        np.where(now.known, 1.0 - now.yields.max(axis=1), 0.0),
        doubt,
        doubt * most,
        changed,
        now.known,
        pairs.type == ConflictType.CROSS,
        pairs.type == ConflictType.MERGE,
        np.where(follows, 0.0, np.cos(pairs.angle_rad)),
        follows,
        np.where(follows, at_once / MOST_MPS2, 0.0),
        _below(gap_m, 8.0, 2.0) * v.min(axis=1) / FASTEST_MPS,
        np.where(follows, np.clip(-a[:, _FIRST_OF_FOLLOW], 0.0, MOST_MPS2) / MOST_MPS2, 0.0),
        v.max(axis=1) / FASTEST_MPS,
        v.min(axis=1) / FASTEST_MPS,
        v.min(axis=1) / FASTEST_MPS * most,
    )  # fmt: skip
    return Signs(pairs, futures[1], np.column_stack(columns).astype(np.float64))


def _surely(times: Times, at_once_s: float, soon_s: float) -> FloatArray:
    """How surely two are in their area at once, or nearly so, soon [...]."""
    return _below(times.encroachment_s(), at_once_s, 0.25) * _below(times.second_s(), soon_s, 0.5)


def _below(value: FloatArray, bound: float, blur: float) -> FloatArray:
    """1 far below the bound, 0 far above it (logistic)."""
    away = np.clip((value - bound) / blur, -30.0, 30.0)
    return np.asarray(1.0 / (1.0 + np.exp(away)))


def _needed(
    pairs: Pairs,
    speed_mps: FloatArray,
    acceleration_mps2: FloatArray,
    predicted: Times,
    reaction_s: float,
) -> FloatArray:
    """[P] the braking that the better placed of the two needs to give way, begun after a time in
    which everybody keeps his acceleration; at most `MOST_MPS2`."""
    then, then_mps = pairs, speed_mps
    if reaction_s > 0.0:
        after = round(reaction_s / DT_S)
        kept_m = kept_travel_m(speed_mps, acceleration_mps2)
        gone_m = kept_m[:, after - 1][pairs.index]
        then_mps = (kept_m[:, after - 1] - kept_m[:, after - 2]) / DT_S
        then = replace(
            pairs,
            room_m=pairs.room_m - gone_m,
            clear_m=pairs.clear_m - gone_m,
            to_point_m=pairs.to_point_m - gone_m,
        )
        behind = pairs.type == FOLLOW
        then.room_m[behind, 1] += gone_m[behind, 0]  # the leader has gone on as well
    leave_s = np.maximum(predicted.leave_s - reaction_s, 0.0)
    each = deceleration_to_avoid_mps2(then, then_mps, leave_s)
    return np.minimum(each, MOST_MPS2).min(axis=1)


def kept_travel_m(speed_mps: FloatArray, acceleration_mps2: FloatArray) -> FloatArray:
    """Path length [N, F] at constant acceleration, from a standstill to `FASTEST_MPS` at most."""
    time_s = DT_S * np.arange(1, HORIZON_FRAMES + 1)
    speed = speed_mps[:, None] + acceleration_mps2[:, None] * time_s
    fastest = np.maximum(speed_mps, FASTEST_MPS)[:, None]
    return np.cumsum(np.clip(speed, 0.0, fastest) * DT_S, axis=1)


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
    point = np.where(np.isfinite(pairs.to_point_m), s + pairs.to_point_m, np.inf)[..., None]
    own = (kind == Gate.STOP_LINE) | (kind == Gate.GIVE_WAY_LINE)
    own &= (gate_s <= point) & (gate_s > point - BEFORE_CONFLICT_M)
    way_m = np.where(own, gate_s - s[..., None], np.inf).min(axis=-1, initial=np.inf)
    return np.asarray(way_m - 0.5 * pairs.length_m)


@dataclass(frozen=True, eq=False)
class _Modes:
    """When the two of each pair are in their area, in each of K predicted modes [P, 2, K]."""

    enter_s: FloatArray
    leave_s: FloatArray
    weight: FloatArray

    def meet(self) -> FloatArray:
        """The four signs [4, P] of modes."""
        pairs, _, count = self.weight.shape
        shape = (pairs, count, count)

        def both(of: FloatArray) -> FloatArray:
            each = np.broadcast_to(of[:, 0, :, None], shape), np.broadcast_to(of[:, 1, None], shape)
            return np.stack([one.reshape(-1) for one in each], axis=1)

        times = Times(both(self.enter_s), both(self.leave_s))
        weight = both(self.weight)
        chance = weight.prod(axis=1).reshape(pairs, count * count)
        has_weight = (weight.min(axis=1) >= SOME_WEIGHT).reshape(pairs, count * count)
        surely = _surely(times, AT_ONCE_S, SOON_S).reshape(pairs, count * count)
        soon = _surely(times, AT_ONCE_S, 3.0).reshape(pairs, count * count)
        enters = np.minimum(self.enter_s, FAR_S)
        mean = (self.weight * enters).sum(axis=2, keepdims=True)
        spread = np.sqrt((self.weight * (enters - mean) ** 2).sum(axis=2)).max(axis=1)
        return np.stack(
            (
                (chance * surely).sum(axis=1),
                (chance * soon).sum(axis=1),
                (has_weight * surely).max(axis=1, initial=0.0),
                spread / FAR_S,
            )
        )


def _modes(moment: Moment, pairs: Pairs) -> _Modes:
    prediction = moment.prediction
    vehicles, count = prediction.mode_probability.shape
    here = np.broadcast_to(moment.scene.xy_m[:, None, None], (vehicles, count, 1, 2))
    path = np.concatenate((here, prediction.xy_m), axis=2)
    way_m = np.cumsum(np.linalg.norm(np.diff(path, axis=2), axis=3), axis=2)
    row = pairs.index[..., None] * count + np.arange(count)
    enter, leave = (
        arrival_s(
            way_m.reshape(vehicles * count, HORIZON_FRAMES),
            row.reshape(-1),
            np.repeat(to_m.reshape(-1), count),
        ).reshape(row.shape)
        for to_m in (pairs.room_m, pairs.clear_m)
    )
    return _Modes(enter, leave, prediction.mode_probability[pairs.index])


@dataclass(frozen=True, eq=False)
class _Slots:
    """How surely each of pairs [P, 2] lets somebody go."""

    yields: FloatArray  # [P, 2]; 0.5 where not known
    known: BoolArray  # [P] of both


def _slots(moment: Moment, pairs: Pairs, prediction: Prediction) -> _Slots:
    chance = yield_probability(moment.scene.ids, pairs.index, prediction)
    known = ~np.isnan(chance)
    return _Slots(np.where(known, chance, 0.5), np.asarray(known.all(axis=1)))


def yield_probability(ids: tuple[str, ...], index: IntArray, prediction: Prediction) -> FloatArray:
    """How surely each of pairs [P, 2] was predicted to let somebody go, where the other is of its
    focus group; elsewhere NaN. `ids` are those of `index`, the prediction may be of another frame.
    """
    graphs, chances = prediction.graphs, prediction.slot_probability
    out = np.full(index.shape, np.nan)
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
        out[:, k] = np.where(known, chances[row, 0], np.nan)
    return out
