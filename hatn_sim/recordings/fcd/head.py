"""What the beginning of floating car data shows: does it fit its net, and what does it lack?"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, Kind, Lane, Scene
from hatn_sim.errors import InputError
from hatn_sim.recordings.fcd.rows import Timestep
from hatn_sim.recordings.fcd.vehicle_types import VehicleType, type_of
from hatn_sim.recordings.fit import distance_to_lanes_m

HEAD_SAMPLES: Final = 2000
"""Positions of vehicles looked at before the first frame is given."""
FAR_M: Final = 10.0
"""A vehicle farther than this from every centre line is off the net."""
ON_LANE_M: Final = 2.0
"""SUMO drives along centre lines: farther off at the median, recording and net are shifted."""
DRIVING_MPS: Final = 2.0
SPEED_RATIOS: Final = (0.5, 2.0)
"""Metres moved over metres that the speed says, at the median; lane changes and teleports apart."""
RATIO_SAMPLES: Final = 10


@dataclass(frozen=True, eq=False)
class Moment:
    """A timestep of the file, its number at 0.1 s from the first one, and its scene."""

    index: int
    step: Timestep
    scene: Scene


def first_moments(moments: Iterable[Moment]) -> Iterator[Moment]:
    """Those up to `HEAD_SAMPLES` vehicles."""
    samples = 0
    for moment in moments:
        yield moment
        samples += len(moment.scene.ids)
        if samples >= HEAD_SAMPLES:
            return


def check_speeds(path: Path, head: Sequence[Moment]) -> None:
    """Raises InputError where vehicles do not move as far as their speeds say."""
    moved_m: list[float] = []
    driven_m: list[float] = []
    for before, now in pairwise(head):
        places = {name: place for place, name in enumerate(before.scene.ids)}
        for place, name in enumerate(now.scene.ids):
            if now.index == before.index + 1 and name in places:
                step_m = now.scene.xy_m[place] - before.scene.xy_m[places[name]]
                moved_m.append(float(np.hypot(*step_m)))
                driven_m.append(float(now.scene.speed_mps[place]) * DT_S)
    driving = np.array(driven_m) > DRIVING_MPS * DT_S
    if driving.sum() < RATIO_SAMPLES:
        return
    ratio = float(np.median(np.array(moved_m)[driving] / np.array(driven_m)[driving]))
    if not SPEED_RATIOS[0] <= ratio <= SPEED_RATIOS[1]:
        raise InputError(
            f"{path}: expected metres and metres per second, found vehicles that move {ratio:.2g} "
            "times as far as their speeds say; record it without --fcd-output.geo, in m/s"
        )


def check_net(
    path: Path, map_path: Path, lanes: Sequence[Lane], head: Sequence[Moment]
) -> str | None:
    """A notice where some vehicles are off the net, or all a little. InputError where most are."""
    driving = [moment.scene.kind != Kind.PEDESTRIAN for moment in head]
    xy_m = np.concatenate(
        [moment.scene.xy_m[rows] for moment, rows in zip(head, driving, strict=True)]
    )
    if not len(xy_m):
        return None
    off_m = distance_to_lanes_m(lanes, xy_m)
    median_m, worst_m = float(np.median(off_m)), float(off_m.max())
    if median_m > FAR_M:
        raise InputError(
            f"{path}: does not fit {map_path}: vehicles are {median_m:.0f} m from the nearest "
            f"lane at the median, {worst_m:.0f} m at worst; check that it is the net of this "
            "recording, and that it was recorded without --fcd-output.utm"
        )
    if median_m > ON_LANE_M:
        return (
            f"vehicles are {median_m:.1f} m from the nearest lane's centre line at the median, "
            f"{worst_m:.1f} m at worst: is {map_path.name} the net of this recording?"
        )
    if worst_m <= FAR_M:
        return None
    return (
        f"{np.mean(off_m > FAR_M):.1%} of the first {len(xy_m)} positions are more than "
        f"{FAR_M:.0f} m from every lane, {worst_m:.0f} m at worst: "
        f"is {map_path.name} the net of this recording?"
    )


def lacks(
    head: Sequence[Moment], types: Mapping[str, VehicleType], lanes: Sequence[Lane]
) -> list[str]:
    """Notices on what the recording does not say; `types` are those of known size."""
    rows = [row for moment in head for row, on_foot in moment.step.users if not on_foot]
    unsized = [row for row in rows if row.get("length") is None or row.get("width") is None]
    names = {str(row.get("type") or "") for row in unsized}
    guesses = sorted(name for name in names if type_of(types, name) is None)
    notices: list[str] = []
    if len(guesses) < len(names):
        notices.append(
            f"sizes of {len(names) - len(guesses)} vehicle types are SUMO's own and those of the "
            ".rou.xml and .add.xml files beside the tracks and the net"
        )
    if guesses:
        more = f" and {len(guesses) - 3} more" if len(guesses) > 3 else ""
        notices.append(
            f"sizes of {len(guesses)} vehicle types are guessed ({', '.join(guesses[:3])}{more}); "
            "a length wrong by 1 m moves a centre by 0.5 m: put the .rou.xml or .add.xml that "
            "defines them beside the tracks"
        )
    if rows and all(row.get("signals") is None for row in rows):
        notices.append("there are no blinkers; record with --fcd-output.signals to have them")
    if any(lane.signals for lane in lanes) and not any(moment.step.closed for moment in head):
        notices.append("there are no traffic lights in floating car data: all count as open")
    return notices
