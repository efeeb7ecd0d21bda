"""The settings of the encoder-decoder network: all that the paper tried, and ours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

Signal = Literal["none", "transform", "input", "output", "hidden"]
"""How the decoder learns of the goal, or of the step it is at."""


@dataclass(frozen=True)
class EdnSettings:
    """The shape of the network, stored in the card of its weights."""

    width: int = 64
    dropout: float = 0.0
    decoder: Literal["kinematic", "plain"] = "kinematic"
    goal: Signal = "input"
    goal_steps: Literal[1, 6] = 6  # 1: the distance in 3 s; 6: those of `travel.PROFILE_S`
    clock: Signal = "input"
    # Of the plain decoder:
    coordinates: Literal["frenet", "cartesian"] = "frenet"
    speed_in: bool = True
    speed_out: bool = False
    yaw_in: bool = True
    yaw_out: bool = False
    incremental: bool = True
    aligned: bool = True
    teacher_forcing: bool = False
    attention: bool = False


PAPER: Final = EdnSettings(decoder="plain", goal_steps=1)
"""The paper's best: Frenet, speed and yaw read, incremental, aligned, goal and step as input."""
