"""The sheet that a moment is drawn on: layout, colours, the road, the legend. All that stays.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle

from hatn_sim.datatypes import FloatArray, Gate, Lane
from hatn_sim.report.label_width import HINTED, width_pt
from hatn_sim.report.letters import readable
from hatn_sim.report.road_shapes import EDGE_M, Box, RoadShapes, Surface, road_shapes

PAPER: Final = "#fbfaf7"
VERGE: Final = "#e8eae1"
KERB: Final = "#c9cac3"
ASPHALT: Final = "#62676d"
PATHWAY: Final = "#d3d0c6"
RAIL: Final = "#9a9a94"
PAINT: Final = "#eceae4"
INK: Final = "#22262b"
SOFT_INK: Final = "#6b7178"
PREDICTED: Final = "#ff5a86"
ACTUAL: Final = "#ffffff"
CLOSED: Final = "#e5484d"
OPEN: Final = "#46a758"
ALERT: Final = "#d7263d"

SCALE_BAR_M: Final = 5.0


@dataclass(frozen=True)
class RoadColours:
    """What a road is painted with."""

    kerb: str
    asphalt: str
    path: str
    rail: str
    paint: str


DARK_ROAD: Final = RoadColours(KERB, ASPHALT, PATHWAY, RAIL, PAINT)


PROBABILITY: Final = LinearSegmentedColormap.from_list(
    "slot", mpl.colormaps["viridis"](np.linspace(0.08, 1.0, 256))
)
"""Perceptually uniform and safe for the colour-blind; without the end that is dark as asphalt."""


@dataclass(frozen=True)
class Style:
    """Sizes of a sheet in inches and points."""

    width_in: float
    height_in: float
    dpi: int
    font_pt: float
    margin_in: float
    header_in: float
    footer_in: float

    @property
    def map_in(self) -> tuple[float, float]:
        """Width and height of the map."""
        return (
            self.width_in - 2.0 * self.margin_in,
            self.height_in - self.header_in - self.footer_in,
        )


POSTER: Final = Style(9.0, 6.3, 200, 9.0, 0.22, 0.74, 0.56)
FILM: Final = Style(7.2, 4.8, 200, 7.4, 0.12, 0.56, 0.42)
SCREEN: Final = Style(9.6, 5.4, 200, 8.6, 0.15, 0.64, 0.46)
"""1920 x 1080."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """An open sheet: draw on `map` in metres, on `page` in fractions of the figure."""

    figure: Figure
    page: Axes
    map: Axes
    box: Box
    shapes: RoadShapes
    style: Style
    points_per_m: float
    keys_in: float = 0.0  # from left, where the legend has room for the keys of a moment

    @property
    def agg(self) -> FigureCanvasAgg:
        canvas = self.figure.canvas
        assert isinstance(canvas, FigureCanvasAgg)
        return canvas


def plain(text: str) -> str:
    """Words as they stand: between two `$` matplotlib would read a formula; fonts lack letters."""
    return readable(text).replace("$", r"\$")


def open_sheet(
    style: Style, lanes: Sequence[Lane], centre_xy_m: FloatArray, width_m: float
) -> Sheet:
    """A sheet with the road around a centre, `width_m` of it from left to right."""
    map_width_in, map_height_in = style.map_in
    half_x, half_y = 0.5 * width_m, 0.5 * width_m * map_height_in / map_width_in
    x, y = float(centre_xy_m[0]), float(centre_xy_m[1])
    box = Box(x - half_x, y - half_y, x + half_x, y + half_y)
    figure = Figure(figsize=(style.width_in, style.height_in), dpi=style.dpi, facecolor=PAPER)
    FigureCanvasAgg(figure)
    page = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    page.set_axis_off()
    page.set_zorder(1)  # over the map: a warning stands there
    page.set(xlim=(0.0, style.width_in), ylim=(0.0, style.height_in))
    axes = figure.add_axes(
        (
            style.margin_in / style.width_in,
            style.footer_in / style.height_in,
            map_width_in / style.width_in,
            map_height_in / style.height_in,
        )
    )
    axes.set_axis_off()
    axes.set(xlim=(box.west_m, box.east_m), ylim=(box.south_m, box.north_m))
    axes.add_patch(
        Rectangle((box.west_m, box.south_m), width_m, 2.0 * half_y, facecolor=VERGE, zorder=0)
    )
    shapes = road_shapes(lanes, box)
    sheet = Sheet(figure, page, axes, box, shapes, style, 72.0 * map_width_in / width_m)
    draw_road(axes, shapes, sheet.points_per_m, DARK_ROAD)
    return replace(sheet, keys_in=_draw_legend(sheet))


def quad(middle_xy_m: FloatArray, half_m: float) -> FloatArray:
    """A strip along a polyline [P, 2] as a polygon [2 P, 2]."""
    along = np.gradient(middle_xy_m, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    left = half_m * np.stack((-along[:, 1], along[:, 0]), axis=1)
    return np.concatenate((middle_xy_m + left, (middle_xy_m - left)[::-1]))


def columns(points: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """x and y of points; none at all is a point that is not drawn."""
    xy = np.array(points) if len(points) else np.full((1, 2), np.nan)
    return xy[:, 0], xy[:, 1]


def mixed(
    colour: Iterable[float], other: Iterable[float], share: float
) -> tuple[float, float, float]:
    """A colour with a share of another in it."""
    red, green, blue = ((1.0 - share) * a + share * b for a, b in zip(colour, other, strict=True))
    return red, green, blue


def draw_road(axes: Axes, shapes: RoadShapes, points_per_m: float, colours: RoadColours) -> None:
    """The road on a map in metres, markings as wide as they are."""
    scale = points_per_m
    if shapes.path is not None:
        _fill(axes, shapes.path, 0.0, colours.path, 1)
    axes.add_collection(
        LineCollection(shapes.rails_xy_m, colors=colours.rail, linewidths=0.14 * scale, zorder=1.5)
    )
    if shapes.asphalt is not None:
        _fill(axes, shapes.asphalt, 0.55, "#dcddd4", 2)
        _fill(axes, shapes.asphalt, 0.28, colours.kerb, 2.1)
        _fill(axes, shapes.asphalt, 0.0, colours.asphalt, 2.2)
        axes.contour(
            shapes.asphalt.x_m,
            shapes.asphalt.y_m,
            shapes.asphalt.outside_m,
            levels=[-1.4 * EDGE_M],
            colors=[colours.paint],
            linewidths=0.11 * scale,
            linestyles="solid",
            alpha=0.5,
            zorder=3,
        )
    paint: dict[str, Any] = {"colors": colours.paint, "capstyle": "butt"}
    axes.add_collection(
        LineCollection(shapes.solid_xy_m, linewidths=0.12 * scale, alpha=0.6, zorder=3, **paint)
    )
    dashes = (0.0, (3.0 / 0.13, 3.0 / 0.13))  # in line widths: 3 m on, 3 m off
    axes.add_collection(
        LineCollection(
            shapes.dashed_xy_m,
            linewidths=0.13 * scale,
            linestyles=[dashes],
            alpha=0.8,
            zorder=3,
            **paint,
        )
    )
    bars = [bar for line in shapes.stop_lines for bar in _bars(line.gate, line.corners_xy_m)]
    axes.add_collection(PolyCollection(bars, facecolors=colours.paint, linewidths=0.0, zorder=3.1))


def _fill(axes: Axes, surface: Surface, grow_m: float, colour: str, zorder: float) -> None:
    axes.contourf(
        surface.x_m,
        surface.y_m,
        surface.outside_m,
        levels=[-1e6, grow_m],
        colors=[colour],
        antialiased=True,
        zorder=zorder,
    )


def _bars(gate: Gate, corners_xy_m: FloatArray) -> list[FloatArray]:
    """A bar where one has to stop, a row of teeth where one has to give way."""
    if gate is not Gate.GIVE_WAY_LINE:
        return [corners_xy_m]
    front_left, front_right, back_right, back_left = corners_xy_m
    teeth: list[FloatArray] = []
    count = 5
    for k in range(count):
        a, b = (k + 0.12) / count, (k + 0.88) / count
        front = front_left + (front_right - front_left) * np.array([[a], [b]])
        # The teeth of a give-way line point at those who have to give way.
        tip = back_left + (back_right - back_left) * 0.5 * (a + b)
        tip = tip + 0.6 * (back_left - front_left)
        teeth.append(np.concatenate((front, tip[None])))
    return teeth


def _draw_legend(sheet: Sheet) -> float:
    """Colour bar, signs and scale bar in the footer; returns where there is room for more signs."""
    style, page = sheet.style, sheet.page
    size, y, em = _letters(style)
    text: dict[str, Any] = {"fontsize": size, "color": INK, "va": "center", "zorder": 5}
    x = _words(sheet, style.margin_in, "slot, 0", gap_em=0.5)
    bar = (x, x + 5.0 * em, y - 0.42 * em, y + 0.42 * em)
    page.imshow(
        np.linspace(0.0, 1.0, 256)[None], cmap=PROBABILITY, extent=bar, aspect="auto", zorder=5
    )
    page.set(xlim=(0.0, style.width_in), ylim=(0.0, style.height_in))  # imshow moves them
    x = _words(sheet, bar[1] + 0.5 * em, "100 %")

    at = _swatch(sheet, x, y, em)
    page.plot(at, np.full(4, y), color=PREDICTED, lw=0.28 * size, alpha=0.75, zorder=5)
    page.plot(at, np.full(4, y), "o", color=PREDICTED, ms=0.5 * size, mec="none", zorder=5)
    x = _words(sheet, x + 3.5 * em, "predicted, 3 s, a dot each 0.5 s")

    at = _swatch(sheet, x, y, em)
    page.plot(at, np.full(4, y), color=ACTUAL, lw=1.2, zorder=5)
    page.plot(at[-1:], [y], "o", mfc=ASPHALT, mec=ACTUAL, mew=1.0, ms=0.5 * size, zorder=6)
    x = _words(sheet, x + 3.5 * em, "what happened")

    x += 0.4 * em
    page.plot([x], [y], "D", mfc=INK, mec="white", mew=0.9, ms=0.62 * size, zorder=5)
    x = _words(sheet, x + 0.9 * em, "conflict")

    length_in = SCALE_BAR_M * sheet.points_per_m / 72.0
    right = style.width_in - style.margin_in
    ends = (right - length_in, right)
    page.plot(ends, (y, y), color=INK, lw=1.6, solid_capstyle="butt", zorder=5)
    page.text(ends[0] - 0.6 * em, y, f"{SCALE_BAR_M:g} m", ha="right", **text)
    return x


def _letters(style: Style) -> tuple[float, float, float]:
    """Of the legend: their size in points, the middle of their line and an em in inches."""
    size_pt = 0.84 * style.font_pt
    return size_pt, 0.5 * style.footer_in, size_pt / 72.0


def _words(sheet: Sheet, x_in: float, words: str, gap_em: float = 1.2) -> float:
    """Words in the legend; returns where the next sign begins."""
    size_pt, y, em = _letters(sheet.style)
    sheet.page.text(x_in, y, words, fontsize=size_pt, color=INK, va="center", zorder=5)
    return x_in + HINTED * width_pt(words, size_pt) / 72.0 + gap_em * em


def signal_look(is_closed: bool) -> dict[str, Any]:
    """How a signal's stop line is drawn: filled or hollow, for who sees no difference of colours.

    For patches and collections of matplotlib.
    """
    colour = CLOSED if is_closed else OPEN
    return {"facecolor": colour if is_closed else "none", "edgecolor": colour, "linewidth": 1.0}


def draw_keys(sheet: Sheet, has_signals: bool, has_alerts: bool) -> list[Artist]:
    """The keys of signals and alerts in the legend, for moments that have some."""
    page, before = sheet.page, {*sheet.page.get_children()}
    size, y, em = _letters(sheet.style)
    x = sheet.keys_in
    if has_signals:
        for is_closed, words in ((True, "signal closed"), (False, "open")):
            bar = (x, y - 0.22 * em), 1.2 * em, 0.44 * em
            page.add_patch(Rectangle(*bar, **signal_look(is_closed), zorder=5))
            x = _words(sheet, x + 1.7 * em, words, gap_em=0.8)
        x += 0.3 * em
    if has_alerts:
        x += 0.5 * em
        page.plot([x], [y], "o", mfc="white", mec=ALERT, mew=1.6, ms=0.95 * size, zorder=5)
        _words(sheet, x + em, "alert")
    return [one for one in page.get_children() if one not in before]


def _swatch(sheet: Sheet, x_in: float, y_in: float, em_in: float) -> FloatArray:
    """A piece of road in the legend; returns four places along it."""
    road = FancyBboxPatch(
        (x_in, y_in - 0.75 * em_in),
        3.0 * em_in,
        1.5 * em_in,
        boxstyle=f"round,pad=0,rounding_size={0.35 * em_in}",
        facecolor=ASPHALT,
        linewidth=0.0,
        zorder=4,
    )
    sheet.page.add_patch(road)
    places: FloatArray = np.linspace(x_in + 0.5 * em_in, x_in + 2.5 * em_in, 4)
    return places
