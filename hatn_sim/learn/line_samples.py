"""Choices of lines with what came after: which candidate the next 3 s of a track fit best.

Labels are hindsight, made from the tracks alone, so any traffic serves: no routes are needed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from hatn_sim.datatypes import HORIZON_FRAMES, BoolArray, FloatArray, Frame, IntArray, Tracks
from hatn_sim.habits import fresh_habits
from hatn_sim.labels import SAMPLE_EVERY_FRAMES
from hatn_sim.line_choice import HAND_MADE_CHOICE, LineChoice
from hatn_sim.line_features import FEATURES, collect_evidence, line_features
from hatn_sim.lines import empty_lines, follow_lines
from hatn_sim.road import Road
from hatn_sim.tracks import empty_tracks, extend, rows_before

FIT_M: Final = 2.0
"""A future further from all candidates than this, on average, was driven on none of them."""
TIED_M: Final = 0.25
"""Candidates that fit the future as well as the best, but for this, are right as well."""
WRONG_M: Final = 0.5
"""A chosen line that fits worse than the best by more than this is wrong."""


@dataclass(frozen=True, eq=False)
class ChoiceSamples:
    """Candidates, those of one vehicle at one moment (a case) together: Q rows, S cases."""

    features: FloatArray  # [Q, F]
    fit_m: FloatArray  # [Q] mean distance of the next 3 s from the candidate
    log_share: FloatArray  # [Q] see `Evidence`
    chosen: BoolArray  # [Q] by the choice that the samples were collected with
    case: IntArray  # [Q] 0, 1 ...
    probability: FloatArray  # [S] that was given to the chosen line

    def __len__(self) -> int:
        return len(self.probability)


def no_samples() -> ChoiceSamples:
    """What there is where nobody has a choice, or nothing lasts for 3 s."""
    none, no_case = np.zeros(0), np.zeros(0, dtype=np.int64)
    not_one = np.zeros(0, dtype=np.bool_)
    return ChoiceSamples(np.zeros((0, len(FEATURES))), none, none, not_one, no_case, none)


def joined(parts: Sequence[ChoiceSamples]) -> ChoiceSamples:
    """The cases of all parts, in order."""
    columns = {f.name: [getattr(part, f.name) for part in parts] for f in fields(ChoiceSamples)}
    before = np.cumsum([0, *(len(part) for part in parts[:-1])])
    columns["case"] = [case + n for case, n in zip(columns["case"], before.tolist(), strict=True)]
    return ChoiceSamples(**{name: np.concatenate(values) for name, values in columns.items()})


def least_of_cases(samples: ChoiceSamples, values: FloatArray) -> FloatArray:
    """The least of values [Q] for each case [S]."""
    least = np.full(len(samples), np.inf)
    np.minimum.at(least, samples.case, values)
    return least


@dataclass(frozen=True, eq=False)
class _Moment:
    """Candidates of one frame that wait for what comes next."""

    ids: tuple[str, ...]  # [N]
    vehicle: IntArray  # [Q]
    line: IntArray  # [Q]
    s_m: FloatArray  # [Q] of the box centre
    features: FloatArray
    log_share: FloatArray
    chosen: BoolArray
    probability: FloatArray  # [N]


def choice_samples(
    road: Road,
    frames: Iterable[Frame],
    choice: LineChoice = HAND_MADE_CHOICE,
    every_frames: int = SAMPLE_EVERY_FRAMES,
) -> ChoiceSamples:
    """The cases of a run: every vehicle with several candidates and 3 s of track after it."""
    tracks, state = empty_tracks(), empty_lines()
    waiting: deque[tuple[int, _Moment]] = deque()
    parts = [no_samples()]
    for index, frame in enumerate(frames):
        scene = frame.scene
        tracks = extend(tracks, scene)
        state, lines = follow_lines(state, road, tracks, scene, choice=choice)
        road.touch(state.line)
        while waiting and waiting[0][0] <= index - HORIZON_FRAMES:
            parts.append(_judge(road, waiting.popleft()[1], tracks))
        if index % every_frames == 0:
            habits = state.habits or fresh_habits(road)
            evidence = collect_evidence(state, road, scene, habits)
            if not len(evidence.vehicle):
                continue
            vehicle, slot = evidence.vehicle, evidence.slot
            moment = _Moment(
                ids=scene.ids,
                vehicle=vehicle,
                line=state.line[vehicle, slot],
                s_m=state.s_m[vehicle, slot] - 0.5 * scene.size_m[vehicle, 0],
                features=line_features(evidence, state, road, tracks, scene)[evidence.alike],
                log_share=evidence.log_share,
                chosen=state.chosen[vehicle] == slot,
                probability=lines.probability,
            )
            waiting.append((index, moment))
    return joined(parts)


def _judge(road: Road, moment: _Moment, tracks: Tracks) -> ChoiceSamples:
    """The cases of a moment, `HORIZON_FRAMES` later: of vehicles in view all the while."""
    row = rows_before(tracks.ids, moment.ids)[moment.vehicle]
    seen = (row >= 0) & tracks.valid[row, -HORIZON_FRAMES - 1 :].all(axis=1)
    q = np.flatnonzero(seen)
    row = row[q]
    xy = tracks.xy_m[row, -HORIZON_FRAMES - 1 :]
    step_m = np.linalg.norm(np.diff(xy, axis=1), axis=2)
    guess_m = moment.s_m[q, None] + np.cumsum(step_m, axis=1)
    line = np.repeat(moment.line[q], HORIZON_FRAMES)
    _, d = road.project(line, xy[:, 1:].reshape(-1, 2), guess_m.ravel(), 6.0)
    fit_m = np.abs(d).reshape(len(q), HORIZON_FRAMES).mean(axis=1)
    vehicle, case = np.unique(moment.vehicle[q], return_inverse=True)
    return ChoiceSamples(
        features=moment.features[q],
        fit_m=fit_m,
        log_share=moment.log_share[q],
        chosen=moment.chosen[q],
        case=case.astype(np.int64),
        probability=moment.probability[vehicle],
    )
