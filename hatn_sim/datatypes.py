"""Every type that flows through hatn_sim, and the protocols, on one page. NumPy only.

Letters used in the shapes:
N vehicles in view, T history frames (the last is now), F future frames, E egos, M nodes,
C mixture components, K modes, S signalled links, P points of a polyline, Q conflicts.

Map frame: x east, y north, metres. Yaw is counter-clockwise from +x in (-pi, pi]. Positions are
box centres. Time in seconds. Arrays are float64 here and float32 inside the networks. What is not
there is told by a mask or an index of -1, never by a sentinel value.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from hatn_sim.road import Road

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Route = tuple[str, ...]
"""Lane ids in driving order, connections inside junctions included."""

DT_S = 0.1
"""The tick: every simulator is run at 10 Hz (METHOD: history and horizon are at 10 Hz)."""
HISTORY_FRAMES = 11
"""Frames that the networks see, now included (t-10 ... t)."""
CASE_HISTORY_FRAMES = 10
"""Frames that a case of the INTERACTION data set gives before its 3 s of future, now included."""
TRACK_FRAMES = 41
"""Frames kept of every vehicle, now included: for line inference and adaptation."""
HORIZON_FRAMES = 30
"""Predicted frames: 3 s."""
MAX_NODES = 8
"""Nodes of a semantic graph, the ego's own included (M_max)."""
PEDESTRIAN_PREFIX = "person:"
"""Persons and vehicles of SUMO may bear the same name; in a scene no two road users may."""


class Kind(IntEnum):
    """What a camera takes a road user for."""

    CAR = 0
    VAN = 1
    LORRY = 2
    BUS = 3
    MOTORCYCLE = 4
    BICYCLE = 5
    TRAM = 6
    PEDESTRIAN = 7
    OTHER = 8


class Gate(IntEnum):
    """What stands at the end of a lane."""

    NONE = 0
    STOP_LINE = 1
    GIVE_WAY_LINE = 2
    SIGNAL = 3


class ConflictType(IntEnum):
    CROSS = 0
    MERGE = 1


class Front(IntEnum):
    """What forms the front boundary of a dynamic insertion area."""

    VEHICLE = 0
    STOP = 1
    CONFLICT = 2
    FREE = 3


# ---------------------------------------------------------------------------------------------
# The road


@dataclass(frozen=True, eq=False)
class Lane:
    """A directed lane, or a connection inside a junction."""

    id: str
    xy_m: FloatArray  # [P, 2] centre line
    width_m: float
    speed_limit_mps: float
    successors: Route
    kinds: frozenset[Kind]
    gate: Gate = Gate.NONE
    signals: Mapping[str, int] | None = None  # successor -> index into Scene.signal_closed
    turn: int = 0  # of a connection: +1 left, 0 straight, -1 right
    is_connection: bool = False


@dataclass(frozen=True, eq=False)
class ReferenceLine:
    """The centre line of a route, sampled every `road.LINE_STEP_M`: s = index * step."""

    index: int
    route: Route
    xy_m: FloatArray  # [P, 2]
    lane_start_s_m: FloatArray  # [len(route)]
    closed_end: bool  # the route ends where the road does, it was not cut at the horizon


@dataclass(frozen=True)
class Conflict:
    """A place where two lines meet: `entry` <= `point` <= `exit` on each, in metres of arc length.

    `entry` is where the centre lines come within `road.CONFLICT_WIDTH_M`, `exit` where they part
    again; `point` is their closest approach for a crossing and the entry for a merge.
    """

    type: ConflictType
    entry_s_m: tuple[float, float]
    point_s_m: tuple[float, float]
    exit_s_m: tuple[float, float]


# ---------------------------------------------------------------------------------------------
# What a simulator yields


@dataclass(frozen=True, eq=False)
class Scene:
    """What a camera above sees at one moment, nothing more."""

    time_s: float
    ids: tuple[str, ...]  # [N]
    xy_m: FloatArray  # [N, 2]
    yaw_rad: FloatArray  # [N]
    speed_mps: FloatArray  # [N]
    size_m: FloatArray  # [N, 2] length, width
    kind: IntArray  # [N] Kind
    colour: IntArray  # [N, 3] red, green, blue in 0 ... 255
    blinker: IntArray  # [N] +1 left, 0 none, -1 right
    signal_closed: BoolArray  # [S] the link may not be entered now


@dataclass(frozen=True, eq=False)
class Truth:
    """What only the simulator knows. Labels, rewards and scores read it; predictors do not."""

    routes: tuple[Route | None, ...]  # [N] lanes driven and to be driven; None: not on a lane
    collisions: tuple[tuple[str, str], ...] = ()  # pairs that touch in this frame, ids sorted
    emergency_braking: tuple[str, ...] = ()
    departed: tuple[str, ...] = ()
    arrived: tuple[str, ...] = ()
    teleported: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Frame:
    scene: Scene
    truth: Truth
    done: bool  # no vehicle is left and none will come


@dataclass(frozen=True, eq=False)
class Tracks:
    """The last frames of every vehicle now in view, aligned; the last column is now."""

    ids: tuple[str, ...]  # [N]
    xy_m: FloatArray  # [N, T, 2]
    yaw_rad: FloatArray  # [N, T]
    speed_mps: FloatArray  # [N, T]
    valid: BoolArray  # [N, T]


@dataclass(frozen=True, eq=False)
class Lines:
    """The reference line of every vehicle in view, and where the vehicle is on it."""

    line: IntArray  # [N] index into the road's lines, -1: on no line
    s_m: FloatArray  # [N] arc length now
    d_m: FloatArray  # [N] lateral offset now, left positive
    phi_rad: FloatArray  # [N] heading minus tangent now
    probability: FloatArray  # [N] of the line among its candidates


# ---------------------------------------------------------------------------------------------
# What is predicted


@dataclass(frozen=True, eq=False)
class SemanticGraphs:
    """The semantic graphs of all egos of a scene: nodes are dynamic insertion areas (DIAs).

    Every vehicle with a reference line is an ego. Node 0 is the ego's own front DIA (choosing it
    is to yield); node m > 0 is the gap in front of an interacting vehicle (choosing it is to pass
    before that vehicle). Indices of vehicles point into `ids`.
    """

    ids: tuple[str, ...]  # [N] of the scene
    ego: IntArray  # [E] vehicle
    rear: IntArray  # [E, M] vehicle behind the DIA, -1 where masked
    front: IntArray  # [E, M] vehicle before the DIA, -1 where the front is no vehicle
    front_type: IntArray  # [E, M] Front
    x: FloatArray  # [E, M, T, 7] d_f, v_f, phi_f, d_r, v_r, phi_r, l; relative: x - x[:, :1]
    context: FloatArray  # [E, M, CONTEXT_SIZE] what holds now, see graph.CONTEXT
    node_mask: BoolArray  # [E, M]
    focus_mask: BoolArray  # [E, M] node 0 and the nodes of the focus group
    history_mask: BoolArray  # [E, M, T] both boundaries were seen
    has_conflict: BoolArray  # [E] there is an active conflict
    ego_at_red: BoolArray  # [E] a closed signal stands between the ego and its conflict
    ego_to_conflict_m: FloatArray  # [E, M] of the ego to the node's conflict, along its line
    rear_to_conflict_m: FloatArray  # [E, M] of the rear vehicle, along its line
    conflict_xy_m: FloatArray  # [E, M, 2] the conflict point on the ego's line
    conflict_type: IntArray  # [E, M] ConflictType
    leader: IntArray  # [E] the vehicle ahead in the ego's corridor, -1: none
    leader_gap_m: FloatArray  # [E] from bumper to bumper; 0 where there is none


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a predictor says of every vehicle in view."""

    ids: tuple[str, ...]  # [N]
    xy_m: FloatArray  # [N, K, F, 2] centres at t + 0.1 s ... t + 3 s
    mode_probability: FloatArray  # [N, K]
    fallback: BoolArray  # [N] no line was found: a physical extrapolation stands in
    adapted: BoolArray  # [N]
    lines: Lines | None = None
    graphs: SemanticGraphs | None = None
    slot_probability: FloatArray | None = None  # [E, M] over the focus nodes, with graphs
    goal_weight: FloatArray | None = None  # [N, C] mixture over the distance travelled in 3 s
    goal_mean_m: FloatArray | None = None  # [N, C]
    goal_std_m: FloatArray | None = None  # [N, C]


@dataclass(frozen=True)
class Suggestion:
    """The slot an ego had better take (METHOD section 7)."""

    ego_id: str
    time_s: float
    action: str  # "yield", "pass" or "abstain"
    slot_id: str | None  # the vehicle to pass before; on yield: the one to let go first
    probability: float  # that the ego takes this slot
    margin: float  # to the most probable of the other slots
    target_time_s: float | None  # until the ego, driving the profile, is at the conflict; None:
    # nobody can say, or on a yield somebody else may come then
    advised_speed_mps: float  # mean of the profile until then, or of all of it
    feasible: bool  # within the comfort limits
    text: str
    profile_mps: tuple[float, ...] = ()  # speed at the end of each tick; empty on abstention
    reason: str = (
        ""  # why this is advised, or nothing: one of `assist.choice.Why`, in small letters
    )


@dataclass(frozen=True)
class Alert:
    """One edge of an alert interval: `onset`, `peak` or `end`, tied together by `alert_id`."""

    alert_id: str
    edge: str
    type: str
    time_s: float
    ego_id: str
    other_id: str
    severity: float
    reason: str
    # What the ego had better do, told at the onset.
    action: str | None = None  # "brake": stay out of the other's way; "clear": get out of it
    room_m: float | None = None  # of "brake": from the front bumper to where the two meet
    open_s: float | None = None  # of "brake": from the onset until the other has left
    text: str | None = None


@dataclass(frozen=True)
class AlertInterval:
    """An alert from onset to end, about an unordered pair of vehicles."""

    first_id: str  # the two ids, sorted
    second_id: str
    type: str  # "CONFLICT" or "DEVIATION"
    onset_s: float
    end_s: float
    peak_s: float
    severity: float  # 0 ... 1, at the peak
    danger: float  # at the peak, in the unit of the rule that raised it; higher is worse


@dataclass(frozen=True)
class SafetyEvent:
    """Something unsafe that really happened, known only afterwards (METHOD section 7).

    Tiers: "T1" collision, "T2" evasive braking, "T3" second entry soon after the first left; and
    "brief", a braking that is hard in single frames only, which is counted apart.
    """

    tier: str
    first_id: str  # ids sorted; of an unattributed event: who braked
    second_id: str | None  # None: nobody was near enough to be the reason
    start_s: float
    cause: str  # "contact", "hard braking", "emergency braking" or "encroachment"
    encroachment_s: float | None = None  # of T2 that would have been, of T3 that was


@dataclass(frozen=True, eq=False)
class Advice:
    prediction: Prediction
    suggestions: tuple[Suggestion, ...]
    alerts: tuple[Alert, ...]

    def __repr__(self) -> str:
        """Without the arrays of the prediction, which fill the screen."""
        told = (*self.suggestions, *self.alerts)
        texts = ", ".join(repr(one.text) for one in told if one.text)
        return f"Advice([{texts}], {len(self.prediction.ids)} predicted)"


@dataclass(frozen=True)
class Command:
    """What an agent wants of its vehicle in the next tick: acceleration along its own line.

    Where the simulator takes it (highway-env), it may steer off that line, too.
    """

    ego_id: str
    acceleration_mps2: float
    steering_rad: float | None = None  # of the front wheels, left positive; None: along the line


@dataclass(frozen=True)
class Score:
    """A measure. `n` = 0 means that there is no value, and `value`, `low`, `high` are None."""

    measure: str
    predictor: str
    scene: str
    subset: str  # "all" or "moving" (more than 1 m in 3 s)
    adapt: str
    value: float | None
    unit: str
    n: int
    low: float | None
    high: float | None
    std: float | None = None  # over samples, of measures that are means
    lines: str = ""  # of recordings: what reference lines follow, and what chose among them
    seen: str = ""  # of networks: what of the scene they were trained or tuned on


# ---------------------------------------------------------------------------------------------
# What might have been


@dataclass(frozen=True, eq=False)
class Plan:
    """Drive a vehicle open loop, whatever is in its way; then the simulator's driver has it back.

    In SUMO's terms: speed mode 32, all of its checks off (safe gap, right of way, the vehicle's
    limits); 33 where it `follows`: nobody who drives by a plan looks away from the one ahead of
    him. Without effect while the vehicle is not on the road.
    """

    ego_id: str
    start_s: float  # from now; until then the simulator's own driver drives
    speed_mps: FloatArray  # [F] at the end of each tick from the start on
    blend_s: float = 0.0  # over which the speed it has at the start changes to the planned ones
    at_least: bool = False  # faster where the simulator's driver would be
    follows: bool = False  # no faster than that driver would follow whoever is ahead on his way


@dataclass(frozen=True)
class GiveWay:
    """Brake a vehicle as little as keeps it out of a place until that is free.

    From `start_s` on it does not speed up, and brakes evenly over the way and the time that are
    left, so as to reach the place no sooner than it is free, or to stop before it; harder where the
    simulator's driver does so himself. Who is in the place all the same, is his driver's again.
    """

    ego_id: str
    start_s: float  # from now; until then the simulator's own driver drives
    room_m: float  # from the front bumper now to the place
    open_s: float  # from now until the place is free
    hardest_mps2: float


@dataclass(frozen=True)
class Lawful:
    """Let a vehicle keep the rules of right of way and of signals, if its driver does not.

    SUMO holds most of what makes a driver break them with the vehicle's type: whoever shares the
    type keeps the rules as well. (A type of its own would upset what its driver has in mind.)
    """

    ego_id: str


Change = Plan | GiveWay | Lawful


@dataclass(frozen=True, eq=False)
class Branch:
    """What becomes of a simulation from now on, or would with changes to it.

    The first of the B frames is now. Rows of N are all vehicles ever there (no pedestrians);
    where `valid` is False the numbers are 0 and mean nothing.
    """

    ids: tuple[str, ...]  # [N]
    time_s: FloatArray  # [B] as in Scene
    valid: BoolArray  # [B, N]
    xy_m: FloatArray  # [B, N, 2]
    yaw_rad: FloatArray  # [B, N]
    speed_mps: FloatArray  # [B, N]
    size_m: FloatArray  # [N, 2] length, width
    collisions: tuple[tuple[float, str, str], ...]  # time, ids sorted; repeated while they touch
    emergency_braking: tuple[tuple[float, str], ...]  # time, id; repeated while it brakes


class BranchFuture(Protocol):
    """A branch that is being driven while the simulation goes on."""

    def result(self) -> Branch | None:
        """Waits for the branch; None where it was lost, because what drove it died."""
        ...


# ---------------------------------------------------------------------------------------------
# The protocols


class Simulator(Protocol):
    """Where frames come from. `notices` are lines for the user on what was made of the scene."""

    @property
    def name(self) -> str: ...

    @property
    def notices(self) -> Sequence[str]: ...

    @property
    def road(self) -> Road: ...

    @property
    def dt_s(self) -> float: ...

    def reset(self, seed: int) -> Frame: ...

    def step(self, commands: Sequence[Command] = ()) -> Frame: ...

    @property
    def cannot_branch(self) -> str | None:
        """Why `branch` raises InputError, in one line; None where it does not."""
        ...

    def branch(
        self, futures: Sequence[Sequence[Change]], horizon_s: float
    ) -> Sequence[BranchFuture]:
        """Starts one branch per set of changes; the empty set is the future as it will be.

        The simulation itself is left as it is, and may go on while the branches are driven.
        """
        ...

    def close(self) -> None: ...


class Recording(Protocol):
    """Traffic that has happened, at 10 Hz; `frames` begins anew at every call and is streamed."""

    @property
    def name(self) -> str: ...

    @property
    def notices(self) -> Sequence[str]: ...

    @property
    def doubts(self) -> Sequence[str]:
        """Those of the notices that ask whether the map is of this place: they go with scores."""
        ...

    @property
    def ids_by(self) -> str:
        """What ids name before their first colon: "recordings", "cases", or "" for nothing."""
        ...

    @property
    def lanes(self) -> Sequence[Lane]: ...

    def frames(self) -> Iterator[Frame]: ...


class Predictor(Protocol):
    """Memory is handed in and out, so that a run can be branched and replayed.

    `observe` is called on every frame and is cheap; `predict` on those where a prediction is
    wanted. `routes` is given under `--lines route` only: an upper bound that knows what a camera
    cannot.
    """

    @property
    def name(self) -> str: ...

    def init(self, road: Road) -> Any: ...

    def observe(
        self, state: Any, scene: Scene, routes: tuple[Route | None, ...] | None = None
    ) -> Any: ...

    def predict(self, state: Any) -> Prediction: ...


class Agent(Protocol):
    """Decides for one vehicle; None leaves the vehicle to the simulator's own driver.

    An agent may have `reads_suggestions`: where that is False, it reads predictions at most, and
    where nobody else asks for suggestions and alerts, these are not worked out. Where
    `reads_predictions` is False, too, it decides by the scene alone and drives the same, whoever
    predicts. Who has neither is taken to read both.
    """

    def init(self, road: Road) -> Any: ...

    def step(
        self, state: Any, ego_id: str, scene: Scene, advice: Advice
    ) -> tuple[Any, Command | None]:
        """The new state and `Command(ego_id, acceleration_mps2)`; None leaves it be this time."""
        ...


@runtime_checkable
class Guided(Protocol):
    """What an agent has that knows where it is going: it is told before each step.

    The route is its own vehicle's only, None where the simulator knows none.
    """

    def guide(self, state: Any, route: Route | None) -> Any: ...
