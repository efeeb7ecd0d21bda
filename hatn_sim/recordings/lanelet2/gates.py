"""Gates: where Lanelet2's regulatory elements and stop lines make vehicles wait."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, Gate, Lane
from hatn_sim.errors import InputError
from hatn_sim.geometry import arc_length_m
from hatn_sim.recordings.lanelet2.bounds import crossings, split
from hatn_sim.recordings.lanelet2.osm import OsmMap
from hatn_sim.recordings.lanelet2.rules import MOTOR, gate_of

AT_END_M: Final = 2.0
"""A line nearer to the end of a lane stands at its end; further inside, the lane is cut there."""
REACH_M: Final = 0.5
"""Lines that end this little short of a lane's middle still stand across it."""
MIN_SINE: Final = 0.5
"""A line across a lane meets it at 30 degrees at least."""
CUT: Final = "+"
"""Ends the name of the part of a lane behind a stop line."""


@dataclass(frozen=True, eq=False)
class Rule:
    gate: Gate
    lines: tuple[FloatArray, ...]  # each [P, 2]; none: at the ends of the lanes
    lanelets: frozenset[str] | None  # those that wait; None: whoever crosses the line


def with_gates(
    path: Path, osm: OsmMap, lanes: Sequence[Lane], lanelet_of: Mapping[str, str]
) -> list[Lane]:
    """The lanes with their gates; a lane with a stop line inside is cut in two at it.

    `lanelet_of` gives the lanelet of every lane.

    Raises:
        InputError: a rule names a stop line that is not in the map.
    """
    predecessors: dict[str, list[Lane]] = {lane.id: [] for lane in lanes}
    for lane in lanes:
        for name in lane.successors:
            predecessors[name].append(lane)
    ends: dict[str, Gate] = {}
    cuts: dict[str, list[tuple[float, Gate]]] = {}
    for rule in _rules(path, osm):
        waiting = [lane for lane in lanes if _concerns(rule, lane, predecessors, lanelet_of)]
        found = _lines_met_m(rule, waiting)
        if not found and rule.lanelets is not None:
            named = [lane for lane in waiting if lanelet_of[lane.id] in rule.lanelets]
            found = {lane.id: _without_line_m(lane, predecessors[lane.id]) for lane in named}
        starts: set[str] = set()
        for name, (at_m, length_m) in found.items():
            if length_m - at_m <= AT_END_M:
                _note(ends, name, rule.gate)
            elif at_m <= AT_END_M:
                starts.add(name)
            else:
                cuts.setdefault(name, []).append((at_m, rule.gate))
        for name in starts:
            for before in predecessors[name]:
                # A line for one of several ways on (a turn) is none for all of them.
                if rule.gate is not Gate.GIVE_WAY_LINE or starts.issuperset(before.successors):
                    _note(ends, before.id, rule.gate)
    out: list[Lane] = []
    for lane in lanes:
        gated = replace(lane, gate=ends.get(lane.id, Gate.NONE))
        out += _cut(gated, cuts.get(lane.id, []))
    return out


def _rules(path: Path, osm: OsmMap) -> list[Rule]:
    rules: list[Rule] = []
    used: set[str] = set()
    for name, relation in osm.relations.items():
        if relation.tags.get("type") != "regulatory_element":
            continue
        refs = relation.refs("way", "ref_line")
        used.update(refs)
        missing = next((ref for ref in refs if ref not in osm.ways), None)
        if missing is not None:
            raise InputError(
                f"{path}: regulatory element {name} names way {missing} as its line, which is not "
                "in the map; the file is cut off or was cut out: export the whole map"
            )
        gate = gate_of(relation, osm)
        if gate is Gate.NONE:
            continue
        lanelets = set(relation.refs("relation", "yield"))
        if not lanelets:
            lanelets = {
                other
                for other, lanelet in osm.relations.items()
                if name in lanelet.refs("relation", "regulatory_element")
            }.difference(relation.refs("relation", "right_of_way"))
        lines = tuple(osm.ways[ref].xy_m for ref in refs if len(osm.ways[ref].nodes) > 1)
        rules.append(Rule(gate, lines, frozenset(lanelets)))
    for name, way in osm.ways.items():
        if way.tags.get("type") == "stop_line" and name not in used and len(way.nodes) > 1:
            rules.append(Rule(Gate.STOP_LINE, (way.xy_m,), None))
    return rules


def _concerns(
    rule: Rule,
    lane: Lane,
    predecessors: Mapping[str, Sequence[Lane]],
    lanelet_of: Mapping[str, str],
) -> bool:
    """Whether a lane, or the one behind or before it, is among those that wait."""
    if rule.lanelets is None:
        return bool(lane.kinds & MOTOR)
    near = [lane.id, *lane.successors, *(before.id for before in predecessors[lane.id])]
    return any(lanelet_of[name] in rule.lanelets for name in near)


def _lines_met_m(rule: Rule, lanes: Sequence[Lane]) -> dict[str, tuple[float, float]]:
    """Lane -> arc length where it meets a line of the rule, and its length."""
    found: dict[str, tuple[float, float]] = {}
    for line in rule.lines:
        for lane in lanes:
            at_m, _, sine = crossings(lane.xy_m, _drawn_out(line))
            across = np.abs(sine) >= MIN_SINE
            if across.any():
                length_m = float(arc_length_m(lane.xy_m)[-1])
                found.setdefault(lane.id, (float(at_m[across][0]), length_m))
    return found


def _without_line_m(lane: Lane, predecessors: Sequence[Lane]) -> tuple[float, float]:
    """The same where no line is drawn: before the fork, or else at the lane's end."""
    length_m = float(arc_length_m(lane.xy_m)[-1])
    forks = any(len(before.successors) > 1 for before in predecessors)
    return (0.0 if forks else length_m), length_m


def _drawn_out(line: FloatArray) -> FloatArray:
    """A line [P, 2], `REACH_M` longer at both ends."""
    ends = np.array([line[0] - line[1], line[-1] - line[-2]])
    ends *= REACH_M / np.maximum(np.linalg.norm(ends, axis=1), 1e-9)[:, None]
    return np.vstack([line[:1] + ends[:1], line, line[-1:] + ends[1:]])


def _note(ends: dict[str, Gate], name: str, gate: Gate) -> None:
    """Where several rules meet, signals count before stop signs, and these before give-way ones."""
    order = (Gate.NONE, Gate.GIVE_WAY_LINE, Gate.STOP_LINE, Gate.SIGNAL)
    ends[name] = max(ends.get(name, Gate.NONE), gate, key=order.index)


def _cut(lane: Lane, cuts: Sequence[tuple[float, Gate]]) -> list[Lane]:
    """The lane cut at arc lengths where it has a gate."""
    parts: list[Lane] = []
    begin_m = 0.0
    for at_m, gate in sorted(cuts, key=lambda cut: cut[0]):
        if at_m - begin_m <= AT_END_M:
            continue
        before, after = split(lane.xy_m, at_m - begin_m)
        behind = lane.id + CUT
        parts.append(replace(lane, xy_m=before, successors=(behind,), gate=gate))
        lane = replace(lane, id=behind, xy_m=after)
        begin_m = at_m
    return [*parts, lane]
