"""What egos were advised, and what they then did: agreement, calibration, flicker (METHOD 7).

| number | what it is |
|---|---|
| encounter | a stretch in which the advice for an ego names a vehicle to pass before or to let go first, pauses under 1 s closed |
| switch | a change between yield and pass of an ego's advice about the same other vehicle within an encounter. "Yield, then go after it" is one piece of advice; an abstention is no switch, and advice after it is compared with that before |
| crossing | a stretch in which a vehicle's own graph has an active conflict, pauses under 1 s closed |
| agreement | the slot advised is the slot really taken (`labels.slot_label`), of suggestions that do not abstain and whose slot taken is known; sampled every 0.5 s |
"""  # noqa: E501 - rows of a table

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import Advice, BoolArray, FloatArray, IntArray, Suggestion
from hatn_sim.labels import slot_label, trajectories_from_rows
from hatn_sim.score.driven import Driven

PAUSE_S: Final = 1.0
ROUNDING_S: Final = 1e-6
ABSTAIN: Final = "abstain"


@dataclass(frozen=True, eq=False)
class Advised:
    """The suggestions of a run in numbers. S are the sampled ones whose slot taken is known."""

    encounters: int
    switches: int
    crossings: int
    sampled: int
    abstained: int  # of the sampled
    probability: FloatArray  # [S] of the slot advised
    agrees: BoolArray  # [S]
    always_yield_agrees: BoolArray  # [S] what always to yield would have got right


@dataclass
class _Encounter:
    last_s: float
    spoken: str


@dataclass(frozen=True, eq=False)
class _Sample:
    """Suggestions [E] of a moment with the graphs they were made from."""

    frame: int
    ego: IntArray  # [E] index into the recorder's ids, as all vehicles here
    node: IntArray  # [E, M]
    focus_mask: BoolArray
    ego_to_conflict_m: FloatArray
    rear_to_conflict_m: FloatArray
    conflict_xy_m: FloatArray
    slot: IntArray  # [E] advised, -1: abstained
    probability: FloatArray  # [E]


class AdviceRecorder:
    """Takes in advice, moment after moment; what is before `from_s` or after `to_s` is not told."""

    def __init__(self, from_s: float = -np.inf, to_s: float = np.inf) -> None:
        self._from_s, self._to_s = from_s, to_s
        self._index: dict[str, int] = {}
        self._encounters: dict[tuple[str, str | None], _Encounter] = {}
        self._conflict_s: dict[str, float] = {}
        self._samples: list[_Sample] = []
        self._counts = {"encounters": 0, "switches": 0, "crossings": 0}

    def add(self, frame: int, time_s: float, advice: Advice, sampled: bool) -> None:
        """The advice of frame number `frame`; every fifth should be `sampled`."""
        graphs = advice.prediction.graphs
        if graphs is None:
            return
        is_told = self._from_s <= time_s < self._to_s
        for name in (graphs.ids[v] for v in graphs.ego[graphs.has_conflict].tolist()):
            pause_s = time_s - self._conflict_s.get(name, -np.inf)
            self._conflict_s[name] = time_s
            self._counts["crossings"] += is_told and pause_s > PAUSE_S + ROUNDING_S
        for one in advice.suggestions:
            self._hear(one, time_s, is_told)
        if sampled and is_told and advice.suggestions:
            self._samples.append(self._sample(frame, advice))

    def _hear(self, one: Suggestion, time_s: float, is_told: bool) -> None:
        if one.action == ABSTAIN:
            return
        met = self._encounters.get((one.ego_id, one.slot_id))
        if met is None or time_s - met.last_s > PAUSE_S + ROUNDING_S:
            met = _Encounter(time_s, one.action)
            self._encounters[one.ego_id, one.slot_id] = met
            self._counts["encounters"] += is_told
        self._counts["switches"] += is_told and met.spoken != one.action
        met.last_s, met.spoken = time_s, one.action

    def _sample(self, frame: int, advice: Advice) -> _Sample:
        graphs = advice.prediction.graphs
        assert graphs is not None
        row_of = {graphs.ids[v]: e for e, v in enumerate(graphs.ego.tolist())}
        rows = [row_of[one.ego_id] for one in advice.suggestions]
        slots = [
            _slot(one, [graphs.ids[v] if v >= 0 else None for v in graphs.rear[e].tolist()])
            for one, e in zip(advice.suggestions, rows, strict=True)
        ]
        index = self._index
        number = np.array([index.setdefault(name, len(index)) for name in graphs.ids])
        node = np.where(graphs.rear[rows] >= 0, number[graphs.rear[rows]], -1)
        return _Sample(
            frame=frame,
            ego=number[graphs.ego[rows]],
            node=node,
            focus_mask=graphs.focus_mask[rows],
            ego_to_conflict_m=graphs.ego_to_conflict_m[rows],
            rear_to_conflict_m=graphs.rear_to_conflict_m[rows],
            conflict_xy_m=graphs.conflict_xy_m[rows],
            slot=np.array(slots, dtype=np.int64),
            probability=np.array([one.probability for one in advice.suggestions]),
        )

    def advised(self, driven: Driven) -> Advised:
        """The numbers, once it is known what everybody did."""
        place = {name: v for v, name in enumerate(driven.ids)}
        number = np.array([place[name] for name in self._index] + [-1], dtype=np.int64)
        trajectories = trajectories_from_rows(
            driven.ids, driven.vehicle, driven.frame, driven.xy_m, len(driven.time_s)
        )
        label, slot, probability = [np.zeros((0,), dtype=np.int64)], [], []
        for sample in self._samples:
            label.append(
                slot_label(
                    trajectories,
                    number[sample.ego],
                    np.full(len(sample.ego), sample.frame),
                    number[sample.node],
                    sample.focus_mask,
                    sample.ego_to_conflict_m,
                    sample.rear_to_conflict_m,
                    sample.conflict_xy_m,
                )
            )
            slot.append(sample.slot)
            probability.append(sample.probability)
        taken = np.concatenate(label)
        advised = np.concatenate([np.zeros(0, dtype=np.int64), *slot])
        known = (taken >= 0) & (advised >= 0)
        return Advised(
            **self._counts,
            sampled=len(advised),
            abstained=int((advised < 0).sum()),
            probability=np.concatenate([np.zeros(0), *probability])[known],
            agrees=(taken == advised)[known],
            always_yield_agrees=(taken == 0)[known],
        )


def _slot(one: Suggestion, rear: list[str | None]) -> int:
    """The node that is advised; -1: none."""
    if one.action == ABSTAIN:
        return -1
    return 0 if one.action == "yield" else rear.index(one.slot_id)
