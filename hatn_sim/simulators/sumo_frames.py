"""Frames as a worker sends them -> frames as everybody else has them."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from hatn_sim.datatypes import Frame, Route, Scene, Truth
from hatn_sim.simulators.sumo_messages import RawFrame, numbers_of


def frames_of(raw: Sequence[RawFrame], routes: list[Route]) -> list[Frame]:
    """The frames, of which all numbers are taken apart at once.

    `routes` are those sent so far; the new ones are added.
    """
    rows = numbers_of(raw)
    numbers = rows[:, 7:11].astype(np.int64)
    xy_m, size_m, colour = rows[:, 0:2].copy(), rows[:, 5:7].copy(), numbers[:, 1:4].copy()
    yaw_rad, speed_mps, kind = rows[:, 2].copy(), rows[:, 3].copy(), numbers[:, 0].copy()
    blinker = rows[:, 4].astype(np.int64)
    frames: list[Frame] = []
    begin = 0
    for one in raw:
        own = slice(begin, begin + len(one.ids))
        begin = own.stop
        scene = Scene(
            time_s=one.time_s,
            ids=one.ids,
            xy_m=xy_m[own],
            yaw_rad=yaw_rad[own],
            speed_mps=speed_mps[own],
            size_m=size_m[own],
            kind=kind[own],
            colour=colour[own],
            blinker=blinker[own],
            signal_closed=one.signal_closed,
        )
        frames.append(Frame(scene=scene, truth=_truth_of(one, routes), done=one.done))
    return frames


def _truth_of(raw: RawFrame, routes: list[Route]) -> Truth:
    # Every route comes with strings of its own: in a city they would fill the memory.
    routes.extend(tuple(map(sys.intern, route)) for route in raw.new_routes)
    return Truth(
        routes=tuple(routes[index] if index >= 0 else None for index in raw.routes),
        collisions=raw.collisions,
        emergency_braking=raw.emergency_braking,
        departed=raw.departed,
        arrived=raw.arrived,
        teleported=raw.teleported,
    )
