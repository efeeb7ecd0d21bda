"""The labels of a moment's slots, drawn on a sheet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.patches import FancyBboxPatch

from hatn_sim.datatypes import FloatArray
from hatn_sim.report.canvas import ALERT, INK, PROBABILITY, Sheet, quad
from hatn_sim.report.label_places import Label, place_labels
from hatn_sim.report.label_width import width_pt
from hatn_sim.report.moment import Moment
from hatn_sim.report.paint import look_of
from hatn_sim.report.vehicle_shapes import placed


def draw_labels(
    sheet: Sheet, moment: Moment, before: Mapping[str, FloatArray] | None
) -> tuple[list[Artist], dict[str, FloatArray]]:
    """A pill for every slot to choose from, the ego, and those that alerts or advice name."""
    scene, style = moment.scene, sheet.style
    if moment.ego_id not in scene.ids:
        return [], {}
    anchors: dict[str, FloatArray] = {}
    words: dict[str, str] = {}
    colours: dict[str, Any] = {}
    ego_xy = scene.xy_m[scene.ids.index(moment.ego_id)]
    anchors[moment.ego_id], words[moment.ego_id], colours[moment.ego_id] = ego_xy, "ego", INK
    for rear_id, chance in reversed(moment.choice.items()):
        colours[rear_id] = PROBABILITY(chance)
        what = "ego: yield" if rear_id == moment.ego_id else "pass before"
        words[rear_id] = f"{_called(moment, rear_id)}{what} {100.0 * chance:.0f} %"
        anchors[rear_id] = scene.xy_m[scene.ids.index(rear_id)]
    alerted = moment.alerted & set(scene.ids)
    for name in sorted((alerted | set(moment.named)) - words.keys()):
        told = "alert" if name in alerted else ""
        words[name] = f"{_called(moment, name)}{told}".removesuffix(": ")
        colours[name] = ALERT if told else INK
        anchors[name] = scene.xy_m[scene.ids.index(name)]
    per_pt = 1.0 / sheet.points_per_m
    size_pt = 0.95 * style.font_pt
    labels: list[Label] = []
    for key, anchor in anchors.items():
        if sheet.box.near(anchor, 0.0):
            wide_m = (width_pt(words[key], size_pt) + 2.6 * size_pt) * per_pt
            labels.append(Label(key, anchor, (wide_m, 1.75 * size_pt * per_pt)))
    centres = place_labels(labels, _obstacles(moment), sheet.box, before)
    drawn: list[Artist] = []
    offsets: dict[str, FloatArray] = {}
    for label in labels:
        centre, key = centres[label.key], label.key
        offsets[key] = centre - label.anchor_xy_m
        drawn += _draw_pill(sheet, label, centre, words[key], colours[key], size_pt)
    return drawn, offsets


def _called(moment: Moment, vehicle_id: str) -> str:
    """By its looks, who the ego is told of; nobody else."""
    if vehicle_id not in moment.named:
        return ""
    i = moment.scene.ids.index(vehicle_id)
    return look_of(int(moment.scene.kind[i]), moment.scene.colour[i].tolist()) + ": "


def _draw_pill(
    sheet: Sheet, label: Label, centre: FloatArray, words: str, colour: Any, size_pt: float
) -> list[Artist]:
    axes, (wide_m, high_m) = sheet.map, label.size_m
    (leader,) = axes.plot(*np.stack((label.anchor_xy_m, centre)).T, color=INK, lw=0.8, zorder=9.5)
    pill = FancyBboxPatch(
        (float(centre[0]) - 0.5 * wide_m, float(centre[1]) - 0.5 * high_m),
        wide_m,
        high_m,
        boxstyle=f"round,pad=0,rounding_size={0.5 * high_m}",
        facecolor="white",
        edgecolor=INK,
        linewidth=0.6,
        zorder=20,
    )
    dot = axes.scatter(
        float(centre[0]) - 0.5 * wide_m + 0.55 * high_m,
        float(centre[1]),
        s=(0.62 * size_pt) ** 2,
        color=[colour],
        edgecolors=INK,
        linewidths=0.4,
        zorder=21,
    )
    text = axes.text(
        float(centre[0]) - 0.5 * wide_m + 0.98 * high_m,
        float(centre[1]),
        words,
        fontsize=size_pt,
        color=INK,
        ha="left",
        va="center_baseline",
        zorder=21,
    )
    return [leader, axes.add_patch(pill), dot, text]


def _obstacles(moment: Moment) -> FloatArray:
    """Points along everything that a label had better not cover, what matters most the densest."""
    scene = moment.scene
    points = [np.zeros((0, 2))]
    shown = moment.involved
    for i in range(len(scene.ids)):
        half_m, wide_m = 0.5 * scene.size_m[i]
        grid = np.stack(
            np.meshgrid(np.linspace(-half_m, half_m, 9), np.linspace(-wide_m, wide_m, 5)), -1
        ).reshape(-1, 2)
        points.append(placed(0.9 * grid, scene.xy_m[i], float(scene.yaw_rad[i])))
    for vehicle_id, forecast in moment.forecasts.items():
        points += [forecast.actual_xy_m, *(path for path, _ in forecast.paths_to_draw())]
        if vehicle_id in shown:
            points += [forecast.actual_xy_m] * 2
    for slot in moment.slots:
        if slot.in_focus:
            points += [slot.strip_xy_m, quad(slot.strip_xy_m, 0.9)]
            if slot.conflict_xy_m is not None:
                points.append(np.repeat(slot.conflict_xy_m[None], 20, axis=0))
    return np.concatenate(points)
