"""The elements of an OSM file, in metres: what Lanelet2 maps are made of.

Nodes of an `.osm` are latitudes and longitudes near (0, 0). As in the INTERACTION data set they are
projected to UTM zone 31N, less the projection of (0, 0). Where nodes carry `x` and `y` in metres
(`.osm_xy`), these are taken as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.etree.ElementTree import Element

import numpy as np

from hatn_sim.datatypes import FloatArray
from hatn_sim.errors import InputError
from hatn_sim.safe_xml import parse_xml

if TYPE_CHECKING:
    from pyproj import Transformer

CRS_OF_ANGLES: Final = "EPSG:4326"
CRS_OF_METRES: Final = "EPSG:32631"  # UTM zone 31N


@dataclass(frozen=True, eq=False)
class Way:
    """A polyline."""

    nodes: tuple[str, ...]  # [P] ids
    xy_m: FloatArray  # [P, 2]
    tags: Mapping[str, str]


@dataclass(frozen=True)
class Member:
    type: str  # "node", "way" or "relation"
    ref: str
    role: str


@dataclass(frozen=True)
class Relation:
    members: tuple[Member, ...]
    tags: Mapping[str, str]

    def refs(self, type: str, *roles: str) -> list[str]:
        """The members of a type in any of these roles, in their order."""
        return [m.ref for m in self.members if m.type == type and m.role in roles]


@dataclass(frozen=True)
class OsmMap:
    """Ways and relations by id. What a map lists twice is there once: the last one counts."""

    ways: Mapping[str, Way]
    relations: Mapping[str, Relation]


def to_metres() -> Transformer:
    """Longitude and latitude in degrees -> UTM in metres, the origin not yet taken off."""
    from pyproj import Transformer  # on first use: it brings a database along

    return Transformer.from_crs(CRS_OF_ANGLES, CRS_OF_METRES, always_xy=True)


def read_osm(path: Path) -> OsmMap:
    """The ways and relations of a file.

    Raises:
        InputError: cannot be read, is no OSM, has nodes that are no numbers, or a way names a node
            that is not there.
    """
    root = parse_xml(path)
    if root.tag != "osm":
        raise InputError(
            f"{path}: expected a Lanelet2 map (<osm>), found <{root.tag}>; give the .osm file"
        )
    elements = [element for element in root if element.get("action") != "delete"]
    ids, xy_m = _nodes(path, [element for element in elements if element.tag == "node"])
    row_of = {node: row for row, node in enumerate(ids)}
    ways = {
        element.get("id", ""): _way(path, element, row_of, xy_m)
        for element in elements
        if element.tag == "way"
    }
    relations = {
        element.get("id", ""): Relation(
            tuple(
                Member(m.get("type", ""), m.get("ref", ""), m.get("role", ""))
                for m in element.iter("member")
            ),
            _tags(element),
        )
        for element in elements
        if element.tag == "relation"
    }
    return OsmMap(ways, relations)


def _tags(element: Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "").strip() for tag in element.iter("tag")}


def _nodes(path: Path, elements: list[Element]) -> tuple[list[str], FloatArray]:
    """Ids and positions [n, 2] in metres."""
    ids = [element.get("id", "") for element in elements]
    if not elements:
        return ids, np.zeros((0, 2))
    named = [dict(element.items()) for element in elements]
    if "lat" not in named[0] and "x" not in named[0]:
        named = [attributes | _tags(e) for attributes, e in zip(named, elements, strict=True)]
    in_metres = "x" in named[0]
    keys = ("x", "y") if in_metres else ("lon", "lat")
    xy = np.empty((len(ids), 2))
    for row, values in enumerate(named):
        try:
            xy[row] = [float(values[key]) for key in keys]
        except (KeyError, ValueError) as error:
            raise InputError(
                f"{path}: node {ids[row]}: expected numbers in {keys[0]} and {keys[1]}, "
                f"found {values.get(keys[0])!r} and {values.get(keys[1])!r}; correct the map"
            ) from error
    if not in_metres:
        project = to_metres().transform
        xy = np.stack(project(xy[:, 0], xy[:, 1]), axis=1) - np.array(project(0.0, 0.0))
    wrong = np.flatnonzero(~np.isfinite(xy).all(axis=1))
    if len(wrong):
        raise InputError(
            f"{path}: node {ids[wrong[0]]}: expected a place near latitude and longitude 0, where "
            "maps of recorded tracks have their origin, found one that has no place in metres; "
            "shift the map"
        )
    return ids, xy


def _way(path: Path, element: Element, row_of: Mapping[str, int], xy_m: FloatArray) -> Way:
    nodes = [nd.get("ref", "") for nd in element.iter("nd")]
    missing = next((node for node in nodes if node not in row_of), None)
    if missing is not None:
        raise InputError(
            f"{path}: way {element.get('id')} names node {missing}, which is not in the map; "
            "the file is cut off or was cut out: export the whole map"
        )
    # A node named twice in a row adds nothing.
    nodes = [n for n, before in zip(nodes, [None, *nodes], strict=False) if n != before]
    return Way(tuple(nodes), xy_m[[row_of[node] for node in nodes]], _tags(element))
