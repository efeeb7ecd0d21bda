"""A moment of a run as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, Kind
from hatn_sim.log import Run
from hatn_sim.report.choice import choose_moment
from hatn_sim.report.moment import Moment, moment_at

__all__ = ["choose_moment", "draw_moment"]

NARROW_M: Final = 62.0
WIDE_M: Final = 88.0
"""A picture shows at least and at most this much of the map from left to right."""
WIDEST_M: Final = 150.0
"""Of what is shown for longer than a moment: more than that is seen too small."""
PADDING_M: Final = 9.0
RIM_M: Final = 2.5
"""Free around vehicles and conflicts that have to be in a picture."""
UNFINISHED: Final = "unfinished run"
"""Said on every picture of a run that was stopped before its end."""


def draw_moment(run: Run, frame: int, ego_id: str, paths: Sequence[Path]) -> None:
    """Draw the moment of `frame` for an ego into files, in the format that their suffix names.

    The same log gives the same bytes.

    Raises:
        InputError: the ego is not in view there, or the folder of the run lacks what it takes.
    """
    from hatn_sim.report.canvas import POSTER, open_sheet
    from hatn_sim.report.drawing import draw_moment_on
    from hatn_sim.report.figures import save_figure

    moment = moment_at(run, frame, ego_id)
    wide, high = POSTER.map_in
    centre, width_m = holding(*camera([moment], wide / high), wide / high, told_of(moment))
    sheet = open_sheet(POSTER, run.lanes, centre, width_m)
    draw_moment_on(sheet, moment, caption(run, moment))
    save_figure(sheet.figure, paths)


def caption(run: Run, moment: Moment) -> str:
    """Scene, time, ego and predictor in one line."""
    scene = moment.scene
    words = [str(run.header.get("title") or run.header.get("scene") or run.path.name)]
    words.append(f"t = {scene.time_s:.1f} s")
    if moment.ego_id in scene.ids:
        i = scene.ids.index(moment.ego_id)
        kind = Kind(int(scene.kind[i])).name.lower()
        words.append(f"ego: {kind} {moment.ego_id} at {scene.speed_mps[i]:.1f} m/s")
    name = run.predictors[0] + (", lines from the simulator's routes" if run.by_route else "")
    words.append(f"predictor: {name}")
    if not run.finished:
        words.append(UNFINISHED)
    words += [] if run.signals_known else ["signals unknown: all count as open"]
    return "  ·  ".join(words)


def camera(
    moments: Sequence[Moment],
    aspect: float,
    widths_m: tuple[float, float] = (NARROW_M, WIDE_M),
    padding_m: float = PADDING_M,
) -> tuple[FloatArray, float]:
    """Centre [2] and width in metres of what to show, for a map `aspect` times as wide as high."""
    points: list[FloatArray] = []
    for moment in moments:
        scene, paths = moment.scene, moment.forecasts
        for vehicle_id in sorted(moment.involved & set(scene.ids)):
            points.append(scene.xy_m[scene.ids.index(vehicle_id)][None])
            if vehicle_id in paths:
                points.append(paths[vehicle_id].actual_xy_m[-1:])
        points += [
            slot.conflict_xy_m[None] for slot in moment.slots if slot.conflict_xy_m is not None
        ]
    xy = np.concatenate(points)
    low, high = xy.min(axis=0) - padding_m, xy.max(axis=0) + padding_m
    span_m = high - low
    width_m = float(np.clip(max(span_m[0], aspect * span_m[1]), *widths_m))
    # Where not all of it fits, what is around the ego goes before.
    free = 0.5 * np.array([width_m, width_m / aspect]) - padding_m
    core = np.concatenate([p for moment in moments for p in _core(moment)])
    most, least = core.min(axis=0) + free, core.max(axis=0) - free
    centre = 0.5 * (low + high)
    fits = least <= most
    return np.where(fits, np.clip(centre, least, most), core.mean(axis=0)), width_m


def told_of(moment: Moment) -> FloatArray:
    """[P, 2] what has to be in a picture: the ego, those it is told of, and where they meet.

    All conflicts of its choice where its slots know none with those it is told of.
    """
    scene, named = moment.scene, moment.named
    points: list[FloatArray] = []
    for vehicle_id in (moment.ego_id, *named):
        if vehicle_id in scene.ids:
            i = scene.ids.index(vehicle_id)
            half_m = 0.5 * scene.size_m[i, 0]
            points += [scene.xy_m[i] - half_m, scene.xy_m[i] + half_m]
    ahead = [slot for slot in moment.slots if slot.in_focus and not slot.is_own]
    met = [slot for slot in ahead if slot.rear_id in named] or ahead
    points += [slot.conflict_xy_m for slot in met if slot.conflict_xy_m is not None]
    return np.array(points).reshape(-1, 2)


def holding(
    centre_xy_m: FloatArray,
    width_m: float,
    aspect: float,
    points_xy_m: FloatArray,
) -> tuple[FloatArray, float]:
    """The view that holds all points [P, 2], moved and widened from the one given no more than
    that takes.

    Args:
        centre_xy_m: [2] of the map shown.
        width_m: of it.
        aspect: its width over its height.
        points_xy_m: to be seen, with `RIM_M` around them.
    """
    if not len(points_xy_m):
        return centre_xy_m, width_m
    low, high = points_xy_m.min(axis=0) - RIM_M, points_xy_m.max(axis=0) + RIM_M
    wide, tall = high - low
    width_m = max(width_m, float(wide), float(aspect * tall))
    half = 0.5 * np.array([width_m, width_m / aspect])
    least, most = high - half, low + half
    return np.minimum(np.maximum(centre_xy_m, least), most), width_m


def framed(
    moments: Sequence[Moment],
    aspect: float,
    widths_m: tuple[float, float] = (NARROW_M, WIDE_M),
    padding_m: float = PADDING_M,
    widest_m: float = WIDEST_M,
) -> tuple[FloatArray, float]:
    """As `camera`, moved and widened to hold what each moment is told of, if that is no wider than
    `widest_m`."""
    view = camera(moments, aspect, widths_m, padding_m)
    told = np.concatenate([told_of(moment) for moment in moments])
    held = holding(*view, aspect, told)
    return held if held[1] <= widest_m else view


def _core(moment: Moment) -> list[FloatArray]:
    """The ego, the conflicts of its choice and where it will be in 3 s."""
    scene = moment.scene
    if moment.ego_id not in scene.ids:
        return []
    points = [scene.xy_m[scene.ids.index(moment.ego_id)][None]]
    if moment.ego_id in moment.forecasts:
        points.append(moment.forecasts[moment.ego_id].actual_xy_m[-1:])
    points += [
        slot.conflict_xy_m[None]
        for slot in moment.slots
        if slot.in_focus and slot.conflict_xy_m is not None
    ]
    return points
