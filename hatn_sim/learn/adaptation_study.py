"""What online adaptation gains and costs: the paper's ADE 1 to 4 over steps, layers and methods.

A scene is watched once: perception, graphs and goals of every frame are kept, and what is swept
over is computed from them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from torch import Tensor

from hatn_sim.datatypes import HORIZON_FRAMES, BoolArray, FloatArray, Frame, IntArray
from hatn_sim.graph import build_graphs
from hatn_sim.hatn.adaptation_layer import lineariser_of
from hatn_sim.hatn.adaptation_memory import (
    MAX_STEPS,
    AdaptationSettings,
    AdaptationState,
    Adapter,
    Moment,
    adapter_of,
    faded,
    first,
    follow,
    moment_of,
    rows_of,
)
from hatn_sim.hatn.edn import EncoderDecoderNetwork, VehicleBatch
from hatn_sim.hatn.inputs import to_vehicle_frame
from hatn_sim.hatn.predictor import Hatn, told_goal_m
from hatn_sim.labels import SAMPLE_EVERY_FRAMES
from hatn_sim.road import Road
from hatn_sim.tracks import rows_before

MEASURES: Final = ("ade1", "ade2", "ade3", "ade4", "short", "fde")
"""ADE 1 and 3 are of what is predicted again from `steps` frames ago, over those frames and over
3 s; ADE 2 and 4 of what is predicted from now, over `steps` frames and over 3 s; `short` is over
0.3 s from now, `fde` after 3 s."""
SHORT_FRAMES: Final = 3
TOGETHER: Final = 20
"""Moments whose predictions are made in one batch."""
NOBODY: Final[frozenset[str]] = frozenset()


@dataclass(frozen=True, eq=False)
class Watched:
    """K frames of traffic as the adaptation reads them, and where everybody was."""

    moments: tuple[Moment, ...]  # [K]
    vehicle: tuple[IntArray, ...]  # [K] of [E]: row of `xy_m`
    scored: tuple[BoolArray, ...]  # [K] of [E]: long enough on its line, and the future is known
    xy_m: FloatArray  # [V, K, 2] in the map, NaN where the vehicle was not in view

    def until(self, frames: int) -> Watched:
        """The first frames alone; what came after them is still known as their future."""
        return replace(
            self,
            moments=self.moments[:frames],
            vehicle=self.vehicle[:frames],
            scored=self.scored[:frames],
        )


@dataclass(frozen=True, eq=False)
class VehicleErrors:
    """Errors in metres of the trained network and of the adapted one, summed for each vehicle."""

    sum_m: FloatArray  # [V, 2, len(MEASURES)] trained, adapted
    n: IntArray  # [V] predictions


def watch(hatn: Hatn, road: Road, frames: Iterable[Frame]) -> Watched:
    """Perceive a run and predict the goals of every frame, with the SGN of `hatn`."""
    state = hatn.init(road)
    row_of: dict[str, int] = {}
    moments: list[Moment] = []
    seen: list[tuple[IntArray, FloatArray]] = []
    for frame in frames:
        scene = frame.scene
        state = hatn.observe(state, scene)
        rows = np.array([row_of.setdefault(name, len(row_of)) for name in scene.ids], np.int64)
        seen.append((rows, scene.xy_m))
        graphs = build_graphs(road, state.seen)
        if len(graphs.ego):
            goal_m = told_goal_m(hatn.weights.edn, hatn.intend(graphs).profile_m[:, 0]).clone()
        else:
            goal_m = torch.zeros(0, hatn.weights.edn.settings.goal_steps)
        moments.append(moment_of(road, state.seen, graphs.ego, goal_m))
    xy_m = np.full((len(row_of), len(seen), 2), np.nan)
    for k, (rows, xy) in enumerate(seen):
        xy_m[rows, k] = xy
    vehicle = [np.array([row_of[name] for name in m.ids], dtype=np.int64) for m in moments]
    return Watched(tuple(moments), tuple(vehicle), _scored(moments, vehicle, xy_m), xy_m)


def _scored(
    moments: Sequence[Moment], vehicle: Sequence[IntArray], xy_m: FloatArray
) -> tuple[BoolArray, ...]:
    """The same samples for any number of steps: MAX_STEPS frames on the line, 3 s to come."""
    since = np.zeros(len(xy_m), dtype=np.int64)
    on = np.full(len(xy_m), -1)
    scored: list[BoolArray] = []
    for k, (moment, rows) in enumerate(zip(moments, vehicle, strict=True)):
        stayed = (on[rows] == moment.line) & moment.whole
        frames = np.where(stayed, since[rows] + 1, 0)
        since[:], on[:] = 0, -1
        since[rows], on[rows] = frames, moment.line
        ahead = xy_m[rows, k + 1 : k + 1 + HORIZON_FRAMES]
        known = np.isfinite(ahead).all(axis=(1, 2)) & (ahead.shape[1] == HORIZON_FRAMES)
        scored.append((frames >= MAX_STEPS) & known & (k % SAMPLE_EVERY_FRAMES == 0))
    return tuple(scored)


def vehicle_errors(
    network: EncoderDecoderNetwork, watched: Watched, settings: AdaptationSettings
) -> VehicleErrors:
    """One figure of a study: everything watched is filtered with `settings`."""
    past, now, vehicle = errors_m(adapter_of(network, settings), watched)
    steps = settings.steps
    means = (past[..., :steps], now[..., :steps], past, now, now[..., :SHORT_FRAMES], now[..., -1:])
    each = np.stack([part.mean(axis=-1) for part in means], axis=-1)
    sums = np.zeros((len(watched.xy_m), *each.shape[1:]))
    np.add.at(sums, vehicle, each)
    return VehicleErrors(sums, np.bincount(vehicle, minlength=len(sums)))


@dataclass(frozen=True, eq=False)
class _Asked:
    """Predictions of B vehicles that are to be scored."""

    theta: Tensor  # [B, P]
    trust: Tensor  # [B]
    batch: VehicleBatch  # [B]
    goal_m: Tensor  # [B, G]
    pose: FloatArray  # [B, 3] x_m, y_m, yaw_rad where it is predicted
    driven_m: FloatArray  # [B, F, 2] the truth in the map


def errors_m(adapter: Adapter, watched: Watched) -> tuple[FloatArray, FloatArray, IntArray]:
    """Displacements [n, 2, F] by step, trained and adapted: from `steps` frames ago, and from now;
    and whose they are [n].

    Both of the adapted are by the parameters of now, faded as predictions are.
    """
    settings = adapter.settings
    # A few vehicles many times: a program pays. What is scored is predicted in large batches.
    linearise = lineariser_of(adapter.network, settings.layer, settings.steps, as_program=True)
    learner = replace(adapter, linearise=linearise)
    past: list[_Asked] = []
    now: list[_Asked] = []
    whose: list[IntArray] = [np.zeros(0, dtype=np.int64)]
    state = first(learner, watched.moments[0])
    for k, moment in enumerate(watched.moments[1:], start=1):
        before, state = state, follow(learner, state, moment, NOBODY)
        rows = np.flatnonzero(watched.scored[k])
        if not len(rows):
            continue
        row = torch.from_numpy(rows)
        believed = state.filter.theta[row], state.trust()[row]
        pose = np.column_stack((moment.xy_m, moment.yaw_rad))[rows]
        vehicle = watched.vehicle[k][rows]
        ahead = watched.xy_m[vehicle, k + 1 : k + 1 + HORIZON_FRAMES]
        now.append(_Asked(*believed, rows_of(moment.batch, rows), moment.goal_m[row], pose, ahead))
        was = rows_before(before.moment.ids, moment.ids)[rows]
        start = k - settings.steps + 1
        driven = watched.xy_m[vehicle, start : start + HORIZON_FRAMES]
        past.append(_Asked(*believed, *_oldest(before, was), before.pose[was, 0], driven))
        whose.append(vehicle)
    return _errors(adapter, past), _errors(adapter, now), np.concatenate(whose)


def _oldest(state: AdaptationState, rows: IntArray) -> tuple[VehicleBatch, Tensor]:
    """What the network read of vehicles as long ago as is kept, and the goals of then."""
    batch = rows_of(state.batch, rows)
    return VehicleBatch(batch.history[:, 0], batch.line[:, 0], batch.at[:, 0]), state.goal_m[
        rows, 0
    ]


def _errors(adapter: Adapter, asked: Sequence[_Asked]) -> FloatArray:
    """Displacements [n, 2, F] of everything asked."""
    found = [np.zeros((0, 2, HORIZON_FRAMES))]
    for some in _gathered(asked):
        with torch.inference_mode():
            trained, adapted = (
                adapter.decode(theta, some.batch, some.goal_m)
                for theta in (adapter.prior.expand(len(some.theta), -1), some.theta)
            )
            adapted = trained + faded(adapter, some.trust[:, None, None] * (adapted - trained))
        truth = to_vehicle_frame(some.driven_m, some.pose[:, :2], some.pose[:, 2])
        said = torch.stack((trained, adapted), 1).double().numpy()
        found.append(np.linalg.norm(said - truth[:, None], axis=-1))
    return np.concatenate(found)


def _gathered(asked: Sequence[_Asked]) -> Iterator[_Asked]:
    """The same, `TOGETHER` moments as one."""
    for begin in range(0, len(asked), TOGETHER):
        some = asked[begin : begin + TOGETHER]
        yield _Asked(
            torch.cat([one.theta for one in some]),
            torch.cat([one.trust for one in some]),
            VehicleBatch(
                torch.cat([one.batch.history for one in some]),
                torch.cat([one.batch.line for one in some]),
                torch.cat([one.batch.at for one in some]),
            ),
            torch.cat([one.goal_m for one in some]),
            np.concatenate([one.pose for one in some]),
            np.concatenate([one.driven_m for one in some]),
        )
