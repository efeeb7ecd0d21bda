"""What a drive was worth: to the ego, and to those whom it met.

| measure | unit | what it is |
|---|---|---|
| `crossed` | share | the ego's rear bumper left its crossing within the limit, no collision |
| `time_to_cross` | s | from its coming into view until then; whoever never crosses: the limit |
| `time_to_enter` | s | the same until its front bumper is in the crossing |
| `collisions` | 1 | others whom the ego touched; the first contact ends the drive |
| `t2_events` | 1 | evasive brakings (T2 of `events`) of the ego, or of others for it |
| `t3_events` | 1 | close passes of the ego with another, under 1.5 s |
| `t3_events_1s` | 1 | those under 1.0 s |
| `t2_t3_events` | 1 | T2, and T3 under 1.5 s |
| `others_braking` | m/s2 | the hardest braking of anybody for the ego, over 0.3 s; 0: none |
| `missed_gaps` | 1 | see `missed_gaps` |
| `standing` | share | of the time to cross: slower than 0.5 m/s |
| `jerk_rms`, `jerk_p95` | m/s3 | of the ego until it has crossed: root mean square, 95 % quantile |

A crossing is the first junction of the ego's way, with those that follow within 50 m of each other
(`way`). Events, and what others brake, are looked at until 3 s after it. For whom somebody braked
is what `attribution` says. Of a drive that ends in a collision the time is the limit.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, FloatArray, SafetyEvent
from hatn_sim.score.attribution import foe_of_braking
from hatn_sim.score.close_passes import CLOSE_S, close_passes
from hatn_sim.score.drive import CROSSED, Drive
from hatn_sim.score.driven import Driven
from hatn_sim.score.events import deceleration_mps2, severe_events, sustained_mps2
from hatn_sim.score.missed_gaps import missed_gaps

UNITS: Final = {
    "crossed": "share",
    "time_to_cross": "s",
    "time_to_enter": "s",
    "collisions": "1",
    "t2_events": "1",
    "t3_events": "1",
    "t3_events_1s": "1",
    "t2_t3_events": "1",
    "others_braking": "m/s2",
    "missed_gaps": "1",
    "standing": "share",
    "jerk_rms": "m/s3",
    "jerk_p95": "m/s3",
}
"""Measure -> unit, in the order of the table."""
VERY_CLOSE_S: Final = 1.0
STANDING_MPS: Final = 0.5
BRAKES_MPS2: Final = 1.0
"""Whoever loses less than this is not braking."""
NEAR_M: Final = 60.0
"""Brakings farther from the ego are not for it."""


def drive_measures(drive: Drive, limit_s: float) -> dict[str, float]:
    """All of `UNITS`; `limit_s` is how long the drive was allowed to take."""
    driven, ego = drive.driven, drive.driven.ids.index(drive.ego_id)
    is_crossed = drive.end == CROSSED
    begin = drive.begin_frame
    own = [event for event in severe_events(driven) if drive.ego_id in _pair(event)]
    passes = [event for event in close_passes(driven) if drive.ego_id in _pair(event)]
    passes_s = [event.encroachment_s or 0.0 for event in passes]
    t2 = sum(event.tier == "T2" for event in own)
    t3 = sum(gap_s < CLOSE_S for gap_s in passes_s)
    speed_mps = _speed_mps(drive, ego)
    jerk = np.diff(speed_mps, n=2) / DT_S**2
    return {
        "crossed": float(is_crossed),
        "time_to_cross": _since(begin, drive.cross_frame if is_crossed else None, limit_s),
        "time_to_enter": _since(begin, drive.enter_frame, limit_s),
        "collisions": float(sum(drive.ego_id in pair for _, *pair in driven.contacts)),
        "t2_events": float(t2),
        "t3_events": float(t3),
        "t3_events_1s": float(sum(gap_s < VERY_CLOSE_S for gap_s in passes_s)),
        "t2_t3_events": float(t2 + t3),
        "others_braking": hardest_braking_mps2(driven, ego, begin),
        "missed_gaps": float(missed_gaps(driven, ego, drive.starts)),
        "standing": float((speed_mps < STANDING_MPS).mean()),
        "jerk_rms": float(np.sqrt((jerk**2).mean())) if len(jerk) else 0.0,
        "jerk_p95": float(np.quantile(np.abs(jerk), 0.95)) if len(jerk) else 0.0,
    }


def hardest_braking_mps2(driven: Driven, ego: int, from_frame: int) -> float:
    """The most speed that anybody lost for the vehicle of number `ego`, from a frame on, m/s2.

    A braking is a stretch in which a vehicle loses 1 m/s2 or more in every frame; it is as hard as
    its hardest 0.3 s, and for the foe that it has when it begins.
    """
    lost_mps2 = deceleration_mps2(driven)
    hardness_mps2 = sustained_mps2(driven, lost_mps2)
    own = driven.rows_of(ego)
    place_m = np.full((len(driven.time_s), 2), np.inf)
    place_m[driven.frame[own]] = driven.xy_m[own]
    brakes = (lost_mps2 >= BRAKES_MPS2) & (driven.vehicle != ego) & (driven.frame > from_frame)
    row = np.flatnonzero(brakes)
    if not len(row):
        return 0.0
    apart = (np.diff(row) != 1) | ~driven.follows_on()[row[1:]]
    stretches = np.split(row, np.flatnonzero(apart) + 1)
    for stretch in sorted(stretches, key=lambda rows: -hardness_mps2[rows].max()):
        hardest = float(hardness_mps2[stretch].max())
        first = int(stretch[0])
        if hardest < BRAKES_MPS2:
            break
        if np.hypot(*(driven.xy_m[first] - place_m[driven.frame[first]])) > NEAR_M:
            continue
        found = foe_of_braking(driven, int(driven.vehicle[first]), int(driven.frame[first]) - 1)
        if found is not None and found.foe == ego:
            return hardest
    return 0.0


def _pair(event: SafetyEvent) -> tuple[str, str | None]:
    return event.first_id, event.second_id


def _since(begin_frame: int, frame: int | None, limit_s: float) -> float:
    return limit_s if frame is None else min((frame - begin_frame) * DT_S, limit_s)


def _speed_mps(drive: Drive, ego: int) -> FloatArray:
    """Of the ego, at every frame until it has crossed."""
    rows = drive.driven.rows_of(ego)
    until = len(drive.driven.time_s) if drive.cross_frame is None else drive.cross_frame
    return drive.driven.speed_mps[rows][drive.driven.frame[rows] <= until]
