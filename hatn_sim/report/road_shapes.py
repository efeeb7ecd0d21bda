"""Lanes -> what is seen of them from above: asphalt with rounded kerbs, markings, lines to stop at.

Pure arrays in metres of the map frame; `canvas` gives them colours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from hatn_sim.datatypes import BoolArray, FloatArray, Gate, Kind, Lane, Scene
from hatn_sim.geometry import resample, tangent_rad

MOTOR_KINDS: Final = frozenset({Kind.CAR, Kind.LORRY, Kind.BUS})
KERB_RADIUS_M: Final = 3.0
"""Corners between lanes are rounded off by this; narrower gaps are paved over."""
GRID_M: Final = 0.2
EDGE_M: Final = 0.18
"""Markings at the edge of the road lie this far inside it."""
STOP_M: Final = 0.45
"""Depth of a stop line."""


@dataclass(frozen=True)
class Box:
    """A part of the map, in metres."""

    west_m: float
    south_m: float
    east_m: float
    north_m: float

    def near(self, xy_m: FloatArray, margin_m: float) -> BoolArray:
        """Which of the points [..., 2] lie in the box, or outside it by less than a margin."""
        low = np.array([self.west_m, self.south_m]) - margin_m
        high = np.array([self.east_m, self.north_m]) + margin_m
        inside: BoolArray = np.all((xy_m >= low) & (xy_m <= high), axis=-1)
        return inside


@dataclass(frozen=True, eq=False)
class Surface:
    """A signed distance on a grid: the surface is where `outside_m` is below 0."""

    x_m: FloatArray  # [X]
    y_m: FloatArray  # [Y]
    outside_m: FloatArray  # [Y, X]


@dataclass(frozen=True, eq=False)
class StopLine:
    """What is painted across the end of a lane."""

    gate: Gate
    corners_xy_m: FloatArray  # [4, 2]
    signals: tuple[int, ...]  # indices into Scene.signal_closed


@dataclass(frozen=True, eq=False)
class RoadShapes:
    """All that is to be drawn of a road within a box."""

    asphalt: Surface | None
    path: Surface | None  # for those on foot or bicycle
    rails_xy_m: tuple[FloatArray, ...]  # of lanes that only trams use
    solid_xy_m: tuple[FloatArray, ...]
    dashed_xy_m: tuple[FloatArray, ...]
    stop_lines: tuple[StopLine, ...]


def road_shapes(lanes: Iterable[Lane], box: Box) -> RoadShapes:
    """The shapes of the lanes that show in the box."""
    near = [lane for lane in lanes if box.near(resample(lane.xy_m, 1.0), 8.0).any()]
    road = [lane for lane in near if lane.kinds & MOTOR_KINDS]
    trams = [lane for lane in near if not lane.kinds & MOTOR_KINDS and Kind.TRAM in lane.kinds]
    others = [lane for lane in near if lane not in road and lane not in trams]
    asphalt = _surface(road, box, KERB_RADIUS_M)
    solid, dashed = markings([lane for lane in road if not lane.is_connection], asphalt)
    return RoadShapes(
        asphalt=asphalt,
        path=_surface(others, box, 1.0),
        rails_xy_m=tuple(beside(lane.xy_m, side) for lane in trams for side in (-0.72, 0.72)),
        solid_xy_m=solid,
        dashed_xy_m=dashed,
        stop_lines=tuple(stop_line(lane) for lane in road if lane.gate is not Gate.NONE),
    )


def lamps_in(shapes: RoadShapes, box: Box, scene: Scene) -> list[tuple[StopLine, bool]]:
    """The stop lines of signals that show in the box, and whether they are closed."""
    closed = scene.signal_closed
    return [
        (line, bool(closed[list(line.signals)].all()))
        for line in shapes.stop_lines
        if line.gate is Gate.SIGNAL
        and line.signals
        and max(line.signals) < len(closed)
        and box.near(line.corners_xy_m, 0.0).any()
    ]


def _surface(lanes: Sequence[Lane], box: Box, radius_m: float) -> Surface | None:
    """The union of lanes, closed by a disc: its corners come out as round as real kerbs are."""
    if not lanes:
        return None
    margin_m = 2.0 * radius_m
    x = np.arange(box.west_m - margin_m, box.east_m + margin_m, GRID_M)
    y = np.arange(box.south_m - margin_m, box.north_m + margin_m, GRID_M)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    outside = np.full(len(grid), np.inf)
    for width_m in sorted({lane.width_m for lane in lanes}):
        lines = [resample(lane.xy_m, GRID_M) for lane in lanes if lane.width_m == width_m]
        points = np.concatenate(lines)
        points = points[box.near(points, margin_m + width_m)]
        if len(points):
            away_m, _ = KDTree(points).query(grid)
            outside = np.minimum(outside, away_m - 0.5 * width_m)
    rim = _crossings(x, y, outside.reshape(len(y), len(x)) - radius_m)
    if len(rim):
        deep_m, _ = KDTree(rim).query(grid)
        outside = np.where(outside < radius_m, np.minimum(outside, radius_m - deep_m), outside)
    return Surface(x, y, gaussian_filter(outside.reshape(len(y), len(x)), 1.0))


def _crossings(x_m: FloatArray, y_m: FloatArray, value: FloatArray) -> FloatArray:
    """Where a function on a grid [Y, X] is 0, by linear interpolation along the grid: [P, 2]."""
    points: list[FloatArray] = []
    for axis in (0, 1):
        before, after = (value[:-1], value[1:]) if axis == 0 else (value[:, :-1], value[:, 1:])
        row, column = np.nonzero((before < 0.0) != (after < 0.0))
        part = before[row, column] / (before[row, column] - after[row, column])
        x, y = x_m[column], y_m[row]
        points.append(
            np.stack((x, y + part * GRID_M) if axis == 0 else (x + part * GRID_M, y), axis=1)
        )
    return np.concatenate(points)


def beside(xy_m: FloatArray, left_m: float) -> FloatArray:
    """A polyline moved to its left."""
    points = resample(xy_m, 1.0)
    yaw = tangent_rad(points)
    return points + left_m * np.stack((-np.sin(yaw), np.cos(yaw)), axis=1)


def markings(
    lanes: Sequence[Lane], asphalt: Surface | None
) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    """Solid lines between directions, dashed ones between lanes of a direction.

    The edges of the road are not among them: they follow the asphalt. Without it, solid lines
    between lanes that part are left out.
    """
    solid: list[FloatArray] = []
    dashed: list[FloatArray] = []
    if not lanes:
        return (), ()
    outside: Callable[[FloatArray], FloatArray] | None = None
    if asphalt is not None:
        grid = (asphalt.y_m, asphalt.x_m)
        outside = RegularGridInterpolator(
            grid, asphalt.outside_m, bounds_error=False, fill_value=0.0
        )
    points = [resample(lane.xy_m, 0.5) for lane in lanes]
    tree = KDTree(np.concatenate(points))
    owner = np.repeat(np.arange(len(lanes)), [len(p) for p in points])
    yaw_rad = np.concatenate([tangent_rad(p) for p in points])
    width_m = np.array([lane.width_m for lane in lanes])
    for index, lane in enumerate(lanes):
        own_yaw = tangent_rad(resample(lane.xy_m, 1.0))
        for side in (1.0, -1.0):
            beyond = beside(lane.xy_m, side * (0.5 * lane.width_m + 0.7))
            away_m, near = tree.query(beyond)
            there = (away_m < 0.5 * width_m[owner[near]] + 0.3) & (owner[near] != index)
            same = np.cos(yaw_rad[near] - own_yaw) > 0.0
            border = beside(lane.xy_m, side * 0.5 * lane.width_m)
            if outside is not None:
                inner = beside(lane.xy_m, side * (0.5 * lane.width_m - EDGE_M))
                solid += _runs(inner, ~there & (outside(inner[:, ::-1]) < -3.0 * EDGE_M))
            if side > 0:  # the neighbour draws the other one
                solid += _runs(border, there & ~same)
                dashed += _runs(border, there & same)
    return tuple(solid), tuple(dashed)


def _runs(xy_m: FloatArray, keep: BoolArray) -> list[FloatArray]:
    """The unbroken stretches of a polyline (a vertex each metre) that are kept, but no crumbs."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], keep, [False])).astype(np.int8)))
    return [xy_m[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 5]


def stop_line(lane: Lane) -> StopLine:
    along = lane.xy_m[-1] - lane.xy_m[-2]
    along = along / np.linalg.norm(along)
    left = np.array([-along[1], along[0]]) * (0.5 * lane.width_m - EDGE_M)
    front, back = lane.xy_m[-1], lane.xy_m[-1] - STOP_M * along
    corners = np.stack((front + left, front - left, back - left, back + left))
    return StopLine(lane.gate, corners, tuple((lane.signals or {}).values()))
