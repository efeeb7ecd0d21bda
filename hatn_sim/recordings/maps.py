"""The map beside recorded tracks -> its lanes: a Lanelet2 map, a SUMO net or the road of a run."""

from __future__ import annotations

from pathlib import Path

from hatn_sim.datatypes import Lane
from hatn_sim.errors import InputError

_LANELET2 = (".osm", ".osm_xy")
_SUMO = (".net.xml", ".net.xml.gz")
_ROAD = (".json.gz",)


def read_lanes(path: Path) -> list[Lane]:
    """The lanes of a map, told by its name: .osm, .net.xml, .net.xml.gz or road.json.gz.

    Raises InputError for any other file, and where the map is at fault or has no lanes.
    """
    lanes = _read(path)
    if not lanes:
        raise InputError(f"{path}: expected lanes for vehicles, found none; give another map")
    return lanes


def _read(path: Path) -> list[Lane]:
    name = path.name.lower()
    if name.endswith(_LANELET2):
        from hatn_sim.recordings.lanelet2.reader import read_lanelet2

        return read_lanelet2(path)
    if name.endswith(_SUMO):
        from hatn_sim.simulators.sumo_net import read_net

        return read_net(path)
    if name.endswith(_ROAD):
        from hatn_sim.log.road_file import read_road

        return read_road(path)
    raise InputError(
        f"{path}: expected a map named *.osm (Lanelet2), *.net.xml or *.net.xml.gz (SUMO), or the "
        "road.json.gz of a run; rename it or give another map"
    )
