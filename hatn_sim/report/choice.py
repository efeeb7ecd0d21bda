"""Which moment of a run is worth a picture."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from hatn_sim.datatypes import HORIZON_FRAMES, BoolArray, FloatArray, IntArray
from hatn_sim.errors import InputError, nearest_vehicle
from hatn_sim.labels import slot_label
from hatn_sim.log import PredictionTable, Run
from hatn_sim.report.moment import main_predictions

COMPANY_M: Final = 40.0
IN_PICTURE_M: Final = 32.0
"""Vehicles this near to the ego surely fit into a picture with it."""


def choose_moment(
    run: Run,
    time_s: float | None = None,
    ego_id: str | None = None,
    frames: range | None = None,
) -> tuple[int, str]:
    """The most telling moment of a run and its ego: (frame, ego id).

    Candidates are all egos that have to choose between at least two slots while they and all
    the vehicles behind these slots stay in view for the next 3 s. Moments at which the ego is
    advised or warned go before all others. Then those whose most probable slot is the one that
    was taken in the end, so the picture shows a typical success; errors of predicted paths play
    no part. Then those at which it is warned, and those whose most probable slot is the one
    advised. Among them the sum of these decides, each between 0 and 1: that the second best
    slot has a real probability, that the best is clearly ahead, the number of slots, the
    distance the ego travels in 3 s and that of the others, the room in the slots, a conflict 6
    to 30 m ahead, the share of the others near enough to fit into the picture, and company
    nearby. Ties go to the earlier frame. Where nobody has a choice, the vehicle and frame with
    the most company are taken.

    Args:
        run: the log.
        time_s: look only at the predicted frame nearest to this time of the simulation.
        ego_id: look only at this vehicle.
        frames: look only at these, an unbroken stretch.

    Raises:
        InputError: nothing was predicted, nobody stays in view for 3 s after a prediction, or there
            is no such time or vehicle.
    """
    table = main_predictions(run)
    wanted = _wanted(run, table, time_s, ego_id)
    if frames is not None:
        wanted &= (table.frame >= frames.start) & (table.frame < frames.stop)
        if not wanted.any():
            raise InputError(
                f"{run.path}: nobody is predicted in frames {frames.start} to {frames.stop - 1}; "
                "name another time"
            )
    trajectories = run.trajectories
    stays = wanted & trajectories.seen(table.vehicle, table.frame, table.frame + HORIZON_FRAMES)
    if not stays.any():
        if time_s is None and frames is None:
            raise InputError(
                f"{run.path}: nobody is in view for 3 s after a prediction, so there is nothing to "
                "draw; make a longer run"
            )
        rows = np.flatnonzero(wanted)
        value = _company(run, table, rows)
    else:
        rows, others = _choices(run, table, stays)
        if len(rows):
            value = _telling(run, table, rows, others)
        else:
            rows = np.flatnonzero(stays)
            value = _company(run, table, rows) + _travelled_m(run, table, rows).round(1) / 100.0
            value += 1000.0 * _warned(run, table, rows)
    best = rows[int(value.argmax())]
    return int(table.frame[best]), run.ids[table.vehicle[best]]


def _wanted(
    run: Run, table: PredictionTable, time_s: float | None, ego_id: str | None
) -> BoolArray:
    wanted = np.ones(len(table.frame), dtype=np.bool_)
    if ego_id is not None:
        if ego_id not in run.ids:
            raise InputError(f"{run.path}: no vehicle {ego_id!r}{nearest_vehicle(ego_id, run.ids)}")
        wanted &= table.vehicle == run.ids.index(ego_id)
    if time_s is not None:
        first_s, last_s = float(run.times_s[0]), float(run.times_s[-1])
        if not first_s <= time_s <= last_s:
            raise InputError(
                f"{run.path}: no time {time_s:g} s; expected {first_s:.1f} to {last_s:.1f} s"
            )
        frame = int(np.abs(run.times_s - time_s).argmin())
        wanted &= table.frame == frame
    if not wanted.any():
        who = "no vehicle" if ego_id is None else f"vehicle {ego_id!r}"
        when = "in this run" if time_s is None else f"at {time_s:g} s"
        raise InputError(f"{run.path}: {who} is predicted {when}; name another time or vehicle")
    return wanted


def _choices(run: Run, table: PredictionTable, stays: BoolArray) -> tuple[IntArray, BoolArray]:
    """Rows [R] of egos with a choice, everybody in view for 3 s, and their others' slots [R, M]."""
    others = table.slot_in_focus & table.slot_mask
    others[:, :1] = False
    rows = np.flatnonzero(stays & table.has_slot_probability & others.any(axis=1))
    seen = np.ones(len(rows), dtype=np.bool_)
    frame = table.frame[rows]
    for m in range(1, others.shape[1]):
        rear = np.maximum(table.slot_vehicle[rows, m], 0)
        stays_too = run.trajectories.seen(rear, frame, frame + HORIZON_FRAMES)
        seen &= ~others[rows, m] | stays_too
    return rows[seen], others[rows[seen]]


def _telling(run: Run, table: PredictionTable, rows: IntArray, others: BoolArray) -> FloatArray:
    focus = table.slot_in_focus[rows] & table.slot_mask[rows]
    chance = np.where(focus, table.slot_probability[rows], 0.0)
    taken = slot_label(
        run.trajectories,
        table.vehicle[rows],
        table.frame[rows],
        table.slot_vehicle[rows],
        focus,
        table.ego_to_conflict_m[rows],
        table.rear_to_conflict_m[rows],
        table.conflict_xy_m[rows],
    )
    right = chance.argmax(axis=1) == taken
    ranked = np.sort(chance, axis=1)
    second, margin = ranked[:, -2], ranked[:, -1] - ranked[:, -2]
    count = others.sum(axis=1)
    ego_m = _travelled_m(run, table, rows)
    rear = np.maximum(table.slot_vehicle[rows], 0)
    frame = np.repeat(table.frame[rows][:, None], rear.shape[1], axis=1)
    others_m = _gone_m(run, rear, frame)
    now_xy_m, _ = run.trajectories.xy_at(rear, frame)
    away_m = np.linalg.norm(now_xy_m - now_xy_m[:, :1], axis=2)
    length_m = table.slot_length_m[rows]
    ahead_m = table.ego_to_conflict_m[rows, 0]
    parts = (
        np.minimum(second / 0.15, 1.0),
        np.minimum(margin / 0.3, 1.0),
        np.minimum(count, 3) / 3.0,
        np.minimum(ego_m / 12.0, 1.0),
        (np.minimum(others_m / 12.0, 1.0) * others).sum(axis=1) / count,
        (np.clip(length_m / 10.0, 0.0, 1.0) * focus).sum(axis=1) / focus.sum(axis=1),
        ((ahead_m > 6.0) & (ahead_m < 30.0)).astype(np.float64),
        np.minimum(_company(run, table, rows) / 8.0, 1.0),
        ((away_m < IN_PICTURE_M) * others).sum(axis=1) / count,
    )
    warned = _warned(run, table, rows)
    advised = _advised(run, table, rows)
    agrees = advised == np.take_along_axis(rear, chance.argmax(axis=1)[:, None], axis=1)[:, 0]
    ranks = ((warned | (advised >= 0), 800.0), (right, 400.0), (warned, 200.0), (agrees, 100.0))
    value: FloatArray = np.sum(parts, axis=0)
    return value + sum(worth * holds for holds, worth in ranks)


def _advised(run: Run, table: PredictionTable, rows: IntArray) -> IntArray:
    """[R] the vehicle behind the slot that the ego is advised to take; itself: it is to yield.

    -1 where nothing is advised.
    """
    number = {name: k for k, name in enumerate(run.ids)}
    told: dict[str, list[tuple[int, int]]] = {}
    for change in run.suggestions:
        said = change.suggestion
        behind = -1
        if said is not None and said.action != "abstain":
            behind = number.get(
                (said.slot_id if said.action == "pass" else change.ego_id) or "", -1
            )
        told.setdefault(change.ego_id, []).append((change.frame, behind))
    out = np.full(len(rows), -1, dtype=np.int64)
    for ego_id, changes in told.items():
        frames, behind = np.array(changes, dtype=np.int64).T
        own = np.flatnonzero(table.vehicle[rows] == number[ego_id])
        last = np.searchsorted(frames, table.frame[rows[own]], side="right") - 1
        out[own] = np.where(last >= 0, behind[last], -1)
    return out


def _warned(run: Run, table: PredictionTable, rows: IntArray) -> BoolArray:
    """[R] an alert stands that warns the ego."""
    ends = {edge.alert_id: frame for frame, edge in run.alerts if edge.edge == "end"}
    out = np.zeros(len(rows), dtype=np.bool_)
    vehicle, at = table.vehicle[rows], table.frame[rows]
    for frame, edge in run.alerts:
        if edge.edge == "onset":
            end = ends.get(edge.alert_id, run.frame_count)
            out |= (vehicle == run.ids.index(edge.ego_id)) & (at >= frame) & (at < end)
    return out


def _travelled_m(run: Run, table: PredictionTable, rows: IntArray) -> FloatArray:
    """How far the vehicles of these rows go in the next 3 s."""
    return _gone_m(run, table.vehicle[rows], table.frame[rows])


def _gone_m(run: Run, vehicle: IntArray, frame: IntArray) -> FloatArray:
    travelled_at = run.trajectories.travelled_at
    return travelled_at(vehicle, frame + HORIZON_FRAMES) - travelled_at(vehicle, frame)


def _company(run: Run, table: PredictionTable, rows: IntArray) -> FloatArray:
    """How many vehicles are near those of these rows."""
    near = np.zeros(len(rows))
    own_xy_m, _ = run.trajectories.xy_at(table.vehicle[rows], table.frame[rows])
    frames, starts = np.unique(table.frame[rows], return_index=True)
    scene_starts, scene_ends = (
        np.searchsorted(run.tracks.frame, frames, side) for side in ("left", "right")
    )
    bounds = np.append(starts, len(rows)).tolist()
    for (first, last), *scene in zip(pairwise(bounds), scene_starts, scene_ends, strict=True):
        away = own_xy_m[first:last, None] - run.tracks.xy_m[slice(*scene)]
        near[first:last] = ((away**2).sum(axis=2) < COMPANY_M**2).sum(axis=1)
    return near - 1.0
