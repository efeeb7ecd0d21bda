"""SUMO's own window: what it takes to open it, and what is drawn over the traffic in it.

libsumo brings the window of sumo-gui with it: the simulation is the same process's, step by step,
and nothing drawn here has a part in it. libsumo is handed in, not imported.
"""

from __future__ import annotations

import math
import os
import socket
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from hatn_sim.errors import InputError
from hatn_sim.simulators.sumo_messages import Drawn, Mark, Paint, Picture, Ribbon, View

START: Final = "--start"
"""The option, sumo-gui's alone, that tells a worker to open a window."""
WINDOW_PX: Final = "1280,860"
"""Wide and high; SUMO's own is half of it."""
PREFIX: Final = "hatn-sim:"
"""Before the names of all that is drawn: a user's own polygons and points stay."""
RING_LAYER: Final = 90
RING_M: Final = 0.55
"""How far a ring reaches further than the vehicle, or the ring, within it."""
MARK_LAYER: Final = 120
WORDS_LAYER: Final = 1000
NO_PAINT: Final = (0, 0, 0, 0)
FIRST_PORT: Final = 6000
"""Of X servers: display N listens at this one and N."""
ANSWER_S: Final = 3.0
SHOWN_M: Final = 65.0
"""Of the map, from top to bottom, when the window goes to a vehicle or to a place."""
WORDS_PARAMETER: Final = "hatn-sim"
"""Of points of interest: `view.xml` has SUMO show what it holds."""
LINE_SHARE: Final = 0.034
"""Of the view's height, from one line of words to the next."""


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


class Canvas:
    """What is drawn in the window now. Things that stay are moved, so that nothing flickers."""

    def __init__(self, sumo: Any) -> None:
        self._sumo = sumo
        self._ribbons: set[str] = set()
        self._marks: set[str] = set()
        self._rings: Mapping[str, tuple[Paint, ...]] = {}
        self._lines = 0  # of words
        self._asked: str | None = None
        self._has_begun = False

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
        self._ring(picture.rings)
        views = self._sumo.gui.getIDList()
        if not views:
            return Drawn("", None)
        followed = self._follow(views[0], picture)
        (low_x_m, low_y_m), (high_x_m, high_y_m) = self._sumo.gui.getBoundary(views[0])
        view_m = low_x_m, low_y_m, high_x_m, high_y_m
        self._write(picture.words, view_m)
        self._show_now(views[0])
        return Drawn(followed, view_m)

    def keep_up(self) -> None:
        """Rings go with their vehicles at once; the next picture takes as long as a prediction."""
        if self._rings:
            self._ring(self._rings)
            for view in self._sumo.gui.getIDList():
                self._show_now(view)

    def _ribbon(self, name: str, ribbon: Ribbon, is_there: bool) -> None:
        polygon, shape = self._sumo.polygon, [tuple(at) for at in ribbon.xy_m.tolist()]
        if is_there:
            polygon.setShape(name, shape)
            polygon.setColor(name, ribbon.paint)
        else:
            half_m = 0.5 * ribbon.width_m  # SUMO draws as much to either side
            polygon.add(name, shape, ribbon.paint, False, "hatn-sim", ribbon.layer, half_m)

    def _mark(self, name: str, mark: Mark, is_there: bool) -> None:
        poi, (x_m, y_m) = self._sumo.poi, mark.xy_m.tolist()
        if is_there:
            poi.setPosition(name, x_m, y_m)
            poi.setColor(name, mark.paint)
        else:
            poi.add(
                name, x_m, y_m, mark.paint, "hatn-sim", MARK_LAYER, "", mark.width_m, mark.width_m
            )

    def _ring(self, rings: Mapping[str, tuple[Paint, ...]]) -> None:
        polygon, vehicle = self._sumo.polygon, self._sumo.vehicle
        present = set(vehicle.getIDList())
        shown = {name: paints for name, paints in rings.items() if name in present}
        for name in self._rings.keys() - shown.keys():
            for ring in range(len(self._rings[name])):
                polygon.remove(f"{PREFIX}ring:{ring}:{name}")
        for name, paints in shown.items():
            front_x_m, front_y_m = vehicle.getPosition(name)
            yaw_rad = math.radians(90.0 - vehicle.getAngle(name))
            ahead_x, ahead_y = math.cos(yaw_rad), math.sin(yaw_rad)
            length_m, width_m = vehicle.getLength(name), vehicle.getWidth(name)
            there = len(self._rings.get(name, ()))
            for ring, paint in enumerate(paints):
                grow_m = (ring + 1) * RING_M
                ends_m = np.array([[-length_m - grow_m], [grow_m]])
                xy_m = np.array([front_x_m, front_y_m]) + ends_m * np.array([ahead_x, ahead_y])
                ribbon = Ribbon(xy_m, width_m + 2.0 * grow_m, paint, RING_LAYER - ring)
                self._ribbon(f"{PREFIX}ring:{ring}:{name}", ribbon, ring < there)
        self._rings = shown

    def _write(self, words: Sequence[str], view_m: View) -> None:
        """Lines of words, one below the other, at points that go with the view."""
        poi, (low_x_m, low_y_m, high_x_m, high_y_m) = self._sumo.poi, view_m
        for line in range(len(words), self._lines):
            poi.remove(f"{PREFIX}words:{line}")
        for line, text in enumerate(words):
            name = f"{PREFIX}words:{line}"
            x_m = 0.5 * (low_x_m + high_x_m)
            y_m = high_y_m - (line + 1.5) * LINE_SHARE * (high_y_m - low_y_m)
            if line < self._lines:
                poi.setPosition(name, x_m, y_m)
            else:
                poi.add(name, x_m, y_m, NO_PAINT, "hatn-sim", WORDS_LAYER, "", 0.1, 0.1)
            poi.setParameter(name, WORDS_PARAMETER, text)
        self._lines = len(words)

    def _follow(self, view: str, picture: Picture) -> str:
        """Goes with a vehicle from its first moment on, or to where the first picture is best seen;
        then the window is the user's."""
        wanted = picture.followed
        if wanted is None:
            self._asked = None
            if picture.begin_xy_m is not None and not self._has_begun:
                self._has_begun = True
                self._go(view, *picture.begin_xy_m.tolist())
        elif wanted != self._asked and wanted in self._sumo.vehicle.getIDList():
            self._asked = wanted
            self._go(view, *self._sumo.vehicle.getPosition(wanted))
            self._sumo.gui.trackVehicle(view, wanted)
        return str(self._sumo.gui.getTrackedVehicle(view))

    def _go(self, view: str, x_m: float, y_m: float) -> None:
        half_m = 0.5 * SHOWN_M
        self._sumo.gui.setBoundary(view, x_m - half_m, y_m - half_m, x_m + half_m, y_m + half_m)
        self._show_now(view)  # the first time after it, SUMO settles how high the view is

    def _show_now(self, view: str) -> None:
        """Has the view drawn again, from where it is. SUMO itself draws when time has passed, and
        what is drawn here would be seen beside the vehicles of the next frame."""
        self._sumo.gui.setOffset(view, *self._sumo.gui.getOffset(view))
