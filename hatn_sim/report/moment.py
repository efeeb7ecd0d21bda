"""The log of a run -> what there is to show around an ego at its moments. No drawing here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np

from hatn_sim.datatypes import (
    HORIZON_FRAMES,
    Alert,
    FloatArray,
    Lines,
    Scene,
    SemanticGraphs,
    Suggestion,
)
from hatn_sim.errors import InputError
from hatn_sim.graph import build_graphs
from hatn_sim.log import PredictionTable, Run
from hatn_sim.log.choice_file import read_run_choice
from hatn_sim.perception import PerceptionState, begin, perceive
from hatn_sim.road import LINE_STEP_M, Road

WARM_UP_FRAMES: Final = 200
"""Scenes perceived before the first one shown, so that lines and graphs are those of the run."""
STILL_M: Final = 0.8
"""Shorter paths are not drawn."""
NAME_LETTERS: Final = 30
SLOT_REACH_M: Final = 45.0
"""A slot is shown up to this far ahead of the vehicle behind it."""


@dataclass(frozen=True, eq=False)
class Slot:
    """A dynamic insertion area of the ego's graph."""

    rear_id: str
    is_own: bool  # node 0: to take it is to yield
    in_focus: bool
    probability: float | None  # None: not in focus, or the predictor gives none
    strip_xy_m: FloatArray  # [P, 2] middle of the strip, from the rear bumper boundary forward
    conflict_xy_m: FloatArray | None  # [2]; None: there is no conflict


def _words_of(alert: Alert) -> str:
    return alert.text or alert.reason or "Alert"


def shortened(name: str) -> str:
    """A name in a line of words: ids may be long."""
    return name if len(name) <= NAME_LETTERS else f"{name[: NAME_LETTERS - 1]}\u2026"


def moves(path_xy_m: FloatArray) -> bool:
    """Whether a path is long enough to be drawn."""
    return float(np.linalg.norm(np.diff(path_xy_m, axis=0), axis=1).sum()) > STILL_M


@dataclass(frozen=True, eq=False)
class Forecast:
    """What was predicted of a vehicle, and what it then did."""

    mode_probability: FloatArray  # [K]
    predicted_xy_m: FloatArray  # [K, F + 1, 2] from now on
    actual_xy_m: FloatArray  # [G + 1, 2] from now on, as long as it stayed in view, G <= F

    def paths_to_draw(self) -> Iterator[tuple[FloatArray, float]]:
        """The predicted paths that go anywhere, and how strong each is: 1 for the likeliest."""
        best = float(self.mode_probability.max(initial=0.0))
        for path, chance in zip(self.predicted_xy_m, self.mode_probability, strict=True):
            if chance > 0.05 and moves(path):
                yield path, float(chance) / best


@dataclass(frozen=True, eq=False)
class Moment:
    """One frame, seen for one ego."""

    scene: Scene
    ego_id: str  # need not be in the scene (any more)
    slots: tuple[Slot, ...]  # the ego's own first
    forecasts: Mapping[str, Forecast]  # by vehicle
    suggestion: Suggestion | None  # the last one given, see its time
    alerts: tuple[Alert, ...] = ()  # the onsets of those that stand, whomever they name
    is_advised: bool = True  # False: advice was not asked for

    @property
    def choice(self) -> dict[str, float]:
        """Probability of each slot to choose from, by the vehicle behind it; the least first."""
        told = {
            slot.rear_id: slot.probability
            for slot in self.slots
            if slot.in_focus and slot.probability is not None
        }
        return dict(sorted(told.items(), key=lambda item: item[1]))

    @property
    def alerted(self) -> set[str]:
        """Whom alerts name."""
        return {name for one in self.alerts for name in (one.ego_id, one.other_id)}

    @property
    def warning(self) -> Alert | None:
        """The latest alert that warns the ego."""
        return next((one for one in reversed(self.alerts) if one.ego_id == self.ego_id), None)

    @property
    def headline(self) -> str | None:
        """What the ego is told, in words: an alert that names it goes before its advice.

        As on the page: the latest alert that warns it, else the latest that warns another of it,
        else its advice, of whatever kind. None: it is told nothing.
        """
        if self.warning is not None:
            return _words_of(self.warning)
        minding = [one for one in self.alerts if one.other_id == self.ego_id]
        if minding:
            return f"{shortened(minding[-1].ego_id)} is told: {_words_of(minding[-1])}"
        return None if self.suggestion is None else self.suggestion.text

    @property
    def alarmed(self) -> bool:
        """Whether an alert names the ego."""
        return any(self.ego_id in (one.ego_id, one.other_id) for one in self.alerts)

    @property
    def named(self) -> tuple[str, ...]:
        """Whom the ego is told of, by its alerts and its advice; of those in view."""
        told = _told_of(self.ego_id, self.alerts, self.suggestion)
        return tuple(one for one in told if one in self.scene.ids)

    @property
    def involved(self) -> set[str]:
        """The ego and the vehicles behind the slots of its focus."""
        return {slot.rear_id for slot in self.slots if slot.in_focus} | {self.ego_id}


def read_moments(run: Run, frames: Sequence[int], ego_id: str) -> Iterator[Moment]:
    """The moments of an ego at these frames, which rise; none where the run has ended.

    Lines and graphs are worked out again from the logged scenes and lanes; probabilities and
    predictions are the logged ones. Where the run lacks what lines are made of, there are no slots.

    Raises:
        InputError: no such first frame or vehicle, no predictions, or no lanes beside the log.
    """
    first, stop = frames[0], min(frames[-1] + 1, run.frame_count)
    if not 0 <= first < run.frame_count:
        raise InputError(f"{run.path}: no frame {first}; expected 0 to {run.frame_count - 1}")
    if ego_id not in run.ids:
        raise InputError(f"{run.path}: no vehicle {ego_id!r} in this run; see its tracks for ids")
    table = main_predictions(run)
    state = begin(Road(run.lanes), read_run_choice(run.path)) if run.has_lines else None
    start, wanted = max(first - WARM_UP_FRAMES, 0), set(frames)
    for frame, logged in enumerate(islice(run.frames(), start, stop), start=start):
        scene = logged.scene
        if state is not None:
            state = perceive(state, scene, logged.truth.routes if run.by_route else None)
        if frame in wanted:
            yield Moment(
                scene=scene,
                ego_id=ego_id,
                slots=() if state is None else _slots(run, table, state, frame, ego_id),
                forecasts=_forecasts(run, table, frame),
                suggestion=_suggestion(run, frame, ego_id),
                alerts=alerts_at(run, frame),
            )


def moment_at(run: Run, frame: int, ego_id: str) -> Moment:
    """A single moment; raises as `read_moments` does, and where the ego is not in view."""
    moment = next(read_moments(run, [frame], ego_id))
    if ego_id not in moment.scene.ids:
        raise InputError(f"{run.path}: vehicle {ego_id!r} is not in view at frame {frame}")
    return moment


def main_predictions(run: Run) -> PredictionTable:
    """What the predictor said whose advice is shown. InputError where there is nothing."""
    if not run.predictors or not len(run.ids):
        what = "predictions" if len(run.ids) else "vehicles"
        raise InputError(f"{run.path}: no {what} in this run, nothing to draw; make a longer run")
    return run.predictions(run.predictors[0])


def _slots(
    run: Run, table: PredictionTable, state: PerceptionState, frame: int, ego_id: str
) -> tuple[Slot, ...]:
    rows = slice(*np.searchsorted(table.frame, [frame, frame + 1]))
    row = np.flatnonzero(table.vehicle[rows] == run.ids.index(ego_id))
    if ego_id not in state.seen.scene.ids or not len(row):
        return ()
    at = rows.start + int(row[0])
    graphs = build_graphs(state.road, state.seen)
    ego = np.flatnonzero(graphs.ego == graphs.ids.index(ego_id))
    if not len(ego):
        return ()
    logged = {run.ids[table.slot_vehicle[at, m]]: m for m in np.flatnonzero(table.slot_mask[at])}
    slots: list[Slot] = []
    for m in np.flatnonzero(graphs.node_mask[ego[0]]).tolist():
        rear_id = graphs.ids[graphs.rear[ego[0], m]]
        if rear_id not in logged:
            continue
        node = logged[rear_id]
        in_focus = bool(table.slot_in_focus[at, node])
        told = table.has_slot_probability[at] and in_focus and table.has_conflict[at]
        slots.append(
            Slot(
                rear_id=rear_id,
                is_own=m == 0,
                in_focus=in_focus,
                probability=float(table.slot_probability[at, node]) if told else None,
                strip_xy_m=slot_strip(
                    state.road, state.seen.scene, state.seen.lines, graphs, int(ego[0]), m
                ),
                conflict_xy_m=table.conflict_xy_m[at, node] if table.has_conflict[at] else None,
            )
        )
    return tuple(slots)


def slot_strip(
    road: Road, scene: Scene, lines: Lines, graphs: SemanticGraphs, ego: int, node: int
) -> FloatArray:
    """The middle of a slot [P, 2], along the line of the vehicle behind it, from its bumper on."""
    rear = int(graphs.rear[ego, node])
    length_m = float(np.clip(graphs.x[ego, node, -1, 6], 0.0, SLOT_REACH_M))
    start_m = float(lines.s_m[rear] + 0.5 * scene.size_m[rear, 0])
    s_m = start_m + np.linspace(0.0, length_m, max(int(length_m / LINE_STEP_M), 2))
    line = np.array([lines.line[rear]])
    strip: FloatArray = road.locate(line, s_m[None], np.zeros((1, len(s_m))))[0]
    return strip


def _forecasts(run: Run, table: PredictionTable, frame: int) -> dict[str, Forecast]:
    first, last = np.searchsorted(table.frame, [frame, frame + 1])
    out: dict[str, Forecast] = {}
    for row in range(int(first), int(last)):
        vehicle = int(table.vehicle[row])
        until = min(int(run.trajectories.seen_until(vehicle, frame)), frame + HORIZON_FRAMES)
        actual_xy_m, _ = run.trajectories.xy_at(vehicle, np.arange(frame, until + 1))
        modes = table.xy_m[row]
        start = np.broadcast_to(actual_xy_m[0], (len(modes), 1, 2))
        out[run.ids[vehicle]] = Forecast(
            mode_probability=table.mode_probability[row],
            predicted_xy_m=np.concatenate((start, modes), axis=1),
            actual_xy_m=actual_xy_m,
        )
    return out


def alerts_at(run: Run, frame: int) -> tuple[Alert, ...]:
    """The onsets of the alerts that stand at a frame, as they came."""
    standing: dict[str, Alert] = {}
    for at, edge in run.alerts:
        if at > frame:
            continue
        if edge.edge == "onset":
            standing[edge.alert_id] = edge
        elif edge.edge == "end":
            standing.pop(edge.alert_id, None)
    return tuple(standing.values())


def named_at(run: Run, frame: int, ego_id: str) -> tuple[str, ...]:
    """Whom an ego is told of at a frame, by its alerts and its advice; of those of the run."""
    told = _told_of(ego_id, alerts_at(run, frame), _suggestion(run, frame, ego_id))
    return tuple(one for one in told if one in run.ids)


def _told_of(
    ego_id: str, alerts: Sequence[Alert], suggestion: Suggestion | None
) -> tuple[str, ...]:
    warned = [
        one.other_id if one.ego_id == ego_id else one.ego_id
        for one in alerts
        if ego_id in (one.ego_id, one.other_id)
    ]
    advised = [] if suggestion is None else [suggestion.slot_id]
    return tuple(one for one in dict.fromkeys([*warned, *advised]) if one is not None)


def _suggestion(run: Run, frame: int, ego_id: str) -> Suggestion | None:
    """The last that the ego was told, if it still stands."""
    told: Suggestion | None = None
    for change in run.suggestions:
        if change.frame > frame:
            break
        if change.ego_id == ego_id:
            told = change.suggestion
    return told
