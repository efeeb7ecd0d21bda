"""How vehicles look whose recording does not say so: by SUMO's vehicle types, or by a guess."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

from hatn_sim.datatypes import Kind
from hatn_sim.errors import InputError
from hatn_sim.safe_xml import iterparse_xml
from hatn_sim.simulators.sumo_lanes import KIND_OF_CLASS

Colour = tuple[int, int, int]

SUMO_YELLOW: Final[Colour] = (255, 255, 0)
"""SUMO's colour of what has none."""
_SIZE_OF_CLASS_M: Final[Mapping[str, tuple[float, float]]] = {
    "emergency": (6.5, 2.16),
    "delivery": (6.5, 2.16),
    "truck": (7.1, 2.4),
    "trailer": (16.5, 2.55),
    "bus": (12.0, 2.5),
    "coach": (14.0, 2.6),
    "motorcycle": (2.2, 0.9),
    "moped": (2.1, 0.78),
    "bicycle": (1.6, 0.65),
    "scooter": (1.2, 0.5),
    "tram": (22.0, 2.4),
    "rail_urban": (109.5, 3.0),
    "rail": (135.0, 2.84),
    "rail_electric": (200.0, 2.95),
    "rail_fast": (200.0, 2.95),
    "subway": (109.5, 3.0),
    "pedestrian": (0.215, 0.478),
    "wheelchair": (1.2, 0.72),
    "ship": (17.0, 4.0),
    "drone": (0.5, 0.5),
    "container": (6.096, 2.438),
    "aircraft": (72.7, 79.8),
}
"""Length and width of a type that gives none: SUMO 1.28; classes that are not here, a car's."""
_CAR_SIZE_M: Final = (5.0, 1.8)
_CLASS_OF_DEFAULT: Final[Mapping[str, str]] = {
    "DEFAULT_VEHTYPE": "passenger",
    "DEFAULT_PEDTYPE": "pedestrian",
    "DEFAULT_BIKETYPE": "bicycle",
    "DEFAULT_TAXITYPE": "taxi",
    "DEFAULT_RAILTYPE": "rail",
    "DEFAULT_CONTAINERTYPE": "container",
}
"""The types that SUMO brings."""
_CLASS_OF_NAME: Final = (
    ("motorcycle", "moto"),
    ("moped", "moped"),
    ("bicycle", "bike|bicyc|cyclist"),
    ("pedestrian", "ped|person|walker"),
    ("trailer", "trailer"),
    ("truck", "truck|lorry|hgv"),
    ("coach", "coach"),
    ("bus", "bus"),
    ("tram", "tram|streetcar"),
    ("rail", "rail|train"),
    ("delivery", "delivery|van"),
    ("emergency", "emergency|ambulance"),
)
"""Class -> what in a type's name speaks for it; the first that fits counts."""
_MAX_ELEMENTS: Final = 100_000
"""Types stand before the vehicles that use them: a city's trips need not be read to their end."""
_COLOURS: Final[Mapping[str, Colour]] = {
    "red": (255, 0, 0),
    "green": (0, 255, 0),
    "blue": (0, 0, 255),
    "yellow": SUMO_YELLOW,
    "cyan": (0, 255, 255),
    "magenta": (255, 0, 255),
    "orange": (255, 128, 0),
    "white": (255, 255, 255),
    "black": (0, 0, 0),
    "grey": (128, 128, 128),
    "gray": (128, 128, 128),
}


@dataclass(frozen=True)
class VehicleType:
    """What all vehicles of a type have in common."""

    length_m: float
    width_m: float
    kind: Kind
    colour: Colour


def of_class(vehicle_class: str) -> VehicleType:
    """A type as SUMO has it that says nothing but its class."""
    length_m, width_m = _SIZE_OF_CLASS_M.get(vehicle_class, _CAR_SIZE_M)
    kind = KIND_OF_CLASS.get(vehicle_class, Kind.OTHER)
    return VehicleType(length_m, width_m, kind, SUMO_YELLOW)


def type_of(types: Mapping[str, VehicleType], name: str) -> VehicleType | None:
    """A type by its name; one that SUMO varied for a single vehicle is named `type@vehicle`."""
    return types.get(name) or types.get(name.partition("@")[0])


def guessed(name: str) -> VehicleType:
    """A type of which only the name is known: a car, unless the name says otherwise."""
    for vehicle_class, words in _CLASS_OF_NAME:
        if re.search(words, name, re.IGNORECASE):
            return of_class(vehicle_class)
    return of_class("passenger")


def read_colour(text: str | None) -> Colour:
    """SUMO's ways to write a colour: a name, `255,0,0`, `1.0,0,0` or `#ff0000`; else yellow."""
    if text is None:
        return SUMO_YELLOW
    if text in _COLOURS:
        return _COLOURS[text]
    if re.fullmatch("#[0-9a-fA-F]{6}([0-9a-fA-F]{2})?", text):
        return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)
    try:
        red, green, blue = (float(part) for part in text.split(",")[:3])
    except ValueError:
        return SUMO_YELLOW
    scale = 255 if "." in text and max(red, green, blue) <= 1 else 1
    red, green, blue = (min(max(round(scale * part), 0), 255) for part in (red, green, blue))
    return red, green, blue


def read_types(folders: Iterable[Path]) -> dict[str, VehicleType]:
    """Types by name from the .rou.xml and .add.xml files (also gzipped) of some folders, and those
    that SUMO brings.

    Where two files define a type, the first counts, by folder and name. Files that cannot be
    read have none.
    """
    types: dict[str, VehicleType] = {}
    paths = [path for folder in folders for path in sorted(folder.glob("*.xml*"))]
    for path in dict.fromkeys(path.resolve() for path in paths if _may_have_types(path.name)):
        for element in _types_in(path):
            name = element.get("id")
            if name is not None:
                types.setdefault(name, _type_of(element))
    for name, vehicle_class in _CLASS_OF_DEFAULT.items():
        types.setdefault(name, of_class(vehicle_class))
    return types


def _may_have_types(name: str) -> bool:
    return re.search(r"\.(rou|add|additional)\.xml(\.gz)?$", name, re.IGNORECASE) is not None


def _types_in(path: Path) -> Iterator[Element]:
    for root in ("routes", "additional"):
        try:
            for element in islice(iterparse_xml(path, root), _MAX_ELEMENTS):
                yield from element.iter("vType")
        except InputError:
            continue


def _type_of(element: Element) -> VehicleType:
    default = of_class(element.get("vClass", "passenger"))
    return VehicleType(
        length_m=_positive(element.get("length"), default.length_m),
        width_m=_positive(element.get("width"), default.width_m),
        kind=default.kind,
        colour=read_colour(element.get("color")),
    )


def _positive(text: str | None, default: float) -> float:
    try:
        value = default if text is None else float(text)
    except ValueError:
        return default
    return value if 0 < value < float("inf") else default
