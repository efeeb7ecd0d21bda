"""Our numbers beside the paper's: rows of a table for a console, a CSV file and JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final

from hatn_sim.datatypes import Score
from hatn_sim.errors import InputError
from hatn_sim.evaluation.paper import SUMMARISES, TABLES, Cell, PaperTable, scenario_of
from hatn_sim.whole_file import save_csv, save_whole

COLUMNS: Final = (
    "table", "scene", "row", "measure", "unit", "paper_scenario", "paper_mean", "paper_std",
    "mean", "std", "low", "high", "n",
)  # fmt: skip


@dataclass(frozen=True)
class AblationRow:
    """What one trained variant reaches: a row of one of the paper's tables, or a part of it.

    `scores` are of any scenes, with the measures of the table; those that lack some leave gaps.
    Rows of the same name are one row.
    """

    table: str  # key of the paper's table: "sgn", "edn.a", "intention.b" ...
    name: str  # of the paper's row, or another for one that the paper has not
    scores: tuple[Score, ...]


@dataclass(frozen=True)
class Entry:
    """One number of a table, the paper's beside ours; None where there is none."""

    table: str
    scene: str
    row: str
    measure: str
    paper_scenario: str | None
    paper: Cell | None
    ours: Score | None


def compare(table: PaperTable, rows: Sequence[AblationRow], subset: str = "all") -> list[Entry]:
    """Every number of a table for each scene of ours, the paper's rows first.

    A scene stands beside the paper's scenario that it is like. Without any scores of ours, the
    paper's numbers stand alone.
    """
    own: dict[str, list[Score]] = {}
    for row in rows:
        if row.table == table.key:
            own.setdefault(row.name, []).extend(row.scores)
    scenes = list(dict.fromkeys(score.scene for scores in own.values() for score in scores))
    if not scenes:
        scenes = list(dict.fromkeys(scenario for of in table.rows.values() for scenario, _ in of))
    entries: list[Entry] = []
    for scene in scenes:
        scenario = scenario_of(scene)
        for name in dict.fromkeys([*table.rows, *own]):
            told = _told(own.get(name, ()), scene, subset)
            cells = table.rows.get(name, {})
            entries += [
                Entry(
                    table=table.key,
                    scene=scene,
                    row=name,
                    measure=measure,
                    paper_scenario=scenario,
                    paper=None if scenario is None else cells.get((scenario, measure)),
                    ours=told.get(measure),
                )
                for measure in table.measures
            ]
    return entries


def _told(scores: Sequence[Score], scene: str, subset: str) -> Mapping[str, Score]:
    return {
        score.measure: score
        for score in scores
        if score.scene == scene and score.subset == subset and score.n
    }


def with_summary(rows: Sequence[AblationRow]) -> list[AblationRow]:
    """The rows, and those of the summary, which are rows of the other tables seen once more."""
    given = {(row.table, row.name) for row in rows}
    shown = {place: name for name, place in SUMMARISES.items() if ("summary", name) not in given}
    more = [
        AblationRow("summary", shown[row.table, row.name], row.scores)
        for row in rows
        if (row.table, row.name) in shown
    ]
    return [*rows, *more]


# ---------------------------------------------------------------------------------------------
# Files


def write_csv(path: Path, entries: Sequence[Entry]) -> None:
    """One line for each number; a field is empty where there is none."""
    save_csv(path, [COLUMNS, *(_flat(entry).values() for entry in entries)])


def entries_json(entries: Sequence[Entry]) -> str:
    """A JSON list of objects with the keys of `COLUMNS`; null where there is no number."""
    return json.dumps([_flat(entry) for entry in entries], indent=2, allow_nan=False)


def _flat(entry: Entry) -> dict[str, Any]:
    paper, ours = entry.paper, entry.ours
    return {
        "table": entry.table,
        "scene": entry.scene,
        "row": entry.row,
        "measure": entry.measure,
        "unit": None if ours is None else ours.unit,
        "paper_scenario": entry.paper_scenario,
        "paper_mean": None if paper is None else round(paper.mean, 6),
        "paper_std": None if paper is None or paper.std is None else round(paper.std, 6),
        "mean": None if ours is None else ours.value,
        "std": None if ours is None else ours.std,
        "low": None if ours is None else ours.low,
        "high": None if ours is None else ours.high,
        "n": 0 if ours is None else ours.n,
    }


def write_rows(path: Path, rows: Sequence[AblationRow]) -> None:
    """Keep the rows of ablations for `read_rows`."""
    text = json.dumps([asdict(row) for row in rows], indent=1, allow_nan=False)
    save_whole(path, text + "\n")


def read_rows(path: Path) -> list[AblationRow]:
    """Rows that `write_rows` kept. Raises InputError where the file is not one of these."""
    keys = {part.key for parts in TABLES.values() for part in parts}
    try:
        rows = [
            AblationRow(
                str(row["table"]), str(row["name"]), tuple(_score(score) for score in row["scores"])
            )
            for row in json.loads(path.read_text(encoding="utf-8"))
        ]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: expected rows of ablations, found none that can be read ({error!r}); give "
            "a file that an ablation wrote"
        ) from None
    for row in rows:
        if row.table not in keys:
            raise InputError(
                f"{path}: unknown table {row.table!r} of row {row.name!r}; expected one of "
                f"{', '.join(sorted(keys))}"
            )
        for score in row.scores:
            if not _is_number_with_interval(score):
                raise InputError(
                    f"{path}: row {row.name!r}: {score.measure}: expected numbers, found {score}; "
                    "give a file that an ablation wrote"
                )
    return rows


def _is_number_with_interval(score: Score) -> bool:
    """Value, deviation and interval are numbers or not there, and n says how many there were."""
    told = (score.value, score.std, score.low, score.high)
    is_known = all(one is None or isinstance(one, int | float) for one in told)
    return is_known and isinstance(score.n, int)


def _score(found: Mapping[str, Any]) -> Score:
    missing = {"lines"} - found.keys()  # of files that are older than this field
    names = [field.name for field in fields(Score) if field.name not in missing]
    return Score(**{name: found[name] for name in names})
