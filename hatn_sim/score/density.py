"""How many vehicles interact with an ego, by four criteria: the paper's "Interacting car density".

An ego is every vehicle at every sampled moment; pedestrians are neither egos nor counted. Distances
are between centres. Lines conflict as in the semantic graph (METHOD section 1.4), before its cap.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from hatn_sim.datatypes import (
    MAX_NODES,
    BoolArray,
    FloatArray,
    Frame,
    IntArray,
    Kind,
    Scene,
    Score,
)
from hatn_sim.graph import active_conflicts
from hatn_sim.labels import SAMPLE_EVERY_FRAMES
from hatn_sim.loop import KEPT_LINES, RELEASE_FRAMES
from hatn_sim.perception import Perception, begin, perceive
from hatn_sim.road import Road
from hatn_sim.score.intervals import MIN_RUNS, cluster_sums, interval, ratio

CRITERIA: Final = ("all", "30m", "10m", "conflict")
"""All vehicles of the scene, those within 30 m, within 10 m, those whose lines conflict."""
CAPPED: Final = "conflict_capped"
"""As "conflict", but no more than a semantic graph has nodes for."""
RADII_M: Final = (30.0, 10.0)
MAX_OTHERS: Final = MAX_NODES - 1


@dataclass(frozen=True, eq=False)
class Density:
    """The samples of a scene: how many vehicles each ego interacts with. S samples."""

    run: IntArray  # [S] number of the run
    vehicle: IntArray  # [S] number of the ego, from 0 on in every run
    count: IntArray  # [S, 4] by CRITERIA
    has_line: BoolArray  # [S] where the ego has none, its count of "conflict" is not defined


@dataclass(frozen=True)
class Summary:
    """The distribution of one criterion; without samples there is no value."""

    criterion: str
    n: int
    mean: float | None = None
    median: float | None = None
    ninetieth: float | None = None  # 90 % of the egos interact with at most this many
    maximum: int | None = None
    none_share: float | None = None  # of the egos that interact with nobody


def count_interacting(road: Road, frames: Iterable[Frame], watched: int = 0) -> Density:
    """Samples of a run at 10 Hz, one of every vehicle each `SAMPLE_EVERY_FRAMES`.

    The first `watched` frames are not sampled: lines are inferred from what was seen before.
    """
    state = begin(road)
    numbers: dict[str, int] = {}
    parts: list[Density] = []
    for index, frame in enumerate(frames, start=-watched):
        state = perceive(state, frame.scene, None)
        if index >= 0 and index % SAMPLE_EVERY_FRAMES == 0:
            parts.append(_sample(road, state.seen, numbers))
        if index % RELEASE_FRAMES == 0:
            road.release(RELEASE_FRAMES, KEPT_LINES)
    return pool(parts)


def _sample(road: Road, seen: Perception, numbers: dict[str, int]) -> Density:
    """The samples of one moment; newcomers get the next free of the vehicles' numbers."""
    scene = seen.scene
    at = np.flatnonzero(scene.kind != Kind.PEDESTRIAN)
    others = np.zeros((len(at), len(CRITERIA)), dtype=np.int64)
    others[:, 0] = len(at) - 1
    others[:, 1:3] = _within(scene, at)
    others[:, 3] = conflicting(road, seen, at)
    vehicle = [numbers.setdefault(scene.ids[i], len(numbers)) for i in at.tolist()]
    return Density(
        run=np.zeros(len(at), dtype=np.int64),
        vehicle=np.array(vehicle, dtype=np.int64),
        count=others,
        has_line=seen.lines.line[at] >= 0,
    )


def _within(scene: Scene, at: IntArray) -> IntArray:
    """Other vehicles [V, 2] within each of `RADII_M` of the vehicles `at` [V]."""
    if not len(at):
        return np.zeros((0, len(RADII_M)), dtype=np.int64)
    xy_m = scene.xy_m[at]
    tree = KDTree(xy_m)
    found = [tree.query_ball_point(xy_m, radius, return_length=True) for radius in RADII_M]
    return np.stack(found, axis=1).astype(np.int64) - 1


def conflicting(road: Road, seen: Perception, at: IntArray) -> IntArray:
    """Vehicles [V] whose lines have an active conflict with each one's, among the vehicles `at`."""
    met = active_conflicts(road, seen, at[seen.lines.line[at] >= 0])
    return np.bincount(met.ego, minlength=len(seen.scene.ids))[at]


def pool(parts: Sequence[Density]) -> Density:
    """Moments of one run put together."""
    if not parts:
        nothing = np.zeros(0, dtype=np.int64)
        return Density(nothing, nothing, np.zeros((0, len(CRITERIA)), np.int64), nothing > 0)
    return Density(
        run=np.concatenate([part.run for part in parts]),
        vehicle=np.concatenate([part.vehicle for part in parts]),
        count=np.concatenate([part.count for part in parts]),
        has_line=np.concatenate([part.has_line for part in parts]),
    )


def pool_runs(runs: Sequence[Density]) -> Density:
    """Runs of one scene put together, numbered in this order."""
    return pool(
        [
            Density(np.full(len(one.run), number), one.vehicle, one.count, one.has_line)
            for number, one in enumerate(runs)
        ]
    )


def counts_of(density: Density, criterion: str) -> IntArray:
    """The counts of one of `CRITERIA`, or of `CAPPED`, where they are defined."""
    if criterion == CAPPED:
        return np.minimum(counts_of(density, "conflict"), MAX_OTHERS)
    column = density.count[:, CRITERIA.index(criterion)]
    return column[density.has_line] if criterion == "conflict" else column


def histogram(count: IntArray, width: int = 1) -> tuple[IntArray, IntArray]:
    """The first count of every bin of `width` counts, from 0 on, and the samples in it."""
    samples = np.bincount(count // width)
    return np.arange(len(samples)) * width, samples


def criteria_of(density: Density) -> tuple[str, ...]:
    """The criteria to report: `CAPPED` only where the cap makes a difference."""
    over = counts_of(density, "conflict") > MAX_OTHERS
    return (*CRITERIA, CAPPED) if over.any() else CRITERIA


def summarise(density: Density, criterion: str) -> Summary:
    """The distribution of a criterion in a few figures."""
    return summary_of(criterion, counts_of(density, criterion))


def summary_of(criterion: str, count: IntArray) -> Summary:
    """The same of its counts [S]."""
    if not len(count):
        return Summary(criterion, 0)
    return Summary(
        criterion,
        n=len(count),
        mean=float(count.mean()),
        median=float(np.median(count)),
        ninetieth=float(np.quantile(count, 0.9, method="inverted_cdf")),
        maximum=int(count.max()),
        none_share=float((count == 0).mean()),
    )


def density_scores(scene: str, density: Density) -> list[Score]:
    """Mean numbers of interacting vehicles, `density_all` and so on, with their intervals.

    The intervals are bootstrapped over runs from `MIN_RUNS` on, below that over vehicles.
    """
    return [_score(scene, density, criterion) for criterion in criteria_of(density)]


def clustered_over(density: Density) -> str:
    """What the intervals are bootstrapped over."""
    return "seeds" if len(np.unique(density.run)) >= MIN_RUNS else "vehicles"


def _score(scene: str, density: Density, criterion: str) -> Score:
    of_lines = criterion in ("conflict", CAPPED)
    count = counts_of(density, criterion).astype(np.float64)
    cluster = density.run
    if clustered_over(density) == "vehicles":
        cluster = density.run * (int(density.vehicle.max(initial=0)) + 1) + density.vehicle
    if of_lines:
        cluster = cluster[density.has_line]
    sums: FloatArray = cluster_sums(np.stack((count, np.ones(len(count))), axis=1), cluster)
    low, high = interval(sums, ratio) or (None, None)
    return Score(
        measure=f"density_{criterion}",
        predictor="semantic graph" if of_lines else "-",
        scene=scene,
        subset="all",
        adapt="none",
        value=summarise(density, criterion).mean,
        unit="vehicles",
        n=len(count),
        low=low,
        high=high,
    )
