"""Frames -> what the networks learn from: graphs, histories, and labels from what came after."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from hatn_sim.datatypes import (
    HISTORY_FRAMES,
    HORIZON_FRAMES,
    BoolArray,
    FloatArray,
    Frame,
    IntArray,
    SemanticGraphs,
)
from hatn_sim.graph import build_graphs
from hatn_sim.hatn.inputs import Float32Array, vehicle_history
from hatn_sim.labels import (
    FOLLOW_FRAMES,
    NEXT_FRAMES,
    SAMPLE_EVERY_FRAMES,
    Trajectories,
    goal_m,
    slot_label,
)
from hatn_sim.labels import trajectories_from_rows as _trajectories
from hatn_sim.loop import KEPT_LINES, RELEASE_FRAMES
from hatn_sim.perception import Perception, begin, perceive
from hatn_sim.road import Road

LABEL_FRAMES: Final = max(HORIZON_FRAMES, NEXT_FRAMES + FOLLOW_FRAMES)
"""Labels look no further ahead."""
SETTLE_FRAMES: Final = max(RELEASE_FRAMES, 2 * LABEL_FRAMES)
"""So often labels are taken, lines are let go of: later than the last of those that wait for it."""
OFF_LINE_M = 3.0
"""A future that leaves the line by more than this was driven on another one."""


@dataclass(frozen=True, eq=False)
class Samples:
    """One row for each ego and sample frame; S rows."""

    x: Float32Array  # [S, M, T, 7]
    context: Float32Array  # [S, M, CONTEXT_SIZE]
    node_mask: BoolArray  # [S, M]
    focus_mask: BoolArray  # [S, M]
    history_mask: BoolArray  # [S, M, T]
    goal_m: Float32Array  # [S, M]
    goal_mask: BoolArray  # [S, M]
    slot: IntArray  # [S] -1: none
    history: Float32Array  # [S, T, 6]
    future: Float32Array  # [S, F, 2] s - s_t, d - d_t
    future_mask: BoolArray  # [S, F]

    def __len__(self) -> int:
        return len(self.slot)


def concatenate(parts: Sequence[Samples]) -> Samples:
    """The rows of all parts, in order."""
    return Samples(
        **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Samples)}
    )


@dataclass(frozen=True, eq=False)
class _Moment:
    frame: int
    seen: Perception
    graphs: SemanticGraphs


def samples_of_run(
    road: Road,
    frames: Iterable[Frame],
    use_routes: bool = False,
    history_frames: int = HISTORY_FRAMES,
) -> Samples:
    """Every vehicle with a line and `history_frames` frames behind it, at every fifth frame.

    Frames are let go of as soon as their labels are known, and so are lines that nobody is near,
    so that memory grows with the samples alone.
    """
    state = begin(road)
    waiting: list[_Moment] = []
    seen_rows: deque[tuple[int, IntArray, FloatArray]] = deque()  # frame, vehicles, centres
    row_of: dict[str, int] = {}
    parts = [_samples_of_nothing(road)]
    index = -1
    for index, frame in enumerate(frames):
        scene = frame.scene
        state = perceive(state, scene, frame.truth.routes if use_routes else None)
        vehicle = [row_of.setdefault(name, len(row_of)) for name in scene.ids]
        seen_rows.append((index, np.array(vehicle, dtype=np.int64), scene.xy_m))
        if index % SAMPLE_EVERY_FRAMES == 0:
            waiting.append(_Moment(index, state.seen, build_graphs(road, state.seen)))
        if index % SETTLE_FRAMES == SETTLE_FRAMES - 1:
            ready = [m for m in waiting if m.frame + LABEL_FRAMES <= index]
            parts += _settle(road, ready, seen_rows, row_of, history_frames)
            del waiting[: len(ready)]
            while seen_rows and seen_rows[0][0] < (waiting[0].frame if waiting else index):
                seen_rows.popleft()
            road.release(SETTLE_FRAMES, KEPT_LINES)
    parts += _settle(road, waiting, seen_rows, row_of, history_frames)
    return concatenate(parts)


def _settle(
    road: Road,
    moments: Sequence[_Moment],
    seen_rows: Iterable[tuple[int, IntArray, FloatArray]],
    row_of: dict[str, int],
    history_frames: int,
) -> list[Samples]:
    """The samples of moments, all that their labels look at being in `seen_rows`."""
    if not moments:
        return []
    frame, vehicle, xy_m = zip(*seen_rows, strict=True)
    trajectories = _trajectories(
        tuple(row_of),
        np.concatenate(vehicle),
        np.repeat(np.array(frame) - frame[0], [len(of_frame) for of_frame in vehicle]),
        np.concatenate(xy_m),
        frame[-1] - frame[0] + 1,
    )
    moved = [replace(moment, frame=moment.frame - frame[0]) for moment in moments]
    return [_samples_of_moment(road, m, trajectories, row_of, history_frames) for m in moved]


def _samples_of_nothing(road: Road) -> Samples:
    """No row, for runs without a vehicle."""
    nobody = begin(road).seen
    none = np.zeros(0, dtype=np.int64)
    trajectories = _trajectories((), none, none, np.zeros((0, 2)), 1)
    moment = _Moment(0, nobody, build_graphs(road, nobody))
    return _samples_of_moment(road, moment, trajectories, {}, HISTORY_FRAMES)


def _samples_of_moment(
    road: Road,
    moment: _Moment,
    trajectories: Trajectories,
    row_of: dict[str, int],
    history_frames: int,
) -> Samples:
    seen, graphs = moment.seen, moment.graphs
    whole = seen.tracks.valid[graphs.ego, -history_frames:].all(axis=1)
    keep = np.flatnonzero(whole)
    ego = graphs.ego[keep]
    rows = np.array([row_of[name] for name in seen.scene.ids], dtype=np.int64)
    rear = graphs.rear[keep]
    node = np.where(rear >= 0, rows[np.maximum(rear, 0)], 0)
    frame = np.full(len(keep), moment.frame)
    goals, known = goal_m(trajectories, node.ravel(), np.repeat(frame, node.shape[1]))
    slot = slot_label(
        trajectories,
        rows[ego],
        frame,
        node,
        graphs.focus_mask[keep],
        graphs.ego_to_conflict_m[keep],
        graphs.rear_to_conflict_m[keep],
        graphs.conflict_xy_m[keep],
    )
    slot = np.where(graphs.has_conflict[keep], slot, -1)
    future, future_mask = _future(road, seen, ego, rows[ego], moment.frame, trajectories)
    return Samples(
        x=graphs.x[keep].astype(np.float32),
        context=graphs.context[keep].astype(np.float32),
        node_mask=graphs.node_mask[keep],
        focus_mask=graphs.focus_mask[keep],
        history_mask=graphs.history_mask[keep],
        goal_m=goals.reshape(node.shape).astype(np.float32),
        goal_mask=known.reshape(node.shape) & graphs.node_mask[keep],
        slot=slot,
        history=vehicle_history(seen, ego),
        future=future.astype(np.float32),
        future_mask=future_mask,
    )


def _future(
    road: Road,
    seen: Perception,
    ego: IntArray,
    row: IntArray,
    frame: int,
    trajectories: Trajectories,
) -> tuple[FloatArray, BoolArray]:
    """The next 30 frames (s - s_t, d - d_t) [B, F, 2] on the line chosen now, and where known."""
    last = trajectories.frame_count - 1
    at = np.minimum(frame + 1 + np.arange(HORIZON_FRAMES), last)
    inside = frame + 1 + np.arange(HORIZON_FRAMES) <= last
    xy, mask = trajectories.xy_at(row[:, None], at)
    mask &= inside
    mask = np.cumprod(mask, axis=1).astype(np.bool_)
    travelled = trajectories.travelled_at(row[:, None], at)
    travelled -= trajectories.travelled_at(row[:, None], frame)
    line = np.repeat(seen.lines.line[ego], HORIZON_FRAMES)
    guess = (seen.lines.s_m[ego, None] + np.where(mask, travelled, 0.0)).ravel()
    s, d = road.project(line, xy.reshape(-1, 2), guess, 5.0)
    s, d = s.reshape(mask.shape), d.reshape(mask.shape)
    mask &= (np.abs(d) < OFF_LINE_M).all(axis=1, where=mask, keepdims=True)
    future = np.stack((s - seen.lines.s_m[ego, None], d - seen.lines.d_m[ego, None]), axis=-1)
    return np.where(mask[..., None], future, 0.0), mask
