"""What a SUMO worker says to its parent. Plain records that pickle well."""

from __future__ import annotations

from dataclasses import dataclass

from hatn_sim.datatypes import BoolArray, FloatArray, Route
from hatn_sim.simulators.sumo_lanes import LaneTable


@dataclass(frozen=True, eq=False)
class RawFrame:
    """A frame, each road user's numbers in one row."""

    time_s: float
    ids: tuple[str, ...]  # [N]
    rows: FloatArray  # [N, 11] x, y, yaw, speed, blinker, length, width, kind, red, green, blue
    routes: tuple[int, ...]  # [N] index among all routes sent so far, -1: on no lane
    new_routes: tuple[Route, ...]  # those not sent before
    signal_closed: BoolArray  # [S]
    collisions: tuple[tuple[str, str], ...]
    emergency_braking: tuple[str, ...]
    departed: tuple[str, ...]
    arrived: tuple[str, ...]
    teleported: tuple[str, ...]
    done: bool
    sumo_s: float = 0.0  # wall clock of SUMO's own step, reading excepted


@dataclass(frozen=True, eq=False)
class Started:
    lane_table: LaneTable
    frame: RawFrame


@dataclass(frozen=True)
class Refused:
    """SUMO did not take its options or what they name."""

    reason: str


@dataclass(frozen=True)
class Failed:
    """SUMO gave up in the middle of a run."""

    reason: str
