"""What a SUMO worker and its parent say to each other. Plain records that pickle well."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from hatn_sim.datatypes import BoolArray, Change, Command, FloatArray, IntArray, Route
from hatn_sim.errors import InputError
from hatn_sim.simulators.sumo_lanes import LaneTable


def accelerations(commands: Iterable[Command]) -> list[tuple[str, float]]:
    """(vehicle, acceleration in m/s2) of each. Raises InputError for one that steers."""
    told: list[tuple[str, float]] = []
    for command in commands:
        if command.steering_rad is not None:
            raise InputError(
                f"{command.ego_id!r} cannot be steered: SUMO keeps vehicles on their lanes; "
                "command its acceleration alone"
            )
        told.append((command.ego_id, command.acceleration_mps2))
    return told


class RawFrame(NamedTuple):
    """A frame, each road user's numbers in one row.

    Numbers are told as bytes, and frames as tuples: arrays and records of one frame take several
    times as long to pickle.
    """

    time_s: float
    ids: tuple[str, ...]  # [N]
    rows: bytes  # float64 [N, 11] x, y, yaw, speed, blinker, length, width, kind, red, green, blue
    routes: tuple[int, ...]  # [N] index among all routes sent so far, -1: on no lane
    new_routes: tuple[Route, ...]  # those not sent before
    closed: bytes  # a bool for each signal [S]
    collisions: tuple[tuple[str, str], ...]
    emergency_braking: tuple[str, ...]
    departed: tuple[str, ...]
    arrived: tuple[str, ...]
    teleported: tuple[str, ...]
    done: bool
    sumo_s: float = 0.0  # wall clock of SUMO's own step, reading excepted

    @property
    def signal_closed(self) -> BoolArray:
        """[S], to be read only."""
        return np.frombuffer(self.closed, np.bool_)


COLUMNS: Final = 11


def numbers_of(frames: Sequence[RawFrame]) -> FloatArray:
    """The rows of frames, one after the other; to be read only."""
    return np.frombuffer(b"".join([one.rows for one in frames])).reshape(-1, COLUMNS)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The first message to a worker: as if its program had been started now, and here."""

    folder: str  # "": it is no more, and the worker stays where it is
    variables: dict[str, str]


@dataclass(frozen=True)
class Leave:
    """The last message. A pipe that closes says as much, unless others hold it open as well."""


@dataclass(frozen=True, eq=False)
class Advance:
    """Asks for one step for each of these lists of commands, until nobody is left to drive."""

    commands: tuple[Sequence[tuple[str, float]], ...]  # vehicle, acceleration in m/s2
    kept: int  # frames to tell of, the last; of the others nobody needs to know


@dataclass(frozen=True, eq=False)
class Advanced:
    frames: tuple[RawFrame, ...]


@dataclass(frozen=True, eq=False)
class Started:
    lane_table: LaneTable
    frame: RawFrame
    cannot_branch: str | None  # why; None: it can


@dataclass(frozen=True)
class Refused:
    """SUMO did not take its options or what they name."""

    reason: str


@dataclass(frozen=True)
class Failed:
    """SUMO gave up in the middle of a run."""

    reason: str


@dataclass(frozen=True, eq=False)
class StartBranches:
    """Asks for one branch of so many steps per set of changes, without letting time pass."""

    futures: tuple[tuple[Change, ...], ...]
    steps: int


@dataclass(frozen=True)
class BranchesStarted:
    numbers: tuple[int, ...]  # to ask for them by


@dataclass(frozen=True)
class AwaitBranch:
    """Asks for a branch that was started; to be asked once."""

    number: int


@dataclass(frozen=True, eq=False)
class BranchEnded:
    """A `Branch`, pickled; None where the child that drove it died."""

    pickled: bytes | None


@dataclass(frozen=True)
class Spawn:
    """Asks for another vehicle of the type of one on the road, from where that one came in on."""

    name: str
    like: str


@dataclass(frozen=True)
class Spawned:
    """It will be on the road as soon as there is room."""


Paint = tuple[int, int, int, int]
"""Red, green, blue, opacity: 0 to 255."""


@dataclass(frozen=True, eq=False)
class Ribbon:
    """A line of some width, drawn over the roads and, in a high layer, over the traffic."""

    xy_m: FloatArray  # [P, 2] P >= 2
    width_m: float
    paint: Paint
    layer: int


@dataclass(frozen=True, eq=False)
class Mark:
    """A point of interest."""

    xy_m: FloatArray  # [2]
    width_m: float
    paint: Paint


@dataclass(frozen=True, eq=False)
class Picture:
    """Asks for all that is to be drawn in SUMO's window, in place of what was drawn before."""

    ribbons: Mapping[str, Ribbon]
    marks: Mapping[str, Mark]
    rings: Mapping[str, tuple[Paint, ...]]  # around vehicles, under them: from within outwards
    words: tuple[str, ...] = ()  # lines, at the top of the view
    followed: str | None = None  # the vehicle for the window to go with, once it is there
    begin_xy_m: FloatArray | None = None  # [2] where to look at first, where nobody is followed


View = tuple[float, float, float, float]
"""What the window shows of the map: least x and y, greatest x and y, in metres."""


@dataclass(frozen=True)
class Drawn:
    """It is drawn."""

    followed: str  # the vehicle that the window goes with; "": none
    view_m: View | None  # None: there is no view open


@dataclass(frozen=True)
class WindowClosed:
    """The user has closed SUMO's window, and the simulation with it."""


@dataclass(frozen=True)
class AskFoes:
    """Asks who conflicts with whom at the junctions ahead, without letting time pass."""

    reach_m: float  # how far ahead of every vehicle, along the lanes


@dataclass(frozen=True)
class AskLaneFoes:
    """Asks what SUMO's junctions hold against each other, whoever is there."""


@dataclass(frozen=True, eq=False)
class JunctionFoes:
    """SUMO's own list of conflicts, K of them, and the junctions ahead of the vehicles, A of them.

    Vehicles are rows of the frame before; lanes are rows of the lane table, -1 where it has none.
    Distances are along the lanes, from the front bumper, negative once passed.
    """

    vehicle: IntArray  # [K, 2] the asked one, its foe
    lane: IntArray  # [K, 2] the lanes inside the junction on which they meet
    enter_m: FloatArray  # [K, 2] to the begin of the area of conflict
    leave_m: FloatArray  # [K, 2] to its end
    approach_vehicle: IntArray  # [A]
    approach_lane: IntArray  # [A] the first lane of the vehicle's way through the junction
    approach_m: FloatArray  # [A] to the begin of that lane


@dataclass(frozen=True, eq=False)
class LaneFoes:
    """Rows of the lane table."""

    inside: IntArray  # [F, 2] a lane inside a junction, its foe
    approaching: IntArray  # [G, 3] a lane, the one it leads to, a lane whose traffic is its foe
    mute: IntArray  # lanes in junctions without logic, of which SUMO lists nothing


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
