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


@dataclass(frozen=True)
class Newcomer:
    """A recorded vehicle that appears."""

    id: str
    type: str  # of those in the types file
    edges: Route  # that it will drive; empty: not known
    length_m: float
    width_m: float


@dataclass(frozen=True, eq=False)
class ReplayStep:
    """What is to happen in one step of a replay."""

    newcomers: tuple[Newcomer, ...]
    leavers: tuple[str, ...]
    placed: tuple[str, ...]  # [M] vehicles moved to where they were recorded at the end of the step
    poses: FloatArray  # [M, 4] front x, y, compass angle in degrees, speed in m/s
    on_lane: BoolArray  # [M] False: placed beside the road, where no driver sees it
    released: tuple[tuple[str, Route], ...]  # from now on SUMO's, with the edges to drive
    driven: tuple[str, ...]  # all that are SUMO's now, those included
    commands: tuple[tuple[str, float], ...]


@dataclass(frozen=True, eq=False)
class ReplayFrame:
    """What SUMO made of a `ReplayStep`."""

    driven: RawFrame  # of the vehicles that are SUMO's
    placed: FloatArray  # [M, 3] front x, y, speed of the vehicles placed, in their order
    lanes: tuple[str, ...]  # [M] "" where on none
    lost: tuple[str, ...]  # placed vehicles that SUMO has taken off the road
    refused: tuple[str, ...]  # vehicles released for which SUMO has no way
