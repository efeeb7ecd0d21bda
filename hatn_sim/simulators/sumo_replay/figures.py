"""How true a replay inside SUMO is: fidelity of placed vehicles, divergence of driven ones."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hatn_sim.datatypes import DT_S, BoolArray, FloatArray, IntArray, Scene

DIVERGENCE_AT_S: Final = (1, 2, 3, 5, 10, 20, 30, 60)
"""Seconds after the hand-over at which divergence is told."""
ROUNDING_S: Final = 1e-6


@dataclass(frozen=True)
class Fidelity:
    """What SUMO made of the vehicles placed along the recording, over all of their frames.

    Errors are SUMO's minus recorded, of the front bumper; the speed is the one SUMO derives from
    the displacement, before it is set to the recorded one for its drivers. Quantiles are within
    1 mm and 1 mm/s. None where n = 0.
    """

    n: int  # vehicle-frames placed
    position_m_median: float | None
    position_m_p99: float | None
    position_m_max: float | None
    lane_n: int  # vehicle-frames whose lane is known by matching the whole recorded track
    lane_share: float | None  # of these, SUMO has the vehicle on that lane (see Match.lanes_at)
    speed_mps_median: float | None
    speed_mps_p99: float | None
    centre_line_m_median: float | None  # recorded vehicles to the nearest centre line
    outside: int  # vehicle-frames recorded beside every lane: no driver in SUMO sees these
    lost: int  # vehicle-frames that SUMO took off the road
    not_placed: int  # frames of pedestrians, which SUMO's drivers do not see


@dataclass(frozen=True)
class DivergenceAt:
    """How far vehicles that are driven are from their own recordings, so long after hand-over.

    One that was held back at its entry is behind its recording from the first moment on.
    """

    after_s: float
    n: int
    median_m: float
    max_m: float


@dataclass(frozen=True)
class Overlap:
    """A driven vehicle's outline touches another vehicle's, for the first time."""

    time_s: float
    driven_id: str
    other_id: str
    other_recorded: bool


@dataclass(frozen=True)
class Divergence:
    """What came of the vehicles that SUMO's drivers or agents took over."""

    vehicles: int
    at: tuple[DivergenceAt, ...]
    final_m_median: float | None  # where both the recording and the vehicle were last there
    overlaps: tuple[Overlap, ...]
    kept: tuple[str, ...]  # to be released, but the net has no way along their recordings
    held_back: int  # released ones whose place of entry was taken when they were to appear
    held_back_s: float  # vehicle-seconds of that


class Quantiles:
    """Counts in bins of 1 mm (or mm/s) up to 100 m: quantiles of any number of values."""

    BIN: Final = 1e-3
    BINS: Final = 100_000

    def __init__(self) -> None:
        self._counts: IntArray = np.zeros(self.BINS, dtype=np.int64)
        self.n = 0
        self.max = 0.0

    def add(self, values: FloatArray) -> None:
        """Counts values [N] >= 0 in."""
        if len(values):
            bins = np.minimum(np.rint(values / self.BIN), self.BINS - 1).astype(np.int64)
            np.add.at(self._counts, bins, 1)
            self.n += len(values)
            self.max = max(self.max, float(values.max()))

    def quantile(self, share: float) -> float | None:
        """The smallest value that at least this share of all does not exceed."""
        if not self.n:
            return None
        place = int(np.searchsorted(np.cumsum(self._counts), max(share * self.n, 1.0) - 1e-9))
        return place * self.BIN if place < self.BINS - 1 else self.max


@dataclass
class FidelityCount:
    """Collects what `Fidelity` tells."""

    position_m: Quantiles = field(default_factory=Quantiles)
    speed_mps: Quantiles = field(default_factory=Quantiles)
    centre_line_m: Quantiles = field(default_factory=Quantiles)
    lane_n: int = 0
    lane_right: int = 0
    outside: int = 0
    lost: int = 0
    not_placed: int = 0

    def add(self, wanted: FloatArray, found: FloatArray, on_lane: BoolArray) -> None:
        """Counts in poses [M, 4] that were wanted and rows [M, 3] found, as in `ReplayFrame`."""
        there = np.isfinite(found[:, 0])
        self.position_m.add(np.linalg.norm(found[there, :2] - wanted[there, :2], axis=1))
        self.speed_mps.add(np.abs(found[there, 2] - wanted[there, 3]))
        self.outside += int(np.count_nonzero(~on_lane))
        self.lost += int(np.count_nonzero(~there))

    def add_lanes(self, right: Sequence[bool]) -> None:
        """Counts in whether SUMO's lane is the one driven."""
        self.lane_n += len(right)
        self.lane_right += sum(right)

    def add_centre_line(self, away_m: FloatArray) -> None:
        """Counts in distances [M] of recorded vehicles to the nearest centre line."""
        self.centre_line_m.add(away_m)

    def figures(self) -> Fidelity:
        """The figures so far."""
        return Fidelity(
            n=self.position_m.n,
            position_m_median=self.position_m.quantile(0.5),
            position_m_p99=self.position_m.quantile(0.99),
            position_m_max=self.position_m.max if self.position_m.n else None,
            lane_n=self.lane_n,
            lane_share=self.lane_right / self.lane_n if self.lane_n else None,
            speed_mps_median=self.speed_mps.quantile(0.5),
            speed_mps_p99=self.speed_mps.quantile(0.99),
            centre_line_m_median=self.centre_line_m.quantile(0.5),
            outside=self.outside,
            lost=self.lost,
            not_placed=self.not_placed,
        )


@dataclass
class DivergenceCount:
    """Collects what `Divergence` tells."""

    since_s: dict[str, float] = field(default_factory=dict[str, float])
    at_m: dict[int, list[float]] = field(default_factory=dict[int, list[float]])
    last_m: dict[str, float] = field(default_factory=dict[str, float])
    touched: dict[tuple[str, str], Overlap] = field(default_factory=dict[tuple[str, str], Overlap])
    held: set[str] = field(default_factory=set[str])
    held_s: float = 0.0

    def add(
        self,
        shown: Scene,
        driven: Collection[str],
        recorded: Scene,
        held: Collection[str],
        overlaps: Sequence[Overlap],
    ) -> None:
        """Counts a frame in: where driven vehicles are and where they were recorded."""
        row_of = {name: row for row, name in enumerate(recorded.ids)} if driven else {}
        for shown_row, name in enumerate(shown.ids):
            if name not in driven:
                continue
            since_s = self.since_s.setdefault(name, shown.time_s)
            row = row_of.get(name)
            if row is None:
                continue
            away_m = float(np.hypot(*(shown.xy_m[shown_row] - recorded.xy_m[row])))
            self.last_m[name] = away_m
            after_s = shown.time_s - since_s
            if abs(after_s - round(after_s)) < ROUNDING_S:
                self.at_m.setdefault(round(after_s), []).append(away_m)
        for overlap in overlaps:
            self.touched.setdefault((overlap.driven_id, overlap.other_id), overlap)
        self.held.update(held)
        self.held_s += DT_S * len(held)

    def figures(self, kept: tuple[str, ...]) -> Divergence:
        """The figures so far, and who was kept to the recording for want of a way."""
        at = tuple(
            DivergenceAt(float(second), len(away), float(np.median(away)), max(away))
            for second in DIVERGENCE_AT_S
            if (away := self.at_m.get(second))
        )
        final = float(np.median(list(self.last_m.values()))) if self.last_m else None
        return Divergence(
            vehicles=len(self.since_s),
            at=at,
            final_m_median=final,
            overlaps=tuple(self.touched.values()),
            kept=kept,
            held_back=len(self.held),
            held_back_s=self.held_s,
        )
