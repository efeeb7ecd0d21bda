"""The log of a run -> SUMO's floating car data, which reads back as the same tracks."""

from __future__ import annotations

import gzip
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np

from hatn_sim.datatypes import Frame, Kind, Scene
from hatn_sim.errors import InputError
from hatn_sim.log import Run
from hatn_sim.log.road_file import ROAD_FILE, read_road, write_road
from hatn_sim.recordings.fcd.rows import CLOSED_ATTRIBUTE
from hatn_sim.recordings.fcd.scenes import LEFT_BLINKER, RIGHT_BLINKER
from hatn_sim.whole_file import write_whole

FCD_FILE: Final = "fcd.xml.gz"
_HEAD: Final = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<fcd-export xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
    'xsi:noNamespaceSchemaLocation="http://sumo.dlr.de/xsd/fcd_file.xsd">\n'
)
_NOT_IN_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_KIND_NAMES: Final = {int(kind): kind.name.lower() for kind in Kind}


def export_fcd(run: Run, folder: Path) -> tuple[Path, Path]:
    """Write `fcd.xml.gz` and its map, the run's `road.json.gz`; returns both paths.

    Numbers are written to their last digit. Positions, angle, speed, type and signals are SUMO's
    (front bumpers, degrees clockwise from north); length, width, kind, color and a timestep's
    closed signals are ours, and other readers pass over them. Lanes are left out, and so is what
    only the simulator knew. The folder has to exist.

    Raises:
        InputError: the run is damaged or has no lanes, or a name does not fit into XML.
    """
    road, tracks = folder / ROAD_FILE, folder / FCD_FILE
    write_road(road, read_road(run.path / ROAD_FILE))
    for name in run.ids:
        if _NOT_IN_XML.search(name):
            raise InputError(
                f"{run.path}: the vehicle {name!r} has a character in its name that XML cannot "
                "hold; give vehicles other names and make the run again"
            )
    write_whole(tracks, partial(_write_tracks, run))
    return tracks, road


def _write_tracks(run: Run, path: Path) -> None:
    # No name and no time in the gzip head: the same run gives the same bytes.
    with (
        path.open("wb") as file,
        gzip.GzipFile("", "wb", compresslevel=6, fileobj=file, mtime=0) as stream,
    ):
        stream.write(_HEAD.encode())
        for frame in run.frames():
            stream.write("".join(_timestep(frame)).encode())
        stream.write(b"</fcd-export>\n")


def _timestep(frame: Frame) -> Iterator[str]:
    scene = frame.scene
    closed = "".join("1" if shut else "0" for shut in scene.signal_closed)
    attribute = f' {CLOSED_ATTRIBUTE}="{closed}"' if closed else ""
    yield f'    <timestep time="{scene.time_s!r}"{attribute}>\n'
    yield from _road_users(scene)
    yield "    </timestep>\n"


def _road_users(scene: Scene) -> Iterator[str]:
    signals = np.array([RIGHT_BLINKER, 0, LEFT_BLINKER])[np.sign(scene.blinker) + 1]
    heading = np.column_stack((np.cos(scene.yaw_rad), np.sin(scene.yaw_rad)))
    front_xy_m = scene.xy_m + 0.5 * scene.size_m[:, :1] * heading
    angle_deg = np.mod(90.0 - np.degrees(scene.yaw_rad), 360.0)
    columns = zip(
        scene.ids,
        front_xy_m.tolist(),
        angle_deg.tolist(),
        scene.speed_mps.tolist(),
        signals.tolist(),
        scene.size_m.tolist(),
        scene.kind.tolist(),
        scene.colour.tolist(),
        strict=True,
    )
    for name, (x_m, y_m), angle, speed_mps, signal, (length_m, width_m), kind, colour in columns:
        tag = "person" if kind == Kind.PEDESTRIAN else "vehicle"
        kind_name = _KIND_NAMES[kind]
        yield (
            f'        <{tag} id={quoteattr(name)} x="{x_m!r}" y="{y_m!r}" angle="{angle!r}" '
            f'type="{kind_name}" speed="{speed_mps!r}" signals="{signal}" '
            f'length="{length_m!r}" width="{width_m!r}" kind="{kind_name}" '
            f'color="{",".join(map(str, colour))}"/>\n'
        )
