"""What the signs along the ego's way forbid: limits, stop lines and closed signals.

As far as the road tells: give-way lines forbid nothing by themselves, and where no way is known
nothing is forbidden.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from hatn_sim.datatypes import DT_S, BoolArray, Gate, Lane
from hatn_sim.road import Road
from hatn_sim.way import Way

TOLERANCE: Final = 0.1
"""Share of the limit by which one may be faster."""
AT_LINE_M: Final = 3.0
STANDING_MPS: Final = 0.3
"""Who has been slower than this so near before a stop line has stopped at it."""
OVER_M: Final = 1.0
"""Front bumpers of those who stand at a line may be so far beyond it."""
STOPPING_MPS2: Final = 3.0
"""Who would have to brake harder for a signal that closes may still pass."""


@dataclass(frozen=True, eq=False)
class Rules:
    """The signs along a way of L lanes with G lines across it; arc lengths are those of `Way`.

    Tuples, for they are looked up one by one, in every frame.
    """

    ends_m: Sequence[float]  # [L]
    limit_mps: Sequence[float]  # [L]
    line_s_m: Sequence[float]  # [G] rising
    signal: Sequence[int]  # [G] index into Scene.signal_closed; -1: a stop line
    passed_s_m: Sequence[float]  # [G] where front bumpers have passed the lines


@dataclass(frozen=True)
class Step:
    """A frame of the ego on its way: arc lengths of its front bumper, and its speed after it."""

    before_m: float
    after_m: float
    half_m: float  # half its length
    speed_mps: float
    came_mps: float = 0.0  # who came on the road too fast may be so until it has slowed down


def rules_along(road: Road, way: Way) -> Rules:
    """The signs along all lanes of a way."""
    lanes, ends_m = [road.lanes[name] for name in way.route], way.ends_m
    found = [
        (ends_m[k], signal)
        for k, (lane, following) in enumerate(zip(lanes, way.route[1:], strict=False))
        if (signal := _line_of(lane, following)) is not None
    ]
    return Rules(
        tuple(ends_m),
        tuple(_limit_mps(lanes, k) for k in range(len(lanes))),
        tuple(s_m for s_m, _ in found),
        tuple(signal for _, signal in found),
        tuple(s_m + OVER_M for s_m, _ in found),
    )


def _line_of(lane: Lane, following: str) -> int | None:
    """The signal of the line at the end of a lane, -1 of a stop line; None: there is no line."""
    if lane.gate is Gate.STOP_LINE:
        return -1
    return (lane.signals or {}).get(following) if lane.gate is Gate.SIGNAL else None


def _limit_mps(lanes: list[Lane], k: int) -> float:
    """No sign stands inside a junction: what roads say of connections is how they bend."""
    beside = [one for one in lanes[max(k - 1, 0) : k + 2] if not one.is_connection]
    if lanes[k].is_connection and beside:
        return max(one.speed_limit_mps for one in (*beside, lanes[k]))
    return lanes[k].speed_limit_mps


def may_pass(rules: Rules, may: bool, front_m: float, speed_mps: float, closed: BoolArray) -> bool:
    """Whether an ego may pass the line ahead of it; `may`: whether it was so a frame ago."""
    ahead = _ahead(rules, front_m)
    if ahead == len(rules.line_s_m):
        return False
    away_m = rules.line_s_m[ahead] - front_m
    signal = rules.signal[ahead]
    if signal < 0:
        return away_m < AT_LINE_M and (may or speed_mps < STANDING_MPS)
    return not closed[signal] or (may and speed_mps**2 / (2.0 * STOPPING_MPS2) > away_m)


def lawless(rules: Rules, may: bool, step: Step) -> float:
    """How much a frame breaks the rules.

    1 for each line passed that may not be (`may`: the first of them may), and the time, in s, times
    the share of the limit by which it is faster than it may be.
    """
    passed = _ahead(rules, step.after_m) - _ahead(rules, step.before_m)
    limit_mps = _limit_at(rules, step)
    allowed_mps = max((1.0 + TOLERANCE) * limit_mps, step.came_mps)
    return max(passed - may, 0) + DT_S * max(step.speed_mps - allowed_mps, 0.0) / limit_mps


def still_came_mps(rules: Rules, step: Step) -> float:
    """The `came_mps` of the next step: what it has slowed down to, 0 once that is lawful."""
    is_lawful = step.speed_mps <= (1.0 + TOLERANCE) * _limit_at(rules, step)
    return 0.0 if is_lawful else min(step.came_mps, step.speed_mps)


def _limit_at(rules: Rules, step: Step) -> float:
    lane = bisect_right(rules.ends_m, step.after_m - step.half_m)
    return rules.limit_mps[min(lane, len(rules.limit_mps) - 1)]


def _ahead(rules: Rules, front_m: float) -> int:
    """The number of the first line that is not passed yet."""
    return bisect_right(rules.passed_s_m, front_m)
