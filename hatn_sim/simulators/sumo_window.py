"""SUMO's own window: what it takes to open it, and what is drawn over the traffic in it.

libsumo brings the window of sumo-gui with it: the simulation is the same process's, step by step,
and nothing drawn here has a part in it. libsumo is handed in, not imported.
"""

from __future__ import annotations

import os
import socket
import sys
from typing import Any, Final

from hatn_sim.errors import InputError
from hatn_sim.simulators.sumo_messages import Drawn, Mark, Paint, Picture, Ribbon

START: Final = "--start"
"""The option, sumo-gui's alone, that tells a worker to open a window."""
WINDOW_PX: Final = "1280,860"
"""Wide and high; SUMO's own is half of it."""
PREFIX: Final = "hatn-sim:"
"""Before the names of all that is drawn: a user's own polygons and points stay."""
MARK_LAYER: Final = 120
FIRST_PORT: Final = 6000
"""Of X servers: display N listens at this one and N."""
ANSWER_S: Final = 3.0
FOLLOWED_WIDTH_M: Final = 120.0
"""Of the map, when the window begins to follow a vehicle."""


def window_options(delay_ms: float) -> tuple[str, ...]:
    """Words of SUMO's command line that open its window. InputError where there can be none.

    `delay_ms` of the wall clock for each second of the scene, as on sumo-gui's own slider.
    """
    if sys.platform == "win32":
        raise InputError("--gui: libsumo has no window on Windows; use Linux or macOS")
    if trouble := display_trouble(os.environ.get("DISPLAY", "")):
        raise InputError(
            f"--gui: {trouble} to open SUMO's window on; run it on a desktop or under `xvfb-run -a`"
        )
    return START, "true", "--delay", f"{delay_ms:g}", "--window-size", WINDOW_PX


def display_trouble(display: str) -> str:
    """What is wrong with an X server of this name, in a few words; nothing: it answers.

    SUMO itself ends the process, or waits, where none answers.
    """
    if not display:
        return "no DISPLAY"
    host, _, number = display.rpartition(":")
    number = number.partition(".")[0]
    if not number.isdigit():
        return f"DISPLAY {display!r} names no display (expected one like :0)"
    places: list[tuple[int, Any]] = []
    if host.startswith("/"):  # macOS: the socket's own name, number and all
        places.append((socket.AF_UNIX, display))
    elif host in ("", "unix"):
        places += [(socket.AF_UNIX, f"{start}/tmp/.X11-unix/X{number}") for start in ("\0", "")]
    else:
        places.append((socket.AF_INET, (host, FIRST_PORT + int(number))))
    why = ""
    for family, place in places:
        try:
            with socket.socket(family, socket.SOCK_STREAM) as there:
                there.settimeout(ANSWER_S)
                there.connect(place)
            return ""
        except OSError as error:
            why = error.strerror or str(error)
    return f"no X server answers on DISPLAY {display} ({why})"


SUMO_DEFAULT_COLOUR: Final = (255, 255, 0, 255)
"""Of a vehicle without a colour of its own; its type's counts then."""


class Canvas:
    """What is drawn in the window now. Things that stay are moved, so that nothing flickers."""

    def __init__(self, sumo: Any) -> None:
        self._sumo = sumo
        self._ribbons: set[str] = set()
        self._marks: set[str] = set()
        self._painted: dict[str, tuple[Paint, Paint]] = {}  # its own, ours
        self._asked: str | None = None

    def draw(self, picture: Picture) -> Drawn:
        """Draws a picture in place of the one before."""
        polygon, poi = self._sumo.polygon, self._sumo.poi
        for name in self._ribbons - picture.ribbons.keys():
            polygon.remove(PREFIX + name)
        for name in self._marks - picture.marks.keys():
            poi.remove(PREFIX + name)
        for name, ribbon in picture.ribbons.items():
            self._ribbon(PREFIX + name, ribbon, name in self._ribbons)
        for name, mark in picture.marks.items():
            self._mark(PREFIX + name, mark, name in self._marks)
        self._ribbons, self._marks = set(picture.ribbons), set(picture.marks)
        self._paint(picture)
        return Drawn(self._follow(picture.followed))

    def _ribbon(self, name: str, ribbon: Ribbon, is_there: bool) -> None:
        polygon, shape = self._sumo.polygon, [tuple(at) for at in ribbon.xy_m.tolist()]
        if is_there:
            polygon.setShape(name, shape)
            polygon.setColor(name, ribbon.paint)
        else:
            polygon.add(name, shape, ribbon.paint, False, "hatn-sim", ribbon.layer, ribbon.width_m)

    def _mark(self, name: str, mark: Mark, is_there: bool) -> None:
        poi, (x_m, y_m) = self._sumo.poi, mark.xy_m.tolist()
        if is_there:
            poi.setPosition(name, x_m, y_m)
            poi.setColor(name, mark.paint)
        else:
            poi.add(
                name, x_m, y_m, mark.paint, "hatn-sim", MARK_LAYER, "", mark.width_m, mark.width_m
            )

    def _paint(self, picture: Picture) -> None:
        vehicle = self._sumo.vehicle
        present = set(vehicle.getIDList())
        painted: dict[str, tuple[Paint, Paint]] = {}
        for name, paint in picture.vehicles.items():
            if name not in present:
                continue
            own, last = self._painted.get(name, (None, None))
            painted[name] = (self._own(name) if own is None else own), paint
            if paint != last:
                vehicle.setColor(name, paint)
        for name in (self._painted.keys() - painted.keys()) & present:
            vehicle.setColor(name, self._painted[name][0])
        self._painted = painted

    def _own(self, name: str) -> Paint:
        """A vehicle's colour, or its type's where it has none of its own."""
        own = self._sumo.vehicle.getColor(name)
        if own != SUMO_DEFAULT_COLOUR:
            return own
        return self._sumo.vehicletype.getColor(self._sumo.vehicle.getTypeID(name))

    def _follow(self, wanted: str | None) -> str:
        """Goes with a vehicle from its first moment on; then the user may choose another."""
        gui, views = self._sumo.gui, self._sumo.gui.getIDList()
        if not views:
            return ""
        if wanted is None:
            self._asked = None
        elif wanted != self._asked and wanted in self._sumo.vehicle.getIDList():
            self._asked = wanted
            x_m, y_m = self._sumo.vehicle.getPosition(wanted)
            half_m = 0.5 * FOLLOWED_WIDTH_M
            gui.setBoundary(views[0], x_m - half_m, y_m - half_m, x_m + half_m, y_m + half_m)
            gui.trackVehicle(views[0], wanted)
        return str(gui.getTrackedVehicle(views[0]))
