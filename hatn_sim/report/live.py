"""Moments of traffic that goes on, as pictures: what is predicted now, and nothing that came of it.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from hatn_sim.datatypes import (
    FloatArray,
    Lane,
    Lines,
    Prediction,
    Scene,
    SemanticGraphs,
    Suggestion,
)
from hatn_sim.report.canvas import Sheet, Style, open_sheet
from hatn_sim.report.drawing import draw_moment_on
from hatn_sim.report.moment import Forecast, Moment, Slot, slot_strip
from hatn_sim.road import Road

SCREEN: Final = Style(7.2, 4.8, 100, 6.9, 0.12, 0.56, 0.42)
WIDTH_M: Final = 84.0
AHEAD: Final = 0.28
"""The camera is set up so far ahead of the ego, as a share of the map's width ..."""
EDGE_M: Final = 9.0
"""... and again when the ego is this near to the map's edge."""


def live_moment(scene: Scene, ego_id: str, suggestion: Suggestion | None) -> Moment:
    """A moment of which nothing is predicted."""
    return Moment(scene, ego_id, (), {}, suggestion)


def predicted_moment(
    scene: Scene,
    ego_id: str,
    suggestion: Suggestion | None,
    road: Road,
    prediction: Prediction,
    graphs: SemanticGraphs,
    lines: Lines,
) -> Moment:
    """A moment with its slots and predicted paths."""
    forecasts = {
        name: Forecast(
            prediction.mode_probability[k],
            np.concatenate((np.broadcast_to(scene.xy_m[k], (len(paths), 1, 2)), paths), axis=1),
            scene.xy_m[k][None],
        )
        for k, (name, paths) in enumerate(zip(scene.ids, prediction.xy_m, strict=True))
    }
    slots: list[Slot] = []
    for row in np.flatnonzero(graphs.ego == scene.ids.index(ego_id)).tolist():
        has_conflict, chances = bool(graphs.has_conflict[row]), prediction.slot_probability
        for m in np.flatnonzero(graphs.node_mask[row]).tolist():
            in_focus = bool(graphs.focus_mask[row, m])
            told = in_focus and has_conflict and chances is not None
            slots.append(
                Slot(
                    rear_id=scene.ids[graphs.rear[row, m]],
                    is_own=m == 0,
                    in_focus=in_focus,
                    probability=float(chances[row, m]) if chances is not None and told else None,
                    strip_xy_m=slot_strip(road, scene, lines, graphs, row, m),
                    conflict_xy_m=graphs.conflict_xy_m[row, m] if has_conflict else None,
                )
            )
    return Moment(scene, ego_id, tuple(slots), forecasts, suggestion)


class LiveSheet:
    """A sheet whose camera stands still until the ego leaves it. Pictures are all of one size."""

    def __init__(self, lanes: Sequence[Lane]) -> None:
        self._lanes = tuple(lanes)
        self._sheet: Sheet | None = None
        self._empty: object = None
        self._labels: dict[str, FloatArray] = {}

    def picture(self, moment: Moment, caption: str) -> np.ndarray:
        """The moment [height, width, 3], as uint8."""
        sheet = self._set_up(moment)
        sheet.agg.restore_region(self._empty)
        artists, self._labels = draw_moment_on(sheet, moment, caption, self._labels, blinking=True)
        renderer = sheet.agg.get_renderer()
        for artist in sorted(artists, key=lambda artist: artist.get_zorder()):
            artist.draw(renderer)
            artist.remove()
        return np.array(sheet.agg.buffer_rgba())[..., :3].copy()

    def _set_up(self, moment: Moment) -> Sheet:
        scene = moment.scene
        sheet = self._sheet
        there = moment.ego_id in scene.ids
        if sheet is not None:
            if not there:
                return sheet
            at = scene.xy_m[scene.ids.index(moment.ego_id)]
            if sheet.box.near(at, -EDGE_M):
                return sheet
        centre = scene.xy_m.mean(axis=0) if len(scene.ids) else np.zeros(2)
        if there:
            row = scene.ids.index(moment.ego_id)
            yaw = scene.yaw_rad[row]
            ahead_m = AHEAD * WIDTH_M * np.array([np.cos(yaw), np.sin(yaw)])
            aspect = SCREEN.map_in[1] / SCREEN.map_in[0]
            centre = scene.xy_m[row] + ahead_m * np.array([1.0, aspect])
        sheet = open_sheet(SCREEN, self._lanes, centre, WIDTH_M)
        sheet.agg.draw()
        self._sheet, self._empty = sheet, sheet.agg.copy_from_bbox(sheet.figure.bbox)
        self._labels = {}
        return sheet
