"""A sheet whose camera moves over the road: what stays is drawn once, and cut out where it is seen.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from hatn_sim.datatypes import FloatArray, Lane
from hatn_sim.report.canvas import DARK_ROAD, VERGE, Sheet, Style, draw_road, open_sheet
from hatn_sim.report.drawing import draw_moment_on
from hatn_sim.report.letters import lend_letters
from hatn_sim.report.moment import Moment
from hatn_sim.report.road_shapes import Box, RoadShapes, road_shapes

ROOM: Final = 1.6
"""The road is drawn for so many widths and heights of the map at once, where the camera moves."""


@dataclass(frozen=True, eq=False)
class _Ground:
    """The road drawn around a place, to cut views out of."""

    west_m: float
    north_m: float
    pixels: NDArray[np.uint8]  # [H, W, 4]
    shapes: RoadShapes


class MovingSheet:
    """Draws moments on one sheet; `draw` gives the pixels of each."""

    def __init__(
        self,
        style: Style,
        lanes: Sequence[Lane],
        centre_xy_m: FloatArray,
        width_m: float,
        moves: bool,
    ) -> None:
        self._sheet = open_sheet(style, lanes, centre_xy_m, width_m)
        self._lanes, self._room = lanes, ROOM if moves else 1.0
        canvas = self._sheet.agg
        canvas.draw()
        self._empty = np.array(canvas.buffer_rgba())
        bounds = self._sheet.map.get_window_extent().bounds
        left, bottom, wide, high = (round(value) for value in bounds)
        self._wide, self._high = wide, high
        top = self._empty.shape[0] - bottom - high
        self._map = (slice(top, top + high), slice(left, left + wide))
        self._metres_per_px = width_m / wide
        self._ground = self._draw_ground(centre_xy_m) if moves else None
        self._labels: dict[str, FloatArray] = {}

    def draw(self, moment: Moment, caption: str, centre_xy_m: FloatArray) -> NDArray[np.uint8]:
        """The pixels [H, W, 3] of a moment, seen from above a place."""
        sheet, pixels = self._seen_from(centre_xy_m)
        canvas = sheet.agg
        np.asarray(canvas.buffer_rgba())[...] = pixels
        artists, self._labels = draw_moment_on(sheet, moment, caption, self._labels, blinking=True)
        lend_letters(artists)
        renderer = canvas.get_renderer()
        for artist in sorted(artists, key=lambda artist: artist.get_zorder()):
            artist.draw(renderer)
            artist.remove()
        return np.array(canvas.buffer_rgba())[..., :3]

    def _seen_from(self, centre_xy_m: FloatArray) -> tuple[Sheet, NDArray[np.uint8]]:
        """The sheet set up over a place, on whole pixels, and what of it stays."""
        if self._ground is None:
            return self._sheet, self._empty
        corner = self._corner_px(self._ground, centre_xy_m)
        size = np.array(self._ground.pixels.shape[:2]) - (self._high, self._wide)
        if (corner < 0).any() or (corner > size).any():
            self._ground = self._draw_ground(centre_xy_m)
            corner = self._corner_px(self._ground, centre_xy_m)
        ground, (row, column) = self._ground, corner.tolist()
        pixels = self._empty.copy()
        pixels[self._map] = ground.pixels[row : row + self._high, column : column + self._wide]
        per_px = self._metres_per_px
        west, north = ground.west_m + column * per_px, ground.north_m - row * per_px
        box = Box(west, north - self._high * per_px, west + self._wide * per_px, north)
        self._sheet.map.set(xlim=(box.west_m, box.east_m), ylim=(box.south_m, box.north_m))
        return replace(self._sheet, box=box, shapes=ground.shapes), pixels

    def _corner_px(self, ground: _Ground, centre_xy_m: FloatArray) -> NDArray[np.int64]:
        """Row and column of the view's upper left corner."""
        x, y = centre_xy_m.tolist()
        row = (ground.north_m - y) / self._metres_per_px - 0.5 * self._high
        column = (x - ground.west_m) / self._metres_per_px - 0.5 * self._wide
        return np.round([row, column]).astype(np.int64)

    def _draw_ground(self, centre_xy_m: FloatArray) -> _Ground:
        wide, high = round(self._room * self._wide), round(self._room * self._high)
        half_m = 0.5 * self._metres_per_px * np.array([wide, high])
        (west, south), (east, north) = centre_xy_m - half_m, centre_xy_m + half_m
        box = Box(float(west), float(south), float(east), float(north))
        dpi = self._sheet.style.dpi
        figure = Figure(figsize=(wide / dpi, high / dpi), dpi=dpi)
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        axes.set(xlim=(box.west_m, box.east_m), ylim=(box.south_m, box.north_m))
        verge: Any = Rectangle((box.west_m, box.south_m), 2.0 * half_m[0], 2.0 * half_m[1])
        verge.set(facecolor=VERGE, linewidth=0.0, zorder=0)
        axes.add_patch(verge)
        shapes = road_shapes(self._lanes, box)
        draw_road(axes, shapes, self._sheet.points_per_m, DARK_ROAD)
        canvas.draw()
        return _Ground(box.west_m, box.north_m, np.array(canvas.buffer_rgba()), shapes)
