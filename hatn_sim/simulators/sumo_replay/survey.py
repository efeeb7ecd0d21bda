"""A first pass over a recording: who drives where in the net, and whether the two fit at all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.datatypes import FloatArray, Frame, Kind, Recording, Route, Scene
from hatn_sim.errors import InputError
from hatn_sim.simulators.sumo_replay.match import LaneMatcher, Match

EVERY_FRAMES: Final = 3
"""Tracks are matched by every third frame, and by their last before that."""
FIT_POINTS: Final = 5000
"""Points after which the fit is judged, so that a misfit is told early."""
FIT_M: Final = 3.0
"""Median distance to the nearest centre line beyond which net and recording do not fit."""
BESIDE_SHARE: Final = 0.1
"""Share of the positions beside every lane from which on that is said."""


@dataclass
class Stay:
    """A recorded vehicle from its appearance to its disappearance."""

    first_s: float
    last_s: float
    match: Match | None  # None: near no lane of its class


class Survey:
    """What the whole recording says of its vehicles. `stays` are by id, in order of time."""

    def __init__(
        self, matcher: LaneMatcher, stays: dict[str, list[Stay]], beside_share: float
    ) -> None:
        self.matcher = matcher
        self.stays = stays
        self.beside_share = beside_share  # of the positions looked at, beside every lane

    def match_at(self, vehicle: str, frame: int) -> Match | None:
        """The match of the stay that a frame belongs to."""
        found = None
        for stay in self.stays.get(vehicle, ()):
            if stay.match is not None and stay.match.first_frame <= frame + EVERY_FRAMES:
                found = stay.match
        return found

    def edges_from(self, vehicle: str, frame: int) -> Route | None:
        """The edges that a vehicle drives from a frame on; None where the net has no such way."""
        match = self.match_at(vehicle, frame)
        return None if match is None else self.matcher.edges_from(match, frame)

    def without_way(self) -> int:
        """How many vehicles were matched to no lane."""
        return sum(all(stay.match is None for stay in stays) for stays in self.stays.values())


def front_xy_m(scene: Scene) -> FloatArray:
    """Front bumpers [N, 2] of the vehicles of a scene."""
    ahead = np.stack([np.cos(scene.yaw_rad), np.sin(scene.yaw_rad)], axis=1)
    return scene.xy_m + 0.5 * scene.size_m[:, :1] * ahead


def survey(recording: Recording, matcher: LaneMatcher, net_path: Path) -> Survey:
    """Reads the recording once, keeping only the tracks of vehicles still there.

    Raises InputError where the recording is at fault, or does not fit the net.
    """
    stays: dict[str, list[Stay]] = {}
    tracks: dict[str, list[tuple[int, float, float, float]]] = {}
    kinds: dict[str, Kind] = {}
    fit: list[FloatArray] = []
    points = beside = 0

    def finish(vehicle: str) -> None:
        rows = np.array(tracks.pop(vehicle))
        kind = kinds.pop(vehicle)
        stays[vehicle][-1].match = matcher.match(
            rows[:, 0].astype(np.int64), rows[:, 1:3], rows[:, 3], kind
        )

    for index, scene in _sampled(recording.frames()):
        on_wheels = np.flatnonzero(scene.kind != Kind.PEDESTRIAN)
        front = front_xy_m(scene)[on_wheels]
        names = [scene.ids[row] for row in on_wheels]
        here = set(names)
        for vehicle in [name for name in tracks if name not in here]:
            finish(vehicle)
        for name, row, at in zip(names, on_wheels, front.tolist(), strict=True):
            if name not in tracks:
                tracks[name] = []
                kinds[name] = Kind(int(scene.kind[row]))
                stays.setdefault(name, []).append(Stay(scene.time_s, scene.time_s, None))
            tracks[name].append((index, *at, float(scene.yaw_rad[row])))
            stays[name][-1].last_s = scene.time_s
        if not len(front):
            continue
        beside += int(np.count_nonzero(~matcher.distance_m(front)[1]))
        was, points = points, points + len(front)
        if was < FIT_POINTS:
            fit.append(front)
            if points >= FIT_POINTS:
                _check_fit(np.concatenate(fit), matcher, recording.name, net_path)
    if 0 < points < FIT_POINTS:
        _check_fit(np.concatenate(fit), matcher, recording.name, net_path)
    for vehicle in list(tracks):
        finish(vehicle)
    return Survey(matcher, stays, beside / max(points, 1))


def _sampled(frames: Iterator[Frame]) -> Iterator[tuple[int, Scene]]:
    """Every third frame and the last, with their numbers."""
    last: tuple[int, Scene] | None = None
    for index, frame in enumerate(frames):
        last = (index, frame.scene)
        if index % EVERY_FRAMES == 0:
            yield last
            last = None
    if last is not None:
        yield last


def _check_fit(front: FloatArray, matcher: LaneMatcher, name: str, net_path: Path) -> None:
    away_m = float(np.median(matcher.distance_m(front)[0]))
    if away_m <= FIT_M:
        return
    x_m, y_m = np.median(front, axis=0)
    low_x, low_y, high_x, high_y = matcher.bounds_m
    raise InputError(
        f"{net_path}: net and recording {name} do not fit: recorded vehicles are {away_m:.1f} m "
        f"(median) from the nearest lane, expected at most {FIT_M:g} m; they are around "
        f"({x_m:.0f}, {y_m:.0f}), the net spans x {low_x:.0f} to {high_x:.0f}, y {low_y:.0f} to "
        f"{high_y:.0f}: check the place, the projection, and netOffset in the net's <location>"
    )
