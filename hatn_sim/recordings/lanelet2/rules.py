"""What Lanelet2's tags say: who may use a lanelet, how fast, which way, and where it must wait.

As in Lanelet2's own documents of tags (LaneletAndAreaTagging, RegulatoryElementTagging).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from hatn_sim.datatypes import Gate, Kind
from hatn_sim.recordings.lanelet2.osm import OsmMap, Relation

MOTOR: Final = frozenset(
    {Kind.CAR, Kind.VAN, Kind.LORRY, Kind.BUS, Kind.MOTORCYCLE, Kind.OTHER}
)  # fmt: skip
ROAD_KINDS: Final = MOTOR | {Kind.BICYCLE}
KINDS_OF_SUBTYPE: Final[Mapping[str, frozenset[Kind]]] = {
    "road": ROAD_KINDS,
    "highway": MOTOR,
    "play_street": ROAD_KINDS | {Kind.PEDESTRIAN},
    "exit": ROAD_KINDS | {Kind.PEDESTRIAN},
    "emergency_lane": frozenset({Kind.OTHER}),
    "bus_lane": frozenset({Kind.BUS}),
    "bicycle_lane": frozenset({Kind.BICYCLE}),
    "rail": frozenset({Kind.TRAM}),
    "shared_walkway": frozenset({Kind.PEDESTRIAN, Kind.BICYCLE}),
    "walkway": frozenset({Kind.PEDESTRIAN}),
    "crosswalk": frozenset({Kind.PEDESTRIAN}),
    "stairs": frozenset({Kind.PEDESTRIAN}),
}
"""Those not named here are roads."""
PARTICIPANT_OF_KIND: Final[Mapping[Kind, str]] = {
    Kind.CAR: "vehicle:car",
    Kind.VAN: "vehicle:car:van",
    Kind.LORRY: "vehicle:truck",
    Kind.BUS: "vehicle:bus",
    Kind.MOTORCYCLE: "vehicle:motorcycle",
    Kind.BICYCLE: "bicycle",
    Kind.TRAM: "tram",
    Kind.PEDESTRIAN: "pedestrian",
    Kind.OTHER: "vehicle:other",
}
"""A kind obeys the tag of the longest beginning of its name."""

KMH: Final = 1 / 3.6
MPH: Final = 0.44704
UNITS_MPS: Final[Mapping[str, float]] = {
    "": KMH, "km/h": KMH, "kmh": KMH, "kph": KMH, "mph": MPH, "m/s": 1.0, "mps": 1.0,
}  # fmt: skip
WALKING_MPS: Final = 5 * KMH
CYCLING_MPS: Final = 25 * KMH
LIMIT_OF_SUBTYPE_MPS: Final[Mapping[str, float]] = {
    "highway": 130 * KMH,
    "play_street": 7 * KMH,
    "bicycle_lane": CYCLING_MPS,
    "shared_walkway": CYCLING_MPS,
    "walkway": WALKING_MPS,
    "crosswalk": WALKING_MPS,
    "stairs": WALKING_MPS,
}
URBAN_MPS: Final = 50 * KMH
NONURBAN_MPS: Final = 100 * KMH
NONURBAN: Final = ("nonurban", "rural", "country")

_LIMIT_SIGN: Final = re.compile(r"^(?:de)?274(?:\.1)?[-_.](\d+)$|^us_?r2-1[-_.](\d+)$")
_STOP_SIGN: Final = re.compile(r"r1-1\b|\b(?:de)?206$|\bstop(?:_sign)?$")


def kinds_of(tags: Mapping[str, str]) -> frozenset[Kind]:
    """Who may use a lanelet: its participants, else what its subtype stands for."""
    said = {
        key.removeprefix("participant:"): value == "yes"
        for key, value in tags.items()
        if key.startswith("participant:")
    }
    if not said:
        return KINDS_OF_SUBTYPE.get(tags.get("subtype", ""), ROAD_KINDS)
    return frozenset(kind for kind, name in PARTICIPANT_OF_KIND.items() if _obeys(name, said))


def _obeys(name: str, said: Mapping[str, bool]) -> bool:
    while name not in said and ":" in name:
        name = name.rpartition(":")[0]
    return said.get(name, False)


def is_one_way(tags: Mapping[str, str], kinds: frozenset[Kind]) -> bool:
    """Lanelets run one way unless they say otherwise; those for pedestrians alone, both ways."""
    return tags.get("one_way", "yes" if kinds - {Kind.PEDESTRIAN} else "no") != "no"


def speed_mps(text: str) -> float | None:
    """A speed as tags give it (`50`, `50 km/h`, `25 mph`, `13.9 m/s`); None: no such thing."""
    found = re.match(r"^\s*(\d+(?:\.\d+)?)\s*([a-z/]*)\s*$", text.lower())
    unit_mps = UNITS_MPS.get(found[2]) if found else None
    return float(found[1]) * unit_mps if found and unit_mps is not None else None


def speed_limit_mps(tags: Mapping[str, str], rules: list[Relation], osm: OsmMap) -> float:
    """The limit of a lanelet: of its rules, of its own tag, else the usual one of its kind."""
    subtype = tags.get("subtype", "road")
    said = [_limit_of_sign(sign) for rule in rules for sign in signs_of(rule, osm)]
    said.append(speed_mps(tags.get("speed_limit", "")))
    usual_mps = NONURBAN_MPS if tags.get("location") in NONURBAN else URBAN_MPS
    said.append(LIMIT_OF_SUBTYPE_MPS.get(subtype, usual_mps))
    return next(limit for limit in said if limit)


def signs_of(rule: Relation, osm: OsmMap) -> list[str]:
    """The names of the signs that make a rule, in small letters: `de205`, `usr1-1`, `25 mph`."""
    names = [rule.tags.get("sign_type", "")]
    names += [osm.ways[ref].tags.get("subtype", "") for ref in rule.refs("way", "refers")
              if ref in osm.ways]  # fmt: skip
    return [name.lower() for name in names if name]


def _limit_of_sign(sign: str) -> float | None:
    found = _LIMIT_SIGN.match(sign)
    if found is None:
        return speed_mps(sign) if any(unit in sign for unit in UNITS_MPS if unit) else None
    return float(found[1]) * KMH if found[1] else float(found[2]) * MPH


def gate_of(rule: Relation, osm: OsmMap) -> Gate:
    """What a rule makes of the line where one waits."""
    subtype = rule.tags.get("subtype", "")
    signs = signs_of(rule, osm)
    has_stop_sign = any(_STOP_SIGN.search(sign) for sign in signs)
    if subtype == "traffic_light":
        return Gate.SIGNAL
    if subtype == "all_way_stop" or (has_stop_sign and subtype in ("right_of_way", "traffic_sign")):
        return Gate.STOP_LINE
    gives_way = any(re.search(r"r1-2\b|\b(?:de)?205$|yield|give_way", sign) for sign in signs)
    if subtype == "right_of_way" or (subtype == "traffic_sign" and gives_way):
        return Gate.GIVE_WAY_LINE
    return Gate.NONE
