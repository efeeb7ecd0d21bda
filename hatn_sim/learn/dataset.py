"""Frames -> what the networks learn from: graphs, histories, and labels from what came after."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from hatn_sim.datatypes import (
    DT_S,
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
    PROFILE_FRAMES,
    SAMPLE_EVERY_FRAMES,
    Trajectories,
    crossing_frame,
    goal_m,
    profile_m,
    slot_label,
)
from hatn_sim.labels import trajectories_from_rows as _trajectories
from hatn_sim.perception import Perception, begin, perceive
from hatn_sim.road import Road

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
    profile_m: Float32Array  # [S, M, P] travelled by every node's vehicle after `PROFILE_FRAMES`
    profile_mask: BoolArray  # [S, M, P]
    slot: IntArray  # [S] -1: none
    crossing_s: Float32Array  # [S] until the ego crosses its focus
    crossing_mask: BoolArray  # [S]
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


def samples_of_run(road: Road, frames: Iterable[Frame], use_routes: bool = False) -> Samples:
    """Every vehicle with a line, 11 frames behind it, at every fifth frame of a run."""
    state = begin(road)
    moments: list[_Moment] = []
    row_of: dict[str, int] = {}
    vehicles: list[IntArray] = []
    at_frame: list[IntArray] = []
    positions: list[FloatArray] = []
    total = 0
    for index, frame in enumerate(frames):
        scene = frame.scene
        state = perceive(state, scene, frame.truth.routes if use_routes else None)
        vehicles.append(
            np.array([row_of.setdefault(name, len(row_of)) for name in scene.ids], dtype=np.int64)
        )
        at_frame.append(np.full(len(scene.ids), index))
        positions.append(scene.xy_m)
        if index % SAMPLE_EVERY_FRAMES == 0:
            moments.append(_Moment(index, state.seen, build_graphs(road, state.seen)))
        total = index + 1
    trajectories = _trajectories(
        tuple(row_of),
        np.concatenate(vehicles),
        np.concatenate(at_frame),
        np.concatenate(positions),
        total,
    )
    return concatenate([_samples_of_moment(road, m, trajectories, row_of) for m in moments])


def _samples_of_moment(
    road: Road, moment: _Moment, trajectories: Trajectories, row_of: dict[str, int]
) -> Samples:
    seen, graphs = moment.seen, moment.graphs
    whole = seen.tracks.valid[graphs.ego, -HISTORY_FRAMES:].all(axis=1)
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
    profile, profile_known = profile_m(trajectories, node.ravel(), np.repeat(frame, node.shape[1]))
    by_time = (*node.shape, len(PROFILE_FRAMES))
    crossing = crossing_frame(
        trajectories,
        rows[ego],
        frame,
        graphs.ego_to_conflict_m[keep, 0],
        graphs.conflict_xy_m[keep, 0],
        NEXT_FRAMES + FOLLOW_FRAMES,
    )
    crosses = (crossing >= 0) & graphs.has_conflict[keep]
    future, future_mask = _future(road, seen, ego, rows[ego], moment.frame, trajectories)
    return Samples(
        x=graphs.x[keep].astype(np.float32),
        context=graphs.context[keep].astype(np.float32),
        node_mask=graphs.node_mask[keep],
        focus_mask=graphs.focus_mask[keep],
        history_mask=graphs.history_mask[keep],
        goal_m=goals.reshape(node.shape).astype(np.float32),
        goal_mask=known.reshape(node.shape) & graphs.node_mask[keep],
        profile_m=profile.reshape(by_time).astype(np.float32),
        profile_mask=profile_known.reshape(by_time) & graphs.node_mask[keep][..., None],
        slot=slot,
        crossing_s=np.where(crosses, (crossing - frame) * DT_S, 0.0).astype(np.float32),
        crossing_mask=crosses,
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
