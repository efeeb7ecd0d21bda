"""Online adaptation of the EDN to every vehicle in view (the paper's section 6, METHOD section 4).

At every frame each vehicle's last seconds are predicted again, with today's parameters, from what
the network read `steps` frames ago and for the goal predicted then; what the prediction missed
corrects the parameters of one layer, each vehicle's own.

What is learnt from the last tenths of a second says much of the next ones and little of the time
when the goal is reached. So the correction, the adapted prediction less the trained one, fades
with the time ahead, and is never larger than an unforeseen acceleration could make it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

import numpy as np
import torch
from torch import Tensor

from hatn_sim.datatypes import (
    DT_S,
    HISTORY_FRAMES,
    HORIZON_FRAMES,
    BoolArray,
    FloatArray,
    IntArray,
)
from hatn_sim.hatn.adaptation import (
    FilterSettings,
    FilterState,
    begin,
    descend,
    restart,
    update,
)
from hatn_sim.hatn.adaptation_layer import (
    LAST,
    Layer,
    decoder_of,
    lineariser_of,
    prior_of,
    sensitivity_m2,
)
from hatn_sim.hatn.edn import EncoderDecoderNetwork, VehicleBatch
from hatn_sim.hatn.inputs import to_vehicle_frame, vehicle_inputs
from hatn_sim.perception import Perception
from hatn_sim.road import Road
from hatn_sim.tracks import rows_before

Method = Literal["mekf", "rls", "sgd"]
METHODS: Final[tuple[Method, ...]] = get_args(Method)
MAX_STEPS: Final = HISTORY_FRAMES - 1
BAND_M: Final = 0.2
BAND_MPS2: Final = 2.0
"""A correction is at most BAND_M, and what this acceleration makes of the time ahead."""
MEMORY: Final = 0.97
"""What counts of the evidence of a frame ago: about the last three seconds speak."""
DOUBT_M: Final = 1e-3
"""Corrections prove nothing before they add up to more than this."""
CAUTION: Final = 0.25
"""Corrections that are right by no more than this share of them are none: it may be chance."""
MAX_CHANGE_M: Final = 1.0
"""Parameters move no further than what moves a steady vehicle by this."""


@dataclass(frozen=True)
class AdaptationSettings:
    """How to adapt.

    Standard deviations are of positions in metres, so that they hold for any layer and network.
    """

    method: Method = "mekf"
    layer: Layer = LAST
    steps: int = 3  # tau: how many frames of 0.1 s are looked back
    start_std_m: float = 0.05  # how far the trained parameters may mispredict a steady vehicle
    measurement_std_m: float = 0.01
    forgetting: float = 0.98
    relaxation: float = 1.0  # as good as less on any traffic tried, and the cheapest
    process_share: float = 0.0  # the variance that parameters gain in a step, over the first one
    rate: float = 0.1  # of `sgd`; 1 would take all of a steady vehicle's error away at once
    fade_s: float = 1.0


def default_settings(network: EncoderDecoderNetwork) -> AdaptationSettings:
    """A decoder that starts from the exact present motion leaves less to be learnt."""
    start_std_m = 0.02 if network.settings.decoder == "kinematic" else 0.2
    return AdaptationSettings(start_std_m=start_std_m)


@dataclass(frozen=True, eq=False)
class Adapter:
    """A network with what its adaptation starts from; made once for a run."""

    network: EncoderDecoderNetwork
    settings: AdaptationSettings
    prior: Tensor  # [P]
    filter: FilterSettings
    rate: float  # of `sgd`, in parameters
    decode: Callable[[Tensor, VehicleBatch, Tensor], Tensor]
    """(theta [B, P], what B vehicles' network reads, goals) -> their future [B, F, 2]."""
    linearise: Callable[[Tensor, VehicleBatch, Tensor], tuple[Tensor, Tensor]]
    """The same -> its first `steps` positions [B, D] and their Jacobian [B, D, P]."""


def adapter_of(
    network: EncoderDecoderNetwork, settings: AdaptationSettings, as_program: bool = False
) -> Adapter:
    """Ready to adapt `network`, whose own parameters are frozen by this.

    `as_program`: the last layer's predictions are traced once, and take half the time from then.
    """
    network.requires_grad_(False)
    sensitivity = sensitivity_m2(network, settings.layer, settings.steps)
    variance = settings.start_std_m**2 / sensitivity
    filter_settings = FilterSettings(
        forgetting=settings.forgetting,
        start_variance=variance,
        process_variance=settings.process_share * variance,
        measurement_variance_m2=settings.measurement_std_m**2,
        relaxation=settings.relaxation,
        max_change=MAX_CHANGE_M / sensitivity**0.5,
    )
    if settings.method == "rls":
        filter_settings = replace(filter_settings, relaxation=0.0, process_variance=0.0, gate=1.0)
    rate = settings.rate / (sensitivity * 2 * settings.steps)
    return Adapter(
        network,
        settings,
        prior_of(network, settings.layer),
        filter_settings,
        rate,
        decoder_of(network, settings.layer, as_program),
        lineariser_of(network, settings.layer, settings.steps, as_program),
    )


def learn(
    adapter: Adapter,
    state: FilterState,
    batch: VehicleBatch,
    goal_m: Tensor,
    driven_m: Tensor,
    seen: Tensor,
    theta_then: Tensor,
) -> tuple[FilterState, Tensor]:
    """One step of the filter for the vehicles of [B] that are `seen` [B], and its evidence [B, 2].

    `batch` and `goal_m` [B, G] are what the network read `steps` frames ago, and `theta_then`
    [B, P] what was believed then; `driven_m` [B, steps, 2] is where the vehicles went from there,
    in their frames of that time. The evidence is of the forecast of then, which had seen nothing of
    that: what its correction changed times what the trained network missed, and the square of that
    change.
    """
    settings = adapter.settings
    predicted, jacobian = adapter.linearise(state.theta, batch, goal_m)
    innovation = driven_m.flatten(1) - predicted
    changed_then, changed_now = (
        (jacobian @ (theta - adapter.prior)[..., None])[..., 0]
        for theta in (theta_then, state.theta)
    )
    missed = changed_now + innovation  # by the trained network
    made_m = changed_then.norm(dim=-1)
    right_m = (changed_then * missed).sum(-1) / made_m.clamp(min=1e-9)
    evidence = torch.stack((right_m, made_m), -1)
    evidence = torch.where(torch.isfinite(evidence) & seen[:, None], evidence, 0.0)
    if settings.method == "sgd":
        after = descend(
            state, adapter.prior, innovation, jacobian, adapter.rate, adapter.filter, seen
        )
    else:
        after = update(state, adapter.prior, innovation, jacobian, adapter.filter, seen)
    return after, evidence


def faded(adapter: Adapter, correction_m: Tensor) -> Tensor:
    """Corrections [B, F, 2] of predicted positions, as far as they are to be trusted."""
    ahead_s = DT_S * torch.arange(1, correction_m.shape[1] + 1)
    correction_m = correction_m * torch.exp(-ahead_s / adapter.settings.fade_s)[:, None]
    band_m = (BAND_M + 0.5 * BAND_MPS2 * ahead_s**2)[:, None]
    length_m = torch.linalg.vector_norm(correction_m, dim=-1, keepdim=True)
    within = torch.where(length_m <= band_m, correction_m, correction_m * (band_m / length_m))
    return torch.where(torch.isfinite(within), within, 0.0)


@dataclass(frozen=True, eq=False)
class Moment:
    """What the EDN reads of the vehicles of a scene that are on a line, and where they are."""

    ids: tuple[str, ...]  # [E]
    line: IntArray  # [E] number of the reference line
    whole: BoolArray  # [E] the whole history was seen
    batch: VehicleBatch  # [E]
    goal_m: Tensor  # [E, G]
    xy_m: FloatArray  # [E, 2]
    yaw_rad: FloatArray  # [E]


@dataclass(frozen=True, eq=False)
class AdaptationState:
    """The newest moment, what is believed of its vehicles, their last `steps` inputs, and beliefs.

    These end with now; the first column is what is to be predicted again at the next frame.
    """

    moment: Moment
    filter: FilterState  # [E]
    theta: Tensor  # [E, steps, P] what was believed when these inputs were new
    evidence: Tensor  # [E, 2] for the adapted parameters, see `learn`; fading sums
    frames: IntArray  # [E] how many of the inputs are the vehicle's, on its present line
    batch: VehicleBatch  # [E, steps, ...]
    goal_m: Tensor  # [E, steps, G]
    pose: FloatArray  # [E, steps, 3] x_m, y_m, yaw_rad

    def trust(self) -> Tensor:
        """How much of a correction would have been right lately [E]: from 0 to 1."""
        right, made = self.evidence.unbind(-1)
        surely = (right - CAUTION * made) / (1.0 - CAUTION)
        return (surely / (made + DOUBT_M)).clamp(0.0, 1.0)


def moment_of(road: Road, seen: Perception, vehicle: IntArray, goal_m: Tensor) -> Moment:
    """The moment of vehicles [E], every one of them on a line, with goals [E, G]."""
    inputs = vehicle_inputs(road, seen, vehicle)
    return Moment(
        ids=tuple(seen.scene.ids[index] for index in vehicle),
        line=seen.lines.line[vehicle],
        whole=np.asarray(seen.tracks.valid[vehicle, -HISTORY_FRAMES:].all(axis=1)),
        batch=VehicleBatch(*map(torch.from_numpy, (inputs.history, inputs.line, inputs.at))),
        goal_m=goal_m,
        xy_m=seen.scene.xy_m[vehicle],
        yaw_rad=seen.scene.yaw_rad[vehicle],
    )


def rows_of(batch: VehicleBatch, rows: IntArray) -> VehicleBatch:
    """The vehicles `rows` [B'] alone."""
    return VehicleBatch(*(tensor[torch.from_numpy(rows)] for tensor in _tensors(batch)))


def first(adapter: Adapter, moment: Moment) -> AdaptationState:
    """Nothing has been learnt of the vehicles of `moment`."""
    count, steps = len(moment.ids), adapter.settings.steps
    return AdaptationState(
        moment,
        begin(adapter.prior, count, adapter.filter),
        adapter.prior.repeat(count, steps, 1),
        torch.zeros(count, 2),
        moment.whole.astype(np.int64),
        VehicleBatch(*(_repeat(tensor, steps) for tensor in _tensors(moment.batch))),
        _repeat(moment.goal_m, steps),
        np.repeat(_pose(moment)[:, None], steps, axis=1),
    )


def follow(
    adapter: Adapter, state: AdaptationState, moment: Moment, unadapted: frozenset[str]
) -> AdaptationState:
    """One frame on: learn from where the vehicles are now.

    Vehicles that are new, change their line or were not seen for a frame begin anew; those of
    `unadapted`, advised or driven by an agent, never learn: they would learn our own advice.
    """
    rows = rows_before(state.moment.ids, moment.ids)
    if not len(state.moment.ids) or not len(rows):
        return first(adapter, moment)
    source = np.maximum(rows, 0)
    kept = (rows >= 0) & (state.moment.line[source] == moment.line) & moment.whole
    frames = np.where(kept, state.frames[source], 0)
    taught = frames >= adapter.settings.steps
    if unadapted:
        taught &= ~np.array([name in unadapted for name in moment.ids], dtype=np.bool_)
    same = state.moment.ids == moment.ids
    before = state.filter if same else state.filter.rows(torch.from_numpy(source))
    lost = ~kept & ((rows < 0) | (state.frames[source] > 0))
    believed = restart(before, torch.from_numpy(lost), adapter.prior, adapter.filter)
    # From now on the first column is `steps` frames old, and the last is now.
    batch = VehicleBatch(
        *(
            torch.cat((old[torch.from_numpy(source)], now[:, None]), 1)
            for old, now in zip(_tensors(state.batch), _tensors(moment.batch), strict=True)
        )
    )
    goal_m = torch.cat((state.goal_m[torch.from_numpy(source)], moment.goal_m[:, None]), 1)
    pose = np.concatenate((state.pose[source], _pose(moment)[:, None]), axis=1)
    evidence = torch.where(
        torch.from_numpy(kept)[:, None], MEMORY * state.evidence[torch.from_numpy(source)], 0.0
    )
    if taught.any():
        driven_m = to_vehicle_frame(pose[:, 1:, :2], pose[:, 0, :2], pose[:, 0, 2])
        believed, found = learn(
            adapter,
            believed,
            VehicleBatch(*(tensor[:, 0] for tensor in _tensors(batch))),
            goal_m[:, 0],
            torch.from_numpy(driven_m.astype(np.float32)),
            torch.from_numpy(taught),
            state.theta[torch.from_numpy(source), 0],
        )
        evidence = evidence + found
    return AdaptationState(
        moment,
        believed,
        torch.cat((state.theta[torch.from_numpy(source), 1:], believed.theta[:, None]), 1),
        evidence,
        np.minimum(frames + 1, adapter.settings.steps) * moment.whole,
        VehicleBatch(*(tensor[:, 1:] for tensor in _tensors(batch))),
        goal_m[:, 1:],
        pose[:, 1:],
    )


def correction_m(
    adapter: Adapter, state: AdaptationState, trained_m: FloatArray | None = None
) -> tuple[IntArray, FloatArray]:
    """How to correct predictions: (rows [A] of adapted vehicles, offsets [A, F, 2] in metres).

    Offsets are in the vehicles' frames of now. `trained_m` [E, F, 2] is what the trained network
    says there, where it has been asked already.
    """
    trust = state.trust()
    changed = (state.filter.theta != adapter.prior).any(dim=1) & (trust > 0.0)
    row = changed.nonzero()[:, 0]
    if not len(row):
        return row.numpy(), np.zeros((0, HORIZON_FRAMES, 2))
    batch, goal_m = rows_of(state.moment.batch, row.numpy()), state.moment.goal_m[row]
    with torch.inference_mode():
        adapted = adapter.decode(state.filter.theta[row], batch, goal_m)
        if trained_m is None:
            trained = adapter.decode(adapter.prior.expand(len(row), -1), batch, goal_m)
        else:
            trained = torch.from_numpy(trained_m[row.numpy()]).to(adapted.dtype)
        moved_m = trust[row, None, None] * (adapted - trained)
        return row.numpy(), faded(adapter, moved_m).double().numpy()


def _tensors(batch: VehicleBatch) -> tuple[Tensor, Tensor, Tensor]:
    return batch.history, batch.line, batch.at


def _repeat(tensor: Tensor, steps: int) -> Tensor:
    return tensor[:, None].expand(-1, steps, *tensor.shape[1:])


def _pose(moment: Moment) -> FloatArray:
    return np.column_stack((moment.xy_m, moment.yaw_rad))
