"""The kinematic decoder for prediction only: what edn.py computes, in half the time.

Vehicles are columns here, see `gru_columns.py`, and what changes from step to step is changed in
place. Letters: B vehicles, H width.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES
from hatn_sim.hatn import edn_kinematic
from hatn_sim.hatn.edn import GOAL_SCALE_M, EncoderDecoderNetwork, decoder_input
from hatn_sim.hatn.edn_kinematic import (
    ACCELERATION_MPS2,
    AHEAD_STEPS,
    MAX_JERK_MPS3,
    MAX_SLOPE,
    MAX_SWERVE_PER_M,
)
from hatn_sim.hatn.edn_settings import EdnSettings
from hatn_sim.hatn.gru_columns import Cell, LastState, gates, reading_halves
from hatn_sim.hatn.kinematics import path_along, positions, present_motion

_MOTION = 5
"""Rows of the vehicle's motion: increment, acceleration, slope, offset, progress."""
_TOLD = 3
"""Rows that are known of every step beforehand: two distances wanted, the clock."""


def has_columns(settings: EdnSettings) -> bool:
    """Whether these settings are those of a decoder that `ColumnDecoder` can stand for."""
    return (
        settings.decoder == "kinematic"
        and settings.goal in ("none", "input", "transform")
        and settings.clock in ("none", "input")
        and not settings.attention
    )


class ColumnDecoder(nn.Module):
    """An `EncoderDecoderNetwork` as it is now, as a function of tensors."""

    def __init__(self, network: EncoderDecoderNetwork) -> None:
        super().__init__()
        self.start = network.start
        of = {name: value.detach() for name, value in network.named_parameters()}
        of_rows = _read_of_rows(network.settings)
        self.encode = LastState(network.encoder)
        self.decode = gates(
            *(of["decoder.weight_ih"] @ of_rows.T, of["decoder.bias_ih"]),
            *(of["decoder.weight_hh"], of["decoder.bias_hh"]),
        )
        dense1, dense2, dense3 = (
            _of_block(of[f"{name}.weight"], of[f"{name}.bias"])
            for name in ("dense1", "dense2", "dense3")
        )
        self.dense1, self.dense2, self.dense3 = 2.0 * dense1, 2.0 * dense2, dense3

    def forward(
        self,
        history: Tensor,
        line: Tensor,
        at: Tensor,
        goal_m: Tensor,
        weight: Tensor | None = None,
        bias: Tensor | None = None,
    ) -> Tensor:
        """What `EncoderDecoderNetwork.forward` gives [B, HORIZON_FRAMES, 2].

        `weight` [B, O, H] and `bias` [B, O]: a last layer for each vehicle.
        """
        now = present_motion(history)
        hidden = self.encode(edn_kinematic.history_inputs(history, line, now))
        now, blend_m = edn_kinematic.corrected(now, self.start(hidden.T))
        last = None
        if weight is not None and bias is not None:
            last = _of_block(weight.flatten(0, 1), bias.flatten())
            last = last.unflatten(0, bias.shape).permute(1, 2, 0).contiguous()
        half = 0.5 * (hidden + 1.0)
        way_m = self._driven(half, now.increment_m, now.acceleration_mps2, goal_m, last)
        path = path_along(line, now.course_rad, now.curvature_per_m, blend_m)
        return positions(path, way_m[:, 1].T, way_m[:, 0].T)

    def _driven(
        self,
        half: Tensor,
        increment: Tensor,
        acceleration: Tensor,
        goal_m: Tensor,
        last: Tensor | None,
    ) -> Tensor:
        """Offset and progress [HORIZON_FRAMES, 2, B] in metres, as `EncoderDecoderNetwork` drives.

        `half` [H, B] is of the hidden state, see `gru_columns.py`. `last` [O, H + 1, B]: weights
        and biases of the vehicles' own last layers.
        """
        width, told = half.shape[0], _told(goal_m)
        ones, still = torch.ones_like(half[:1]), torch.zeros_like(told[0, :1])
        rows = (ones, increment[None], acceleration[None], still, still, still, told[0], goal_m.T)
        block = torch.cat((half, *rows))
        cell, state = Cell(self.decode, block), block[: width + 1]
        deep1, deep2 = torch.cat((half, ones)), torch.cat((half, ones))
        out1, out2 = deep1[:width], deep2[:width]
        emitted = half.new_empty((self.dense3.shape[0], half.shape[1]))
        jerk, swerve = emitted.unbind(0)
        motion = block[width + 1 : width + 1 + _MOTION]
        increment, acceleration, slope, offset, progress = motion.unbind(0)
        now_told = block[width + 1 + _MOTION : width + 1 + _MOTION + _TOLD]
        way_m = half.new_empty((HORIZON_FRAMES, 2, half.shape[1]))
        for told_of_step, way_of_step in zip(told.unbind(0), way_m.unbind(0), strict=True):
            now_told.copy_(told_of_step)
            cell.step()
            torch.mm(self.dense1, state, out=out1).sigmoid_()
            torch.mm(self.dense2, deep1, out=out2).sigmoid_()
            if last is None:
                torch.mm(self.dense3, deep2, out=emitted).tanh_()
            else:
                torch.sum(last * deep2, 1, out=emitted).tanh_()
            acceleration.add_(jerk, alpha=MAX_JERK_MPS3 * DT_S).clamp_(*ACCELERATION_MPS2)
            increment.add_(acceleration, alpha=DT_S * DT_S).relu_()
            # Who has come to a halt brakes no more: whoever stands was braking.
            acceleration.mul_(increment.sign())
            slope.addcmul_(swerve, increment, value=MAX_SWERVE_PER_M).clamp_(-MAX_SLOPE, MAX_SLOPE)
            offset.addcmul_(slope, increment)
            progress.add_(increment)
            way_of_step.copy_(motion[-2:])
        return way_m


def _of_block(weight: Tensor, bias: Tensor) -> Tensor:
    """Weights [O, H + 1] of a layer for a block of halves and ones."""
    return reading_halves(torch.cat((weight, bias[:, None]), 1), weight.shape[1])


def _read_of_rows(settings: EdnSettings) -> Tensor:
    """What the decoder reads [rows, I] of a one in every single row beneath the hidden state.

    It reads sums of the rows: so its weights for what it reads are weights for the rows as well.
    """
    named = 1 + _MOTION + _TOLD
    rows = torch.eye(named + settings.goal_steps)
    _, increment, acceleration, slope, offset, progress, wanted, ahead, clock = rows[:named]
    state = edn_kinematic.state_inputs(
        increment, acceleration, slope, offset, progress, wanted, ahead
    )
    goal_m = rows[:, named:]
    left_m = goal_m - progress[:, None]
    return decoder_input(
        settings, state, goal_m / GOAL_SCALE_M, left_m / GOAL_SCALE_M, clock[:, None]
    )


def _told(goal_m: Tensor) -> Tensor:
    """[HORIZON_FRAMES, _TOLD, B]: what every step knows beforehand."""
    wanted_m = edn_kinematic.by_step(goal_m, HORIZON_FRAMES)
    step = torch.arange(HORIZON_FRAMES, device=goal_m.device)
    ahead_m = wanted_m[:, (step + AHEAD_STEPS).clamp(max=wanted_m.shape[1] - 1)]
    clock = (step / HORIZON_FRAMES).to(goal_m.dtype).expand_as(ahead_m)
    return torch.stack((wanted_m, ahead_m, clock), -1).permute(1, 2, 0).contiguous()
