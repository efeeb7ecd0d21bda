"""A scene with what is predicted of it -> what SUMO's window shows over the traffic.

Pure functions: nothing here knows of a window. Imports matplotlib, for the colours of all pictures.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final

import numpy as np
from matplotlib.colors import to_rgb

from hatn_sim.datatypes import Advice, Alert, FloatArray, Prediction, Scene
from hatn_sim.report.canvas import ALERT, INK, PREDICTED, PROBABILITY
from hatn_sim.report.moment import moves, slot_strip
from hatn_sim.road import Road
from hatn_sim.simulators.sumo_messages import Mark, Paint, Picture, Ribbon, View

SLOT_LAYER: Final = 100
WAY_LAYER: Final = 110
SLOT_WIDTH_M: Final = 2.8
WAY_WIDTH_M: Final = 0.7
THIN_WIDTH_M: Final = 0.3
THIN_OPACITY: Final = 0.6
LEAST_CHANCE: Final = 0.05
"""Modes that are less probable are not drawn."""
MARK_WIDTH_M: Final = 1.4
MOST_LINES: Final = 3
"""Of words at once."""


def _paint(colour: str, opacity: float = 1.0) -> Paint:
    red, green, blue = to_rgb(colour)
    return round(255 * red), round(255 * green), round(255 * blue), round(255 * opacity)


EGO_RINGS: Final = (_paint("white"), _paint(INK))
ALERTED_RINGS: Final = (_paint(ALERT), _paint("white"))


def picture_of(
    scene: Scene,
    road: Road,
    advice: Advice,
    egos: Collection[str],
    alerts: Collection[Alert] = (),
    followed: str | None = None,
) -> Picture:
    """Everybody's likeliest way thin; of `egos` all modes, slots, conflict points and advice.

    All vehicles keep their colour, for words name it. Around egos it is white, around those that
    `alerts` name red, whoever they are, and around vehicles behind the slots that an ego chooses
    from it is the colour of that slot's probability.
    """
    prediction = advice.prediction
    ribbons = _ways(scene, prediction, egos)
    marks: dict[str, Mark] = {}
    rings: dict[str, tuple[Paint, ...]] = {}
    graphs, chances, lines = prediction.graphs, prediction.slot_probability, prediction.lines
    begin_xy_m: FloatArray | None = None
    if graphs is not None and chances is not None and lines is not None:
        wanted = [row for row, ego in enumerate(graphs.ego.tolist()) if scene.ids[ego] in egos]
        for row in wanted:
            if not graphs.has_conflict[row]:
                continue
            ego_id = scene.ids[graphs.ego[row]]
            for m in np.flatnonzero(graphs.node_mask[row] & graphs.focus_mask[row]).tolist():
                rear_id = scene.ids[graphs.rear[row, m]]
                paint = _probability(float(chances[row, m]))
                strip_xy_m = slot_strip(road, scene, lines, graphs, row, m)
                ribbons[f"slot:{ego_id}:{rear_id}"] = Ribbon(
                    strip_xy_m, SLOT_WIDTH_M, paint, SLOT_LAYER
                )
                if m > 0:
                    rings[rear_id] = paint, _paint(INK)
                    at = begin_xy_m = graphs.conflict_xy_m[row, m]
                    marks[f"conflict:{ego_id}:{rear_id}"] = Mark(at, MARK_WIDTH_M, _paint(INK))
    rings |= dict.fromkeys(egos, EGO_RINGS)
    rings |= {name: ALERTED_RINGS for one in alerts for name in (one.ego_id, one.other_id)}
    return Picture(ribbons, marks, rings, words_of(advice, egos, alerts), followed, begin_xy_m)


def words_of(advice: Advice, egos: Collection[str], alerts: Collection[Alert]) -> tuple[str, ...]:
    """What is said now: to those who are warned, the latest first, and to `egos`."""
    warned = [f"Alert! {one.ego_id}: {one.text or one.reason}" for one in reversed([*alerts])]
    told = [f"{one.ego_id}: {one.text}" for one in advice.suggestions if one.ego_id in egos]
    return tuple([*warned, *told][:MOST_LINES])


def _ways(scene: Scene, prediction: Prediction, egos: Collection[str]) -> dict[str, Ribbon]:
    ribbons: dict[str, Ribbon] = {}
    best = prediction.mode_probability.argmax(axis=1)
    for i, name in enumerate(scene.ids):
        chances = prediction.mode_probability[i]
        modes = np.flatnonzero(chances > LEAST_CHANCE) if name in egos else best[i : i + 1]
        for k in modes.tolist():
            way_xy_m: FloatArray = np.concatenate((scene.xy_m[i][None], prediction.xy_m[i, k]))
            if not moves(way_xy_m):
                continue
            if name in egos:
                strength = float(chances[k] / chances[best[i]])
                ribbons[f"way:{name}:{k}"] = Ribbon(
                    way_xy_m[::3], WAY_WIDTH_M, _paint(PREDICTED, strength), WAY_LAYER
                )
            else:
                ribbons[f"thin:{name}"] = Ribbon(
                    way_xy_m[::3], THIN_WIDTH_M, _paint(PREDICTED, THIN_OPACITY), WAY_LAYER
                )
    return ribbons


def most_pressed(
    scene: Scene,
    prediction: Prediction,
    before: str | None,
    warned: Collection[str] = (),
    view_m: View | None = None,
) -> str | None:
    """The ego to look at where none is named, of those who have a choice of slots and, with a
    view, are in it: of `warned`, if there are any; the same as before; else the one nearest to its
    conflict. None: nobody has a choice."""
    graphs = prediction.graphs
    if graphs is None or prediction.slot_probability is None or not len(graphs.ego):
        return None
    others = graphs.focus_mask & graphs.node_mask
    others[:, 0] = False
    # At a red light there is nothing to choose, and nobody is advised.
    chooses = graphs.has_conflict & others.any(axis=1) & ~graphs.ego_at_red
    if view_m is not None:
        at_m, low_m, high_m = scene.xy_m[graphs.ego], np.array(view_m[:2]), np.array(view_m[2:])
        chooses &= ((at_m >= low_m) & (at_m <= high_m)).all(axis=1)
    of_warned = chooses & np.isin([scene.ids[k] for k in graphs.ego], list(warned))
    if of_warned.any():
        chooses = of_warned
    if before is not None and before in {scene.ids[k] for k in graphs.ego[chooses].tolist()}:
        return before
    far_m = np.where(others, graphs.ego_to_conflict_m, np.inf).min(axis=1)
    moving = scene.speed_mps[graphs.ego] > 0.5
    far_m = np.where(chooses & moving & (far_m >= 0.0), far_m, np.inf)
    row = int(np.argmin(far_m))
    return scene.ids[graphs.ego[row]] if np.isfinite(far_m[row]) else None


def alerted_after(before: Mapping[str, Alert], alerts: Collection[Alert]) -> dict[str, Alert]:
    """The alerts that stand, by their id, after the edges of one more frame."""
    standing = dict(before)
    for alert in alerts:
        if alert.edge == "end":
            standing.pop(alert.alert_id, None)
        else:
            standing[alert.alert_id] = alert
    return standing


def _probability(chance: float) -> Paint:
    red, green, blue, _ = PROBABILITY(chance)
    return round(255 * red), round(255 * green), round(255 * blue), 220
