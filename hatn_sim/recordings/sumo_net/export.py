"""Lanes -> a SUMO net: plain XML, which netconvert builds without moving anything."""

from __future__ import annotations

import gzip
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from hatn_sim.datatypes import FloatArray, Kind, Lane
from hatn_sim.errors import InputError
from hatn_sim.recordings.sumo_net.plan import NetPlan, PlannedConnection, plan_net
from hatn_sim.simulators.sumo_config import first_error
from hatn_sim.simulators.sumo_lanes import KIND_OF_CLASS
from hatn_sim.whole_file import save_whole

OPTIONS: Final = {
    "offset.disable-normalization": "true",  # the net stays in the frame of the map
    "no-turnarounds": "true",
    "precision": "3",
    "junctions.limit-turn-speed": "2.5",  # the default lets turns be driven too fast
    "xml-validation": "never",
}
SPECK_M: Final = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
FAR_M: Final = 1000.0
"""Where a junction's outline is while netconvert works, and how far from everything else."""
NAMES: Final = ("nod", "edg", "con")


def write_net(lanes: Iterable[Lane], path: Path) -> NetPlan:
    """Builds the net of lanes at `path` (.net.xml or .net.xml.gz); returns what it was built from.

    Coordinates are those of the lanes: netOffset is 0, 0.

    Raises InputError where there is no lane to drive on, netconvert is not installed, or it
    refuses the lanes.
    """
    plan = plan_net(lanes)
    if not plan.edges:
        raise InputError(f"{path}: no net is written: the map has no lane for vehicles")
    netconvert = find_netconvert()
    with tempfile.TemporaryDirectory() as folder:
        trees = (node_tree(plan), edge_tree(plan), connection_tree(plan))
        files = [Path(folder) / f"plain.{name}.xml" for name in NAMES]
        for file, tree in zip(files, trees, strict=True):
            ElementTree.ElementTree(tree).write(file, encoding="utf-8", xml_declaration=True)
        inputs = dict(
            zip(("node-files", "edge-files", "connection-files"), map(str, files), strict=True)
        )
        built = Path(folder) / "built.net.xml"
        options = inputs | OPTIONS | {"output-file": str(built)}
        words = [word for key, value in options.items() for word in (f"--{key}", value)]
        said = subprocess.run([netconvert, *words], capture_output=True, text=True, check=False)
        if said.returncode or not built.is_file():
            reason = first_error(said.stderr) or f"exit code {said.returncode}"
            raise InputError(f"{path}: netconvert refuses the lanes of the map: {reason}")
        net = ElementTree.parse(built)
    outlines = {node.id: _shape(node.shape_m) for node in plan.nodes}
    for junction in net.iter("junction"):
        if junction.get("id") in outlines:
            junction.set("shape", outlines[junction.attrib["id"]])
    for location in net.iter("location"):
        location.set("origBoundary", location.attrib["convBoundary"])
    _deliver(ElementTree.tostring(net.getroot(), encoding="utf-8", xml_declaration=True), path)
    return plan


def find_netconvert() -> str:
    """The path of netconvert. Raises InputError where it is not installed."""
    beside = Path(sys.executable).parent / "netconvert"
    found = shutil.which("netconvert") or shutil.which(str(beside))
    if found is None:
        raise InputError(
            "netconvert: expected it to be installed, it is not; "
            "get it with: pip install 'hatn-sim[gui]'"
        )
    return found


def node_tree(plan: NetPlan) -> Element:
    """The junctions, with outlines far off: netconvert would cut or draw out lanes to them."""
    root = Element("nodes")
    far_off_m = np.min([node.shape_m.min(axis=0) for node in plan.nodes], axis=0) - FAR_M
    for node in plan.nodes:
        x_m, y_m = node.shape_m.mean(axis=0)
        place = {"x": f"{x_m:.3f}", "y": f"{y_m:.3f}"}
        shape = _shape(far_off_m + SPECK_M)
        SubElement(root, "node", {"id": node.id, "type": node.type, **place, "shape": shape})
    return root


def edge_tree(plan: NetPlan) -> Element:
    """The edges with the shape of every lane; `origId` are the names of the lanes as given."""
    root = Element("edges")
    for edge in plan.edges:
        attributes = {
            "id": edge.id,
            "from": edge.source,
            "to": edge.target,
            "numLanes": str(len(edge.lanes)),
            "priority": "2" if edge.has_right_of_way else "1",
            "shape": _shape(edge.lanes[-1].lane.xy_m),
        }
        element = SubElement(root, "edge", attributes)
        for index, chain in enumerate(edge.lanes):
            lane = chain.lane
            attributes = {
                "index": str(index),
                "speed": f"{lane.speed_limit_mps:.3f}",
                "width": f"{lane.width_m:.3f}",
                "shape": _shape(lane.xy_m),
            }
            child = SubElement(element, "lane", attributes | _allowed(lane.kinds))
            SubElement(child, "param", {"key": "origId", "value": " ".join(chain.given)})
    return root


def connection_tree(plan: NetPlan) -> Element:
    """The ways through the junctions; an edge that leads nowhere is said to."""
    root = Element("connections")
    sources = {connection.source[0] for connection in plan.connections}
    for connection in plan.connections:
        SubElement(root, "connection", _connection(connection))
    for edge in plan.edges:
        if edge.id not in sources:
            SubElement(root, "connection", {"from": edge.id})
    return root


def _connection(connection: PlannedConnection) -> dict[str, str]:
    attributes = {
        "from": connection.source[0],
        "to": connection.target[0],
        "fromLane": str(connection.source[1]),
        "toLane": str(connection.target[1]),
        "speed": f"{connection.speed_mps:.3f}",
    }
    if connection.through:
        attributes["shape"] = _shape(connection.shape_m)
    return attributes


def _shape(xy_m: FloatArray) -> str:
    return " ".join(f"{x_m:.3f},{y_m:.3f}" for x_m, y_m in xy_m.tolist())


def _allowed(kinds: frozenset[Kind]) -> dict[str, str]:
    if kinds >= frozenset(Kind):
        return {}
    return {"allow": " ".join(name for name, kind in KIND_OF_CLASS.items() if kind in kinds)}


def _deliver(content: bytes, path: Path) -> None:
    data = gzip.compress(content, mtime=0) if path.suffix == ".gz" else content
    save_whole(path, data, "give another --out")
