"""What the page knows of the whole run: vehicles, advice, alerts, events, scores, settings."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import Alert, FloatArray, Kind, SafetyEvent, Score
from hatn_sim.log import Run
from hatn_sim.report.meeting import meeting_place
from hatn_sim.report.page.tables import score_tables
from hatn_sim.report.paint import look_of, paint_of
from hatn_sim.report.table import SCORES_FILE, notes
from hatn_sim.score.close_passes import shown_passes
from hatn_sim.score.driven import Driven, driven_in
from hatn_sim.score.events import severe_events
from hatn_sim.score.everyday import everyday_braking_in

SPEEDS_ADVISED: Final = slice(4, None, 5)
"""Of an advised profile: its speeds after 0.5 s, 1 s ..., told in steps of 0.1 m/s."""
SIGNALS_UNKNOWN: Final = (
    "The recording does not tell the states of its signals: all count as open, and none is drawn"
)
HIDDEN: Final = ("ids_by",)
"""Settings of which nobody is told."""


def vehicles_of(run: Run) -> list[dict[str, Any]]:
    """Name, kind, size and paint of every vehicle of the run, and when it was in view."""
    tracks = run.tracks
    _, first = np.unique(tracks.vehicle, return_index=True)
    _, last = np.unique(tracks.vehicle[::-1], return_index=True)
    last = len(tracks.vehicle) - 1 - last
    return [
        {
            "id": name,
            "kind": Kind(int(tracks.kind[row])).name.lower(),
            "length_m": round(float(tracks.size_m[row, 0]), 2),
            "width_m": round(float(tracks.size_m[row, 1]), 2),
            "colour": list(paint_of(*tracks.colour[row].tolist())),
            "look": look_of(int(tracks.kind[row]), tracks.colour[row].tolist()),
            "first": int(tracks.frame[row]),
            "last": int(tracks.frame[end]),
        }
        for name, row, end in zip(run.ids, first.tolist(), last.tolist(), strict=True)
    ]


def advice_of(run: Run) -> list[dict[str, Any]]:
    """Every change of advice, by frame; `action` None where it ends."""
    number = {name: index for index, name in enumerate(run.ids)}
    out: list[dict[str, Any]] = []
    for change in run.suggestions:
        line: dict[str, Any] = {"frame": change.frame, "ego": number.get(change.ego_id, -1)}
        said = change.suggestion
        if said is not None:
            line |= {
                "action": said.action,
                "slot": -1 if said.slot_id is None else number.get(said.slot_id, -1),
                "chance": _rounded(said.probability),
                "target_s": _rounded(said.target_time_s),
                "speed_mps": _rounded(said.advised_speed_mps),
                "feasible": said.feasible,
                "text": said.text,
                "reason": said.reason,
                "speeds": [round(10.0 * mps) for mps in said.profile_mps[SPEEDS_ADVISED]],
            }
        out.append(line)
    return out


def alerts_of(run: Run) -> list[dict[str, Any]]:
    """Alerts from onset to end (None: it was still on), by onset."""
    number = {name: index for index, name in enumerate(run.ids)}
    edges: dict[str, dict[str, Alert]] = {}
    for _, alert in run.alerts:
        edges.setdefault(alert.alert_id, {})[alert.edge] = alert
    out: list[dict[str, Any]] = []
    for by_edge in edges.values():
        onset = by_edge.get("onset")
        if onset is None:
            continue
        peak, end = by_edge.get("peak", onset), by_edge.get("end")
        out.append(
            {
                "from_s": _rounded(onset.time_s),
                "to_s": None if end is None else _rounded(end.time_s),
                "type": onset.type,
                "ego": number.get(onset.ego_id, -1),
                "other": number.get(onset.other_id, -1),
                "severity": _rounded(peak.severity),
                "text": onset.text or peak.reason,
                "reason": peak.reason,
            }
        )
    return sorted(out, key=lambda alert: alert["from_s"])


def events_of(run: Run, origin_m: FloatArray) -> list[dict[str, Any]]:
    """What really went wrong: T1, T2 and T3, by start, and where the two met, from `origin_m`."""
    driven = driven_in(run)
    number = {name: index for index, name in enumerate(run.ids)}
    found: list[SafetyEvent] = [*severe_events(driven), *shown_passes(driven)]
    return [
        {
            "tier": event.tier,
            "at_s": _rounded(event.start_s),
            "first": number.get(event.first_id, -1),
            "second": -1 if event.second_id is None else number.get(event.second_id, -1),
            "cause": event.cause,
            "apart_s": _rounded(event.encroachment_s),
            "met_m": _met(driven, event, number, origin_m),
        }
        for event in sorted(found, key=lambda one: one.start_s)
        if event.tier in ("T1", "T2", "T3")
    ]


def _met(
    driven: Driven, event: SafetyEvent, number: Mapping[str, int], origin_m: FloatArray
) -> list[float] | None:
    """None: there is one vehicle only, or their ways did not meet."""
    one, other = number.get(event.first_id), number.get(event.second_id or "")
    if one is None or other is None:
        return None
    place = meeting_place(driven, one, other, int(np.abs(driven.time_s - event.start_s).argmin()))
    return None if place is None else np.round(place - origin_m, 1).tolist()


def notices_of(run: Run) -> list[str]:
    """What is said above all else: what is missing in the run's folder, or not known, or what its
    events do not tell."""
    said = [str(gap) for gap in run.gaps]
    said += [] if run.signals_known else [SIGNALS_UNKNOWN]
    everyday = everyday_braking_in(driven_in(run))
    said += [] if everyday is None else [everyday]
    return [f"{one}." for one in said]


def settings_of(run: Run) -> list[list[str]]:
    """What the run was made of, as names and words."""
    header = run.header
    lines = [["scene", str(header.get("scene", ""))], ["seed", str(header.get("seed"))]]
    lines += _told("", header.get("settings", {}))
    lines += _told("version of ", header.get("versions", {}))
    lines += _told("weights of ", header.get("weights_sha256", {}))
    return lines


def scores_of(run: Run) -> dict[str, Any]:
    """Tables of the run's scores, and what they cannot do without; empty before they are made."""
    path = run.path / SCORES_FILE
    if not path.is_file():
        return {"tables": [], "notes": []}
    try:
        scores = [Score(**row) for row in json.loads(path.read_text(encoding="utf-8"))]
    except (OSError, ValueError, TypeError):
        return {"tables": [], "notes": [f"{SCORES_FILE} cannot be read"]}
    return {"tables": score_tables(scores), "notes": notes(scores)}


def _told(before: str, values: Mapping[str, Any]) -> list[list[str]]:
    lines: list[list[str]] = []
    for name, value in values.items():
        if isinstance(value, Mapping):
            lines += _told(f"{before}{name}: ", value)
        elif value not in (None, "", [], {}) and name not in HIDDEN:
            words = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
            lines.append([f"{before}{name}".replace("_", " "), words])
    return lines


def _rounded(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(float(value), 3)
