"""A case study as a figure: panels over time, each a scene, its semantic graph and plain words.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hatn_sim.datatypes import FloatArray, Kind
from hatn_sim.log.road_file import ROAD_FILE, read_road
from hatn_sim.report.canvas import INK, PAPER, SOFT_INK, plain
from hatn_sim.report.case_cast import BEYOND, BEYOND_WORDS, Part, cast_of, panel_words, story_words
from hatn_sim.report.case_graph import draw_graph
from hatn_sim.report.case_legend import draw_legend
from hatn_sim.report.case_map import MapView, draw_map, open_view
from hatn_sim.report.cases import Case
from hatn_sim.report.figures import save_figure
from hatn_sim.report.moment import Moment, read_moments
from hatn_sim.report.picture import UNFINISHED, camera, framed, told_of
from hatn_sim.report.road_shapes import lamps_in

WIDTH_IN: Final = 7.2
"""As wide as the text of a page in two columns, so that sizes in points are those in print."""
DPI: Final = 300
MARGIN_IN: Final = 0.1
GAP_IN: Final = 0.1
HEADER_IN: Final = 0.56
STAMP_IN: Final = 0.19
GRAPH_IN: Final = 0.82
WORDS_IN: Final = 0.36
ROW_GAP_IN: Final = 0.06
FOOTER_IN: Final = 0.36
ASPECT: Final = 1.08
"""Width over height of a scene."""
WIDTHS_M: Final = (36.0, 58.0)
"""A scene shows at least and at most so much of the map from left to right."""
WIDEST_M: Final = 72.0
"""... and where somebody that the ego is told of is far away, so much."""
PADDING_M: Final = 5.0
NEAR_M: Final = 40.0
"""Whoever is met within this of the ego had better be in the picture."""
FONT_PT: Final = 6.6
WRONG: Final = "#b3261e"


def draw_case(case: Case, paths: Sequence[Path]) -> None:
    """Draw a case into files, in the format that their suffix names; the same log, the same bytes.

    InputError where the folder of the run lacks what it takes.
    """
    run = case.run
    moments = list(read_moments(run, case.frames, run.ids[case.ego]))
    cast = cast_of(moments)
    columns = _columns(len(moments))
    rows = math.ceil(len(moments) / columns)
    panel_in = (WIDTH_IN - 2.0 * MARGIN_IN - (columns - 1) * GAP_IN) / columns
    map_in = (panel_in, panel_in / ASPECT)
    row_in = STAMP_IN + map_in[1] + GRAPH_IN + WORDS_IN + ROW_GAP_IN
    height_in = HEADER_IN + rows * row_in + FOOTER_IN
    figure = Figure(figsize=(WIDTH_IN, height_in), dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    page = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    page.set_axis_off()
    page.set(xlim=(0.0, WIDTH_IN), ylim=(0.0, height_in))
    _draw_header(page, case, moments, cast, height_in)
    views = _views(case, moments, map_in)
    for k, (moment, view) in enumerate(zip(moments, views, strict=True)):
        left = MARGIN_IN + (k % columns) * (panel_in + GAP_IN)
        top = height_in - HEADER_IN - (k // columns) * row_in
        _draw_panel(page, case, k, (left, top), map_in, moment, view, cast)
    is_beyond = any(panel_words(case, cast, at).happened.endswith(BEYOND) for at in case.frames)
    ends_in, note = (MARGIN_IN, WIDTH_IN - MARGIN_IN), BEYOND_WORDS if is_beyond else ""
    pairs = zip(views, moments, strict=True)
    has_signals = any(lamps_in(view.shapes, view.box, one.scene) for view, one in pairs)
    draw_legend(page, ends_in, FOOTER_IN, views[0].points_per_m, note, has_signals)
    save_figure(figure, paths, facecolor=PAPER)


def _columns(panels: int) -> int:
    return 3 if panels in (3, 5, 6, 9) else min(panels, 4)


def _views(case: Case, moments: Sequence[Moment], map_in: tuple[float, float]) -> list[MapView]:
    """All panels on one scale; one view for all where it holds the ego's whole story."""
    lanes = read_road(case.run.path / ROAD_FILE)
    centre, width_m = camera(moments, ASPECT, WIDTHS_M, PADDING_M)
    on_way = np.concatenate([p for one in moments for p in (_on_way(one), told_of(one))])
    half_m = 0.5 * width_m * np.array([1.0, 1.0 / ASPECT]) - 0.5 * PADDING_M
    if (np.abs(on_way - centre) <= half_m).all():
        return [open_view(lanes, centre, width_m, map_in)] * len(moments)
    single = [framed([one], ASPECT, WIDTHS_M, PADDING_M, WIDEST_M) for one in moments]
    width_m = max(width for _, width in single)
    return [open_view(lanes, middle, width_m, map_in) for middle, _ in single]


def _on_way(moment: Moment) -> FloatArray:
    """[P, 2] the ego, the conflicts it chooses at, and whom it meets there, if not far away."""
    scene = moment.scene
    at = {vehicle_id: scene.xy_m[i] for i, vehicle_id in enumerate(scene.ids)}
    ego_xy_m = at[moment.ego_id]
    met = [at[slot.rear_id] for slot in moment.slots if slot.in_focus]
    near = [xy_m for xy_m in met if np.linalg.norm(xy_m - ego_xy_m) < NEAR_M]
    conflicts = [
        slot.conflict_xy_m
        for slot in moment.slots
        if slot.in_focus and not slot.is_own and slot.conflict_xy_m is not None
    ]
    return np.array([ego_xy_m, *near, *conflicts])


def _inside(page: Axes, left: float, bottom: float, size_in: tuple[float, float]) -> Axes:
    """New axes at a place of the page in inches."""
    figure = page.get_figure(root=True)
    assert figure is not None
    wide, high = figure.get_size_inches()
    return figure.add_axes((left / wide, bottom / high, size_in[0] / wide, size_in[1] / high))


def _draw_header(
    page: Axes, case: Case, moments: Sequence[Moment], cast: Mapping[str, Part], top: float
) -> None:
    run, scene = case.run, moments[0].scene
    head = run.header
    kind = Kind(int(scene.kind[scene.ids.index(moments[0].ego_id)])).name.lower()
    facts = [str(head.get("title") or head.get("scene") or run.path.name)]
    if head.get("seed") is not None:
        facts.append(f"seed {head['seed']}")
    facts += [f"ego: {kind} {moments[0].ego_id}", f"predictor: {run.predictors[0]}"]
    if run.by_route:
        facts.append("lines from the simulator's routes")
    if case.kind.name == "transfer":
        known = "never trained on this scene" if run.trained_on else "training scenes not known"
        facts.append(known)
    if not run.finished:
        facts.append(UNFINISHED)
    x = MARGIN_IN
    page.text(
        x,
        top - 0.15,
        f"Case {case.kind.number}  ·  {case.kind.title}",
        fontsize=10.0,
        fontweight="bold",
        color=INK,
        va="center",
    )
    page.text(x, top - 0.32, story_words(case, cast), fontsize=7.2, color=INK, va="center")
    page.text(x, top - 0.46, plain("  ·  ".join(facts)), fontsize=6.2, color=SOFT_INK, va="center")


def _draw_panel(
    page: Axes,
    case: Case,
    k: int,
    corner_in: tuple[float, float],
    map_in: tuple[float, float],
    moment: Moment,
    view: MapView,
    cast: Mapping[str, Part],
) -> None:
    left, top = corner_in
    wide, high = map_in
    centred: dict[str, Any] = {"va": "center", "fontsize": FONT_PT, "color": INK}
    y = top - 0.5 * STAMP_IN
    page.text(left, y, f"({'abcdefgh'[k]})", fontweight="bold", **centred)
    page.text(left + 0.2, y, f"t = {moment.scene.time_s:.1f} s", **centred)
    if moment.ego_id in moment.scene.ids:
        speed = moment.scene.speed_mps[moment.scene.ids.index(moment.ego_id)]
        words: dict[str, Any] = {**centred, "color": SOFT_INK, "ha": "right"}
        page.text(left + wide, y, f"ego {speed:.1f} m/s", **words)
    bottom = top - STAMP_IN - high
    draw_map(_inside(page, left, bottom, map_in), view, moment, cast)
    bottom -= GRAPH_IN
    draw_graph(_inside(page, left, bottom, (wide, GRAPH_IN)), moment, cast, (wide, GRAPH_IN))
    said = panel_words(case, cast, case.frames[k])
    middle: dict[str, Any] = {"fontsize": FONT_PT, "ha": "center", "va": "top"}
    page.text(left + 0.5 * wide, bottom - 0.02, said.said, color=INK, fontweight="bold", **middle)
    colour = WRONG if said.wrong else INK
    fits = int(wide * 72.0 / (0.5 * FONT_PT))
    happened = textwrap.fill(said.happened, fits)
    page.text(left + 0.5 * wide, bottom - 0.14, happened, color=colour, **middle)
