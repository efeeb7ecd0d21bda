"""Alert rules to compare ours with (METHOD section 7). The oracle knows the future: it is none."""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.assist.danger import constant_velocity_rule, hatn_rule, no_prediction_rule
from hatn_sim.assist.moment import AlertRule, Moment, PairDangers, pair_dangers
from hatn_sim.assist.pairs import FOLLOW
from hatn_sim.assist.risk import time_to_collision_s, times_at_speed
from hatn_sim.datatypes import BoolArray, FloatArray, Gate
from hatn_sim.geometry import wrap_angle

LEAST_TTC_S: Final = 0.1
LONGEST_S: Final = 5.0
"""What is farther off than this is no danger."""
BEFORE_CONFLICT_M: Final = 30.0
"""A line this near before a conflict is the conflict's."""
COMFORT_MPS2: Final = 3.0
"""Who needs to brake harder to stop at the line is taken not to stop."""


def time_to_collision_rule(moment: Moment) -> PairDangers:
    """Time to collision at constant speeds; the danger is 1 / TTC, in 1/s."""
    ttc = time_to_collision_s(moment.pairs, moment.scene.speed_mps)
    danger = np.where(ttc < LONGEST_S, 1.0 / np.maximum(ttc, LEAST_TTC_S), 0.0)
    return pair_dangers(moment.pairs.index, danger)


def encroachment_rule(moment: Moment) -> PairDangers:
    """Predictive encroachment time at constant speeds; the danger is `LONGEST_S` less it, in s."""
    times = times_at_speed(moment.pairs, moment.scene.speed_mps)
    near = (times.second_s() < LONGEST_S) & (moment.pairs.type != FOLLOW)
    danger = LONGEST_S - np.clip(times.encroachment_s(), -LONGEST_S, LONGEST_S)
    return pair_dangers(moment.pairs.index, np.where(near, danger, 0.0))


def right_of_way_rule(moment: Moment) -> PairDangers:
    """Who has to give way goes, or cannot stop at his line any more, while another is coming.

    To give way has whoever meets a stop or give-way line before the conflict and the other does
    not; of equals, the one on the left. The danger is `LONGEST_S` less the time, at constant speed,
    until the other is there, in s.
    """
    pairs, speed = moment.pairs, moment.scene.speed_mps
    times = times_at_speed(pairs, speed)
    goes, has_line = _goes(moment)
    danger = np.zeros(len(pairs.type))
    left = _is_left(moment)
    for k in (0, 1):
        minor = np.where(has_line[:, 0] == has_line[:, 1], left[:, k], has_line[:, k])
        there = times.enter_s[:, 1 - k]
        late = minor & goes[:, k] & (times.leave_s[:, k] > there) & (there < LONGEST_S)
        danger = np.maximum(danger, np.where(late, LONGEST_S - there, 0.0))
    return pair_dangers(pairs.index, np.where(pairs.type == FOLLOW, 0.0, danger))


def _goes(moment: Moment) -> tuple[BoolArray, BoolArray]:
    """Whether vehicles [Q, 2] move on into the conflict, and whether they have a line before it."""
    road, lines, pairs = moment.road, moment.seen.lines, moment.pairs
    index = pairs.index
    line, s = np.maximum(lines.line[index], 0), lines.s_m[index]
    gate_s, kind = road.gate_s_m[line], road.gate_type[line]
    point = np.where(np.isfinite(pairs.to_point_m), s + pairs.to_point_m, np.inf)[..., None]
    own = (kind == Gate.STOP_LINE) | (kind == Gate.GIVE_WAY_LINE)
    own &= (gate_s <= point) & (gate_s > point - BEFORE_CONFLICT_M)
    has_line: BoolArray = np.asarray(own.any(axis=-1))
    to_gate = np.where(own, gate_s - s[..., None], np.inf).min(axis=-1, initial=np.inf)
    to_stop = np.where(has_line, to_gate - 0.5 * pairs.length_m, pairs.room_m)
    speed = moment.scene.speed_mps[index]
    needed: FloatArray = speed**2 / (2.0 * np.maximum(to_stop, 0.1))
    return (speed > 0.5) & ((to_stop <= 0.0) | (needed > COMFORT_MPS2)), has_line


def _is_left(moment: Moment) -> BoolArray:
    """Who of each pair [Q, 2] has the other on the right."""
    pairs, scene = moment.pairs, moment.scene
    out = np.zeros(pairs.index.shape, dtype=np.bool_)
    for k in (0, 1):
        me, other = pairs.index[:, k], pairs.index[:, 1 - k]
        out[:, k] = wrap_angle(scene.yaw_rad[other] - scene.yaw_rad[me]) > 0.0
    return out


def always(moment: Moment) -> PairDangers:
    """Everybody who may meet."""
    return pair_dangers(moment.pairs.index, np.ones(len(moment.pairs.type)))


def never(_: Moment) -> PairDangers:
    """Nobody."""
    none = np.zeros(0, dtype=np.int64)
    return PairDangers(none, none, np.zeros(0))


RULES: Final[dict[str, AlertRule]] = {
    "hatn": hatn_rule,
    "no_prediction": no_prediction_rule,
    "constant_velocity": constant_velocity_rule,
    "time_to_collision": time_to_collision_rule,
    "encroachment": encroachment_rule,
    "right_of_way": right_of_way_rule,
    "always": always,
    "never": never,
}
