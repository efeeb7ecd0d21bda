"""The lane table that a SUMO worker sends, and the lanes it means. Pure: no libsumo here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from hatn_sim.datatypes import FloatArray, Gate, Kind, Lane

_CLASSES_OF_KIND: Mapping[Kind, tuple[str, ...]] = {
    Kind.CAR: ("passenger", "private", "taxi", "evehicle", "hov", "vip", "authority", "emergency",
               "army"),
    Kind.VAN: ("delivery",),
    Kind.LORRY: ("truck", "trailer"),
    Kind.BUS: ("bus", "coach"),
    Kind.MOTORCYCLE: ("motorcycle", "moped"),
    Kind.BICYCLE: ("bicycle", "scooter"),
    Kind.TRAM: ("tram", "rail_urban", "rail", "rail_electric", "rail_fast", "subway", "cable_car"),
    Kind.PEDESTRIAN: ("pedestrian", "wheelchair"),
}  # fmt: skip
KIND_OF_CLASS: Mapping[str, Kind] = {
    name: kind for kind, names in _CLASSES_OF_KIND.items() for name in names
}
"""SUMO's vehicle classes; those that are not here (ship, drone, custom1 ...) are Kind.OTHER."""

TURN_OF_DIRECTION: Mapping[str, int] = {
    "l": 1, "L": 1, "t": 1, "r": -1, "R": -1, "T": -1, "s": 0,
}  # fmt: skip
"""SUMO's link directions; t is a turnaround where traffic keeps right, T where it keeps left."""

_SELDOM_FORBIDDEN = frozenset({"wheelchair", "scooter"})
"""Classes that nets forget to forbid beside pedestrians and bicycles: they open no lane."""

CLOSED_SIGNALS = "ryuRY"
"""Signal states that forbid entering the link."""


@dataclass(frozen=True)
class Link:
    """The way from a lane to the next: SUMO's link, its state and direction letters."""

    successor: str
    state: str
    direction: str
    signal: int | None  # index into Scene.signal_closed


@dataclass(frozen=True, eq=False)
class LaneTable:
    """Every lane of a net, column by column."""

    ids: tuple[str, ...]  # [L]
    point_counts: tuple[int, ...]  # [L]
    xy_m: FloatArray  # [sum of point_counts, 2]
    length_m: tuple[float, ...]  # [L] as SUMO counts it
    width_m: tuple[float, ...]  # [L]
    speed_limit_mps: tuple[float, ...]  # [L]
    kinds: tuple[frozenset[Kind], ...]  # [L]
    links: tuple[tuple[Link, ...], ...]  # [L]


def is_connection(lane_id: str) -> bool:
    """Whether the lane lies inside a junction: SUMO's names for these begin with a colon."""
    return lane_id.startswith(":")


def junction_of(lane_id: str) -> str:
    """The junction that a lane inside it is part of.

    >>> junction_of(":north_3_0")
    'north'
    """
    return lane_id[1:].rpartition("_")[0].rpartition("_")[0]


def edge_of(lane_id: str) -> str:
    """The edge that a lane is part of."""
    return lane_id.rpartition("_")[0]


def kinds_of(classes: Iterable[str]) -> frozenset[Kind]:
    """The kinds that a list of SUMO's vehicle classes allows."""
    return frozenset(
        KIND_OF_CLASS.get(name, Kind.OTHER) for name in classes if name not in _SELDOM_FORBIDDEN
    )


def gate_of(links: Iterable[Link]) -> Gate:
    """What stands at the end of a lane with these links.

    A line to give way at needs every link to be minor: a lane of the major road, off which a left
    turn waits for oncoming traffic, has no line across it.
    """
    states = [link.state for link in links]
    if any(link.signal is not None for link in links):
        return Gate.SIGNAL
    if any(state in "ws" for state in states):
        return Gate.STOP_LINE
    if states and all(state == "m" for state in states):
        return Gate.GIVE_WAY_LINE
    return Gate.NONE


def lanes_of(table: LaneTable) -> list[Lane]:
    """The lanes of a table, in its order."""
    links_of = dict(zip(table.ids, table.links, strict=True))
    turns = _turns(links_of)
    ends = np.cumsum(table.point_counts)
    lanes: list[Lane] = []
    for row, lane_id in enumerate(table.ids):
        links = table.links[row]
        inside = is_connection(lane_id)
        signals = {link.successor: link.signal for link in links if link.signal is not None}
        lanes.append(
            Lane(
                id=lane_id,
                xy_m=table.xy_m[ends[row] - table.point_counts[row] : ends[row]],
                width_m=table.width_m[row],
                speed_limit_mps=table.speed_limit_mps[row],
                successors=tuple(dict.fromkeys(link.successor for link in links)),
                kinds=table.kinds[row],
                # A place to wait inside a junction (for oncoming traffic) is no line on the road.
                gate=Gate.NONE if inside else gate_of(links),
                signals=signals if signals and not inside else None,
                turn=turns.get(lane_id, 0),
                is_connection=inside,
            )
        )
    return lanes


def _turns(links_of: Mapping[str, tuple[Link, ...]]) -> dict[str, int]:
    """Turns of the connections; both halves of a split connection turn as the whole does."""
    turns: dict[str, int] = {}
    for lane_id, links in links_of.items():
        if is_connection(lane_id):
            continue
        for link in links:
            part = link.successor
            while is_connection(part) and part not in turns:
                turns[part] = TURN_OF_DIRECTION.get(link.direction, 0)
                onward = links_of.get(part, ())
                if onward:
                    part = onward[0].successor
    return turns
