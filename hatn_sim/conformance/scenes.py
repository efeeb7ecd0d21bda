"""Real traffic to try somebody's class on: a few seconds of scenes that ship, and cut-down ones."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from hatn_sim.config import load_scenario
from hatn_sim.datatypes import Frame, IntArray, Scene
from hatn_sim.loop import warm_up
from hatn_sim.road import Road
from hatn_sim.traffic import open_traffic

SCENES: Final = ("tjunction", "roundabout8")
SEED: Final = 7
WARM_UP_FRAMES: Final = 300
FRAMES: Final = 40
GONE: Final = (12, 20)
"""The frames in which a vehicle is out of sight."""


@dataclass(frozen=True, eq=False)
class Footage:
    """Frames of a scene, each with at least two vehicles, and where they were taken."""

    name: str
    road: Road
    frames: tuple[Frame, ...]

    @property
    def scenes(self) -> tuple[Scene, ...]:
        return tuple(frame.scene for frame in self.frames)

    @property
    def longest(self) -> str:
        """Whoever is there in most of the frames from the first on."""
        first = self.scenes[0].ids
        return max(first, key=lambda name: sum(name in scene.ids for scene in self.scenes))


def film(name: str) -> Footage:
    """`FRAMES` of a scene that ships."""
    with closing(open_traffic(load_scenario(name))) as simulator:
        frame = warm_up(simulator, simulator.reset(SEED), WARM_UP_FRAMES)
        while len(frame.scene.ids) < 2:
            frame = simulator.step()
        frames = [frame]
        while len(frames) < FRAMES:
            frames.append(simulator.step())
        return Footage(simulator.name, simulator.road, tuple(frames))


def fresh(road: Road) -> Road:
    """The same road, with nothing remembered."""
    return Road(road.lanes.values())


def taken(scene: Scene, rows: IntArray) -> Scene:
    """Some of the vehicles of a scene, in the order of `rows`."""
    parts = {
        field.name: getattr(scene, field.name)[rows].copy()
        for field in fields(Scene)
        if field.name not in ("time_s", "ids", "signal_closed")
    }
    return replace(scene, ids=tuple(scene.ids[row] for row in rows.tolist()), **parts)


def turned_round(scenes: Sequence[Scene]) -> tuple[Scene, ...]:
    """The vehicles of every scene in the opposite order."""
    return tuple(taken(scene, np.arange(len(scene.ids))[::-1]) for scene in scenes)


def alone(scenes: Sequence[Scene], name: str) -> tuple[Scene, ...]:
    """One vehicle, as long as it is there."""
    return tuple(
        taken(scene, np.array([scene.ids.index(name)])) for scene in scenes if name in scene.ids
    )


def nobody(scenes: Sequence[Scene]) -> tuple[Scene, ...]:
    """Everybody gone from the third scene on, and back with the last two."""
    none = np.zeros(0, dtype=np.int64)
    last = len(scenes) - 2
    return tuple(taken(scene, none) if 2 <= k < last else scene for k, scene in enumerate(scenes))


def coming_and_going(scenes: Sequence[Scene], name: str) -> tuple[Scene, ...]:
    """One vehicle is out of sight for a while."""
    return tuple(
        taken(scene, np.array([k for k, one in enumerate(scene.ids) if one != name], np.int64))
        if GONE[0] <= frame < GONE[1]
        else scene
        for frame, scene in enumerate(scenes)
    )


def copy_of(scene: Scene) -> Scene:
    """With arrays of its own."""
    return taken(scene, np.arange(len(scene.ids)))


def differs_in(scene: Scene, other: Scene) -> str | None:
    """The first field in which two scenes differ; None: in none."""
    for field in fields(Scene):
        one, two = getattr(scene, field.name), getattr(other, field.name)
        if not np.array_equal(np.asarray(one), np.asarray(two)):
            return field.name
    return None
