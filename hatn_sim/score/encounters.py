"""What comes of scripted encounters: how many end in a collision or in hard braking.

The scenes of a suite name their pairs: `NAME_ego.K` has right of way, `NAME_foe.K` meets it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Final

from hatn_sim.datatypes import Frame
from hatn_sim.score.traffic import hard_braking

PAIRED: Final = re.compile(r"(.*)_(?:ego|foe)\.(\d+)")


@dataclass(frozen=True)
class EncounterCount:
    """What was counted in runs of a suite's scene; counts of several runs add up."""

    runs: int = 0
    vehicle_hours: float = 0.0
    encounters: int = 0  # both had left before the run's end
    with_event: int = 0  # of these: the two collided, or one of them braked hard
    collisions: int = 0  # pairs, those that are not scripted included
    hard_brakings: int = 0  # vehicles
    unscripted: int = 0  # of collisions and hard brakings: not of a scripted pair

    def __add__(self, other: EncounterCount) -> EncounterCount:
        names = (field.name for field in fields(EncounterCount))
        return EncounterCount(
            **{name: getattr(self, name) + getattr(other, name) for name in names}
        )


def partners(vehicle: str) -> tuple[str, str] | None:
    """The scripted pair that a vehicle belongs to, ids sorted; None where it belongs to none.

    >>> partners("merge_foe.3")
    ('merge_ego.3', 'merge_foe.3')
    """
    match = PAIRED.fullmatch(vehicle)
    return None if match is None else (f"{match[1]}_ego.{match[2]}", f"{match[1]}_foe.{match[2]}")


def count_encounters(before: Frame, frames: Iterable[Frame], dt_s: float) -> EncounterCount:
    """Counts of one run, `before` being the frame just before the first of `frames`.

    Vehicles brake hard as `traffic.hard_braking` says or by SUMO's emergency braking.
    """
    collided: set[tuple[str, str]] = set()
    braked: set[str] = set()
    arrived: set[str] = set()
    vehicle_frames = 0
    for frame in frames:
        collided.update(frame.truth.collisions)
        braked.update(hard_braking(before, frame, dt_s), frame.truth.emergency_braking)
        arrived.update(frame.truth.arrived)
        vehicle_frames += len(frame.scene.ids)
        before = frame
    pairs = {partners(vehicle) for vehicle in arrived}
    scripted = [pair for pair in pairs if pair is not None and arrived.issuperset(pair)]
    with_event = [pair for pair in scripted if pair in collided or braked.intersection(pair)]
    unscripted_collisions = [pair for pair in collided if partners(pair[0]) != pair]
    unscripted_brakings = [vehicle for vehicle in braked if partners(vehicle) is None]
    return EncounterCount(
        runs=1,
        vehicle_hours=vehicle_frames * dt_s / 3600.0,
        encounters=len(scripted),
        with_event=len(with_event),
        collisions=len(collided),
        hard_brakings=len(braked),
        unscripted=len(unscripted_collisions) + len(unscripted_brakings),
    )


def encounter_figures(count: EncounterCount) -> dict[str, float | None]:
    """Means over runs; None where nothing was there to take a mean of."""

    def per_run(total: float) -> float | None:
        return total / count.runs if count.runs else None

    return {
        "vehicle_hours": count.vehicle_hours,
        "encounters_per_run": per_run(count.encounters),
        "event_percent": 100.0 * count.with_event / count.encounters if count.encounters else None,
        "collisions_per_run": per_run(count.collisions),
        "hard_brakings_per_run": per_run(count.hard_brakings),
        "unscripted_per_run": per_run(count.unscripted),
    }
