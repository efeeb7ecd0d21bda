"""What the numbers of an observation are: the one definition that spaces and tables come from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from gymnasium.spaces import Box, Dict, Space

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES, MAX_NODES, FloatArray
from hatn_sim.envs.errors import OptionError
from hatn_sim.graph import FREE_M

VEHICLES: Final = 15
"""The nearest others."""
REACH_M: Final = 100.0
"""Those farther from the ego than this are not observed."""
MODES: Final = 3
EVERY_FRAMES: Final = 5
POINTS: Final = HORIZON_FRAMES // EVERY_FRAMES
"""Of each predicted trajectory: 0.5 s ... 3 s from now."""
ROAD_AT_M: Final = (0.0, 8.0, 16.0, 30.0, 50.0)
"""Where the ego's line ahead is looked at; some of `graph.AHEAD_AT_M`."""
TRAJECTORY_M: Final = 250.0


@dataclass(frozen=True, eq=False)  # compared by identity: tables of them are looked up often
class Feature:
    """One number of an observation. What is beyond its range is observed as the end of it."""

    name: str
    low: float
    high: float
    unit: str


def _flag(name: str) -> Feature:
    return Feature(name, 0.0, 1.0, "0 or 1")


OWN: Final = (
    Feature("speed", 0.0, 40.0, "m/s"),
    Feature("acceleration, of the last 0.1 s", -10.0, 10.0, "m/s2"),
    Feature("length", 0.0, 25.0, "m"),
    Feature("width", 0.0, 5.0, "m"),
    Feature("share of the time limit left", 0.0, 1.0, "1"),
)
"""Of the ego, without a look at the road."""
ON_ROAD: Final = (
    _flag("on a reference line; what follows is 0 where not"),
    Feature("lateral offset from the line, left positive", -5.0, 5.0, "m"),
    Feature("heading against the line", -np.pi, np.pi, "rad"),
    *(Feature(f"speed limit at {at:g} m", 0.0, 40.0, "m/s") for at in ROAD_AT_M),
    *(Feature(f"curvature at {at:g} m, left positive", -0.5, 0.5, "1/m") for at in ROAD_AT_M),
    Feature("time stood still, up to 4 s", 0.0, 4.1, "s"),
    Feature("centre to a stop line, give-way line or closed signal, 50: none", 0.0, 50.0, "m"),
    _flag("has a conflict"),
    Feature("way to the nearest conflict, 50: none", -10.0, 60.0, "m"),
    _flag("a closed signal is before it"),
    _flag("has a leader"),
    Feature("gap to the leader, 60: none", -5.0, 60.0, "m"),
    Feature("speed of the leader", 0.0, 40.0, "m/s"),
)
"""Of the ego, along its reference line."""
OTHER: Final = (
    Feature("x, ahead of the ego", -REACH_M, REACH_M, "m"),
    Feature("y, left of the ego", -REACH_M, REACH_M, "m"),
    Feature("cosine of the heading against the ego's", -1.0, 1.0, "1"),
    Feature("sine of it, left positive", -1.0, 1.0, "1"),
    Feature("velocity ahead, less the ego's", -80.0, 80.0, "m/s"),
    Feature("velocity to the left", -80.0, 80.0, "m/s"),
    Feature("speed", 0.0, 40.0, "m/s"),
    Feature("length", 0.0, 25.0, "m"),
    Feature("width", 0.0, 5.0, "m"),
    Feature("number of its slot, 0: none", 0.0, MAX_NODES - 1.0, "1"),
)
SLOT: Final = (
    Feature("d_f, way from the front boundary to the conflict", -60.0, 120.0, "m"),
    Feature("v_f, speed of the front boundary", -10.0, 40.0, "m/s"),
    Feature("phi_f, its heading against the line", -np.pi, np.pi, "rad"),
    Feature("d_r, way from the rear boundary to the conflict", -60.0, 120.0, "m"),
    Feature("v_r, speed of the rear boundary", -10.0, 40.0, "m/s"),
    Feature("phi_r, its heading against the line", -np.pi, np.pi, "rad"),
    Feature("l, length of the slot", -60.0, 120.0, "m"),
    Feature("way of the ego to the conflict", -10.0, 60.0, "m"),
    Feature("way of the rear vehicle to the conflict", -10.0, 60.0, "m"),
    Feature("the conflict point, ahead of the ego", -REACH_M, REACH_M, "m"),
    Feature("the conflict point, left of the ego", -REACH_M, REACH_M, "m"),
    _flag("the conflict is a merge"),
    _flag("of the focus group: what is at stake next"),
    Feature("earliest time of the ego at the conflict", 0.0, 10.0, "s"),
    Feature("earliest time of the rear vehicle there", 0.0, 10.0, "s"),
    Feature("time the rear vehicle has stood still, up to 4 s", 0.0, 4.1, "s"),
    Feature("probability of the slot; all are 0 where the predictor gives none", 0.0, 1.0, "1"),
)


def _box(features: Sequence[Feature], *rows: int) -> Box:
    shape = (*rows, len(features))
    low, high = (
        np.broadcast_to([getattr(one, end) for one in features], shape) for end in ("low", "high")
    )
    return Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def _unit_box(*shape: int) -> Box:
    return Box(0.0, 1.0, shape, np.float32)


def observation_space(form: str, has_slots: bool) -> Dict:
    """The space of a form of observation; with an action mask where actions are slots."""
    if form not in ("slots", "vehicles"):
        raise OptionError(f"observation: expected slots or vehicles, found {form!r}")
    own = OWN + ON_ROAD if form == "slots" else OWN
    spaces: dict[str, Space[Any]] = {
        "ego": _box(own),
        "vehicles": _box(OTHER, VEHICLES),
        "vehicle_mask": _unit_box(VEHICLES),
    }
    if form == "slots":
        spaces |= {
            "slots": _box(SLOT, MAX_NODES),
            "slot_mask": _unit_box(MAX_NODES),
            "trajectories": Box(
                -TRAJECTORY_M, TRAJECTORY_M, (VEHICLES + 1, MODES, POINTS, 2), np.float32
            ),
            "mode_probability": _unit_box(VEHICLES + 1, MODES),
        }
    if has_slots:
        spaces["action_mask"] = _unit_box(MAX_NODES)
    return Dict(spaces)


def clipped(values: FloatArray, features: tuple[Feature, ...]) -> np.ndarray:
    """Numbers [..., len(features)] within the ranges of their features, as float32."""
    low, high = _limits(features)
    return np.minimum(np.maximum(values.astype(np.float32), low), high)


@cache
def _limits(features: tuple[Feature, ...]) -> tuple[np.ndarray, np.ndarray]:
    low = np.array([one.low for one in features], np.float32)
    return low, np.array([one.high for one in features], np.float32)


def _rows(features: Sequence[Feature], first: int = 0) -> list[str]:
    return [
        f"| {index} | {one.name} | {one.low:.4g} ... {one.high:.4g} | {one.unit} |"
        for index, one in enumerate(features, start=first)
    ]


def observation_table() -> str:
    """The tables of all numbers: index, name, range, unit."""
    head = ["| index | name | range | unit |", "|---|---|---|---|"]
    step_s = EVERY_FRAMES * DT_S
    return "\n".join(
        [
            "`ego`",
            "",
            *head,
            *_rows(OWN),
            *_rows(ON_ROAD, len(OWN)),
            "",
            f"(from {len(OWN)} on: only in the form `slots`)",
            "",
            f"`vehicles` [{VEHICLES}, {len(OTHER)}], the nearest first of those whose centres are "
            f"within {REACH_M:g} m, `vehicle_mask` [{VEHICLES}]: 1 where there is one",
            "",
            *head,
            *_rows(OTHER),
            "",
            f"`slots` [{MAX_NODES}, {len(SLOT)}], 0 is to yield, `slot_mask` [{MAX_NODES}]; where "
            f"there is no conflict, 0 is measured to the point {FREE_M:g} m ahead on the line",
            "",
            *head,
            *_rows(SLOT),
            "",
            f"`trajectories` [{VEHICLES + 1}, {MODES}, {POINTS}, 2]: predicted centres, x ahead "
            f"and y left of the ego as it is now, m, every {step_s:g} s; row 0 is the ego, row "
            f"k + 1 is vehicle k; `mode_probability` [{VEHICLES + 1}, {MODES}], the likeliest mode "
            "first, 0 where there is none",
            "",
            f"`action_mask` [{MAX_NODES}]: 1 where the slot may be chosen; only with `slot` "
            "actions",
        ]
    )
