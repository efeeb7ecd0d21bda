"""The alert rules that are compared, by name: each says how dangerous every pair is now.

The oracle is not among them: it knows the future (see `score.dangers`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.assist.risk import encounters, required_deceleration_mps2
from hatn_sim.datatypes import FloatArray, IntArray, Prediction, Scene
from hatn_sim.errors import InputError, nearest
from hatn_sim.perception import Perception
from hatn_sim.road import Road


@dataclass(frozen=True, eq=False)
class Moment:
    """All that a rule may look at."""

    road: Road
    seen: Perception
    prediction: Prediction  # of HATN
    extrapolation: Prediction  # at constant velocity

    @property
    def scene(self) -> Scene:
        return self.seen.scene


@dataclass(frozen=True, eq=False)
class PairDangers:
    """Pairs [P] of vehicles of the scene and how dangerous they are; higher is worse."""

    first: IntArray
    second: IntArray
    danger: FloatArray  # 0: none
    type: IntArray | None = None  # index into score.dangers.TYPES; None: all CONFLICT


AlertRule = Callable[[Moment], PairDangers]


def _hard_braking(moment: Moment) -> PairDangers:
    meeting = encounters(moment.scene, moment.prediction)
    graphs = moment.prediction.graphs
    assert graphs is not None
    other = np.maximum(graphs.rear, 0)
    speed = moment.scene.speed_mps
    own = required_deceleration_mps2(
        meeting.ego_room_m, speed[graphs.ego][:, None], meeting.other_leave_s
    )
    others = required_deceleration_mps2(meeting.other_room_m, speed[other], meeting.ego_leave_s)
    danger = graphs.node_mask & (np.arange(graphs.rear.shape[1]) > 0)
    danger &= meeting.predicted_encroachment_s() < 0.0
    danger &= np.maximum(meeting.ego_enter_s, meeting.other_enter_s) < 3.0
    e, m = np.nonzero(danger)
    return PairDangers(graphs.ego[e], graphs.rear[e, m], np.minimum(own, others)[e, m])


def _always(moment: Moment) -> PairDangers:
    graphs = moment.prediction.graphs
    assert graphs is not None
    e, m = np.nonzero(graphs.node_mask & (np.arange(graphs.rear.shape[1]) > 0))
    return PairDangers(graphs.ego[e], graphs.rear[e, m], np.ones(len(e)))


def _never(_: Moment) -> PairDangers:
    none = np.zeros(0, dtype=np.int64)
    return PairDangers(none, none, np.zeros(0))


RULES: Final[dict[str, AlertRule]] = {
    "hatn": _hard_braking,
    "always": _always,
    "never": _never,
}
THRESHOLDS: Final = {"hatn": 3.0, "always": 0.5, "never": 0.5}
"""Rule -> the danger at which its alerts begin."""


def chosen_rules(names: Sequence[str]) -> dict[str, AlertRule]:
    """The rules of these names. Raises InputError where there is none."""
    for name in names:
        if name not in RULES:
            raise InputError(f"--rules: unknown rule {name!r}{nearest(name, RULES)}")
    return {name: RULES[name] for name in names}
