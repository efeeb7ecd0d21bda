"""Tracks and the lanes of a map -> lanes along which people drive.

The mean path of every way driven is laid into one web (`web.py`), and with it what of the map
nobody drove. The strands of the web are cut where the map has a stop or give-way line or a signal,
and where its junctions begin and end. What else there is to know of a lane the map says.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, Gate, IntArray, Kind, Lane
from hatn_sim.geometry import tangent_rad
from hatn_sim.recordings.lanelet2.rules import MOTOR
from hatn_sim.recordings.track_lines.clusters import mean_paths
from hatn_sim.recordings.track_lines.map_match import LaneMatch
from hatn_sim.recordings.track_lines.paths import STEP_M, DrivenTrack, Path, driven_path
from hatn_sim.recordings.track_lines.pieces import Piece, pieces_of
from hatn_sim.recordings.track_lines.undriven import lay_undriven
from hatn_sim.recordings.track_lines.web import Near, Web

PREFIX: Final = "driven:"
"""Begins the names of the lanes."""
TOGETHER_M: Final = 0.3
UNSURE_M: Final = 0.5
"""Paths are taken to run together within the first, and the second over the root of the number of
vehicles: of two vehicles the mean is not as sure as of many."""
TOGETHER_RAD: Final = np.deg2rad(2.5)
STRAY: Final = 2.5
GATE_REACH_M: Final = 3.5
"""A line across a lane holds for who passes this far beside the lane's middle."""
ONE_GATE_M: Final = 2.0
"""Lines nearer to each other than this are one."""
_WIDTH_M: Final = 3.5
TURN_RAD: Final = np.deg2rad(30.0)
_ORDER: Final = (Gate.NONE, Gate.GIVE_WAY_LINE, Gate.STOP_LINE, Gate.SIGNAL)


def lanes_from_tracks(tracks: Sequence[DrivenTrack], lanes: Sequence[Lane]) -> list[Lane]:
    """The lanes that tracks of motor vehicles draw, with those of the map where nobody drove.

    Lanes for others than motor vehicles stay as they are. Where too few drove to draw a line, all
    lanes are those of the map. Neither the order of the tracks nor the way the world is turned and
    shifted has an effect.
    """
    return lanes_from_paths([path for path in map(driven_path, tracks) if path is not None], lanes)


def lanes_from_paths(paths: Sequence[Path], lanes: Sequence[Lane]) -> list[Lane]:
    """The same of the paths of the vehicles among the tracks."""
    means = mean_paths(paths)
    motor = [lane for lane in lanes if lane.kinds & MOTOR]
    if not means or not motor:
        return list(lanes)
    web = Web()
    for path in means:
        web.lay(path, _near(path))
    driven = len(web.ahead)
    lay_undriven(web, motor)
    match = LaneMatch(motor)
    gates = _with_gates(web, motor, match)
    lane_at = match.lane_at(web.xy_m, web.yaw_rad)
    inside = np.array([*(lane.is_connection for lane in motor), False])[lane_at]
    drawn = _lanes(pieces_of(web, inside, gates), web, motor, lane_at, gates, driven)
    names = {lane.id for lane in motor}
    rest = [lane for lane in lanes if lane.id not in names]
    kept = {lane.id for lane in rest}
    return [*drawn, *(replace(one, successors=_among(one.successors, kept)) for one in rest)]


def _near(path: Path) -> Near:
    return Near(TOGETHER_M + UNSURE_M / float(np.sqrt(path.vehicles)), TOGETHER_RAD, STRAY)


def _among(names: Sequence[str], kept: set[str]) -> tuple[str, ...]:
    return tuple(name for name in names if name in kept)


def _with_gates(web: Web, lanes: Sequence[Lane], match: LaneMatch) -> dict[int, Gate]:
    """Put a point into the web wherever it crosses the line at the end of a lane: its gate."""
    gates: dict[int, Gate] = {}
    number = {lane.id: k for k, lane in enumerate(lanes)}
    lane_at = match.lane_at(web.xy_m, web.yaw_rad)
    for k, lane in enumerate(lanes):
        if lane.gate is Gate.NONE:
            continue
        own = [k, *(number[name] for name in lane.successors if name in number)]
        end, yaw = lane.xy_m[-1], float(tangent_rad(lane.xy_m)[-1])
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        away = web.xy_m - end
        along_m, left_m = away @ ahead, away @ np.array([-ahead[1], ahead[0]])
        beside = (np.abs(left_m) <= GATE_REACH_M) & (np.abs(along_m) <= 2.0 * STEP_M)
        beside &= np.isin(np.concatenate((lane_at, np.full(len(beside) - len(lane_at), -1))), own)
        for first in np.flatnonzero(beside & (along_m < 0.0)).tolist():
            for second in list(web.ahead[first]):
                if along_m[second] >= 0.0:
                    _set_gate(web, gates, (first, second), (along_m[first], along_m[second]), lane)
    return gates


def _set_gate(
    web: Web,
    gates: dict[int, Gate],
    link: tuple[int, int],
    along_m: tuple[float, float],
    lane: Lane,
) -> None:
    """Note a line between two points of the web, at the point of a line that is there already."""
    near = _within_steps(web, link, round(ONE_GATE_M / STEP_M)) & gates.keys()
    if near:
        point = min(near)
        gates[point] = max(gates[point], lane.gate, key=_ORDER.index)
        return
    part = -along_m[0] / (along_m[1] - along_m[0])
    xy_m = (1.0 - part) * web.xy_m[link[0]] + part * web.xy_m[link[1]]
    gates[web.split(*link, xy_m)] = lane.gate


def _within_steps(web: Web, link: tuple[int, int], steps: int) -> set[int]:
    """The points of the web on the way to and from a link."""
    found = set(link)
    back, on = {link[0]}, {link[1]}
    for _ in range(steps):
        back = {k for point in back for k in web.behind[point]}
        on = {k for point in on for k in web.ahead[point]}
        found |= back | on
    return found


def _lanes(
    pieces: Sequence[Piece],
    web: Web,
    lanes: Sequence[Lane],
    lane_at: IntArray,
    gates: Mapping[int, Gate],
    driven: int,
) -> list[Lane]:
    """The pieces as lanes; the first `driven` points of the web are of tracks.

    `lane_at` [V] is the number of the map's lane at every point of the web, -1: none.
    """
    names = [f"{PREFIX}{k}" for k in range(len(pieces))]
    usual = float(np.median([lane.speed_limit_mps for lane in lanes]))
    drawn: list[Lane] = []
    for name, piece in zip(names, pieces, strict=True):
        points = list(piece.points)
        known = [lanes[k] for k in lane_at[points[:-1]].tolist() if k >= 0]
        kinds = frozenset[Kind]().union(*(lane.kinds for lane in known))
        if points[len(points) // 2] < driven or not kinds:
            kinds |= MOTOR
        xy_m = web.xy_m[points]
        limits = [lane.speed_limit_mps for lane in known] or [usual]
        end = points[-1]
        drawn.append(
            Lane(
                id=name,
                xy_m=xy_m,
                width_m=float(np.median([lane.width_m for lane in known] or [_WIDTH_M])),
                speed_limit_mps=Counter(limits).most_common(1)[0][0],
                successors=tuple(names[k] for k in piece.ahead),
                kinds=kinds,
                gate=gates.get(end, Gate.NONE),
                turn=_turn(xy_m, known) if piece.inside else 0,
                is_connection=piece.inside,
            )
        )
    return drawn


def _turn(xy_m: FloatArray, known: Sequence[Lane]) -> int:
    """How a connection turns: as most of the map's connections under it do, or by its heading."""
    turns = Counter(lane.turn for lane in known if lane.is_connection)
    if turns:
        return turns.most_common(1)[0][0]
    yaw = tangent_rad(xy_m)
    change = float(yaw[-1] - yaw[0])
    return 0 if abs(change) < TURN_RAD else 1 if change > 0 else -1
