"""Who of a recording is moved and who drives: a recorded scene -> what SUMO is to do. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hatn_sim.datatypes import Command, FloatArray, IntArray, Kind, Route, Scene
from hatn_sim.errors import InputError, nearest
from hatn_sim.simulators.sumo_messages import (
    Newcomer,
    ReplayFrame,
    ReplayStep,
    accelerations,
)
from hatn_sim.simulators.sumo_replay.survey import Survey, front_xy_m
from hatn_sim.simulators.touching import boxes_touch

ENTRY_GAP_M: Final = 2.0
ENTRY_GAP_S: Final = 1.0
"""A vehicle that is to drive from its appearance on waits until this is free ahead of it."""
ROUNDING_S: Final = 1e-6


def type_of(kind: Kind) -> str:
    """The name of the vehicle type in SUMO for a kind."""
    return f"replay_{kind.name.lower()}"


@dataclass(frozen=True, eq=False)
class Look:
    """What a vehicle looks like, which the recording knows."""

    size_m: FloatArray  # [2]
    kind: int
    colour: IntArray  # [3]


@dataclass(eq=False)
class Held:
    """A vehicle that is to drive from its appearance on and waits for room."""

    newcomer: Newcomer
    pose: FloatArray  # [4] as in ReplayStep
    box: FloatArray  # [5] centre, yaw, length, width of it and the gap it wants ahead
    waited: bool = False


@dataclass
class Cast:
    """Who is placed, driven, waiting or gone; one for each run."""

    where: str  # of the recording, for messages
    survey: Survey
    take_over: Mapping[str, float | None]
    react_from_s: float | None
    present: set[str] = field(default_factory=set[str])
    driven: set[str] = field(default_factory=set[str])
    gone: set[str] = field(default_factory=set[str])
    held: dict[str, Held] = field(default_factory=dict[str, Held])
    kept: dict[str, None] = field(default_factory=dict[str, None])
    looks: dict[str, Look] = field(default_factory=dict[str, Look])

    def __post_init__(self) -> None:
        """Raises InputError where a vehicle to be taken over is not there, or not then."""
        stays = self.survey.stays
        for vehicle, at_s in self.take_over.items():
            if vehicle not in stays:
                raise InputError(
                    f"{self.where}: there is no vehicle {vehicle!r} to take over"
                    + nearest(vehicle, stays)
                )
            first_s, last_s = stays[vehicle][0].first_s, stays[vehicle][-1].last_s
            if at_s is not None and at_s > last_s:
                raise InputError(
                    f"{self.where}: vehicle {vehicle!r} is there from {first_s:.1f} to "
                    f"{last_s:.1f} s, it cannot be taken over at {at_s:g} s; give a time before"
                )

    def plan(
        self,
        index: int,
        scene: Scene,
        before: Scene | None,
        commands: Sequence[Command],
    ) -> ReplayStep:
        """What SUMO is to do so that it stands as recorded at the frame `index`, `scene`.

        `before` is the frame shown last; None at the beginning.

        Raises InputError for a vehicle that cannot be taken over, or a command to one that is not.
        """
        front = front_xy_m(scene)
        angle_deg = 90.0 - np.degrees(scene.yaw_rad)
        poses = np.column_stack([front, angle_deg, scene.speed_mps])
        row_of = {
            name: row
            for row, (name, kind) in enumerate(zip(scene.ids, scene.kind.tolist(), strict=True))
            if kind != Kind.PEDESTRIAN and name not in self.gone
        }
        released = self._release(index, row_of, before)
        newcomers = self._appear(index, scene, row_of, poses)
        entering = self._enter(before)
        newcomers += [held.newcomer for held in entering]
        away = self.present - row_of.keys() - self.driven
        moved = [name for name in row_of if name not in self.driven and name not in self.held]
        self.present = set(moved)
        rows = np.array([row_of[name] for name in moved], dtype=np.int64)
        return ReplayStep(
            newcomers=tuple(newcomers),
            leavers=tuple(sorted(away)),
            placed=(*moved, *(held.newcomer.id for held in entering)),
            poses=np.concatenate([poses[rows], *(held.pose[None] for held in entering)]),
            on_lane=np.concatenate(
                [self.survey.matcher.distance_m(front[rows])[1], np.ones(len(entering), np.bool_)]
            ),
            released=released,
            driven=tuple(sorted(self.driven)),
            commands=self._accepted(commands),
        )

    def take(self, answer: ReplayFrame) -> tuple[str, ...]:
        """Takes in what SUMO made of the step; returns the driven vehicles that have left."""
        self.present -= set(answer.lost)
        for vehicle in answer.refused:
            self._keep(vehicle)
            self.driven.discard(vehicle)
            self.present.add(vehicle)
        left = tuple(sorted(self.driven.difference(answer.driven.ids)))
        self.driven.difference_update(left)
        self.gone.update(left)
        return left

    def _is_due(self, vehicle: str, now_s: float) -> bool:
        """Whether the vehicle is to drive at a time."""
        if vehicle in self.take_over:
            at_s = self.take_over[vehicle]
            if at_s is None or at_s <= now_s + ROUNDING_S:
                return True
        return self.react_from_s is not None and self.react_from_s <= now_s + ROUNDING_S

    def _keep(self, vehicle: str) -> None:
        """Leaves a vehicle to its recording for want of a way in the net."""
        if vehicle in self.take_over:
            raise InputError(
                f"{self.where}: vehicle {vehicle!r} cannot be taken over: the net has no way along "
                "its recording; choose another, or mend the net's connections"
            )
        self.kept[vehicle] = None

    def _release(
        self, index: int, row_of: Mapping[str, int], before: Scene | None
    ) -> tuple[tuple[str, Route], ...]:
        """The placed vehicles that drive from the frame before on, with their edges."""
        if before is None:
            return ()
        released: list[tuple[str, Route]] = []
        for vehicle in row_of:
            if vehicle not in self.present or vehicle in self.kept:
                continue
            if self._is_due(vehicle, before.time_s):
                edges = self.survey.edges_from(vehicle, index - 1)
                if edges is None:
                    self._keep(vehicle)
                else:
                    released.append((vehicle, edges))
        self.driven.update(vehicle for vehicle, _ in released)
        self.present.difference_update(vehicle for vehicle, _ in released)
        return tuple(released)

    def _appear(
        self, index: int, scene: Scene, row_of: Mapping[str, int], poses: FloatArray
    ) -> list[Newcomer]:
        """The vehicles that appear and are placed; those that are to drive are held."""
        newcomers: list[Newcomer] = []
        for vehicle, row in row_of.items():
            if vehicle in self.present or vehicle in self.driven or vehicle in self.held:
                continue
            kind = Kind(int(scene.kind[row]))
            length_m, width_m = scene.size_m[row].tolist()
            edges = self.survey.edges_from(vehicle, index)
            newcomer = Newcomer(vehicle, type_of(kind), edges or (), length_m, width_m)
            self.looks[vehicle] = Look(scene.size_m[row].copy(), kind, scene.colour[row].copy())
            due = vehicle not in self.kept and self._is_due(vehicle, scene.time_s)
            if due and edges is None:
                self._keep(vehicle)
            if due and edges is not None:
                self.held[vehicle] = Held(newcomer, poses[row], _wanted_box(scene, row))
            else:
                newcomers.append(newcomer)
        return newcomers

    def _enter(self, before: Scene | None) -> list[Held]:
        """The waiting vehicles that have room, which drive from now on.

        At its appearance a vehicle heeds only those that drive: the others left it room, those
        that appear with it included (everybody does at the beginning of a recording).
        """
        entering: list[Held] = []
        for vehicle, held in list(self.held.items()):
            others = [other.box[None] for other in entering if held.waited or other.waited]
            if before is not None:
                heeded = [held.waited or name in self.driven for name in before.ids]
                boxes = np.column_stack([before.xy_m, before.yaw_rad, before.size_m])
                others.append(boxes[np.array(heeded, dtype=np.bool_)])
            if others and _touches_any(held.box, np.concatenate(others)):
                held.waited = True
                continue
            del self.held[vehicle]
            self.driven.add(vehicle)
            entering.append(held)
        return entering

    def _accepted(self, commands: Sequence[Command]) -> tuple[tuple[str, float], ...]:
        for command in commands:
            if self.react_from_s is None and command.ego_id not in self.take_over:
                raise InputError(
                    f"{self.where}: {command.ego_id!r} cannot be driven, it keeps to its "
                    "recording; name it among the vehicles to take over"
                )
        return tuple(wanted for wanted in accelerations(commands) if wanted[0] in self.driven)


def _wanted_box(scene: Scene, row: int) -> FloatArray:
    """Centre, yaw, length and width of a vehicle and the gap that it wants ahead."""
    gap_m = ENTRY_GAP_M + ENTRY_GAP_S * scene.speed_mps[row]
    yaw_rad = scene.yaw_rad[row]
    length_m, width_m = scene.size_m[row]
    ahead = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
    return np.array([*(scene.xy_m[row] + 0.5 * gap_m * ahead), yaw_rad, length_m + gap_m, width_m])


def _touches_any(box: FloatArray, others: FloatArray) -> bool:
    """Whether a box [5] overlaps one of others [K, 5]: centre, yaw, length, width."""
    every = np.concatenate([box[None], others])
    other = np.arange(1, len(every))
    first = np.zeros(len(others), dtype=np.int64)
    return bool(boxes_touch(every[:, :2], every[:, 2], every[:, 3:], first, other).any())
