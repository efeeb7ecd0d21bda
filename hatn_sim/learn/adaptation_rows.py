"""Rows of the study of online adaptation: pooled over runs, with intervals, as CSV and JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from hatn_sim.learn.adaptation_study import MEASURES, VehicleErrors
from hatn_sim.score import intervals
from hatn_sim.whole_file import save_csv

PAIR: Final = ("trained", "adapted")
COLUMNS: Final = (
    "scene", "network", "method", "layer", "steps", "measure",
    "trained_m", "adapted_m", "change", "low", "high", "n",
)  # fmt: skip


@dataclass(frozen=True)
class Change:
    """What adaptation makes of one measure; `low` and `high` are those of the change."""

    trained_m: float
    adapted_m: float
    low: float | None
    high: float | None

    @property
    def share(self) -> float:
        """By what share the error changes: less than 0 is better."""
        return self.adapted_m / self.trained_m - 1.0


@dataclass(frozen=True, eq=False)
class AdaptationRow:
    """Mean errors over n predictions of the trained network and of the adapted one."""

    scene: str
    network: str
    method: str
    layer: str
    steps: int
    n: int
    changes: Mapping[str, Change]  # by measure, see `adaptation_study.MEASURES`

    def error_m(self, measure: str, which: str) -> float:
        """`measure` of "trained" or "adapted"."""
        value: float = getattr(self.changes[measure], f"{which}_m")
        return value

    def change(self, measure: str) -> float:
        """See `Change.share`."""
        return self.changes[measure].share


def pooled(parts: Sequence[VehicleErrors]) -> tuple[int, dict[str, Change]]:
    """Number of predictions, and the change of every measure over all runs; none where n = 0.

    The same predictions are made by both networks, so the change is a paired figure: clusters are
    drawn again with both sums. Clusters are the runs, or the vehicles where runs are few.
    """
    sums = [part.sum_m for part in parts]
    if len(parts) >= intervals.MIN_RUNS:
        clusters = np.stack([part.sum(axis=0) for part in sums])
    else:
        clusters = np.concatenate([part[of.n > 0] for part, of in zip(sums, parts, strict=True)])
    n = sum(int(part.n.sum()) for part in parts)
    if not n:
        return 0, {}
    changes: dict[str, Change] = {}
    for k, measure in enumerate(MEASURES):
        pair = clusters[:, ::-1, k]  # adapted over trained
        adapted, trained = pair.sum(axis=0).tolist()
        found = intervals.interval(pair, intervals.ratio)
        low, high = (None, None) if found is None else (found[0] - 1.0, found[1] - 1.0)
        changes[measure] = Change(trained / n, adapted / n, low, high)
    return n, changes


def clustered_over(runs: int) -> str:
    """What intervals over so many runs are bootstrapped over."""
    return "runs" if runs >= intervals.MIN_RUNS else "vehicles"


def write_csv(path: Path, rows: Sequence[AdaptationRow]) -> None:
    """One line for each measure of each row; errors in metres, the change as a share."""
    save_csv(path, [COLUMNS, *(flat.values() for flat in _flat(rows))])


def rows_json(rows: Sequence[AdaptationRow]) -> str:
    """A JSON list of objects with the keys of `COLUMNS`."""
    return json.dumps(_flat(rows), indent=2, allow_nan=False)


def _flat(rows: Sequence[AdaptationRow]) -> list[dict[str, Any]]:
    return [
        {
            "scene": row.scene,
            "network": row.network,
            "method": row.method,
            "layer": row.layer,
            "steps": row.steps,
            "measure": measure,
            "trained_m": round(change.trained_m, 6),
            "adapted_m": round(change.adapted_m, 6),
            "change": round(change.share, 6),
            "low": None if change.low is None else round(change.low, 6),
            "high": None if change.high is None else round(change.high, 6),
            "n": row.n,
        }
        for row in rows
        for measure, change in row.changes.items()
    ]
