"""Build a SUMO net from a map, in the map's own frame, and say how true it is.

The map is a Lanelet2 map (.osm), the road of a run (road.json.gz) or another SUMO net. Recorded
tracks on the map can then be replayed inside SUMO. Needs netconvert: pip install 'hatn-sim[gui]'.

Lanes keep their centre lines, widths, speed limits and who may use them; lanes side by side become
one edge, so that SUMO's drivers can change between them. Right of way follows the stop and
give-way lines of the map; without any it is right before left. Where there are signals SUMO makes
up a programme. netOffset is 0, 0: net and tracks are in one frame.
"""

from __future__ import annotations

import argparse
from pathlib import Path

EXAMPLES = """examples:
  hatn-sim net place.osm --out place.net.xml
  hatn-sim net runs/mine/road.json.gz --out place.net.xml --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim net`."""
    parser.add_argument("map", metavar="MAP", type=Path, help="a .osm, road.json.gz or .net.xml")
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help="the net to write, named *.net.xml or *.net.xml.gz",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of lines")


def main(arguments: argparse.Namespace) -> int:
    """Read, build, check."""
    import json
    from dataclasses import asdict

    from hatn_sim.errors import InputError
    from hatn_sim.recordings.maps import read_lanes
    from hatn_sim.recordings.sumo_net.check import check_net
    from hatn_sim.recordings.sumo_net.export import write_net
    from hatn_sim.simulators.sumo_net import read_net

    out: Path = arguments.out
    if not out.name.endswith((".net.xml", ".net.xml.gz")):
        raise InputError(f"--out {out}: expected a name that ends in .net.xml or .net.xml.gz")
    lanes = read_lanes(arguments.map)
    plan = write_net(lanes, out)
    check = check_net(lanes, plan, read_net(out))
    if arguments.json:
        print(json.dumps({"net": str(out)} | asdict(check), indent=2))
        return 0
    print(
        f"{out}: {check.edges:,} edges, {check.junctions:,} junctions and {check.connections:,} "
        f"connections from {check.lanes:,} lanes"
    )
    print(
        f"given centre lines to those of the net: median {check.distance_m_median:.3f} m, "
        f"99 % {check.distance_m_p99:.3f} m, max {check.distance_m_max:.3f} m"
    )
    share = 100.0 * check.successors_kept / check.successors if check.successors else 100.0
    print(f"successors kept: {check.successors_kept:,} of {check.successors:,} ({share:.1f} %)")
    return 0
