"""Timesteps of floating car data -> scenes: box centres, yaw, sizes and looks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from hatn_sim.datatypes import PEDESTRIAN_PREFIX, FloatArray, IntArray, Kind, Scene
from hatn_sim.errors import InputError, nearest
from hatn_sim.recordings.fcd.rows import Row, Timestep
from hatn_sim.recordings.fcd.vehicle_types import VehicleType, guessed, read_colour, type_of

KIND_NAMES: Final = {kind.name.lower(): kind for kind in Kind}
"""The values of our own attribute `kind`."""
RIGHT_BLINKER: Final = 1
LEFT_BLINKER: Final = 2
"""Bits of SUMO's `signals`."""
_LOOKS: Final = ("type", "length", "width", "kind", "color")


class SceneReader:
    """Makes scenes of timesteps. Size and kind come from the vehicle's own attributes where it has
    them, else from its type where that is known, else they are guessed by the type's name.

    Positions in the file are those of front bumpers and angles are degrees clockwise from north,
    so a wrong length moves a centre by half of the error.
    """

    def __init__(self, path: Path, types: Mapping[str, VehicleType]) -> None:
        self._path = path
        self._types = types
        self._looks: dict[tuple[Any, ...], VehicleType] = {}

    def scene(self, step: Timestep) -> Scene:
        """The scene of a timestep; its moment is the file's.

        Raises InputError for a vehicle that is there twice and for what is no number.
        """
        users = _named(step)
        ids = tuple(user.name for user in users)
        if len(set(ids)) < len(ids) or "" in ids:
            odd = next((name for place, name in enumerate(ids) if name in ids[:place]), "")
            found = f"{odd!r} twice" if odd else "one without"
            raise self._wrong(step, "every vehicle once and with an id", found)
        looks = [self._look(step, user) for user in users]
        size_m = np.array([(look.length_m, look.width_m) for look in looks], np.float64)
        size_m = size_m.reshape(-1, 2)
        numbers = self._numbers(step, users)
        yaw_rad = np.radians(90.0 - numbers[:, 2])
        yaw_rad = np.pi - np.mod(np.pi - yaw_rad, 2 * np.pi)
        heading = np.column_stack((np.cos(yaw_rad), np.sin(yaw_rad)))
        return Scene(
            time_s=step.time_s,
            ids=ids,
            xy_m=numbers[:, :2] - 0.5 * size_m[:, :1] * heading,
            yaw_rad=yaw_rad,
            speed_mps=numbers[:, 3].copy(),
            size_m=size_m,
            kind=np.array([look.kind for look in looks], np.int64),
            colour=np.array([look.colour for look in looks], np.int64).reshape(-1, 3),
            blinker=_blinker(numbers[:, 4].astype(np.int64)),
            signal_closed=np.array([letter == "1" for letter in step.closed], np.bool_),
        )

    def _look(self, step: Timestep, user: _Named) -> VehicleType:
        key = (user.on_foot, *(user.row.get(name) for name in _LOOKS))
        look = self._looks.get(key)
        if look is None:
            look = self._looks[key] = self._read_look(step, user)
        return look

    def _read_look(self, step: Timestep, user: _Named) -> VehicleType:
        row, type_name = user.row, str(user.row.get("type") or "")
        default = type_of(self._types, type_name) or guessed(
            "pedestrian" if user.on_foot else type_name
        )
        kind_name, colour = row.get("kind"), row.get("color")
        kind = Kind.PEDESTRIAN if user.on_foot else default.kind
        if kind_name is not None and kind_name not in KIND_NAMES:
            what = f"a kind of vehicle{nearest(str(kind_name), KIND_NAMES)}"
            raise self._wrong(step, what, f"{kind_name!r} of {user.name!r}")
        return VehicleType(
            length_m=self._metres(step, user, "length", default.length_m),
            width_m=self._metres(step, user, "width", default.width_m),
            kind=kind if kind_name is None else KIND_NAMES[kind_name],
            colour=default.colour if colour is None else read_colour(colour),
        )

    def _metres(self, step: Timestep, user: _Named, key: str, default: float) -> float:
        if user.row.get(key) is None:
            return default
        value = _number(user.row, key)
        if not 0 < value < math.inf:
            found = f"{user.row[key]!r} of {user.name!r}"
            raise self._wrong(step, f"{key} in metres above 0", found)
        return value

    def _numbers(self, step: Timestep, users: Sequence[_Named]) -> FloatArray:
        """[N, 5] x, y, angle, speed, signals."""
        keys = ("x", "y", "angle", "speed", "signals")
        rows = [[_number(user.row, key) for key in keys] for user in users]
        numbers = np.array(rows, np.float64).reshape(-1, len(keys))
        bad = np.argwhere(~np.isfinite(numbers))
        if len(bad):
            user, key = users[bad[0, 0]], keys[bad[0, 1]]
            found = repr(user.row[key]) if user.row.get(key) is not None else "none"
            raise self._wrong(step, f"a number as {key} of {user.name!r}", found)
        return numbers

    def _wrong(self, step: Timestep, expected: str, found: str) -> InputError:
        return InputError(
            f"{self._path}: timestep {step.time}: expected {expected}, found {found}; "
            "record it anew with SUMO's --fcd-output"
        )


class _Named(NamedTuple):
    """A road user and its name in the scene."""

    name: str
    row: Row
    on_foot: bool


def _named(step: Timestep) -> list[_Named]:
    """The vehicles, and the persons that do not ride in one of them."""
    vehicles = {_place(row) for row, on_foot in step.users if not on_foot}
    users: list[_Named] = []
    for row, on_foot in step.users:
        if on_foot and (row.get("vehicle") or _place(row) in vehicles):
            continue
        # Our own export says the kind, and gives the whole name.
        prefix = PEDESTRIAN_PREFIX if on_foot and not row.get("kind") else ""
        users.append(_Named(f"{prefix}{row.get('id') or ''}", row, on_foot))
    return users


def _place(row: Row) -> tuple[Any, ...]:
    """Where and how fast: SUMO writes the same of a rider and the vehicle."""
    return tuple(row.get(key) for key in ("x", "y", "angle", "speed"))


def _blinker(signals: IntArray) -> IntArray:
    right, left = (signals & RIGHT_BLINKER) > 0, (signals & LEFT_BLINKER) > 0
    return left.astype(np.int64) - right


def _number(row: Row, key: str) -> float:
    """NaN for what is no number; signals are none where the file has none."""
    value = row.get(key)
    if value is None:
        return 0.0 if key == "signals" else math.nan
    try:
        return float(value)
    except ValueError:
        return math.nan
