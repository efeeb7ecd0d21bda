"""What came out of the comparison with SUMO's conflicts: measures, and classes in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.spatial.distance import cdist

from hatn_sim.datatypes import BoolArray, FloatArray, Score
from hatn_sim.geometry import resample, tangent_rad, wrap_angle
from hatn_sim.score.intervals import cluster_sums, interval, ratio
from hatn_sim.score.oracle import Compared, Outcome
from hatn_sim.score.oracle_lanes import JunctionLanes

MEANING: Final[Mapping[Outcome, str]] = {
    Outcome.BOTH: "in both lists",
    Outcome.ONLY_SUMO: "SUMO's, and no conflict of ours",
    Outcome.ONLY_SUMO_OTHER_LANE: "SUMO's, and our line leads over another lane than SUMO plans",
    Outcome.ONLY_OURS: "ours, and SUMO holds nothing between these ways through the junction",
    Outcome.ONLY_OURS_NO_JUNCTION: "ours, at no junction that both have ahead",
    Outcome.NEITHER: "in neither list: their ways through the junction do not meet",
    Outcome.SAME_LANE_BEFORE: "from the same lane: one follows the other until they part",
    Outcome.NO_ROUTE: "SUMO's, of a vehicle that is on no lane",
    Outcome.PASSED: "a front bumper is beyond the area of conflict",
    Outcome.OUTDATED: "SUMO's, of a vehicle that left that lane in its last step",
    Outcome.UNANNOUNCED: "ours and in SUMO's table of foes; its list waits until one of them "
    "announces to pass (not at a red light, not far off in a queue)",
    Outcome.CUT_SHORT: "ours and in SUMO's table of foes; its list ends before, at the first foe "
    "lane in the table that does not cross",
    Outcome.NO_LIST: "ours and in SUMO's table of foes; the vehicle that should list the other "
    "lists nobody at all (it leaves another junction, or has to change lanes)",
    Outcome.RIGHT_OF_WAY_ONLY: "ours and in SUMO's right of way between the approaches; its table "
    "of lanes inside the junction lacks them",
    Outcome.HEAD_ON: "ours: they drive against each other on one lane, of which SUMO knows nothing",
    Outcome.NO_LOGIC: "ours, in an unregulated junction, of which SUMO keeps no list",
}
ERRORS: Final = (
    Outcome.ONLY_SUMO,
    Outcome.ONLY_SUMO_OTHER_LANE,
    Outcome.ONLY_OURS,
    Outcome.ONLY_OURS_NO_JUNCTION,
)
MISSED: Final = ERRORS[:2]
INVENTED: Final = ERRORS[2:]
IN_TABLE: Final = (Outcome.UNANNOUNCED, Outcome.CUT_SHORT, Outcome.NO_LIST)
PREDICTOR: Final = "route"


@dataclass(eq=False)
class Tally:
    """Everything compared so far."""

    lanes: JunctionLanes
    _numbers: dict[str, int] = field(default_factory=dict[str, int])
    _outcomes: list[FloatArray] = field(default_factory=list[FloatArray])  # outcome, vehicle
    _distances: list[FloatArray] = field(default_factory=list[FloatArray])  # place, entry, vehicle
    _waiting: int = 0
    _ways: Counter[tuple[Outcome, int, int]] = field(
        default_factory=Counter[tuple[Outcome, int, int]]
    )

    def add(self, compared: Compared, ids: Sequence[str]) -> None:
        """Count one moment; `ids` name its vehicles."""
        number = np.array([self._numbers.setdefault(name, len(self._numbers)) for name in ids])
        if len(compared.outcome):
            first = number[compared.vehicle[:, 0]]
            self._outcomes.append(np.stack((compared.outcome, first), axis=1).astype(np.float64))
        errors = compared.distances
        if len(errors.vehicle):
            columns = (errors.place_m, errors.entry_m, number[errors.vehicle])
            self._distances.append(np.stack(columns, axis=1).astype(np.float64))
        self._waiting += errors.waiting_places
        for row in np.flatnonzero(np.isin(compared.outcome, ERRORS)).tolist():
            one, other = sorted(compared.way[row].tolist())
            self._ways[Outcome(int(compared.outcome[row])), one, other] += 1

    def scores(self, scene: str) -> list[Score]:
        """The measures, and the number of meetings in every class, `n` being all meetings."""
        outcome, vehicle = _columns(self._outcomes, 2)
        place_m, entry_m, asked = _columns(self._distances, 3)
        found = outcome == Outcome.BOTH
        in_table = np.isin(outcome, IN_TABLE)
        wrong = np.isin(outcome, INVENTED)
        shares = {
            "conflict_recall": (found, np.isin(outcome, MISSED)),
            "conflict_precision": (found, wrong),
            "conflict_precision_with_table": (found | in_table, wrong),
        }
        scores = [_share(name, scene, hit, miss, vehicle) for name, (hit, miss) in shares.items()]
        scores.append(_median("distance_median_m", scene, place_m, asked))
        scores.append(_median("entry_distance_median_m", scene, entry_m, asked))
        counts = Counter(outcome.astype(np.int64).tolist())
        scores += [
            _count(f"meetings_{kind.name.lower()}", scene, counts[int(kind)], len(outcome))
            for kind in Outcome
        ]
        total = len(place_m) + self._waiting
        scores.append(_count("distances_to_waiting_places", scene, self._waiting, total))
        return scores

    def disagreements(self) -> list[tuple[Outcome, int, str]]:
        """Class, count and words for every two ways on which SUMO and we differ, most first."""
        return [
            (kind, count, explain(self.lanes, one, other))
            for (kind, one, other), count in self._ways.most_common()
        ]


def explain(lanes: JunctionLanes, one: int, other: int) -> str:
    """Two ways through a junction by name, how near they come and at which angle."""
    if min(one, other) < 0:
        return "outside junctions"
    near_m, turned_deg = _nearest(way_xy_m(lanes, one), way_xy_m(lanes, other))
    names = f"{lanes.lanes[one].id} and {lanes.lanes[other].id}"
    return f"{names} come within {near_m:.1f} m of each other, at {turned_deg:.0f} degrees"


def way_xy_m(lanes: JunctionLanes, way: int) -> FloatArray:
    """The centre line of a way, a point every 0.2 m."""
    parts: list[FloatArray] = []
    row = way
    while row >= 0:
        parts.append(lanes.lanes[row].xy_m)
        after = (lanes.row.get(name, -1) for name in lanes.lanes[row].successors)
        row = next((k for k in after if k >= 0 and lanes.way[k] == way), -1)
    return resample(np.concatenate(parts), 0.2)


def _nearest(one_xy_m: FloatArray, other_xy_m: FloatArray) -> tuple[float, float]:
    distance = cdist(one_xy_m, other_xy_m)
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    turned = wrap_angle(tangent_rad(one_xy_m)[i] - tangent_rad(other_xy_m)[j])
    return float(distance[i, j]), float(np.degrees(np.abs(turned)))


def _columns(parts: Sequence[FloatArray], count: int) -> FloatArray:
    """The columns [count, rows] of all parts [rows, count] together."""
    return np.concatenate((np.zeros((0, count)), *parts)).T


def _share(measure: str, scene: str, hit: BoolArray, miss: BoolArray, vehicle: FloatArray) -> Score:
    """Hits among hits and misses; the interval is bootstrapped over vehicles."""
    of_it = hit | miss
    n = int(of_it.sum())
    if not n:
        return _score(measure, scene, None, "1", 0, None)
    values = np.stack((hit[of_it].astype(np.float64), np.ones(n)), axis=1)
    clusters = cluster_sums(values, vehicle[of_it].astype(np.int64))
    return _score(measure, scene, float(hit[of_it].mean()), "1", n, interval(clusters, ratio))


def _median(measure: str, scene: str, error_m: FloatArray, vehicle: FloatArray) -> Score:
    """The median of absolute errors; no interval: it is no mean of clusters."""
    if not len(error_m):
        return _score(measure, scene, None, "m", 0, None)
    return _score(measure, scene, float(np.median(np.abs(error_m))), "m", len(error_m), None)


def _count(measure: str, scene: str, count: int, of: int) -> Score:
    return (
        _score(measure, scene, float(count), "meetings", of, None)
        if of
        else _score(measure, scene, None, "meetings", 0, None)
    )


def _score(
    measure: str,
    scene: str,
    value: float | None,
    unit: str,
    n: int,
    bounds: tuple[float, float] | None,
) -> Score:
    low, high = bounds or (None, None)
    return Score(measure, PREDICTOR, scene, "all", "none", value, unit, n, low, high)
