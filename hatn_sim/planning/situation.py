"""What a driver sees of its own way: limits, leader, lines to stop at, and where it meets whom.

Nothing here is predicted. The driver knows its own way where it was told (`guide`); that of all
others is inferred, as predictors do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hatn_sim.assist.areas import areas_m
from hatn_sim.assist.pairs import Pairs, at_conflicts
from hatn_sim.datatypes import (
    BoolArray,
    ConflictType,
    FloatArray,
    Gate,
    IntArray,
    Lines,
    Route,
    Scene,
)
from hatn_sim.graph import Gates, gates_ahead
from hatn_sim.perception import PerceptionState, begin, find_leaders, perceive
from hatn_sim.road import LINE_STEP_M, Road
from hatn_sim.speed_profile import allowed_speed_mps

STANDING_MPS: Final = 0.3
LONG_M: Final = 1000.0
"""Ways longer than this are looked at as far as lines reach."""
GATE_BEHIND_M: Final = 10.0
"""A line that the ego's front bumper has passed by less counts as one of this crossing."""
STOPS_MPS2: Final = 4.5
"""How hard others brake for a line at most (SUMO's default)."""
AT_LINE_M: Final = 3.0
"""Who has stood this near to a stop line has done what it asks for."""


@dataclass(frozen=True, eq=False)
class DriverState:
    """The memory of a driver. Handed in and out."""

    perception: PerceptionState
    route: Route | None = None
    has_stopped: bool = False  # at the stop line ahead


@dataclass(frozen=True, eq=False)
class Meetings:
    """Where the own line meets those of others [J], nearest first; distances as in `Pairs`.

    From the front bumper to the area (`room_m`) and until the rear bumper is out of it (`clear_m`).
    """

    other: IntArray  # [J] vehicles
    merges: BoolArray  # [J]
    room_m: FloatArray  # [J] of the ego
    clear_m: FloatArray  # [J]
    other_room_m: FloatArray  # [J]
    other_clear_m: FloatArray  # [J]
    gives_way: BoolArray  # [J] the other has a gate before the area, the ego none
    will_wait: (
        BoolArray  # [J] of those, who can still stop at it, and had none of the ego's to heed
    )


@dataclass(frozen=True, eq=False)
class Situation:
    """One moment of one driver. Distances are from its front bumper, along its line."""

    road: Road
    scene: Scene
    lines: Lines  # of all vehicles
    ego: int  # row of the scene
    line: int
    s_m: float  # of the centre
    speed_mps: float
    half_m: float  # half the length
    allowed_mps: FloatArray  # [P] every `PROFILE_STEP_M` from here on, by limits and bends
    leader: int  # row, -1: nobody
    gap_m: float  # to the leader's rear bumper; inf: nobody
    stop_m: float  # to a stop line or a closed signal; inf: none
    gate_m: float  # to any line or closed signal ahead, those it need not stop at, too; inf: none
    has_stopped: bool  # at the stop line ahead
    meetings: Meetings

    @property
    def leader_mps(self) -> float:
        """The leader's speed; 0 where there is none."""
        return float(self.scene.speed_mps[self.leader]) if self.leader >= 0 else 0.0


def begin_driving(road: Road) -> DriverState:
    """Nothing seen yet."""
    return DriverState(begin(road))


def guide(state: DriverState, route: Route | None) -> DriverState:
    """The way that the vehicle is to drive; None: to be inferred like anybody's."""
    return replace(state, route=route)


def look(
    state: DriverState, ego_id: str, scene: Scene, *, as_swept: bool = True
) -> tuple[DriverState, Situation | None]:
    """A frame on; None where the ego is not there, or on no line. As `situation_of`."""
    perception = perceive(state.perception, scene, None)
    state = replace(state, perception=perception)
    if ego_id not in scene.ids:
        return state, None
    road, ego = perception.road, scene.ids.index(ego_id)
    lines = on_route(road, scene, perception.seen.lines, ego, state.route)
    now = situation_of(road, scene, lines, ego, state.has_stopped, as_swept=as_swept)
    return state if now is None else replace(state, has_stopped=now.has_stopped), now


def situation_of(
    road: Road,
    scene: Scene,
    lines: Lines,
    ego: int,
    has_stopped: bool,
    *,
    as_swept: bool = True,
) -> Situation | None:
    """What the vehicle in this row sees where all are on these lines; None: it is on none.

    `has_stopped`: a moment ago, at the stop line ahead. `as_swept`: areas are what outlines sweep
    where lines bend (`assist.areas`), not those of straight lines.
    """
    if lines.line[ego] < 0:
        return None
    road.touch(lines.line[ego : ego + 1])
    gates = gates_ahead(road, scene, lines)
    speed_mps = float(scene.speed_mps[ego])
    near_line = gates.stop_m[ego] < AT_LINE_M
    stopped = bool(near_line and (has_stopped or speed_mps < STANDING_MPS))
    to_line_m = np.inf if stopped else gates.stop_m[ego]
    leader, gap_m = _leader(road, scene, lines, ego)
    line, s_m = lines.line[ego : ego + 1], lines.s_m[ego : ego + 1]
    return Situation(
        road=road,
        scene=scene,
        lines=lines,
        ego=ego,
        line=int(line[0]),
        s_m=float(s_m[0]),
        speed_mps=speed_mps,
        half_m=0.5 * float(scene.size_m[ego, 0]),
        allowed_mps=allowed_speed_mps(road, line, s_m)[0],
        leader=leader,
        gap_m=gap_m,
        stop_m=float(min(to_line_m, gates.closed_m[ego])),
        gate_m=float(_gate_m(gates)[ego]),
        has_stopped=stopped,
        meetings=_meetings(road, scene, lines, gates, ego, as_swept),
    )


def on_route(road: Road, scene: Scene, lines: Lines, ego: int, route: Route | None) -> Lines:
    """The lines of a moment, the ego's by its route, where that is known and of this road."""
    if not route or any(name not in road.lanes for name in route):
        return lines
    line, s_m, d_m = _on_line(road, scene, ego, route)
    if float(road.count[line[0]]) * LINE_STEP_M > LONG_M:
        # A line knows so many gates only; and what is far away need not be looked at.
        line, s_m, d_m = _on_line(road, scene, ego, road.stretch(int(line[0]), float(s_m[0])))
    turned = scene.yaw_rad[ego] - road.line_yaw_rad(line, s_m)
    new = {"line": line, "s_m": s_m, "d_m": d_m, "phi_rad": turned, "probability": np.ones(1)}
    columns = {name: getattr(lines, name).copy() for name in new}
    for name, value in new.items():
        columns[name][ego] = value[0]
    return Lines(**columns)


def _on_line(
    road: Road, scene: Scene, ego: int, route: Route
) -> tuple[IntArray, FloatArray, FloatArray]:
    """The line along a route, and where on it a vehicle is: arc length, offset; [1] each."""
    line = np.array([road.line(route)])
    length_m = float(road.count[line[0]]) * LINE_STEP_M
    return line, *road.search(line, scene.xy_m[ego : ego + 1], np.zeros(1), length_m)


def _leader(road: Road, scene: Scene, lines: Lines, ego: int) -> tuple[int, float]:
    """The vehicle ahead in the ego's corridor and the gap to it; -1, inf: nobody."""
    only = np.where(np.arange(len(scene.ids)) == ego, lines.line, -1)
    leader, at_m = find_leaders(road, scene, replace(lines, line=only))
    if leader[ego] < 0:
        return -1, np.inf
    half_m = 0.5 * (scene.size_m[ego, 0] + scene.size_m[leader[ego], 0])
    return int(leader[ego]), float(at_m[ego] - lines.s_m[ego] - half_m)


def _meetings(
    road: Road, scene: Scene, lines: Lines, gates: Gates, ego: int, as_swept: bool
) -> Meetings:
    pairs = at_conflicts(road, scene, lines)
    pairs = pairs.of(np.flatnonzero((pairs.index == ego).any(axis=1)))
    if as_swept:
        pairs = _swept(road, scene, lines, pairs)
    row, mine = np.nonzero(pairs.index == ego)
    room_m = pairs.room_m[row, mine]
    order = np.argsort(room_m, kind="stable")
    row, mine, room_m = row[order], mine[order], room_m[order]
    its = 1 - mine
    other, other_room_m = pairs.index[row, its], pairs.room_m[row, its]
    gate_m = _gate_m(gates)
    gives_way = (gate_m[other] <= other_room_m) & (gate_m[ego] > room_m)
    can_stop = scene.speed_mps**2 <= 2.0 * STOPS_MPS2 * np.maximum(gate_m, 0.0)
    # At two lines to give way at, both are equal; at a stop line one stops whoever else did.
    has_to_stop = np.minimum(gates.stop_m, gates.closed_m)[other] <= other_room_m
    had_line = _gate_behind_m(road, scene, lines, ego) < GATE_BEHIND_M
    return Meetings(
        other=other,
        merges=pairs.type[row] == ConflictType.MERGE,
        room_m=room_m,
        clear_m=pairs.clear_m[row, mine],
        other_room_m=other_room_m,
        other_clear_m=pairs.clear_m[row, its],
        gives_way=gives_way,
        will_wait=gives_way & can_stop[other] & (has_to_stop | (not had_line)),
    )


def _gate_m(gates: Gates) -> FloatArray:
    return np.minimum(np.minimum(gates.stop_m, gates.give_way_m), gates.closed_m)


def _swept(road: Road, scene: Scene, lines: Lines, pairs: Pairs) -> Pairs:
    point_s_m = lines.s_m[pairs.index] + pairs.to_point_m
    line = lines.line[pairs.index]
    before_m, beyond_m = areas_m(road, scene, pairs.index, line, point_s_m, pairs.type)
    room_m, clear_m = pairs.to_point_m - before_m, pairs.to_point_m + beyond_m
    return replace(pairs, room_m=room_m, clear_m=clear_m)


def _gate_behind_m(road: Road, scene: Scene, lines: Lines, ego: int) -> float:
    """From the last line to stop or give way at, to the front bumper; inf: there was none."""
    line = lines.line[ego]
    front_m = lines.s_m[ego] + 0.5 * scene.size_m[ego, 0]
    behind_m = front_m - road.gate_s_m[line]
    kind = road.gate_type[line]
    counts = (behind_m > 0.0) & ((kind == Gate.STOP_LINE) | (kind == Gate.GIVE_WAY_LINE))
    return float(behind_m[counts].min(initial=np.inf))
