"""The encoder-decoder network (the paper's section 5): how a vehicle drives to its goal.

A GRU reads the history; a GRU stacked with three dense layers writes the future, a step of 0.1 s at
a time. Everything the paper tried is a setting of this one network; `edn_settings.PAPER` is its
best form. Ours emits bounded changes of acceleration and of curvature, which are integrated to
positions, as METHOD section 3 has it under "Beyond the paper".

The decoder is written out by hand, so that the parameters of any layer may be each vehicle's own
(online adaptation): [B, out, in] in place of [out, in].
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES
from hatn_sim.hatn import edn_kinematic, edn_plain
from hatn_sim.hatn.edn_kinematic import (
    ACCELERATION_MPS2,
    AHEAD_STEPS,
    MAX_JERK_MPS3,
    MAX_SLOPE,
    MAX_SWERVE_PER_M,
    START_LIMITS,
)
from hatn_sim.hatn.edn_settings import EdnSettings
from hatn_sim.hatn.kinematics import path_along, positions, present_motion

GOAL_SCALE_M: Final = 10.0


@dataclass(frozen=True, eq=False)
class VehicleBatch:
    """`inputs.VehicleInputs` as float32 tensors: what the network reads."""

    history: Tensor  # [B, T, len(HISTORY)]
    line: Tensor  # [B, P, 2]
    at: Tensor  # [B, 5]


Parameters = Mapping[str, Tensor]
"""Parameters [B, ...] that each vehicle has for itself, by the names of those they replace."""
SHARED: Final[Parameters] = {}
LastLayer = Callable[[Tensor], Tensor]
"""What may stand in for the last layer: [B, width] -> [B, O], asked once for each step in turn."""


@dataclass(frozen=True, eq=False)
class _Memory:
    """What every step of the decoder reads beside its own state."""

    goal: Tensor  # [B, goal_steps] scaled
    encoded: Tensor | None  # [B, T, width] for attention
    own: Parameters
    last_layer: LastLayer | None


class EncoderDecoderNetwork(nn.Module):
    """GRU encoder, GRU decoder with three dense layers."""

    def __init__(self, settings: EdnSettings) -> None:
        super().__init__()
        self.settings = settings
        width, kinematic = settings.width, settings.decoder == "kinematic"
        size = edn_kinematic.HISTORY_SIZE if kinematic else edn_plain.history_size(settings)
        self.encoder = nn.GRU(size, width, batch_first=True)
        outputs = 2 if kinematic else edn_plain.output_size(settings)
        size = edn_kinematic.STATE_SIZE if kinematic else outputs
        size += _goal_input_size(settings) + (settings.clock in ("input", "transform"))
        if settings.attention:
            size += width
            self.attend = nn.Linear(2 * width, width)
            self.attend_score = nn.Linear(width, 1, bias=False)
        self.decoder = nn.GRUCell(size, width)
        appended = settings.goal_steps * (settings.goal == "output") + (settings.clock == "output")
        self.dense1 = nn.Linear(width + appended, width)
        self.dense2 = nn.Linear(width, width)
        self.dense3 = nn.Linear(width, outputs)
        self.dropout = nn.Dropout(settings.dropout)
        if settings.goal == "hidden":
            self.embed_goal = nn.Linear(settings.goal_steps, width)
        if settings.clock == "hidden":
            self.embed_clock = nn.Linear(1, width)
        if kinematic:
            self.start = nn.Linear(width, len(START_LIMITS) + 2)
            nn.init.zeros_(self.start.weight)
            nn.init.zeros_(self.start.bias)

    def forward(
        self,
        batch: VehicleBatch,
        goal_m: Tensor,
        steps: int = HORIZON_FRAMES,
        own: Parameters = SHARED,
        last_layer: LastLayer | None = None,
    ) -> Tensor:
        """Future positions [B, steps, 2] in metres, in the vehicles' frames of now.

        `goal_m` [B, goal_steps]: distance travelled in three seconds, or after each half of one.
        """
        if self.settings.decoder == "kinematic":
            return self._drive(batch, goal_m, steps, own, last_layer)
        native = self.native(batch, goal_m, steps, own, last_layer=last_layer)
        return edn_plain.to_vehicle_frame(self.settings, batch.line, batch.at, native)

    def _drive(
        self,
        batch: VehicleBatch,
        goal_m: Tensor,
        steps: int,
        own: Parameters,
        last_layer: LastLayer | None,
    ) -> Tensor:
        """Accelerations and curvatures, integrated."""
        now = present_motion(batch.history)
        read = edn_kinematic.history_inputs(batch.history, batch.line, now)
        hidden, memory = self._encode(read, goal_m, own, last_layer)
        now, blend_m = edn_kinematic.corrected(now, self.start(hidden))
        increment, acceleration = now.increment_m, now.acceleration_mps2
        wanted_m = edn_kinematic.by_step(goal_m, steps)
        progress = torch.zeros_like(increment)
        offset, slope = torch.zeros_like(increment), torch.zeros_like(increment)
        progress_m, offset_m = [], []
        for step in range(steps):
            ahead_m = wanted_m[:, min(step + AHEAD_STEPS, wanted_m.shape[1] - 1)]
            state = edn_kinematic.state_inputs(
                increment, acceleration, slope, offset, progress, wanted_m[:, step], ahead_m
            )
            left_m = (goal_m - progress.unsqueeze(-1)) / GOAL_SCALE_M
            emitted, hidden = self._step(state, left_m, hidden, step, memory)
            jerk, swerve = emitted.tanh().unbind(-1)
            acceleration = (acceleration + MAX_JERK_MPS3 * DT_S * jerk).clamp(*ACCELERATION_MPS2)
            faster = (increment + acceleration * DT_S * DT_S).clamp(min=0.0)
            # Who has come to a halt brakes no more.
            acceleration = torch.where(faster > 0.0, acceleration, acceleration.clamp(min=0.0))
            increment = faster
            slope = (slope + MAX_SWERVE_PER_M * swerve * increment).clamp(-MAX_SLOPE, MAX_SLOPE)
            offset = offset + slope * increment
            progress = progress + increment
            progress_m.append(progress)
            offset_m.append(offset)
        path = path_along(batch.line, now.course_rad, now.curvature_per_m, blend_m)
        return positions(path, torch.stack(progress_m, 1), torch.stack(offset_m, 1))

    def native(
        self,
        batch: VehicleBatch,
        goal_m: Tensor,
        steps: int = HORIZON_FRAMES,
        own: Parameters = SHARED,
        teacher: Tensor | None = None,
        last_layer: LastLayer | None = None,
    ) -> Tensor:
        """What the plain decoder says [B, steps, O]: see `edn_plain.targets`.

        `teacher` [B, steps, O]: the truth, to be read in place of what was said before.
        """
        settings = self.settings
        said = edn_plain.history_outputs(settings, batch.history, batch.at)
        read = edn_plain.history_inputs(settings, batch.history, batch.at, goal_m)
        hidden, memory = self._encode(read, goal_m, own, last_layer)
        last = edn_plain.first_input(settings, said)
        position = said[:, -1, :2]
        out = []
        for step in range(steps):
            travelled = edn_plain.travelled(settings, position, said[:, -1, :2])
            left_m = (goal_m - travelled) / GOAL_SCALE_M
            emitted, hidden = self._step(
                edn_plain.scaled(settings, last), left_m, hidden, step, memory
            )
            last = edn_plain.unscaled(settings, emitted)
            position = position + last[:, :2] if settings.incremental else last[:, :2]
            out.append(torch.cat((position, last[:, 2:]), -1))
            if teacher is not None:
                before = said[:, -1] if step == 0 else teacher[:, step - 1]
                last = edn_plain.taught(settings, teacher[:, step], before)
        return torch.stack(out, 1)

    def _encode(
        self, read: Tensor, goal_m: Tensor, own: Parameters, last_layer: LastLayer | None
    ) -> tuple[Tensor, _Memory]:
        encoded, hidden = self._encoder(read, own)
        goal = goal_m / GOAL_SCALE_M
        if self.settings.goal == "hidden":
            hidden = hidden + self.embed_goal(goal)
        return hidden, _Memory(goal, encoded if self.settings.attention else None, own, last_layer)

    def _encoder(self, read: Tensor, own: Parameters) -> tuple[Tensor, Tensor]:
        """(every hidden state [B, T, width], the last [B, width])."""
        names = ("weight_ih_l0", "weight_hh_l0", "bias_ih_l0", "bias_hh_l0")
        if own.keys().isdisjoint(f"encoder.{name}" for name in names):
            encoded, last = self.encoder(read)
            return encoded, last[0]
        parameters = [
            own.get(f"encoder.{name}", getattr(self.encoder, name).detach()) for name in names
        ]
        hidden = read.new_zeros((len(read), self.settings.width))
        encoded = []
        for frame in range(read.shape[1]):
            hidden = _gru(read[:, frame], hidden, *parameters)
            encoded.append(hidden)
        return torch.stack(encoded, 1), hidden

    def _step(
        self, state: Tensor, left_m: Tensor, hidden: Tensor, step: int, memory: _Memory
    ) -> tuple[Tensor, Tensor]:
        """One step of the decoder: (what it emits [B, O], its hidden state [B, width])."""
        settings, own = self.settings, memory.own
        clock = torch.full_like(state[:, :1], step / HORIZON_FRAMES)
        read = decoder_input(settings, state, memory.goal, left_m, clock)
        if memory.encoded is not None:
            read = torch.cat((read, self._attended(hidden, memory.encoded)), -1)
        if settings.clock == "hidden":
            hidden = hidden + self.embed_clock(clock)
        hidden = self._decoder(read, hidden, own)
        deep = [hidden]
        if settings.goal == "output":
            deep.append(memory.goal)
        if settings.clock == "output":
            deep.append(clock)
        out = self.dropout(torch.tanh(self._dense("dense1", torch.cat(deep, -1), own)))
        out = self.dropout(torch.tanh(self._dense("dense2", out, own)))
        emitted = (
            self._dense("dense3", out, own) if memory.last_layer is None else memory.last_layer(out)
        )
        return emitted, hidden

    def _attended(self, hidden: Tensor, encoded: Tensor) -> Tensor:
        """Additive attention over the history (Bahdanau et al. 2015)."""
        pair = torch.cat((encoded, hidden.unsqueeze(1).expand_as(encoded)), -1)
        weight = self.attend_score(torch.tanh(self.attend(pair))).softmax(1)
        return (weight * encoded).sum(1)

    def _decoder(self, read: Tensor, hidden: Tensor, own: Parameters) -> Tensor:
        names = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
        if own.keys().isdisjoint(f"decoder.{name}" for name in names):
            after: Tensor = self.decoder(read, hidden)
            return after
        return _gru(
            read,
            hidden,
            *(own.get(f"decoder.{name}", getattr(self.decoder, name)) for name in names),
        )

    def _dense(self, name: str, x: Tensor, own: Parameters) -> Tensor:
        layer: nn.Linear = getattr(self, name)
        return _linear(
            x, own.get(f"{name}.weight", layer.weight), own.get(f"{name}.bias", layer.bias)
        )


def _linear(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """A dense layer whose parameters are shared [out, in] or each row's own [B, out, in]."""
    if weight.dim() == 2:
        return nn.functional.linear(x, weight) + bias
    return (weight @ x.unsqueeze(-1)).squeeze(-1) + bias


def _gru(
    x: Tensor,
    hidden: Tensor,
    weight_ih: Tensor,
    weight_hh: Tensor,
    bias_ih: Tensor,
    bias_hh: Tensor,
) -> Tensor:
    """A step of a GRU (Cho et al. 2014, in the form of torch) with shared or own parameters."""
    reset_x, update_x, new_x = _linear(x, weight_ih, bias_ih).chunk(3, -1)
    reset_h, update_h, new_h = _linear(hidden, weight_hh, bias_hh).chunk(3, -1)
    reset, update = (reset_x + reset_h).sigmoid(), (update_x + update_h).sigmoid()
    new = (new_x + reset * new_h).tanh()
    return new + update * (hidden - new)


def decoder_input(
    settings: EdnSettings, state: Tensor, goal: Tensor, left: Tensor, clock: Tensor
) -> Tensor:
    """What a step of the decoder reads [B, I] beside its hidden state and what it attends to.

    `state` [B, O]; `goal` and `left` [B, goal_steps] scaled; `clock` [B, 1] from 0 to 1.
    """
    read = [state]
    if settings.goal == "input":
        read += [goal, left]
    elif settings.goal == "transform":
        read.append(left)
    if settings.clock == "input":
        read.append(clock)
    elif settings.clock == "transform":
        # Relative to the goal: the speed that would be needed to get there in time.
        read.append(left[:, -1:] / (1.0 - clock))
    return torch.cat(read, -1)


def _goal_input_size(settings: EdnSettings) -> int:
    return {"input": 2, "transform": 1}.get(settings.goal, 0) * settings.goal_steps


def edn_loss(predicted: Tensor, future: Tensor, mask: Tensor, weight: Tensor) -> Tensor:
    """Mean l2 distance in metres over the frames `mask` [B, F] of futures [B, F, ...].

    `weight` [F] says how much a step counts.
    """
    square = ((predicted - future) ** 2).sum(-1)
    weighted = mask * weight
    return ((square + 1e-8).sqrt() * weighted).sum() / weighted.sum().clamp(min=1.0)
