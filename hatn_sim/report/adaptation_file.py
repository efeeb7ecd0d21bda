"""What `evaluate --table adaptation` kept, read again and sorted by the figure it is of."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from hatn_sim.learn.adaptation_rows import COLUMNS, AdaptationRow, Change
from hatn_sim.report.kept_numbers import numbers, read_csv

Rows = Mapping[str, list[AdaptationRow]]
"""Of a network, by scene."""
MEKF: Final = "mekf"
_OF_ROW: Final = ("scene", "network", "method", "layer", "steps")


def read_adaptation(path: Path) -> dict[str, tuple[Rows, Rows]]:
    """Network -> rows over whole runs, and those by layer, which stand behind them in the file.

    InputError where the file is damaged.
    """
    kept = read_csv(path, COLUMNS)
    names = ("trained_m", "adapted_m", "low", "high", "n")
    values = np.column_stack([numbers(kept, name, path) for name in names])
    steps = numbers(kept, "steps", path)
    found: dict[str, tuple[dict[str, list[AdaptationRow]], dict[str, list[AdaptationRow]]]] = {}
    changes: dict[str, Change] = {}
    seen: set[tuple[str, ...]] = set()
    last: tuple[str, ...] = ()
    for row, step, (trained_m, adapted_m, low, high, n) in zip(
        kept, steps.tolist(), values.tolist(), strict=True
    ):
        key = tuple(row[name] for name in _OF_ROW)
        if key != last or row["measure"] in changes:
            scene, network, method, layer, _ = last = key
            changes = {}
            kinds = found.setdefault(network, ({}, {}))
            # The first layer of the second part is another one, or a row that was there already.
            by_layer = scene in kinds[1] or key in seen or _is_of_layers(layer)
            if by_layer or method == MEKF:
                made = AdaptationRow(scene, network, method, layer, int(step), int(n), changes)
                kinds[by_layer].setdefault(scene, []).append(made)
            seen.add(key)
        interval = [None if np.isnan(value) else value for value in (low, high)]
        changes[row["measure"]] = Change(trained_m, adapted_m, *interval)
    return {**found}


def _is_of_layers(layer: str) -> bool:
    from hatn_sim.report.adaptation_table import LAST

    return layer != LAST
