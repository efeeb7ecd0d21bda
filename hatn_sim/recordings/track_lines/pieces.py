"""The strands of a web -> what becomes lanes: cut where the map's junctions begin and end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from hatn_sim.datatypes import BoolArray
from hatn_sim.recordings.track_lines.paths import STEP_M
from hatn_sim.recordings.track_lines.web import Web

SHORTEST_M: Final = 4.0
"""Shorter stretches inside or outside of a junction are of the one around them."""
CHOICE_M: Final = 15.0
"""Ways that part so soon behind the beginning of a junction are apart from there on, as in a map:
drivers have chosen before it. And so are ways up to its end that join this little before it."""

MERGING_M: Final = 40.0
"""Ways from a junction that take longer to merge are lanes side by side until then."""


@dataclass(frozen=True)
class Piece:
    """Points of the web one after the other, and the numbers of the pieces that follow."""

    points: tuple[int, ...]
    inside: bool  # of a junction
    ahead: tuple[int, ...]


def pieces_of(web: Web, inside: BoolArray, gates: Container[int]) -> list[Piece]:
    """The strands of a web, cut at gates and where points [V] begin and cease to be `inside`."""
    cut: list[tuple[tuple[int, ...], bool]] = []
    for strand in web.strands(gates):
        flags = _without_short(inside[strand[:-1]])
        bounds = [0, *(np.flatnonzero(np.diff(flags)) + 1).tolist(), len(flags)]
        if strand[-1] in gates:  # those who wait are not inside
            flags[bounds[-2] :] = False
            bounds = [0, *(np.flatnonzero(np.diff(flags)) + 1).tolist(), len(flags)]
        for first, last in pairwise(bounds):
            cut.append((tuple(strand[first : last + 1]), bool(flags[first])))
    starting: dict[int, list[int]] = {}
    for number, (points, _) in enumerate(cut):
        starting.setdefault(points[0], []).append(number)
    pieces = [
        Piece(points, is_inside, tuple(starting.get(points[-1], ()))) for points, is_inside in cut
    ]
    pieces = _inside_until_merged(pieces, gates)
    # Backwards, what joins late parts early.
    return _joined(_backwards(_parted_early(_backwards(_parted_early(pieces)))))


def _without_short(flags: BoolArray) -> BoolArray:
    """Flags [N] a step apart, without runs shorter than `SHORTEST_M`, the shortest first."""
    flags = flags.copy()
    while True:
        bounds = np.concatenate(([0], np.flatnonzero(np.diff(flags)) + 1, [len(flags)]))
        lengths = np.diff(bounds)
        if len(lengths) < 2 or lengths.min() * STEP_M >= SHORTEST_M:
            return flags
        k = int(lengths.argmin())
        flags[bounds[k] : bounds[k + 1]] ^= True


def _inside_until_merged(pieces: Sequence[Piece], gates: Container[int]) -> list[Piece]:
    """The pieces, of which those that lead from a junction into a merge are inside of it as well.

    As on a map a junction ends where its ways have become one; drivers take longer to merge.
    """
    inside = [piece.inside for piece in pieces]
    arriving = Counter(piece.points[-1] for piece in pieces)
    open_numbers = [k for k, piece in enumerate(pieces) if piece.inside]
    while open_numbers:
        for k in pieces[open_numbers.pop()].ahead:
            end = pieces[k].points[-1]
            short = (len(pieces[k].points) - 1) * STEP_M < MERGING_M
            if not inside[k] and short and arriving[end] > 1 and end not in gates:
                inside[k] = True
                open_numbers.append(k)
    return [replace(piece, inside=flag) for piece, flag in zip(pieces, inside, strict=True)]


def _parted_early(pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces, with one for each way where ways part inside a junction soon after entering it.

    A piece that forks there becomes a copy for each piece that follows, joined to it where nothing
    else leads there.
    """
    known: dict[int, Piece] = dict(enumerate(pieces))
    before = _before(known)
    open_numbers = [
        k
        for k, piece in known.items()
        if piece.inside and before[k] and not any(known[b].inside for b in before[k])
    ]
    free = len(known)
    while open_numbers:
        number = open_numbers.pop(0)
        piece = known[number]
        short = (len(piece.points) - 1) * STEP_M < CHOICE_M
        if len(piece.ahead) < 2 or not short or not all(known[k].inside for k in piece.ahead):
            continue
        del known[number]
        copies: list[int] = []
        for following in piece.ahead:
            way = known[following]
            if before[following] == {number}:
                copy = replace(way, points=piece.points + way.points[1:])
                del known[following]
                open_numbers.append(free)
            else:
                copy = replace(piece, ahead=(following,))
                before[following].add(free)
                before[following].discard(number)
            for k in copy.ahead:
                before[k].add(free)
                before[k].discard(following)
            known[free] = copy
            before[free] = set(before[number])
            copies.append(free)
            free += 1
        for other in before[number]:
            ahead = [k for k in known[other].ahead if k != number]
            known[other] = replace(known[other], ahead=(*ahead, *copies))
    return _renumbered(known)


def _joined(pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces, of which those inside a junction that only follow each other are one."""
    known = dict(enumerate(pieces))
    before = _before(known)
    for number in range(len(pieces)):
        while number in known and known[number].inside and len(known[number].ahead) == 1:
            (following,) = known[number].ahead
            way = known[following]
            if not way.inside or before[following] != {number} or following == number:
                break
            points = known[number].points + way.points[1:]
            known[number] = replace(way, points=points)
            for k in way.ahead:
                before[k] = {number if other == following else other for other in before[k]}
            del known[following]
    return _renumbered(known)


def _backwards(pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces as they are driven from their ends to their starts."""
    before = _before(dict(enumerate(pieces)))
    return [
        Piece(piece.points[::-1], piece.inside, tuple(sorted(before[k])))
        for k, piece in enumerate(pieces)
    ]


def _before(pieces: dict[int, Piece]) -> dict[int, set[int]]:
    """The pieces that lead to each."""
    before: dict[int, set[int]] = {k: set() for k in pieces}
    for k, piece in pieces.items():
        for following in piece.ahead:
            before[following].add(k)
    return before


def _renumbered(pieces: dict[int, Piece]) -> list[Piece]:
    """Without gaps in the numbers."""
    number = {old: new for new, old in enumerate(sorted(pieces))}
    return [
        replace(pieces[old], ahead=tuple(sorted(number[k] for k in pieces[old].ahead)))
        for old in sorted(pieces)
    ]
