"""Everybody follows the own line at today's acceleration, which fades, up to a standstill."""

from __future__ import annotations

from hatn_sim.datatypes import FloatArray
from hatn_sim.perception import Perception
from hatn_sim.predictors.along_lines import LineFollower
from hatn_sim.predictors.free_motion import ACCELERATION_FADE_S, travelled_m
from hatn_sim.predictors.present import Present
from hatn_sim.road import Road


def constant_acceleration() -> LineFollower:
    """Along the reference line, which beats straight on wherever roads bend.

    Held for the whole horizon, an acceleration leads too far: it fades over
    `ACCELERATION_FADE_S`. Vehicles on no line go on at their turn rate.
    """
    return LineFollower("constant_acceleration", _travel)


def _travel(road: Road, seen: Perception, now: Present) -> FloatArray:
    return travelled_m(now.speed_mps, now.acceleration_mps2, ACCELERATION_FADE_S)
