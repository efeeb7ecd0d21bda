"""The settings of the semantic graph network: the paper's form, its six variants, and ours.

One model has them all. What a setting turns on beyond the paper says so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class SgnSettings:
    """The shape of the network and how it is learnt, stored in the card of its weights."""

    width: int = 64
    components: int = 3
    """Of the Gaussian mixture over the goal."""

    temporal: bool = True
    """False: only the present frame, and nothing of the context that was made of a history."""
    attend_absolute: bool = False
    """Relations from absolute features, as in a graph attention network; else from relative."""
    graph_layers: int = 1
    heads: int = 1
    sequential: bool = False
    """Relations frame by frame and then the recurrence; else the recurrence first."""
    history_stride: int = 2
    """Every second frame tells as much, in half the time; 1 is the paper's."""

    slots: Literal["race", "softmax"] = "race"
    """"race": beyond the paper, see `slots.py`. "softmax": over the nodes' scores."""
    context: bool = True
    """Beyond the paper: `graph.CONTEXT` beside the seven features."""
    goal_base: Literal["none", "speed", "anchors"] = "speed"
    """What goals are learnt as a change of. "none": the paper's. "speed": the distance at today's
    speed. "anchors": a choice among plain things to do, see `anchors.py`."""
    goal_knows_slots: bool = False
    """Beyond the paper: how probably a vehicle is the first to cross tells how far it gets."""
    profile: bool = False
    """Beyond the paper: the way to the goal, half second by half second, is learnt."""
    slot_modes: bool = False
    """Beyond the paper: the ego's goal and time of crossing for every slot it may take."""
    goal_by_slots: bool = False
    """Beyond the paper: half of the ego's goal is what it does for each slot, by their
    probability. Nothing without `slot_modes`."""

    class_weight: float = 2.0
    """Beta of the paper's loss."""
    ego_only: bool = False
    """The ego's goal alone is learnt, not those of the vehicles around it."""
    ego_weight: float = 3.0
    """How much the ego's goal counts among all; its trajectory hangs on it. 1 is the paper's."""
    goal_l1_weight: float = 4.0
    """Of the error of the mixture's mean beside its likelihood; 0 is the paper's."""
    label_smoothing: float = 0.05
    """Certainty learnt in one place is too much in another; 0 is the paper's."""
    dropout: float = 0.1
    race_dropout: float = 0.5
    """Who goes first is soon known by heart for one place: hidden in training, so that what is
    learnt rests on more than that."""


def paper_sgn() -> SgnSettings:
    """The network as the paper has it ("Ours" in its table of graph networks)."""
    return SgnSettings(
        history_stride=1,
        slots="softmax",
        context=False,
        goal_base="none",
        class_weight=1.0,
        ego_weight=1.0,
        goal_l1_weight=0.0,
        label_smoothing=0.0,
        dropout=0.0,
        race_dropout=0.0,
    )


def best_sgn() -> SgnSettings:
    """The network that predicts best, in places it was not trained on above all."""
    return SgnSettings(
        history_stride=3,
        goal_base="anchors",
        goal_knows_slots=True,
        profile=True,
        slot_modes=True,
    )


def paper_variants(settings: SgnSettings) -> dict[str, SgnSettings]:
    """The columns of the paper's table of graph networks, of any form of the network."""
    return {
        "No-Temporal": replace(settings, temporal=False),
        "GAT": replace(settings, attend_absolute=True),
        "Single-Agent": replace(settings, ego_only=True),
        "Two-Layer-Graph": replace(settings, graph_layers=2),
        "Multi-Head": replace(settings, heads=3),
        "Seq-Graph": replace(settings, sequential=True),
        "Ours": settings,
    }
