"""What egos were told: advice that has begun goes on about the same vehicles, and says the same.

Letters as in `choice`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, IntArray, Scene, SemanticGraphs

ACTIONS: Final = ("yield", "pass")
SILENT: Final = "abstain"
LEAST_S: Final = 1.0
"""Advice says the same for so long (action, whom it names, feasible), but where that is unsafe."""
ROUNDING_S: Final = 1e-6


@dataclass(frozen=True)
class Told:
    """What an ego was told last."""

    slot_id: str  # the rear vehicle of the slot: the ego itself for a yield
    other_id: str  # whom to pass before, or to let go first
    action: str
    feasible: bool
    doubted_s: float | None = None  # since when other advice would have been given
    said: frozenset[tuple[str, str]] = frozenset()  # (action, other vehicle) of all that was said
    time_s: float = 0.0
    others: frozenset[str] = frozenset()  # all whom it is about: to be let go, or passed before
    since_s: float = -np.inf  # when it began to say the same: action, other vehicle, feasible
    wanted: str = (
        SILENT  # what would have been said, but that it has to be the best for a while ...
    )
    wanted_s: float = np.inf  # ... since when
    why: int = -1  # of `choice.Why`: of silence ...
    why_s: float = -np.inf  # ... since when it is said so
    timed: bool = False  # whether a yield was told how long it takes ...
    timed_s: float = -np.inf  # ... since when that is so, or is not
    called: str = ""  # what the other was called


@dataclass(frozen=True, eq=False)
class Before:
    """The same of egos [R], in terms of their graphs as they are now."""

    told: IntArray  # [R] the slot, -1: none, or all whom it was about are gone
    about: IntArray  # [R] the node of whom it named, -1: gone
    action: IntArray  # [R] into ACTIONS, -1: silence
    feasible: BoolArray  # [R]
    since_s: FloatArray  # [R]
    doubted_s: FloatArray  # [R] nan: not
    wanted: IntArray  # [R] into ACTIONS, -1: silence
    wanted_s: FloatArray  # [R]
    said: Sequence[frozenset[tuple[str, str]]]
    watched: IntArray  # [R] the vehicle that silence was about, -1: none
    why: IntArray  # [R] of `choice.Why`
    why_s: FloatArray  # [R]
    timed: BoolArray  # [R]
    timed_s: FloatArray  # [R]
    other: Sequence[str]  # whom it named, or silence was about, gone or not; "": nobody ...
    called: Sequence[str]  # ... and how


class Now(Protocol):
    """What is told to egos [R] now."""

    @property
    def slot(self) -> IntArray: ...
    @property
    def other(self) -> IntArray: ...  # the vehicle it names
    @property
    def speaks(self) -> BoolArray: ...
    @property
    def feasible(self) -> BoolArray: ...
    @property
    def doubted_s(self) -> FloatArray: ...
    @property
    def since_s(self) -> FloatArray: ...
    @property
    def wanted(self) -> IntArray: ...
    @property
    def wanted_s(self) -> FloatArray: ...
    @property
    def why(self) -> IntArray: ...
    @property
    def why_s(self) -> FloatArray: ...


_NOTHING: Final = Told("", "", SILENT, False)


def _number(action: str) -> int:
    return -1 if action == SILENT else ACTIONS.index(action)


def recall(
    before: Sequence[Told | None],
    scene: Scene,
    graphs: SemanticGraphs,
    row: IntArray,
    slot_probability: FloatArray,
) -> Before:
    """What egos of graphs [R] were told; a pass whose vehicle has gone is one before the others."""
    last = [one or _NOTHING for one in before]
    index = {name: v for v, name in enumerate(scene.ids)}
    others = graphs.focus_mask[row]
    others[:, 0] = False
    rear = np.maximum(graphs.rear[row], 0)
    speaks = [one.action != SILENT for one in last]
    named = [
        index.get(one.other_id, -1) if is_on else -1
        for one, is_on in zip(last, speaks, strict=True)
    ]
    is_named = others & (rear == np.array(named)[:, None])
    concerns = np.zeros((len(last), len(index)), dtype=np.bool_)
    for r, one in enumerate(last):
        if speaks[r]:
            concerns[r, [index[name] for name in one.others if name in index]] = True
    still = is_named | (others & np.take_along_axis(concerns, rear, axis=1))
    about = np.where(is_named.any(axis=1), is_named.argmax(axis=1), -1)
    likeliest = np.where(still, slot_probability[row], -1.0).argmax(axis=1)
    yields = np.array([one.action == "yield" for one in last])
    slot = np.where(yields, 0, np.where(about >= 0, about, likeliest))
    return Before(
        told=np.where(still.any(axis=1), slot, -1),
        about=about,
        action=np.array([_number(one.action) for one in last]),
        feasible=np.array([one.feasible for one in last]),
        since_s=np.array([one.since_s for one in last]),
        doubted_s=np.array([np.nan if one.doubted_s is None else one.doubted_s for one in last]),
        wanted=np.array([_number(one.wanted) for one in last]),
        wanted_s=np.array([one.wanted_s for one in last]),
        said=[one.said for one in last],
        watched=np.array(
            [
                -1 if is_on else index.get(one.other_id, -1)
                for one, is_on in zip(last, speaks, strict=True)
            ]
        ),
        why=np.array([one.why for one in last]),
        why_s=np.array([one.why_s for one in last]),
        timed=np.array([one.timed for one in last]),
        timed_s=np.array([one.timed_s for one in last]),
        other=[one.other_id for one in last],
        called=[one.called for one in last],
    )


def remember(
    before: Before,
    scene: Scene,
    graphs: SemanticGraphs,
    row: IntArray,
    concerns: BoolArray,
    now: Now,
    timed: BoolArray,
    timed_s: FloatArray,
    called: Sequence[str],
) -> list[Told]:
    """What egos of graphs [R] are told; `concerns` [R, M] are all whom it is about.

    `timed` [R] tells whether with a time, `timed_s` [R] since when, `called` [R] whom it names.
    """
    ids, time_s = scene.ids, scene.time_s
    others: list[list[str]] = [[] for _ in range(len(row))]
    r, m = np.nonzero(concerns & now.speaks[:, None])
    for k, v in zip(r.tolist(), graphs.rear[row[r], m].tolist(), strict=True):
        others[k].append(ids[v])
    told: list[Told] = []
    for k, (
        rear,
        other,
        goes,
        speaks,
        feasible,
        doubted_s,
        since_s,
        wanted,
        wanted_s,
        why,
        why_s,
        is_timed,
        is_timed_s,
    ) in enumerate(
        zip(
            graphs.rear[row, now.slot].tolist(),
            now.other.tolist(),
            (now.slot > 0).tolist(),
            now.speaks.tolist(),
            now.feasible.tolist(),
            now.doubted_s.tolist(),
            now.since_s.tolist(),
            now.wanted.tolist(),
            now.wanted_s.tolist(),
            now.why.tolist(),
            now.why_s.tolist(),
            timed.tolist(),
            timed_s.tolist(),
            strict=True,
        )
    ):
        action = ACTIONS[goes] if speaks else SILENT
        said = before.said[k]
        told.append(
            Told(
                slot_id=ids[rear],
                other_id=ids[other],
                action=action,
                feasible=feasible,
                doubted_s=None if np.isnan(doubted_s) else doubted_s,
                said=said | {(action, ids[other])} if speaks else said,
                time_s=time_s,
                others=frozenset(others[k]),
                since_s=since_s,
                wanted=SILENT if wanted < 0 else ACTIONS[wanted],
                wanted_s=wanted_s,
                why=why,
                why_s=why_s,
                timed=is_timed,
                timed_s=is_timed_s,
                called=called[k],
            )
        )
    return told
