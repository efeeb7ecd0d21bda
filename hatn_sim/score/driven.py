"""What everybody did in a stretch of traffic, and what befell them: what events are found in.

Letters: V vehicles, T frames, R rows (a vehicle at a frame, by vehicle and then by frame).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hatn_sim.datatypes import BoolArray, FloatArray, Frame, IntArray, Kind

if TYPE_CHECKING:
    from hatn_sim.log import Run


@dataclass(frozen=True, eq=False)
class Driven:
    """The motion of all vehicles; pedestrians are left out."""

    ids: tuple[str, ...]  # [V]
    time_s: FloatArray  # [T]
    vehicle: IntArray  # [R] index into `ids`, rising
    frame: IntArray  # [R] index into `time_s`, rising for each vehicle
    xy_m: FloatArray  # [R, 2]
    yaw_rad: FloatArray  # [R]
    speed_mps: FloatArray  # [R]
    size_m: FloatArray  # [V, 2] length, width
    contacts: tuple[tuple[int, str, str], ...] = ()  # frame, and a pair that touches then
    emergency_braking: tuple[tuple[int, str], ...] = ()
    teleported: tuple[tuple[int, str], ...] = ()

    def rows_of(self, vehicle: int) -> slice:
        """Those of a vehicle."""
        first, last = np.searchsorted(self.vehicle, [vehicle, vehicle + 1])
        return slice(int(first), int(last))

    def follows_on(self) -> BoolArray:
        """[R] the row before is of the same vehicle, one frame earlier."""
        result = np.zeros(len(self.vehicle), dtype=np.bool_)
        result[1:] = (np.diff(self.vehicle) == 0) & (np.diff(self.frame) == 1)
        return result


def driven_by(frames: Iterable[Frame]) -> Driven:
    """The motion in frames that follow each other."""
    recorder = DrivenRecorder()
    for frame in frames:
        recorder.add(frame)
    return recorder.driven()


def driven_in(run: Run) -> Driven:
    """The motion in a run's log."""
    tracks = run.tracks
    happened: dict[str, list[Any]] = {}
    for event in run.events:
        happened.setdefault(event.type, []).append((event.frame, *event.ids))
    return _sorted(
        ids=run.ids,
        time_s=run.times_s,
        vehicle=tracks.vehicle,
        frame=tracks.frame,
        motion=np.column_stack([tracks.xy_m, tracks.yaw_rad, tracks.speed_mps, tracks.size_m]),
        walks=tracks.kind == Kind.PEDESTRIAN,
        contacts=happened.get("collision", ()),
        emergency_braking=happened.get("emergency_braking", ()),
        teleported=happened.get("teleported", ()),
    )


def driven_from_arrays(
    ids: Sequence[str],
    time_s: FloatArray,
    valid: BoolArray,
    xy_m: FloatArray,
    yaw_rad: FloatArray,
    speed_mps: FloatArray,
    size_m: FloatArray,
    collisions: Sequence[tuple[float, str, str]] = (),
    emergency_braking: Sequence[tuple[float, str]] = (),
) -> Driven:
    """The motion of a branch: dense arrays [T, N] masked by `valid`, sizes [N, 2], times in s."""

    def at(moment_s: float) -> int:
        return int(np.abs(time_s - moment_s).argmin())

    vehicle, frame = np.nonzero(valid.T)
    return Driven(
        ids=tuple(ids),
        time_s=time_s,
        vehicle=vehicle,
        frame=frame,
        xy_m=xy_m[frame, vehicle],
        yaw_rad=yaw_rad[frame, vehicle],
        speed_mps=speed_mps[frame, vehicle],
        size_m=size_m,
        contacts=tuple((at(moment), one, other) for moment, one, other in collisions),
        emergency_braking=tuple((at(moment), name) for moment, name in emergency_braking),
    )


class DrivenRecorder:
    """Takes in frame after frame."""

    def __init__(self) -> None:
        self._index: dict[str, int] = {}
        self._time_s: list[float] = []
        self._vehicle: list[list[int]] = []
        self._motion: list[FloatArray] = []
        self._walks: list[BoolArray] = []
        self._contacts: list[tuple[int, str, str]] = []
        self._emergency_braking: list[tuple[int, str]] = []
        self._teleported: list[tuple[int, str]] = []

    def add(self, frame: Frame) -> None:
        """The next frame."""
        scene, truth, now = frame.scene, frame.truth, len(self._time_s)
        index = self._index
        self._time_s.append(scene.time_s)
        self._vehicle.append([index.setdefault(name, len(index)) for name in scene.ids])
        self._motion.append(
            np.column_stack([scene.xy_m, scene.yaw_rad, scene.speed_mps, scene.size_m])
        )
        self._walks.append(scene.kind == Kind.PEDESTRIAN)
        self._contacts += [(now, one, other) for one, other in truth.collisions]
        self._emergency_braking += [(now, name) for name in truth.emergency_braking]
        self._teleported += [(now, name) for name in truth.teleported]

    def driven(self) -> Driven:
        """All that was taken in."""
        counts = [len(vehicles) for vehicles in self._vehicle]
        return _sorted(
            ids=tuple(self._index),
            time_s=np.array(self._time_s),
            vehicle=np.array([v for vehicles in self._vehicle for v in vehicles], dtype=np.int64),
            frame=np.repeat(np.arange(len(counts)), counts),
            motion=np.concatenate([np.zeros((0, 6)), *self._motion]),
            walks=np.concatenate([np.zeros(0, dtype=np.bool_), *self._walks]),
            contacts=self._contacts,
            emergency_braking=self._emergency_braking,
            teleported=self._teleported,
        )


def _sorted(
    ids: tuple[str, ...],
    time_s: FloatArray,
    vehicle: IntArray,
    frame: IntArray,
    motion: FloatArray,
    walks: BoolArray,
    contacts: Sequence[tuple[int, str, str]],
    emergency_braking: Sequence[tuple[int, str]],
    teleported: Sequence[tuple[int, str]],
) -> Driven:
    """`motion` [R, 6] are x, y, yaw, speed, length and width of rows in any order."""
    on_foot = {ids[v] for v in np.unique(vehicle[walks]).tolist()}
    order = np.lexsort((frame, vehicle))
    order = order[~walks[order]]
    size_m = np.zeros((len(ids), 2))
    size_m[vehicle[order[::-1]]] = motion[order[::-1], 4:]  # the first seen is written last
    motion = motion[order]
    return Driven(
        ids=ids,
        time_s=time_s,
        vehicle=vehicle[order],
        frame=frame[order],
        xy_m=motion[:, :2],
        yaw_rad=motion[:, 2],
        speed_mps=motion[:, 3],
        size_m=size_m,
        contacts=tuple(one for one in contacts if not on_foot.intersection(one[1:])),
        emergency_braking=tuple(emergency_braking),
        teleported=tuple(teleported),
    )
