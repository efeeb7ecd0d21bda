"""The paper's three case studies, found in runs: who tells them best, and at which moments.

1. interaction: an ego yields to somebody and then passes before others, at one conflict.
2. sequence: an ego meets at least three conflicts one after the other, and both yields and passes.
3. transfer: where the networks were not trained, an ego's plan changes while it meets the same
   vehicles, and it meets others later.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from hatn_sim.datatypes import DT_S, IntArray
from hatn_sim.errors import InputError
from hatn_sim.labels import FOLLOW_FRAMES
from hatn_sim.log import Run
from hatn_sim.report.case_moments import Beat, beats_of, key_frames
from hatn_sim.report.story import Choices, Encounter, read_choices, stories

MIN_SLOTS: Final = 3
"""One interaction is told only where there are at least so many slots."""
MIN_ENCOUNTERS: Final = 3
BACK_FRAMES: Final = 120
"""A story begins at most so long before the ego crosses the conflict."""
NEXT_FRAMES: Final = 60
"""An encounter of a sequence begins at most so long after the one before."""
AFTER_FRAMES: Final = 10
"""A story ends so long after the last crossing."""
LONG_ROWS: Final = 15
"""An encounter of a sequence is long enough to be looked at."""
NEAR_M: Final = 12.0
FAR_M: Final = 45.0
"""Whoever is met is telling up to the nearer, and not at all beyond the farther distance ahead."""
CHANGE: Final = 0.4
"""A plan changes where the probability of yielding does so by this much ..."""
CHANGE_FRAMES: Final = 15
"""... within so many frames, while the same vehicles are met ..."""
CHANGE_REACH_M: Final = 30.0
"""... at a conflict this near."""


@dataclass(frozen=True)
class CaseKind:
    """One of the paper's case studies."""

    name: str
    number: int
    title: str
    panels: int  # at most
    what: str  # for whoever has none


KINDS: Final[Mapping[str, CaseKind]] = {
    kind.name: kind
    for kind in (
        CaseKind(
            "interaction",
            1,
            "One interaction",
            6,
            f"an ego that yields and then passes at one conflict with {MIN_SLOTS} slots or more",
        ),
        CaseKind(
            "sequence",
            2,
            "A sequence of interactions",
            8,
            f"an ego that yields and passes at {MIN_ENCOUNTERS} conflicts one after the other, at "
            "another moment than that of transfer",
        ),
        CaseKind(
            "transfer",
            3,
            "Transfer to another scene",
            8,
            "an ego, where the networks were not trained, whose likeliest slot changes while it "
            "meets the same vehicles, and that meets others later",
        ),
    )
}


@dataclass(frozen=True, eq=False)
class Case:
    """A story to be drawn."""

    kind: CaseKind
    run: Run
    choices: Choices
    ego: int  # index into run.ids
    encounters: tuple[Encounter, ...]
    frames: tuple[int, ...]  # of its panels
    value: float  # how telling it is


@dataclass(frozen=True, eq=False)
class _Told:
    """A candidate: encounters within a span of frames, and how telling what sets it apart is."""

    encounters: tuple[Encounter, ...]
    first: int
    extra: float
    beats: tuple[Beat, ...] = ()


class _Candidate(NamedTuple):
    value: float
    choices: Choices
    ego: int
    told: _Told

    def shares_moments(self, other: _Candidate) -> bool:
        """Whether both tell of the same ego at the same time."""
        same = self.choices is other.choices and self.ego == other.ego
        return same and self.told.first <= other.last_frame and other.told.first <= self.last_frame

    @property
    def last_frame(self) -> int:
        end = self.told.encounters[-1]
        return max(end.last_frame, end.crossed_frame or 0)


def find_cases(runs: Sequence[Run], names: Sequence[str]) -> dict[str, Case]:
    """The most telling case of each of these kinds, by its name; none where there is none.

    The value of a candidate is the sum of parts, each between 0 and 1: how often the likeliest
    slot was the one taken, and that it was at the last moment of every encounter; how far the
    probability of yielding swings; slots to choose from; vehicles let go and passed; distance
    driven; a story that is not long; others near to their conflicts, and soon there; and what the
    kind of case is about. Wrong predictions make a case less telling, not unfit. Ties go to the
    earlier run, ego and frame. A sequence and a transfer are never of one ego at the same time:
    those are taken that together are the most telling, and a transfer alone where none differ.

    Raises:
        InputError: a run has no predictions of slots.
    """
    found: dict[str, list[_Candidate]] = {}
    for run in runs:
        choices = read_choices(run)
        for ego, met in stories(choices):
            for name in names:
                for told in _candidates(name, choices, met):
                    value = _value(choices, ego, told)
                    found.setdefault(name, []).append(_Candidate(value, choices, ego, told))
        found = {name: _foremost(some) for name, some in found.items()}
    best = {name: max(some, key=lambda one: one.value) for name, some in found.items()}
    if {"sequence", "transfer"} <= best.keys():
        pairs = product(found["sequence"], found["transfer"])
        apart = (pair for pair in pairs if not pair[0].shares_moments(pair[1]))
        pair = max(apart, key=lambda pair: pair[0].value + pair[1].value, default=None)
        if pair is None:
            del best["sequence"]
        else:
            best["sequence"], best["transfer"] = pair
    return {
        name: _case(
            KINDS[name], best[name].choices, best[name].ego, best[name].told, best[name].value
        )
        for name in names
        if name in best
    }


def _foremost(candidates: Sequence[_Candidate]) -> list[_Candidate]:
    """Those of the two egos with the most telling; no other is among two that are told together.

    Of several runs all others would be held in memory, and every pair of them compared.
    """
    best: dict[tuple[int, int], float] = {}
    for one in candidates:
        ego = id(one.choices), one.ego
        best[ego] = max(one.value, best.get(ego, -np.inf))
    egos = sorted(best, key=lambda ego: -best[ego])[:2]
    return [one for one in candidates if (id(one.choices), one.ego) in egos]


def missing(runs: Sequence[Run], kinds: Sequence[CaseKind]) -> InputError:
    """What to say to whoever asked for cases that are in none of these runs."""
    named = ", ".join(str(run.path) for run in runs)
    wanted = " or ".join(kind.what for kind in kinds)
    return InputError(
        f"{named}: no case to draw: expected {wanted}, found none; name further runs, longer or in "
        "denser traffic"
    )


def _candidates(name: str, choices: Choices, met: Sequence[Encounter]) -> Iterator[_Told]:
    if name == "interaction":
        return _interactions(choices, met)
    if name == "sequence":
        return _sequences(choices, met)
    return _transfers(choices, met)


def _interactions(choices: Choices, met: Sequence[Encounter]) -> Iterator[_Told]:
    for one in met:
        if one.crossed_frame is None or not one.let_go or not one.passed:
            continue
        first = max(one.first_frame, one.crossed_frame - BACK_FRAMES)
        rows = _rows_from(choices, one, first)
        yields = choices.likeliest[rows] == choices.ego[rows]
        slots = int(choices.focus[rows].sum(axis=1).max())
        # It is seen to yield, and then, without a break, to pass.
        if slots >= MIN_SLOTS and yields[0] and not yields[-1] and one.let_go_frame[-1] >= first:
            yield _Told((one,), first, extra=float(slots == choices.focus[rows[0]].sum()))


def _sequences(choices: Choices, met: Sequence[Encounter]) -> Iterator[_Told]:
    decided = [one for one in met if one.decided]
    for k, begin in enumerate(decided):
        chain = [begin]
        for one in decided[k + 1 :]:
            whom = {*chain[-1].let_go, *chain[-1].passed}
            others = {*one.let_go, *one.passed} - whom
            near = one.first_frame - chain[-1].last_frame <= NEXT_FRAMES
            if not near or len(chain) == 2 * MIN_ENCOUNTERS - 1:
                break
            if others:
                chain.append(one)
            both = any(e.let_go for e in chain) and any(not e.let_go for e in chain)
            if others and both and len(chain) >= MIN_ENCOUNTERS:
                assert begin.crossed_frame is not None
                at = min(begin.crossed_frame, begin.last_frame)
                first = max(begin.first_frame, at - BACK_FRAMES // 2)
                variety = np.mean([bool(e.let_go) for e in chain])
                shortest = min(len(one.rows) for one in chain)
                extra = 4.0 * variety * (1.0 - variety) + min(shortest / LONG_ROWS, 1.0)
                yield _Told(tuple(chain), first, extra=float(extra))


def _transfers(choices: Choices, met: Sequence[Encounter]) -> Iterator[_Told]:
    run = choices.run
    if run.header.get("scene") in run.trained_on:
        return
    for k, one in enumerate(met):
        later = next((e for e in met[k + 1 :] if e.decided), None)
        if later is None or not one.decided or later.first_frame - one.last_frame > NEXT_FRAMES:
            continue
        assert one.crossed_frame is not None
        first = max(one.first_frame, one.crossed_frame - BACK_FRAMES)
        rows = _rows_from(choices, one, first)
        changes = _changes(choices, rows)
        if changes:
            beats = [
                Beat(1, frame)
                for at, _ in changes
                for frame in (int(choices.frame[at]), int(choices.frame[at]) + CHANGE_FRAMES)
            ]
            size = max(size for _, size in changes)
            extra = size + min(len(changes), 2) / 2.0
            yield _Told((one, later), first, extra, tuple(beats))


def _changes(choices: Choices, rows: IntArray) -> list[tuple[int, float]]:
    """Where the plan changes among the same vehicles: (row before, change of probability)."""
    found: list[tuple[int, float]] = []
    skip_to = 0
    for k in range(len(rows) - CHANGE_FRAMES):
        a, b = rows[k], rows[k + CHANGE_FRAMES]
        size = abs(float(choices.yields[b] - choices.yields[a]))
        if k < skip_to or size < CHANGE or choices.nearest_m[a] > CHANGE_REACH_M:
            continue
        whom = [set(choices.node[r][choices.focus[r]].tolist()) for r in (a, b)]
        plans = [choices.likeliest[r] == choices.ego[r] for r in (a, b)]
        if whom[0] == whom[1] and plans[0] != plans[1]:
            found.append((int(a), size))
            skip_to = k + CHANGE_FRAMES
    return found


def _rows_from(choices: Choices, one: Encounter, first: int) -> IntArray:
    """The rows of an encounter from a frame on, the last one in any case."""
    rows = one.rows[choices.frame[one.rows] >= first]
    return rows if len(rows) else one.rows[-1:]


def _value(choices: Choices, ego: int, told: _Told) -> float:
    spans = [_rows_from(choices, one, told.first) for one in told.encounters]
    rows = np.concatenate(spans)
    known = choices.known[rows]
    last = [span[choices.known[span]][-1] for span in spans if choices.known[span].any()]
    crossed = told.encounters[-1].crossed_frame
    stop = told.encounters[-1].last_frame if crossed is None else crossed
    seconds = DT_S * (stop - told.first)
    travelled = choices.run.trajectories.travelled_at(ego, np.array([told.first, stop]))
    whom = {v for one in told.encounters for v in (*one.let_go, *one.passed)}
    swing = [float(np.ptp(choices.yields[span])) for span in spans]
    parts = (
        float(choices.right[rows].sum() / max(known.sum(), 1)),
        float(np.mean(choices.right[last])) if last else 0.0,
        float(np.mean(swing)),
        min(float(choices.focus[rows].sum(axis=1).max()), 5.0) / 5.0,
        min(len(whom), 5) / 5.0,
        min(float(travelled[1] - travelled[0]) / 30.0, 1.0),
        min(10.0 / max(seconds, 1.0), 1.0),
        _closeness(choices, rows),
        _promptness(told.encounters),
    )
    return sum(parts) + told.extra


def _closeness(choices: Choices, rows: IntArray) -> float:
    """How near to their conflicts those are that are met."""
    others = choices.focus[rows].copy()
    others[:, 0] = False
    away = (FAR_M - choices.other_m[rows][others]) / (FAR_M - NEAR_M)
    return float(np.clip(away, 0.0, 1.0).mean())


def _promptness(encounters: Sequence[Encounter]) -> float:
    """How soon before and after the ego the others go: the whole 10 s later tells nothing."""
    apart = [
        min(abs(frame - one.crossed_frame) for frame in (*one.let_go_frame, *one.passed_frame))
        for one in encounters
        if one.crossed_frame is not None and one.decided
    ]
    return float(np.mean(np.clip(1.0 - np.array(apart) / FOLLOW_FRAMES, 0.0, 1.0)))


def _case(kind: CaseKind, choices: Choices, ego: int, told: _Told, value: float) -> Case:
    beats = [*told.beats, *beats_of(choices, told.encounters, told.first)]
    end = told.encounters[-1].crossed_frame
    assert end is not None
    seen_until = int(choices.run.trajectories.seen_until(ego, end))
    stop = min(end + AFTER_FRAMES, seen_until)
    frames = key_frames([*beats, Beat(0, stop)], told.first, stop, kind.panels)
    return Case(kind, choices.run, choices, ego, told.encounters, frames, value)
