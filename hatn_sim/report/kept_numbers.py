"""Numbers that a command kept, read again to be drawn."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from hatn_sim.datatypes import FloatArray, IntArray, Score
from hatn_sim.errors import InputError
from hatn_sim.score.density import CRITERIA
from hatn_sim.score.sweep import Operating

MAKE_AGAIN: Final = "make it again with the command that wrote it"


def read_csv(path: Path, columns: Iterable[str]) -> list[dict[str, str]]:
    """The rows of a table that has these columns. InputError where it has not."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            rows = list(reader)
            found = reader.fieldnames or ()
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error}); {MAKE_AGAIN}") from None
    if missing := [name for name in columns if name not in found]:
        raise InputError(f"{path}: expected a column {missing[0]!r}, found none; {MAKE_AGAIN}")
    return rows


def numbers(rows: Sequence[Mapping[str, str]], column: str, path: Path) -> FloatArray:
    """A column [R]; an empty field is NaN. InputError where one is no number."""
    try:
        return np.array([float(row[column] or "nan") for row in rows], dtype=np.float64)
    except (ValueError, TypeError):
        raise InputError(f"{path}: {column}: expected numbers; {MAKE_AGAIN}") from None


def read_curves(path: Path) -> dict[str, dict[str, list[Operating]]]:
    """Scene -> rule -> operating points, as `evaluation.comparison.write_curves` wrote them."""
    names = [field.name for field in fields(Operating)]
    rows = read_csv(path, ("scene", "rule", *names))
    values = np.column_stack([numbers(rows, name, path) for name in names])
    curves: dict[str, dict[str, list[Operating]]] = {}
    for row, point in zip(rows, values.tolist(), strict=True):
        curves.setdefault(row["scene"], {}).setdefault(row["rule"], []).append(Operating(*point))
    return curves


def read_density(path: Path) -> dict[str, dict[str, IntArray]]:
    """Scene -> criterion -> [S] counts, as the histograms of `evaluate --table density` tell."""
    rows = read_csv(path, ("scene", "criterion", "interacting_vehicles", "samples"))
    count, samples = (
        numbers(rows, name, path).astype(np.int64) for name in ("interacting_vehicles", "samples")
    )
    if (samples < 0).any() or (count < 0).any():
        raise InputError(f"{path}: expected counts of 0 or more; {MAKE_AGAIN}")
    found: dict[str, dict[str, IntArray]] = {}
    for row, one, n in zip(rows, count, samples, strict=True):
        of_scene = found.setdefault(
            row["scene"], {name: np.zeros(0, np.int64) for name in CRITERIA}
        )
        before = of_scene.get(row["criterion"], np.zeros(0, np.int64))
        of_scene[row["criterion"]] = np.append(before, np.repeat(one, n))
    return found


@dataclass(frozen=True)
class Beside:
    """A number of the paper beside ours, as `evaluation.table.write_csv` wrote it; NaN: none."""

    table: str
    scene: str
    row: str
    measure: str
    paper: float
    ours: float
    low: float
    high: float


def read_beside(path: Path) -> list[Beside]:
    """The numbers of a table of the paper. InputError where the file is damaged."""
    names = ("paper_mean", "mean", "low", "high")
    rows = read_csv(path, ("table", "scene", "row", "measure", *names))
    values = np.column_stack([numbers(rows, name, path) for name in names])
    return [
        Beside(row["table"], row["scene"], row["row"], row["measure"], *value)
        for row, value in zip(rows, values.tolist(), strict=True)
    ]


def read_scores(path: Path) -> list[Score]:
    """What `table.write_scores` wrote. InputError where it is damaged."""
    try:
        rows: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
        return [Score(**row) for row in rows]
    except (OSError, ValueError, TypeError) as error:
        said = str(error).splitlines()[0]
        raise InputError(f"{path}: expected scores, found damage ({said}); {MAKE_AGAIN}") from None
