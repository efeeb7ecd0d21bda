"""Alerts as intervals: onset, peak, end, with hysteresis (METHOD section 7, CONFLICT)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from hatn_sim.assist.risk import Encounters, required_deceleration_mps2
from hatn_sim.datatypes import Alert, Prediction, Scene

ENCROACHMENT_S: Final = 0.0
"""Both are predicted to be in the area at once."""
SOON_S: Final = 3.0
"""The prediction's own horizon: nothing later is alerted of."""
HARD_BRAKING_MPS2: Final = 3.0
"""Beyond comfort: neither can easily give way any more."""
END_AFTER_S: Final = 0.5
"""The danger must be gone for this long."""


@dataclass(frozen=True)
class _Open:
    alert: Alert  # the peak so far
    last_s: float


@dataclass(frozen=True)
class AlertState:
    """The alerts that are open now, by unordered pair, and how many there were."""

    open: Mapping[tuple[str, str], _Open] = field(default_factory=dict[tuple[str, str], _Open])
    count: int = 0


def alert(
    state: AlertState,
    scene: Scene,
    prediction: Prediction,
    meeting: Encounters,
    egos: frozenset[str] | None,
) -> tuple[AlertState, tuple[Alert, ...]]:
    """Edges of this moment: pairs predicted to meet, where both would have to brake hard."""
    graphs = prediction.graphs
    assert graphs is not None
    other = np.maximum(graphs.rear, 0)
    ego_speed = scene.speed_mps[graphs.ego][:, None]
    ego_drac = required_deceleration_mps2(meeting.ego_room_m, ego_speed, meeting.other_leave_s)
    other_drac = required_deceleration_mps2(
        meeting.other_room_m, scene.speed_mps[other], meeting.ego_leave_s
    )
    least = np.minimum(ego_drac, other_drac)
    danger = graphs.node_mask & (np.arange(graphs.rear.shape[1]) > 0)
    danger &= meeting.predicted_encroachment_s() < ENCROACHMENT_S
    danger &= np.maximum(meeting.ego_enter_s, meeting.other_enter_s) < SOON_S
    danger &= least > HARD_BRAKING_MPS2
    edges: list[Alert] = []
    still: dict[tuple[str, str], _Open] = dict(state.open)
    count = state.count
    for e, m in np.argwhere(danger).tolist():
        ego_id, other_id = scene.ids[graphs.ego[e]], scene.ids[graphs.rear[e, m]]
        if egos is not None and ego_id not in egos:
            continue
        pair = (min(ego_id, other_id), max(ego_id, other_id))
        severity = float(np.clip(least[e, m] / 9.0, 0.0, 1.0))
        reason = f"both need to brake at {least[e, m]:.1f} m/s2 or more not to meet"
        before = still.get(pair)
        if before is None:
            count += 1
            onset = Alert(
                f"a{count:05d}",
                "onset",
                "CONFLICT",
                scene.time_s,
                ego_id,
                other_id,
                severity,
                reason,
            )
            edges.append(onset)
            still[pair] = _Open(onset, scene.time_s)
        else:
            peak = before.alert
            if severity > peak.severity:
                peak = replace(
                    peak, edge="peak", severity=severity, time_s=scene.time_s, reason=reason
                )
            still[pair] = _Open(peak, scene.time_s)
    for pair, held in list(still.items()):
        if scene.time_s - held.last_s > END_AFTER_S:
            edges.append(replace(held.alert, edge="peak"))
            edges.append(replace(held.alert, edge="end", time_s=held.last_s))
            del still[pair]
    return AlertState(still, count), tuple(edges)
