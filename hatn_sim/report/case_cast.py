"""Who plays in a case: names, colours and plain words, one set for all of its panels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, FloatArray, IntArray
from hatn_sim.labels import FOLLOW_FRAMES, NEXT_FRAMES, crossing_frame
from hatn_sim.report.cases import Case
from hatn_sim.report.moment import Moment

BLACK: Final = "#111418"
COLOURS: Final = (
    "#d55e00",
    "#0072b2",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#8c6d1f",
    "#882255",
    "#5e4fa2",
)
"""Of Okabe and Ito, told apart by the colour-blind; darker ones in place of their yellow."""

BEYOND: Final = "*"
"""Marks what happened later than scores look ahead."""
BEYOND_WORDS: Final = (
    f"{BEYOND} not scored: scores look {NEXT_FRAMES * DT_S:.0f} s ahead, "
    f"{FOLLOW_FRAMES * DT_S:.0f} s for who follows"
)
NAMED: Final = 3
"""So many vehicles are named at once, the others are counted."""


@dataclass(frozen=True)
class Part:
    """What stands for a vehicle: the name of its slot, and its colour."""

    name: str
    colour: str


@dataclass(frozen=True)
class Words:
    """What is said under a panel."""

    said: str
    happened: str
    wrong: bool


def cast_of(moments: Sequence[Moment]) -> dict[str, Part]:
    """A name and colour for the ego and everybody whose slot it could choose in a panel.

    Names are numbered as vehicles appear. A colour is given again only to a vehicle that shares no
    panel, and no neighbouring ones, with whoever had it, as far as the colours go.
    """
    ego_id = moments[0].ego_id
    panels: dict[str, list[int]] = {}
    for k, moment in enumerate(moments):
        for slot in moment.slots:
            if slot.in_focus and slot.rear_id != ego_id:
                panels.setdefault(slot.rear_id, []).append(k)
    cast = {ego_id: Part("A1", BLACK)}
    free_from = dict.fromkeys(COLOURS, -2)  # panel that a colour was last seen in
    for number, (vehicle_id, shown) in enumerate(panels.items(), start=2):
        colour = min(COLOURS, key=lambda c: (free_from[c] >= shown[0] - 1, free_from[c]))
        free_from[colour] = max(free_from[colour], shown[-1])
        cast[vehicle_id] = Part(f"A{number}", colour)
    return cast


def story_words(case: Case, cast: Mapping[str, Part]) -> str:
    """What the ego really did at one conflict after the other, in a sentence.

    Whom it meets again is not named again.
    """
    did: list[str] = []
    told: set[int] = set()
    for one in case.encounters:
        let_go = [
            v for v, at in zip(one.let_go, one.let_go_frame, strict=True) if at >= case.frames[0]
        ]
        here: list[str] = []
        for verb, vehicles in (("lets {} go first", let_go), ("passes before {}", one.passed)):
            ids = [case.run.ids[v] for v in vehicles if v not in told]
            told.update(vehicles)
            if ids:
                here.append(verb.format(_listed(ids, cast)))
        if here:
            did.append(" and ".join(here))
    return "The ego " + ", then ".join(did) + "." if did else "The ego drives on."


def _listed(ids: Sequence[str], cast: Mapping[str, Part]) -> str:
    named = [cast[i].name for i in ids if i in cast][:NAMED]
    others = len(ids) - len(named)
    if others and named:
        named.append(f"{others} more")
    if not named:
        return f"{others} other{'s' if others > 1 else ''}"
    return named[0] if len(named) == 1 else f"{', '.join(named[:-1])} and {named[-1]}"


def panel_words(case: Case, cast: Mapping[str, Part], frame: int) -> Words:
    """What was said of the ego at this frame, and what it then did."""
    choices, ids = case.choices, case.run.ids
    rows = np.flatnonzero((choices.ego == case.ego) & (choices.frame == frame))
    if not len(rows):
        crossed = case.encounters[-1].crossed_frame
        past = crossed is not None and frame >= crossed
        return Words("No conflict ahead.", "It has crossed." if past else "", False)
    row = int(rows[0])
    likeliest = int(choices.likeliest[row])
    chance = float(choices.chance[row].max())
    said = f"{_does(likeliest, case, cast)} ({100.0 * chance:.0f} %)."
    said = said[0].upper() + said[1:]
    if not choices.known[row]:
        return _in_the_end(case, cast, row, said)
    taken = int(choices.node[row, choices.taken[row]])
    first = _goes_first(case, row) if taken == case.ego else None
    whom = "" if first is None or ids[first] not in cast else cast[ids[first]].name
    if choices.right[row]:
        return Words(said, f"It did: {whom} went first." if whom else "It did.", False)
    did = f"yielded{f' to {whom}' if whom else ''}"
    if taken != case.ego:
        did = f"passed before {_name(taken, case, cast)}"
    return Words(said, f"Wrong: it {did}.", True)


def _does(vehicle: int, case: Case, cast: Mapping[str, Part]) -> str:
    return "yields" if vehicle == case.ego else f"passes before {_name(vehicle, case, cast)}"


def _name(vehicle: int, case: Case, cast: Mapping[str, Part]) -> str:
    part = cast.get(case.run.ids[vehicle])
    return case.run.ids[vehicle] if part is None else part.name


def _in_the_end(case: Case, cast: Mapping[str, Part], row: int, said: str) -> Words:
    """What came of a row that scores leave out, as far as the log knows it.

    Who went first is decided as in `labels.slot_label`, without its limits of time.
    """
    choices, frame = case.choices, int(case.choices.frame[row])
    met = np.flatnonzero(choices.focus[row, 1:]) + 1
    others = choices.node[row, met]

    def crossing(vehicle: IntArray, away_m: FloatArray) -> IntArray:
        now = np.full(len(met), frame)
        there_xy_m, limit = choices.conflict_xy_m[row, met], case.run.frame_count
        return crossing_frame(case.run.trajectories, vehicle, now, away_m, there_xy_m, limit)

    ego_at = crossing(np.full(len(met), case.ego), choices.ego_m[row, met])
    other_at = crossing(others, choices.other_m[row, met])
    before = (other_at >= 0) & ((ego_at < 0) | (other_at <= ego_at))
    after = (ego_at >= 0) & (other_at > ego_at)
    likeliest = int(choices.likeliest[row])
    if before.any():
        at = int(other_at[before].min())
        first = int(others[before][other_at[before].argmin()])
        is_wrong, did = likeliest != case.ego, f"{_name(first, case, cast)} went first"
    elif after.any():
        next_ = int(np.where(after, other_at, case.run.frame_count).argmin())
        at, passed = int(ego_at[next_]), int(others[next_])
        is_wrong, did = likeliest != passed, f"it passed before {_name(passed, case, cast)}"
    elif (ego_at >= 0).any():
        return Words(said, "It went; nobody was seen to follow soon.", False)
    else:
        # So far it was looked at, however soon that was.
        return Words(said, "Nobody was seen to cross until the end of the run.", False)
    verdict = "Wrong" if is_wrong else "Right"
    later = f"{(at - frame) * DT_S:.1f}\u00a0s later"
    return Words(said, f"{verdict} in the end: {did}, {later}.{BEYOND}", is_wrong)


def _goes_first(case: Case, row: int) -> int | None:
    """Whom the ego lets go next, of those it has a choice about at this row."""
    frame = int(case.choices.frame[row])
    met = set(case.choices.node[row][case.choices.focus[row]].tolist())
    return next((v for v, at in _let_go(case, row) if at >= frame and v in met), None)


def _let_go(case: Case, row: int) -> Iterator[tuple[int, int]]:
    for one in case.encounters:
        if row in one.rows:
            yield from zip(one.let_go, one.let_go_frame, strict=True)
