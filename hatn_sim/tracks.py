"""The last frames of every vehicle in view, aligned by vehicle."""

from __future__ import annotations

import numpy as np

from hatn_sim.datatypes import TRACK_FRAMES, IntArray, Scene, Tracks


def empty_tracks() -> Tracks:
    shape = (0, TRACK_FRAMES)
    return Tracks(
        ids=(),
        xy_m=np.zeros((*shape, 2)),
        yaw_rad=np.zeros(shape),
        speed_mps=np.zeros(shape),
        valid=np.zeros(shape, dtype=np.bool_),
    )


def rows_before(ids_before: tuple[str, ...], ids: tuple[str, ...]) -> IntArray:
    """For each of `ids` its row among `ids_before`, -1 for a newcomer."""
    if ids == ids_before:
        return np.arange(len(ids))
    row = {name: index for index, name in enumerate(ids_before)}
    return np.fromiter((row.get(name, -1) for name in ids), dtype=np.int64, count=len(ids))


def extend(tracks: Tracks, scene: Scene) -> Tracks:
    """The tracks one frame later: vehicles out of view are forgotten, newcomers begin invalid.

    Invalid frames hold the first pose seen, so that nothing downstream meets an invented jump.
    """
    rows = rows_before(tracks.ids, scene.ids)
    known = rows >= 0
    source = np.maximum(rows, 0)
    count = len(scene.ids)
    xy = np.repeat(scene.xy_m[:, None], TRACK_FRAMES, axis=1)
    yaw = np.repeat(scene.yaw_rad[:, None], TRACK_FRAMES, axis=1)
    speed = np.repeat(scene.speed_mps[:, None], TRACK_FRAMES, axis=1)
    valid = np.zeros((count, TRACK_FRAMES), dtype=np.bool_)
    valid[:, -1] = True
    if known.any():
        before = source[known]
        xy[known, :-1] = tracks.xy_m[before, 1:]
        yaw[known, :-1] = tracks.yaw_rad[before, 1:]
        speed[known, :-1] = tracks.speed_mps[before, 1:]
        valid[known, :-1] = tracks.valid[before, 1:]
    return Tracks(ids=scene.ids, xy_m=xy, yaw_rad=yaw, speed_mps=speed, valid=valid)
