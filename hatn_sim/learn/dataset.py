"""Frames -> what the networks learn from: graphs, histories, and labels from what came after."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import (
    DT_S,
    HISTORY_FRAMES,
    HORIZON_FRAMES,
    BoolArray,
    FloatArray,
    Frame,
    IntArray,
    Scene,
    SemanticGraphs,
)
from hatn_sim.geometry import wrap_angle
from hatn_sim.graph import build_graphs
from hatn_sim.hatn.inputs import (
    LINE_AT_M,
    Float32Array,
    VehicleInputs,
    to_vehicle_frame,
    vehicle_inputs,
)
from hatn_sim.labels import (
    FOLLOW_FRAMES,
    SAMPLE_EVERY_FRAMES,
    Trajectories,
    crossing_frame,
    goal_m,
    slot_label,
)
from hatn_sim.labels import trajectories_from_rows as _trajectories
from hatn_sim.line_choice import LineChoice
from hatn_sim.perception import Perception, begin, perceive
from hatn_sim.road import Road

OFF_LINE_M: Final = 3.0
"""A future that leaves the line by more than this was driven on another one."""
PROFILE_EVERY: Final = 5
"""Frames from one distance of a profile to the next."""
IDLE_FRAMES: Final = 600
"""Lines nobody has driven on for so long are let go of: long recordings stay small."""
KEEP_LINES: Final = 4000


@dataclass(frozen=True, eq=False)
class Samples:
    """One row for each ego and sample frame; S rows."""

    # What the SGN reads:
    x: Float32Array  # [S, M, T, 7]
    context: Float32Array  # [S, M, CONTEXT_SIZE]
    node_mask: BoolArray  # [S, M]
    focus_mask: BoolArray  # [S, M]
    history_mask: BoolArray  # [S, M, T]
    # What it is to say:
    goal_m: Float32Array  # [S, M] distance travelled in 3 s
    goal_mask: BoolArray  # [S, M]
    profile_m: Float32Array  # [S, M, 6] distance travelled after 0.5, 1 ... 3 s; as `goal_mask`
    slot: IntArray  # [S] -1: none
    crossing_s: Float32Array  # [S] until the ego crosses its focus
    crossing_mask: BoolArray  # [S]
    # What the EDN reads; see `inputs.VehicleInputs`:
    history: Float32Array  # [S, T, len(HISTORY)]
    line: Float32Array  # [S, P, 2]
    at: Float32Array  # [S, 5]
    # What it is to say:
    future_xy: Float32Array  # [S, F, 2] in the vehicle's frame of now
    future: Float32Array  # [S, F, 2] s and d since now
    future_motion: Float32Array  # [S, F, 3] speed_mps, yaw_rad since now, heading against the line
    future_mask: BoolArray  # [S, F] known
    on_line: BoolArray  # [S] the future was driven on the line chosen now
    # Whose they are:
    run: IntArray  # [S] number of the run among those concatenated
    vehicle: IntArray  # [S] number of the vehicle in its run
    frame: IntArray  # [S]

    def __len__(self) -> int:
        return len(self.slot)


def concatenate(parts: Sequence[Samples]) -> Samples:
    """The rows of all parts, in order; runs are numbered on."""
    first = 0
    numbered: list[Samples] = []
    for part in parts:
        numbered.append(replace(part, run=part.run + first))
        first += int(part.run.max(initial=-1)) + 1
    return _stack(numbered)


def _stack(parts: Sequence[Samples]) -> Samples:
    return Samples(
        **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Samples)}
    )


@dataclass(frozen=True, eq=False)
class _Moment:
    """What is seen at a sample frame, copied out of perception: lines may be let go of later."""

    frame: int
    rows: IntArray  # [N] the run's numbers of the vehicles in view
    keep: IntArray  # [B] egos with a whole history
    graphs: SemanticGraphs
    inputs: VehicleInputs  # of those [B]
    xy_m: FloatArray  # [B, 2]
    yaw_rad: FloatArray  # [B]


def samples_of_run(
    road: Road,
    frames: Iterable[Frame],
    use_routes: bool = False,
    history_frames: int = HISTORY_FRAMES,
    choice: LineChoice | None = None,
) -> Samples:
    """Every vehicle with a line and `history_frames` behind it, at every fifth frame of a run.

    Lines are chosen by `choice`; None: the one that ships.
    """
    state = begin(road, choice)
    moments: list[_Moment] = []
    row_of: dict[str, int] = {}
    seen_rows: list[tuple[IntArray, Scene]] = []
    for index, frame in enumerate(frames):
        scene = frame.scene
        state = perceive(state, scene, frame.truth.routes if use_routes else None)
        rows = np.array([row_of.setdefault(name, len(row_of)) for name in scene.ids], np.int64)
        seen_rows.append((rows, scene))
        if index % SAMPLE_EVERY_FRAMES == 0:
            moments.append(_moment(road, index, rows, state.seen, history_frames))
        if index % IDLE_FRAMES == 0:
            road.release(IDLE_FRAMES, KEEP_LINES)
    trajectories, motion = _trajectories_of(tuple(row_of), seen_rows)
    return _stack([_samples_of_moment(m, trajectories, motion) for m in moments])


def _moment(
    road: Road, index: int, rows: IntArray, seen: Perception, history_frames: int
) -> _Moment:
    graphs = build_graphs(road, seen)
    graphs = replace(
        graphs, x=graphs.x.astype(np.float32), context=graphs.context.astype(np.float32)
    )
    keep = np.flatnonzero(seen.tracks.valid[graphs.ego, -history_frames:].all(axis=1))
    ego = graphs.ego[keep]
    inputs = vehicle_inputs(road, seen, ego)
    return _Moment(index, rows, keep, graphs, inputs, seen.scene.xy_m[ego], seen.scene.yaw_rad[ego])


def _trajectories_of(
    ids: tuple[str, ...], seen_rows: Sequence[tuple[IntArray, Scene]]
) -> tuple[Trajectories, FloatArray]:
    """Trajectories, and speed and yaw [1 + R, 2] for each of their rows."""
    vehicle = np.concatenate([rows for rows, _ in seen_rows])
    frame = np.repeat(np.arange(len(seen_rows)), [len(rows) for rows, _ in seen_rows])
    xy_m = np.concatenate([scene.xy_m for _, scene in seen_rows])
    speed_mps = np.concatenate([scene.speed_mps for _, scene in seen_rows])
    yaw_rad = np.concatenate([scene.yaw_rad for _, scene in seen_rows])
    order = np.lexsort((frame, vehicle))
    motion = np.zeros((len(order) + 1, 2))
    motion[1:] = np.column_stack((speed_mps, yaw_rad))[order]
    return _trajectories(ids, vehicle, frame, xy_m, len(seen_rows)), motion


def _samples_of_moment(moment: _Moment, trajectories: Trajectories, motion: FloatArray) -> Samples:
    graphs, keep, rows = moment.graphs, moment.keep, moment.rows
    ego = rows[graphs.ego[keep]]
    rear = graphs.rear[keep]
    node = np.where(rear >= 0, rows[np.maximum(rear, 0)], 0) if len(rows) else rear
    frame = np.full(len(keep), moment.frame)
    of_nodes = np.repeat(frame, node.shape[1])
    goals, known = goal_m(trajectories, node.ravel(), of_nodes)
    ahead = np.arange(PROFILE_EVERY, HORIZON_FRAMES + 1, PROFILE_EVERY)
    profile = trajectories.travelled_at(node[..., None], moment.frame + ahead)
    profile = profile - trajectories.travelled_at(node, moment.frame)[..., None]
    slot = slot_label(
        trajectories,
        ego,
        frame,
        node,
        graphs.focus_mask[keep],
        graphs.ego_to_conflict_m[keep],
        graphs.rear_to_conflict_m[keep],
        graphs.conflict_xy_m[keep],
    )
    has_conflict = graphs.has_conflict[keep]
    crossing = crossing_frame(
        trajectories,
        ego,
        frame,
        graphs.ego_to_conflict_m[keep, 0],
        graphs.conflict_xy_m[keep, 0],
        FOLLOW_FRAMES,
    )
    crosses = has_conflict & (crossing >= 0)
    return Samples(
        x=graphs.x[keep].astype(np.float32),
        context=graphs.context[keep].astype(np.float32),
        node_mask=graphs.node_mask[keep],
        focus_mask=graphs.focus_mask[keep],
        history_mask=graphs.history_mask[keep],
        goal_m=goals.reshape(node.shape).astype(np.float32),
        goal_mask=known.reshape(node.shape) & graphs.node_mask[keep],
        profile_m=profile.astype(np.float32),
        slot=np.where(has_conflict, slot, -1),
        crossing_s=np.where(crosses, DT_S * (crossing - frame), 0.0).astype(np.float32),
        crossing_mask=crosses,
        history=moment.inputs.history,
        line=moment.inputs.line,
        at=moment.inputs.at,
        **_future(moment, ego, trajectories, motion),
        run=np.zeros(len(keep), dtype=np.int64),
        vehicle=ego,
        frame=frame,
    )


def _future(
    moment: _Moment, vehicle: IntArray, trajectories: Trajectories, motion: FloatArray
) -> dict[str, Any]:
    """The fields of `Samples` that say where the vehicles [B] then were."""
    at = moment.frame + 1 + np.arange(HORIZON_FRAMES)
    row = trajectories.row_at(vehicle[:, None], at)
    # Known until the vehicle is out of view for the first time.
    mask = (trajectories.seen_until(vehicle, moment.frame)[:, None] >= at) & (row > 0)
    xy = to_vehicle_frame(trajectories.row_xy_m[row], moment.xy_m, moment.yaw_rad)
    line = moment.inputs.line.astype(np.float64)
    s, d, tangent_rad = project_on_polylines(line, LINE_AT_M, xy)
    on_line = (np.abs(d + moment.inputs.at[:, 4:5]) < OFF_LINE_M).all(axis=1, where=mask)
    yaw = wrap_angle(motion[row, 1] - moment.yaw_rad[:, None])
    future_motion = np.stack((motion[row, 0], yaw, wrap_angle(yaw - tangent_rad)), axis=-1)
    known = mask[..., None]
    return {
        "future_xy": np.where(known, xy, 0.0).astype(np.float32),
        "future": np.where(known, np.stack((s, d), axis=-1), 0.0).astype(np.float32),
        "future_motion": np.where(known, future_motion, 0.0).astype(np.float32),
        "future_mask": mask,
        "on_line": on_line,
    }


def project_on_polylines(
    line_xy: FloatArray, at_m: FloatArray, xy: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points [B, Q, 2] on polylines [B, P, 2] of their own, whose vertices are at `at_m` [P].

    Arc length, left-positive offset in metres and direction of the segment, [B, Q] each. Both ends
    are drawn out straight.
    """
    along = np.diff(line_xy, axis=1)[:, None]
    away = xy[:, :, None] - line_xy[:, None, :-1]
    part = (away * along).sum(axis=-1) / np.maximum((along**2).sum(axis=-1), 1e-12)
    inside = np.clip(part, 0.0, 1.0)
    inside[..., 0] = np.minimum(part[..., 0], inside[..., 0])
    inside[..., -1] = np.maximum(part[..., -1], inside[..., -1])
    miss = away - inside[..., None] * along
    segment = (miss**2).sum(axis=-1).argmin(axis=-1)
    pick = segment[..., None]
    inside = np.take_along_axis(inside, pick, axis=-1)[..., 0]
    miss = np.take_along_axis(miss, pick[..., None], axis=2)[:, :, 0]
    direction = np.arctan2(along[..., 1], along[..., 0])[:, 0]
    tangent = np.take_along_axis(direction, segment, axis=1)
    side = np.cos(tangent) * miss[..., 1] - np.sin(tangent) * miss[..., 0]
    offset = np.copysign(np.linalg.norm(miss, axis=-1), side)
    return at_m[segment] + inside * np.diff(at_m)[segment], offset, tangent
