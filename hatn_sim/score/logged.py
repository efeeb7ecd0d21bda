"""Assistance in the log of a run: its own alerts and suggestions, scored as `assistance` does.

Alerts that begin in the last 5 s of a log are not scored: nobody knows what came of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hatn_sim.datatypes import AlertInterval, BoolArray, FloatArray, IntArray, Score, Suggestion
from hatn_sim.labels import SAMPLE_EVERY_FRAMES
from hatn_sim.log import PredictionTable, Run
from hatn_sim.score.advised import ABSTAIN, Advised
from hatn_sim.score.assessed import AssessedRun
from hatn_sim.score.assistance import alert_scores, rare_s, suggestion_scores, warned_by
from hatn_sim.score.close_passes import close_passes
from hatn_sim.score.driven import driven_in
from hatn_sim.score.events import severe_events, vehicle_hours
from hatn_sim.score.matching import EARLIEST_S
from hatn_sim.score.pooling import by_scene
from hatn_sim.score.samples import reported_name, taken_slots

PAUSE_S = 1.0
Settings = dict[str, Any]


def assistance_scores(runs: Sequence[Run]) -> list[Score]:
    """The measures of the alerts and suggestions in logs, for each scene; none without graphs."""
    scores: list[Score] = []
    for scene, of_scene in by_scene(runs).items():
        advised = [run for run in of_scene if run.predictions(run.predictors[0]).slot_mask.any()]
        if not advised:
            continue
        assessed = [assessed_log(run) for run in advised]
        name, risk = reported_name(advised[0], advised[0].predictors[0]), assessed[0].risk or "all"
        found = warned_by(assessed, [alerts_in(run) for run in advised], rare_s(assessed))
        scores += alert_scores(found, name, scene, risk)
        scores += suggestion_scores(assessed, name, scene, risk)
    return scores


def assessed_log(run: Run) -> AssessedRun:
    """What scoring needs of a log."""
    driven = driven_in(run)
    settings: Settings = run.header.get("settings", {})
    window_s = (float(run.times_s[0]), float(run.times_s[-1]) - EARLIEST_S)
    return AssessedRun(
        scene=str(run.header.get("scene", "")),
        risk=settings.get("risk") or "",
        seed=int(run.header.get("seed") or 0),
        window_s=window_s,
        vehicle_hours=vehicle_hours(driven, *window_s),
        events=(*severe_events(driven), *close_passes(driven)),
        traces={},
        advised=advised_in(run),
    )


def alerts_in(run: Run) -> list[AlertInterval]:
    """The alerts of a log; those that are open at its end, end with it."""
    edges: dict[str, dict[str, Any]] = {}
    for _, edge in run.alerts:
        edges.setdefault(edge.alert_id, {})[edge.edge] = edge
    alerts: list[AlertInterval] = []
    for of_alert in edges.values():
        onset = of_alert["onset"]
        peak = of_alert.get("peak", onset)
        end_s = of_alert["end"].time_s if "end" in of_alert else float(run.times_s[-1])
        first, second = sorted((onset.ego_id, onset.other_id))
        # The danger itself is not in a log; its severity is.
        alerts.append(
            AlertInterval(
                first,
                second,
                onset.type,
                onset.time_s,
                end_s,
                peak.time_s,
                peak.severity,
                peak.severity,
            )
        )
    return alerts


def advised_in(run: Run) -> Advised:
    """The suggestions of a log in numbers, see `advised`."""
    table = run.predictions(run.predictors[0])
    encounters, switches = _flicker(run)
    sampled = np.flatnonzero(
        (table.frame % SAMPLE_EVERY_FRAMES == 0) & table.has_slot_probability & table.has_conflict
    )
    told, slot, probability = _advised_slots(run, table, sampled)
    rows = sampled[told]
    taken = taken_slots(run, table, rows)
    known = (taken >= 0) & (slot >= 0)
    return Advised(
        encounters=encounters,
        switches=switches,
        crossings=_crossings(run, table),
        sampled=len(rows),
        abstained=int((slot < 0).sum()),
        probability=probability[known],
        agrees=(taken == slot)[known],
        always_yield_agrees=(taken == 0)[known],
    )


def _advised_slots(
    run: Run, table: PredictionTable, rows: IntArray
) -> tuple[BoolArray, IntArray, FloatArray]:
    """Of rows [S]: whether the ego is advised then; of those that are, the slot (-1: it abstains)
    and its probability."""
    changes: dict[str, list[Any]] = {}
    for change in run.suggestions:
        changes.setdefault(change.ego_id, []).append(change)
    told = np.zeros(len(rows), dtype=np.bool_)
    slots: list[int] = []
    chances: list[float] = []
    for place, row in enumerate(rows.tolist()):
        of_ego = changes.get(run.ids[table.vehicle[row]], [])
        frames = [change.frame for change in of_ego]
        last = int(np.searchsorted(frames, table.frame[row], side="right")) - 1
        one = of_ego[last].suggestion if last >= 0 else None
        if one is None:
            continue
        told[place] = True
        names = [run.ids[v] if v >= 0 else None for v in table.slot_vehicle[row].tolist()]
        slot = 0 if one.action == "yield" else -1
        if one.action not in ("yield", ABSTAIN) and one.slot_id in names:
            slot = names.index(one.slot_id)
        slots.append(slot)
        # Only changes are logged; the probability is that of the moment.
        chances.append(float(table.slot_probability[row, slot]) if slot >= 0 else 0.0)
    return told, np.array(slots, dtype=np.int64), np.array(chances)


def _flicker(run: Run) -> tuple[int, int]:
    """(encounters, switches)"""
    encounters = switches = 0
    told: dict[str, Suggestion] = {}  # what holds now, by ego
    spoken: dict[tuple[str, str | None], tuple[str, float]] = {}  # action, last time it held
    for change in run.suggestions:
        time_s = float(run.times_s[change.frame])
        before = told.pop(change.ego_id, None)
        if before is not None and before.action != ABSTAIN:
            spoken[change.ego_id, before.slot_id] = (before.action, time_s)
        one = change.suggestion
        if one is None:
            continue
        told[change.ego_id] = one
        if one.action == ABSTAIN:
            continue
        action, last_s = spoken.get((change.ego_id, one.slot_id), ("", -np.inf))
        again = time_s - last_s <= PAUSE_S
        encounters += not again
        switches += again and action != one.action
        spoken[change.ego_id, one.slot_id] = (one.action, time_s)
    return encounters, switches


def _crossings(run: Run, table: PredictionTable) -> int:
    """Stretches in which a vehicle's own graph has an active conflict."""
    row = np.flatnonzero(table.has_conflict)
    order = np.lexsort((table.frame[row], table.vehicle[row]))
    vehicle, time_s = table.vehicle[row][order], run.times_s[table.frame[row][order]]
    if not len(vehicle):
        return 0
    return int(1 + ((np.diff(vehicle) != 0) | (np.diff(time_s) > PAUSE_S)).sum())
