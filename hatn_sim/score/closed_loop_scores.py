"""Drives of many seeds -> scores: each row by itself, against the baseline, and open against closed
loop.

| measure | unit | what it is |
|---|---|---|
| those of `closed_loop` | | mean over the drives of a row |
| `NAME_change` | as NAME | mean difference to the same drives with the baseline |
| `NAME_relative_change` | share | that, over the baseline's mean; none where this is 0 |
| `lost_seeds` | 1 | seeds of which the row is missing, for a process died |
| those of `prediction` | | errors of the same predictors on the same seeds, nobody being driven |
| `spearman`, `kendall` | 1 | rank correlation over predictors, of open-loop and closed-loop means |

Closed-loop scores have the agent as their subset, the simulator's own driver has himself; rank
correlations have the two measures ("ade_3s, time_to_cross"), the open-loop ones their samples.
Intervals are bootstrapped over seeds, with all their drives; there are none below five seeds, nor
where every draw comes to the same. Of
the rank correlation everything is drawn again together, but not the predictors: it says how sure
the order of these predictors is, not what others would do. Kendall's is tau-b.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import rankdata

from hatn_sim.datatypes import FloatArray, Score
from hatn_sim.score.closed_loop import UNITS
from hatn_sim.score.closed_loop_rows import ORACLE, REFERENCE, DrivenRow, OpenLoop
from hatn_sim.score.intervals import (
    MIN_RUNS,
    Statistic,
    cluster_sums,
    interval,
    ratio,
    share_interval,
)

ALL: Final = "all"
CHANGE: Final = "_change"
RELATIVE_CHANGE: Final = "_relative_change"
SHARES: Final = ("crossed",)
COUNTS: Final = tuple(name for name, unit in UNITS.items() if unit == "1")
"""Where none was counted, the interval is that of the share of drives with one."""
OPEN_MEASURES: Final = (("ade_3s", "all"), ("fde_3s", "all"), ("slot_accuracy", "all"))
CLOSED_MEASURES: Final = ("time_to_cross", "t2_t3_events", "collisions")
"""Whose ranks are held against each other."""
FEWEST_RANKED: Final = 3
"""Of two predictors, the order is either the same or the other: no correlation."""

Place = tuple[str, int]
"""Scene and seed: what is drawn in a bootstrap."""


@dataclass(frozen=True, eq=False)
class _Drives:
    """The drives of one row, S of them, by place and ego."""

    keys: tuple[tuple[Place, str], ...]
    values: Mapping[str, FloatArray]  # measure -> [S]


def closed_loop_scores(
    rows: Sequence[DrivenRow], agent: str, predictors: Sequence[str], wanted: Sequence[Place]
) -> list[Score]:
    """All scores of each scene, and of all together where there are several.

    The first predictor is the baseline. `wanted` are the places that were asked for.
    """
    scenes = {scene: [scene] for scene, _ in wanted}
    scenes |= {ALL: list(scenes)} if len(scenes) > 1 else {}
    scores: list[Score] = []
    for name, within in scenes.items():
        chosen = [row for row in rows if row.scene in within]
        places = [place for place in wanted if place[0] in within]
        scores += _of_scene(chosen, agent, predictors, name, places)
    return scores


def _of_scene(
    rows: Sequence[DrivenRow],
    agent: str,
    predictors: Sequence[str],
    scene: str,
    places: Sequence[Place],
) -> Iterator[Score]:
    drives = {name: _drives(rows, name) for name in (REFERENCE, *predictors)}
    baseline = drives[predictors[0]]
    for name, one in drives.items():
        who = REFERENCE if name == REFERENCE else agent
        yield from _means(one, name, scene, who)
        if name != predictors[0]:
            yield from _changes(one, baseline, name, scene, who)
        there = {(row.scene, row.seed) for row in rows if row.row == name}
        lost, count = float(len(set(places) - there)), len(places)
        yield Score("lost_seeds", name, scene, who, "none", lost, "1", count, None, None)
    terms = {name: _open_terms(rows, name, predictors) for name in predictors}
    for name, of_predictor in terms.items():
        for measure, subset, unit in of_predictor:
            sums = _by_place(of_predictor[measure, subset, unit])
            yield _score(measure, name, scene, subset, unit, sums, ratio, int(sums[:, 1].sum()))
    yield from _ranks(terms, drives, predictors, scene)


def _drives(rows: Sequence[DrivenRow], name: str) -> _Drives:
    found = {
        ((row.scene, row.seed), ego.ego_id): ego.measures
        for row in rows
        if row.row == name
        for ego in row.egos
    }
    values = {
        measure: np.array([measures[measure] for measures in found.values()], dtype=np.float64)
        for measure in UNITS
    }
    return _Drives(tuple(found), values)


def _means(drives: _Drives, name: str, scene: str, who: str) -> Iterator[Score]:
    for measure, unit in UNITS.items():
        sums = _sums(drives.keys, drives.values[measure], np.ones(len(drives.keys)))
        told = _score(measure, name, scene, who, unit, sums, ratio, len(drives.keys))
        yield told


def _changes(
    drives: _Drives, baseline: _Drives, name: str, scene: str, who: str
) -> Iterator[Score]:
    """Differences of the drives that both have."""
    place = {key: k for k, key in enumerate(baseline.keys)}
    common = [key for key in drives.keys if key in place]
    ours = np.array([k for k, key in enumerate(drives.keys) if key in place], dtype=np.int64)
    theirs = np.array([place[key] for key in common], dtype=np.int64)
    for measure, unit in UNITS.items():
        base = baseline.values[measure][theirs]
        change = drives.values[measure][ours] - base
        sums = _sums(common, change, np.ones(len(common)))
        n = len(common)
        yield _score(measure + CHANGE, name, scene, who, unit, sums, ratio, n)
        sums = _sums(common, change, base)
        yield _score(measure + RELATIVE_CHANGE, name, scene, who, "share", sums, ratio, n)


def _sums(keys: Sequence[tuple[Place, str]], values: FloatArray, weights: FloatArray) -> FloatArray:
    """[G, 2] of both, in each place."""
    numbers: dict[Place, int] = {}
    cluster = np.array(
        [numbers.setdefault(place, len(numbers)) for place, _ in keys], dtype=np.int64
    )
    return cluster_sums(np.column_stack([values, weights]), cluster)


def _score(
    measure: str,
    name: str,
    scene: str,
    subset: str,
    unit: str,
    sums: FloatArray,
    statistic: Statistic,
    n: int,
) -> Score:
    value = float(statistic(sums.sum(axis=0))) if len(sums) else np.nan
    if not np.isfinite(value):
        return Score(measure, name, scene, subset, "none", None, unit, 0, None, None)
    low, high = (_bounds(measure, sums, statistic) if len(sums) >= MIN_RUNS else None) or (
        None,
        None,
    )
    return Score(measure, name, scene, subset, "none", value, unit, n, low, high)


def _bounds(measure: str, sums: FloatArray, statistic: Statistic) -> tuple[float, float] | None:
    """The interval; None where all draws come to the same, which says nothing of how sure it is."""
    if measure in SHARES or (measure in COUNTS and not sums[:, 0].any()):
        return share_interval(sums)
    found = interval(sums, statistic)
    return None if found is None or found[0] == found[1] else found


# ---------------------------------------------------------------------------------------------
# Open against closed loop

Terms = Mapping[tuple[str, str, str], Mapping[Place, tuple[float, float]]]
"""(measure, subset, unit) -> place -> sum over samples, and their number."""


def _open_terms(rows: Sequence[DrivenRow], name: str, predictors: Sequence[str]) -> Terms:
    """Of a predictor. A branch without changes is what follows, so the oracle makes no error."""
    terms: dict[tuple[str, str, str], dict[Place, tuple[float, float]]] = {}
    other = next((one for one in predictors if one != ORACLE), None)
    for row in rows:
        if row.row == (other if name == ORACLE else name):
            for one in row.open_loop:
                value = 0.0 if name == ORACLE else one.value
                if name != ORACLE or _is_displacement(one):
                    key = one.measure, one.subset, one.unit
                    terms.setdefault(key, {})[row.scene, row.seed] = value * one.n, float(one.n)
    return terms


def _is_displacement(one: OpenLoop) -> bool:
    return one.measure in ("ade_3s", "fde_3s")


def _by_place(terms: Mapping[Place, tuple[float, float]]) -> FloatArray:
    return np.array(list(terms.values()), dtype=np.float64).reshape(-1, 2)


def _ranks(
    terms: Mapping[str, Terms],
    drives: Mapping[str, _Drives],
    predictors: Sequence[str],
    scene: str,
) -> Iterator[Score]:
    for measure, subset in OPEN_MEASURES:
        opened = {
            name: next((v for k, v in terms[name].items() if k[:2] == (measure, subset)), None)
            for name in predictors
        }
        known = {name: of for name, of in opened.items() if of and drives[name].keys}
        count = len(known)
        for closed in CLOSED_MEASURES:
            is_ranked = count >= FEWEST_RANKED
            sums = _ranked_sums(known, drives, closed) if is_ranked else np.zeros((0, 4 * count))
            pair = f"{measure}, {closed}"
            for rank, statistic in (("spearman", spearman), ("kendall", kendall)):
                yield _score(rank, ALL, scene, pair, "1", sums, _of_means(statistic, count), count)


def _ranked_sums(
    known: Mapping[str, Mapping[Place, tuple[float, float]]],
    drives: Mapping[str, _Drives],
    closed: str,
) -> FloatArray:
    """[G, K * 4] of K predictors in each place: open-loop sum, count, closed-loop sum, count."""
    sums: dict[Place, FloatArray] = {}
    for k, (name, of) in enumerate(known.items()):
        for place, both in of.items():
            sums.setdefault(place, np.zeros((len(known), 4)))[k, :2] += both
        one = drives[name]
        for (place, _), value in zip(one.keys, one.values[closed].tolist(), strict=True):
            sums.setdefault(place, np.zeros((len(known), 4)))[k, 2:] += (value, 1.0)
    return np.array([each.ravel() for each in sums.values()])


def _of_means(statistic: Statistic, count: int) -> Statistic:
    def of(sums: FloatArray) -> FloatArray:
        each = sums.reshape(*sums.shape[:-1], count, 4)
        means = np.stack([ratio(each[..., :2]), ratio(each[..., 2:])], axis=-2)
        return statistic(means)

    return of


def spearman(pairs: FloatArray) -> FloatArray:
    """Spearman's rank correlation [...] of pairs [..., 2, K]; NaN where a side is all alike."""
    ranks = rankdata(pairs, axis=-1)
    away = ranks - ranks.mean(axis=-1, keepdims=True)
    spread = np.sqrt((away**2).sum(axis=-1).prod(axis=-1))
    together = away.prod(axis=-2).sum(axis=-1)
    found = np.where(spread > 0.0, together / np.where(spread > 0.0, spread, 1.0), np.nan)
    return np.where(np.isfinite(pairs).all(axis=(-2, -1)), found, np.nan)


def kendall(pairs: FloatArray) -> FloatArray:
    """Kendall's tau-b [...] of pairs [..., 2, K]; NaN where a side is all alike."""
    order = np.sign(pairs[..., :, None] - pairs[..., None, :])
    together = order.prod(axis=-3).sum(axis=(-2, -1))
    spread = np.sqrt((order**2).sum(axis=(-2, -1)).prod(axis=-1))
    return np.where(spread > 0.0, together / np.where(spread > 0.0, spread, 1.0), np.nan)
