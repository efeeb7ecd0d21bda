"""What traffic is like, from its frames: how much, how fast, how delayed, how often unsafe."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Final

from hatn_sim.datatypes import Frame

HARD_BRAKING_MPS2: Final = 4.5
"""A vehicle that loses speed at this rate between two frames brakes hard."""
ROUNDING_MPS2: Final = 1e-6
"""A braking of exactly the threshold counts, whatever the last bit of a difference of speeds."""


@dataclass(frozen=True)
class TrafficCount:
    """What was counted in stretches of traffic; counts of several stretches add up."""

    seconds: float = 0.0
    frames: int = 0
    vehicle_frames: int = 0
    speed_sum_mps: float = 0.0  # over vehicle-frames, those standing included
    arrived: int = 0
    delays: int = 0  # vehicles whose delay is known
    delay_sum_s: float = 0.0
    collisions: int = 0
    emergency_brakings: int = 0
    hard_brakings: int = 0

    def __add__(self, other: TrafficCount) -> TrafficCount:
        names = (field.name for field in fields(TrafficCount))
        return TrafficCount(**{name: getattr(self, name) + getattr(other, name) for name in names})

    def with_delays(self, delays_s: Sequence[float]) -> TrafficCount:
        """This count with the delays of the vehicles that arrived, known only afterwards."""
        return replace(self, delays=len(delays_s), delay_sum_s=sum(delays_s))


def count_traffic(before: Frame, frames: Iterable[Frame], dt_s: float) -> TrafficCount:
    """Counts of the frames, `before` being the frame just before the first of them.

    A collision is a pair of vehicles, counted once while they overlap. Emergency brakings and hard
    brakings are vehicles, counted once each; the frame in which a vehicle appears is left out, and
    so is one in which it teleports.
    """
    count = vehicle_frames = arrived = collisions = 0
    speed_sum_mps = 0.0
    emergency: set[str] = set()
    hard: set[str] = set()
    touching = set(before.truth.collisions)
    for frame in frames:
        truth = frame.truth
        count += 1
        arrived += len(truth.arrived)
        collisions += len(set(truth.collisions) - touching)
        touching = set(truth.collisions)
        emergency.update(truth.emergency_braking)
        hard.update(hard_braking(before, frame, dt_s))
        vehicle_frames += len(frame.scene.ids)
        speed_sum_mps += float(frame.scene.speed_mps.sum())
        before = frame
    return TrafficCount(
        seconds=count * dt_s,
        frames=count,
        vehicle_frames=vehicle_frames,
        speed_sum_mps=speed_sum_mps,
        arrived=arrived,
        collisions=collisions,
        emergency_brakings=len(emergency),
        hard_brakings=len(hard),
    )


def hard_braking(before: Frame, frame: Frame, dt_s: float) -> set[str]:
    """The vehicles that lose speed hard from one frame to the next, teleporting ones left out."""
    speed_before, speed_now = _speeds(before), _speeds(frame)
    return {
        name
        for name in speed_now.keys() & speed_before.keys() - set(frame.truth.teleported)
        if (speed_before[name] - speed_now[name]) / dt_s >= HARD_BRAKING_MPS2 - ROUNDING_MPS2
    }


def density_figures(count: TrafficCount) -> dict[str, float | None]:
    """How much and how fast; None where nothing was there to take a mean of."""
    return {
        "vehicles_at_once": _ratio(count.vehicle_frames, count.frames),
        "throughput_per_h": _ratio(3600.0 * count.arrived, count.seconds),
        "mean_speed_mps": _ratio(count.speed_sum_mps, count.vehicle_frames),
        "mean_delay_s": _ratio(count.delay_sum_s, count.delays),
    }


def risk_figures(count: TrafficCount) -> dict[str, float | None]:
    """Base rates of what goes wrong, per 1000 vehicles that arrived."""
    return {
        "collisions_per_1000": _ratio(1000.0 * count.collisions, count.arrived),
        "emergency_brakings_per_1000": _ratio(1000.0 * count.emergency_brakings, count.arrived),
        "hard_brakings_per_1000": _ratio(1000.0 * count.hard_brakings, count.arrived),
    }


def read_delays_s(tripinfo: Path, after_s: float) -> list[float]:
    """Time lost by every vehicle that arrived after `after_s`, from SUMO's `--tripinfo-output`."""
    trips = ElementTree.parse(tripinfo).getroot().iter("tripinfo")
    return [
        float(trip.attrib["timeLoss"]) for trip in trips if float(trip.attrib["arrival"]) > after_s
    ]


def _speeds(frame: Frame) -> dict[str, float]:
    return dict(zip(frame.scene.ids, frame.scene.speed_mps.tolist(), strict=True))


def _ratio(part: float, whole: float) -> float | None:
    return part / whole if whole else None
