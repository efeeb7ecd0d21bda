"""The speed a vehicle had better drive: as fast as the road, a leader and other vehicles' turns
allow, with bounded acceleration, braking and jerk. Many vehicles and slots at once.

Letters: R profiles, K areas on the way of each, G knots of time, P points of the road ahead,
F ticks of the profile.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, BoolArray, FloatArray, IntArray

PROFILE_FRAMES: Final = 50
"""5 s: what a plan is driven for (METHOD section 7)."""
KNOT_AT_S: Final[FloatArray] = np.array(
    [0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0]
)
"""Between knots the jerk is constant. The first ones are closest: a new profile replaces them."""
KNOTS: Final = len(KNOT_AT_S) - 1
_STEP_S: Final[FloatArray] = np.diff(KNOT_AT_S)
_KNOT_STEP_S: Final[list[float]] = _STEP_S.tolist()
_KNOT_BEFORE_S: Final = np.append(0.0, KNOT_AT_S[:-1])
ROAD_STEP_M: Final = 2.5
ROAD_REACH_M: Final = 50.0

COMFORT_ACCELERATION_MPS2: Final = 2.0
COMFORT_BRAKING_MPS2: Final = 3.0
COMFORT_JERK_MPS3: Final = 3.5
"""ISO 15622 allows cruise control 5 m/s^3 below 5 m/s and 2.5 above 20."""
HARD_BRAKING_MPS2: Final = 8.0
HARD_JERK_MPS3: Final = 40.0
"""Where comfort cannot keep a vehicle out of another's way; the profile is not feasible then."""
SLOWING_MPS2: Final = 1.5
"""Braking for a bend, a limit or a stop line, which are known long before."""
EASE_S: Final = 0.5
"""Differences of speed are made up for in this time."""
LAG_S: Final = 0.3
"""How long an acceleration lasts until it can be another."""
SHORT_M: Final = 1.0
"""Who has to stop does so this far before an area: a long body cuts the corner where it turns, and
nobody stops to the centimetre."""
SURE_S: Final = 0.5
"""Until so long before an area opens, the vehicle can still stop before it within comfort."""
FAR_S: Final = 60.0


@dataclass(frozen=True)
class Rule:
    """How a vehicle keeps out of a place. The jerk, which is bounded too, takes what is left to
    the limit of comfort."""

    braking_mps2: float
    time_s: float
    short_m: float


AREA: Final = Rule(2.4, 0.4, SHORT_M)
LEADER: Final = Rule(2.4, 0.9, 2.0)
LINE: Final = Rule(SLOWING_MPS2, 0.4, 0.5)


@dataclass(frozen=True, eq=False)
class Approach:
    """What R vehicles start from and have to keep to.

    Distances are from where their front bumpers are now, times from now; the profile itself may
    start later, where a driver needs time to react.
    """

    start_s: float
    start_m: FloatArray  # [R] driven until then
    speed_mps: FloatArray  # [R] then
    acceleration_mps2: FloatArray  # [R]
    allowed_mps: FloatArray  # [R, P] every `ROAD_STEP_M` from here to `ROAD_REACH_M`
    leader_m: FloatArray  # [R, G] to the rear bumper of whoever is ahead at a knot; inf: nobody
    leader_mps: FloatArray  # [R, G]
    stop_m: FloatArray  # [R] to a line to stop at; inf: none
    area_m: FloatArray  # [R, K] to areas that others have to leave first; inf: none
    open_s: FloatArray  # [R, K] when these may be entered

    def of(self, rows: IntArray) -> Approach:
        """Some of them, in the order asked for."""
        arrays = {
            name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)
        }
        return replace(self, **arrays)


@dataclass(frozen=True, eq=False)
class Profiles:
    """How R vehicles drive, at knots `KNOT_AT_S` after the start."""

    start_s: float
    speed_mps: FloatArray  # [R, G]
    acceleration_mps2: FloatArray  # [R, G]
    travelled_m: FloatArray  # [R, G] from where the vehicle is now

    @property
    def braking_mps2(self) -> FloatArray:
        """[R] the hardest; how it brakes as it starts is not the profile's."""
        ends = 2.0 * np.diff(self.speed_mps) / _STEP_S - self.acceleration_mps2[:, :-1]
        return np.asarray(np.maximum(-ends.min(axis=1), 0.0))

    def mean_mps(self, until_s: FloatArray) -> FloatArray:
        """[R] from now until then, at least a tick and at most to the end."""
        speed = self.tick_speed_mps()
        ticks = np.clip(np.round(until_s / DT_S), 1, PROFILE_FRAMES).astype(np.int64)
        counts = np.arange(PROFILE_FRAMES) < ticks[:, None]
        return np.asarray(np.where(counts, speed, 0.0).sum(axis=1) / ticks)

    def of(self, rows: IntArray) -> Profiles:
        """Some of them, in the order asked for."""
        return Profiles(
            self.start_s, self.speed_mps[rows], self.acceleration_mps2[rows], self.travelled_m[rows]
        )

    def tick_speed_mps(self) -> FloatArray:
        """[R, F] at the end of each tick: the jerk is constant between knots.

        Also where a vehicle comes to a stand at a knot, from which on its acceleration is nothing.
        """
        low, part = _TICK_KNOT, _TICK_PART_S / _TICK_STEP_S
        before, gained = self.speed_mps[:, low], np.diff(self.speed_mps)[:, low]
        at_once = self.acceleration_mps2[:, low] * _TICK_STEP_S
        speed = before + part * (at_once + part * (gained - at_once))
        return np.asarray(np.maximum(speed, 0.0))

    def arrival_s(self, distance_m: FloatArray) -> FloatArray:
        """When distances [R, K] from here have been driven, from now; at most `FAR_S`.

        At the last speed beyond the last knot, and no sooner than the profile starts.
        """
        reached = self.travelled_m[:, None, 1:].copy()
        reached[..., -1] = np.inf  # what is beyond the last knot is reached after it
        after = (reached < distance_m[..., None]).argmin(axis=-1) + 1
        row = np.arange(len(reached))[:, None]
        high, low = self.travelled_m[row, after], self.travelled_m[row, after - 1]
        within = (distance_m - low) / np.maximum(high - low, 1e-6)
        left_m = np.maximum(distance_m - self.travelled_m[:, -1:], 0.0)
        last = self.speed_mps[:, -1:]
        # Who stands at the end has no arrival; who rolls goes on at its speed.
        later = KNOT_AT_S[-1] + left_m / np.maximum(last, 1e-3)
        step_s = KNOT_AT_S[after] - KNOT_AT_S[after - 1]
        soon = KNOT_AT_S[after - 1] + np.maximum(within, 0.0) * step_s
        time_s = np.where(left_m > 0.0, later, soon)
        return np.minimum(self.start_s + time_s, FAR_S)


_TICK_S: Final = DT_S * np.arange(1, PROFILE_FRAMES + 1)
_TICK_KNOT: Final = np.clip(np.searchsorted(KNOT_AT_S, _TICK_S + 1e-9) - 1, 0, KNOTS - 1)
_TICK_PART_S: Final = _TICK_S - KNOT_AT_S[_TICK_KNOT]
_TICK_STEP_S: Final = _STEP_S[_TICK_KNOT]


def drive(approach: Approach) -> Profiles:
    """The fastest profile within comfort that keeps to all of an approach.

    At every knot the acceleration is the largest that keeps the vehicle (1) below what the road
    allows, (2) able to stop behind its leader (Gipps 1981, eq. 4, with equal braking), (3) able to
    stop at a line, (4) out of every area until it opens: braking evenly, so as to arrive as it
    opens, and until `SURE_S` before that able to stop. Comfort is left where these ask for more.
    """
    count = len(approach.speed_mps)
    shape = (KNOTS + 1, count)
    speeds, accelerations, travels = np.empty(shape), np.empty(shape), np.empty(shape)
    speed, travelled = np.maximum(approach.speed_mps, 0.0), approach.start_m
    acceleration = np.clip(
        approach.acceleration_mps2, -COMFORT_BRAKING_MPS2, COMFORT_ACCELERATION_MPS2
    )
    speeds[0], accelerations[0], travels[0] = speed, acceleration, travelled
    places = _places(approach)
    for knot, step_s in enumerate(_KNOT_STEP_S, start=1):
        now = speed, acceleration, travelled
        wanted = np.minimum(_keep_out(places, knot, *now), _by_road(approach, *now))
        is_hard = wanted < -COMFORT_BRAKING_MPS2
        drop = np.where(is_hard, HARD_JERK_MPS3 * step_s, COMFORT_JERK_MPS3 * step_s)
        before = acceleration
        most = np.minimum(before + COMFORT_JERK_MPS3 * step_s, COMFORT_ACCELERATION_MPS2)
        # To let go of the accelerator takes no time.
        least = np.maximum(np.minimum(before, 0.0) - drop, -HARD_BRAKING_MPS2)
        acceleration = np.minimum(np.maximum(wanted, least), most)
        after = speed + 0.5 * step_s * (before + acceleration)
        # It stops rather than reverse, and starts again from an acceleration of nothing.
        acceleration = np.where(after < 0.0, 0.0, acceleration)
        step_m = step_s * speed + step_s**2 / 6.0 * (2.0 * before + acceleration)
        travelled = travelled + np.maximum(step_m, 0.0)
        speed = np.maximum(after, 0.0)
        speeds[knot], accelerations[knot], travels[knot] = speed, acceleration, travelled
    return Profiles(approach.start_s, speeds.T, accelerations.T, travels.T)


LINE_ASKS: Final = -2
LEADER_ASKS: Final = -1


def hardest_asked(
    approach: Approach, profiles: Profiles, until_s: float
) -> tuple[IntArray, IntArray]:
    """At which knot [R] profiles brake hardest, within `until_s`, and what asks for it [R].

    That is the column of an area of the approach, `LINE_ASKS` or `LEADER_ASKS`. `profiles` are what
    `drive` makes of it. The road, which asks for `SLOWING_MPS2` at most, is left out.
    """
    last = int(np.searchsorted(KNOT_AT_S, until_s, side="right"))
    knots = 1 + profiles.acceleration_mps2[:, 1:last].argmin(axis=1)
    places = _places(approach)
    areas = approach.area_m.shape[1]
    _, column = np.nonzero(np.isfinite(approach.area_m))
    others = len(places.profile) - len(column) - len(knots)
    column = np.concatenate((column, np.full(others, areas), np.full(len(knots), areas + 1)))
    asked_mps2 = np.full((len(knots), areas + 2), np.inf)
    for knot in np.unique(knots).tolist():
        before = knot - 1
        now = (
            profiles.speed_mps[:, before],
            profiles.acceleration_mps2[:, before],
            profiles.travelled_m[:, before],
        )
        wanted, here = _asked_by_each(places, knot, *now), (knots == knot)[places.profile]
        asked_mps2[places.profile[here], column[here]] = wanted[here]
    most = asked_mps2.argmin(axis=1)
    return knots, np.where(most < areas, most, most - areas - 2)


def _by_road(
    approach: Approach, speed: FloatArray, acceleration: FloatArray, travelled: FloatArray
) -> FloatArray:
    # Where it will be when the difference has been made up for.
    rows, points = approach.allowed_mps.shape
    ahead = np.minimum((travelled + EASE_S * speed) / ROAD_STEP_M, points - 1.001)
    low = ahead.astype(np.int64)
    at, allowed_mps = points * np.arange(rows) + low, approach.allowed_mps.ravel()
    before, after = allowed_mps.take(at), allowed_mps.take(at + 1)
    allowed = before + (ahead - low) * (after - before)
    return np.maximum(_towards(allowed, _then_mps(speed, acceleration)), -SLOWING_MPS2)


_RULES: Final = np.array(
    [
        (rule.braking_mps2, rule.braking_mps2 * rule.time_s, rule.short_m, ease_s)
        # What stands still is reckoned with from where the vehicle will be: or it stops too late.
        for rule, ease_s in ((AREA, EASE_S), (LINE, EASE_S), (LEADER, 0.0))
    ]
).T


@dataclass(frozen=True, eq=False)
class _Places:
    """The L places that vehicles keep out of: A areas, then lines, last the leader of each vehicle.

    What is known of them beforehand, at every knot [G, ...].
    """

    profile: IntArray  # [L] whose
    braking_mps2: FloatArray  # [L] of the rule of each
    slack_mps: FloatArray  # [L]
    ease_s: FloatArray  # [L]
    square: FloatArray  # [G, L] (m/s)^2, of the speed safe there, but for the way driven until then
    stop_m: FloatArray  # [G, L] where to stand at the latest
    square_there: FloatArray  # [G, L] of the speed of the place
    arrive_m: FloatArray  # [A] where to be as areas open
    late_s: FloatArray  # [G, A] from the knot before until then, at least `EASE_S`
    closed: BoolArray  # [G, A] at the knot before
    sure: BoolArray  # [G, A] for longer than `SURE_S`


def _places(approach: Approach) -> _Places:
    of_area, which = np.nonzero(np.isfinite(approach.area_m))
    of_line = np.flatnonzero(np.isfinite(approach.stop_m))
    of_leader = np.arange(len(approach.speed_mps))
    area_m = approach.area_m[of_area, which]
    left_s = approach.open_s[of_area, which] - approach.start_s - _KNOT_BEFORE_S[:, None]
    numbers = len(of_area), len(of_line), len(of_leader)
    braking, slack, short, ease = np.repeat(_RULES, numbers, axis=1)
    room_m = np.empty((KNOTS + 1, len(braking)))
    standing = len(room_m[0]) - len(of_leader)
    room_m[:, :standing] = np.concatenate((area_m, approach.stop_m[of_line]))
    room_m[:, standing:] = approach.leader_m.T
    square_there = np.zeros(room_m.shape)
    square_there[:, standing:] = approach.leader_mps.T**2
    return _Places(
        profile=np.concatenate((of_area, of_line, of_leader)),
        braking_mps2=braking,
        slack_mps=slack,
        ease_s=ease,
        square=slack**2 + 2.0 * braking * (room_m - short) + square_there,
        stop_m=room_m - 0.5 * short,
        square_there=square_there,
        # As it opens the vehicle is a little before it: should it open late, that is what is left.
        arrive_m=area_m - AREA.short_m,
        late_s=np.maximum(left_s, EASE_S),
        closed=left_s > 0.0,
        sure=left_s > SURE_S,
    )


def _keep_out(
    places: _Places,
    knot: int,
    speed: FloatArray,
    acceleration: FloatArray,
    travelled: FloatArray,
) -> FloatArray:
    """The largest acceleration [R] that keeps vehicles out of all places."""
    wanted, own = _asked_by_each(places, knot, speed, acceleration, travelled), places.profile
    others = len(own) - len(speed)
    least = wanted[others:]
    np.minimum.at(least, own[:others], wanted[:others])
    return least


def _asked_by_each(
    places: _Places,
    knot: int,
    speed: FloatArray,
    acceleration: FloatArray,
    travelled: FloatArray,
) -> FloatArray:
    """The largest acceleration [L] that keeps vehicles out of each place.

    They stay able to stop so far before the end of their room, which may move on:
    v t + v^2 / 2b = d + u^2 / 2b (Gipps 1981, eq. 4, with equal braking b). They brake harder than
    planned only for the room itself.
    """
    own, braking = places.profile, places.braking_mps2
    v, gone = speed[own], travelled[own]
    square = places.square[knot] - 2.0 * braking * (gone + places.ease_s * v)
    safe = np.maximum(np.sqrt(np.maximum(square, 0.0)) - places.slack_mps, 0.0)
    faster_square = np.maximum(v * v - places.square_there[knot], 0.0)
    needed = 0.5 * faster_square / np.maximum(places.stop_m[knot] - gone, 0.25)
    wanted = _towards(safe, _then_mps(speed, acceleration)[own])
    wanted = np.maximum(wanted, -np.maximum(braking, 1.2 * needed))
    wanted = np.where(needed > 0.8 * braking, np.minimum(wanted, -needed), wanted)
    areas = len(places.arrive_m)
    wanted[:areas] = _in_time(places, knot, v[:areas], gone[:areas], wanted[:areas])
    return wanted


def _in_time(
    places: _Places, knot: int, speed: FloatArray, travelled: FloatArray, stopping: FloatArray
) -> FloatArray:
    """Acceleration [A] to arrive at areas as they open, or to stop before them."""
    late_s, sure = places.late_s[knot], places.sure[knot]
    even = 2.0 * (places.arrive_m - travelled - speed * late_s) / late_s**2
    # What the last centimetres would take is not worth more than comfort.
    even = np.where(sure, even, np.maximum(even, -AREA.braking_mps2))
    # Standing still before it opens is to stop, not to arrive.
    stops = speed + even * late_s < 0.0
    wanted = np.where(stops, stopping, np.where(sure, np.minimum(even, stopping), even))
    return np.where(places.closed[knot], wanted, np.inf)


def _then_mps(speed: FloatArray, acceleration: FloatArray) -> FloatArray:
    """The speed when the acceleration can be another."""
    return speed + LAG_S * acceleration


def _towards(wanted_mps: FloatArray, then_mps: FloatArray) -> FloatArray:
    """Acceleration to a speed, from that when it can be another."""
    return (wanted_mps - then_mps) / EASE_S
