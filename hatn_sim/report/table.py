"""Scores for people (a table of 100 columns) and for programs (JSON)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Group
from rich.table import Table
from rich.text import Text

from hatn_sim.datatypes import Score
from hatn_sim.log.schema import SCORES_FILE
from hatn_sim.report.plain_table import plain_table
from hatn_sim.whole_file import save_whole

BASELINE = "constant_velocity"
"""Errors of the others are also given as a multiple of this predictor's, where it is there."""

TITLES = {
    "ade_3s": "ADE 3 s",
    "fde_3s": "FDE 3 s",
    "ade_0s3": "ADE 0.3 s, mm",
    "fde_0s3": "FDE 0.3 s, mm",
    "goal_error": "goal error",
    "fallback_share": "fallback",
    "slot_accuracy": "slot accuracy",
    "slot_macro_f1": "macro-F1",
    "slot_ece": "ECE",
    "slot_masked_share": "masked",
    "yield_base_rate": "always yield",
    "single_slot_share": "single slot",
    "min_ade_3s": "least ADE 3 s",
    "miss_rate_2m": "miss 2 m",
    "goal_coverage_50": "goals in 50 %",
    "goal_coverage_90": "in 90 %",
    "slot_brier": "slot Brier",
}
IN_MILLIMETRES = ("ade_0s3", "fde_0s3")
"""In tables; in JSON all errors are in metres."""
ERRORS = ("ade_3s", "fde_3s", "ade_0s3", "fde_0s3", "goal_error")
SLOTS = (
    "slot_accuracy",
    "slot_macro_f1",
    "yield_base_rate",
    "slot_ece",
    "slot_masked_share",
    "single_slot_share",
)
SPREADS = ("min_ade_3s", "miss_rate_2m", "goal_coverage_50", "goal_coverage_90", "slot_brier")
SUBSETS = {"all": "all samples", "moving": "moving samples (more than 1 m in 3 s)"}
NONE = "-"
IF_SAID = ("lines", "seen")
"""Fields that are left out where there is nothing to say."""


def scores_json(scores: Sequence[Score]) -> str:
    """A JSON list of objects with the fields of `Score`; no value is null, with n = 0."""
    rows = [asdict(score) for score in scores]
    told = [{key: v for key, v in row.items() if key not in IF_SAID or v} for row in rows]
    return json.dumps(told, indent=2, allow_nan=False)


def write_scores(folder: Path, scores: Sequence[Score]) -> Path:
    """Write `scores.json` into the folder of a run."""
    path = folder / SCORES_FILE
    save_whole(path, scores_json(scores) + "\n")
    return path


def score_table(scores: Sequence[Score], clustered_over: str = "vehicles") -> Group:
    """The scores as tables for a console: for each scene errors, slots, and how wide answers are.

    Each value stands over its 95 % interval, errors over their deviation too; with constant
    velocity among the predictors, errors come with their ratio to its.

    Args:
        scores: of any scenes and predictors.
        clustered_over: what the intervals were bootstrapped over, said below the tables.
    """
    parts: list[Table | Text] = []
    for scene in dict.fromkeys(score.scene for score in scores):
        of_scene = [score for score in scores if score.scene == scene]
        for subset in SUBSETS:
            parts += [_error_table(scene, subset, of_scene), Text()]
        if any(score.n for score in of_scene if score.measure in SLOTS):
            parts += [_slot_table(scene, of_scene), Text()]
        if any(score.n for score in of_scene if score.measure in SPREADS):
            parts += [_spread_table(scene, of_scene), Text()]
    note = f"± of samples; [low high] 95 % interval, bootstrapped over {clustered_over}"
    if any(score.predictor == BASELINE for score in scores):
        note += f"; x ratio to {BASELINE.replace('_', ' ')}"
    if any(score.predictor.endswith("+route") for score in scores):
        note += "; +route: given the simulator's routes, an upper bound"
    parts += [Text(line, style="dim") for line in (*notes(scores), note)]
    return Group(*parts)


def notes(scores: Sequence[Score]) -> list[str]:
    """What tables of the scores cannot do without.

    A line for each network that is judged on what it learnt from, and one for each scene of
    recorded tracks: what lines follow, and what chose among them.
    """
    seen = {(score.scene, score.predictor): score.seen for score in scores if score.seen}
    told = {score.scene: score.lines for score in scores if score.lines}
    return [
        *(f"{scene}: {predictor} {words}" for (scene, predictor), words in seen.items()),
        *(f"{scene}: {lines}" for scene, lines in told.items()),
    ]


def _error_table(scene: str, subset: str, scores: Sequence[Score]) -> Table:
    table = _table(f"{scene}: errors in metres, {SUBSETS[subset]}", (*ERRORS, "fallback_share"))
    found = by_measure(scores, subset)
    base = [found.get((BASELINE, measure)) for measure in ERRORS]
    for predictor in dict.fromkeys(score.predictor for score in scores):
        row = [found.get((predictor, measure)) for measure in ERRORS]
        fallback = found.get((predictor, "fallback_share"))
        table.add_row(
            row_name(row),
            row_count(row),
            *(error_cell(*pair) for pair in zip(row, base, strict=True)),
            share_cell(fallback, interval=False),
        )
    return table


def _slot_table(scene: str, scores: Sequence[Score]) -> Table:
    table = _table(f"{scene}: slots", SLOTS)
    found = by_measure(scores, "all")
    for predictor in dict.fromkeys(score.predictor for score in scores):
        row = [found.get((predictor, measure)) for measure in SLOTS]
        if any(score and score.n for score in row):
            table.add_row(row_name(row), row_count(row), *(share_cell(score) for score in row))
    return table


def _spread_table(scene: str, scores: Sequence[Score]) -> Table:
    """The best of several modes, and how often the goal is where its mixture has it."""
    table = _table(f"{scene}: modes and probabilities, {SUBSETS['all']}", SPREADS)
    found = by_measure(scores, "all")
    for predictor in dict.fromkeys(score.predictor for score in scores):
        row = [found.get((predictor, measure)) for measure in SPREADS]
        if any(score and score.n for score in row):
            table.add_row(row_name(row), row_count(row), *(plain_cell(score) for score in row))
    return table


def _table(title: str, measures: Sequence[str]) -> Table:
    table = plain_table(title, apart=1)
    table.add_column("predictor", min_width=9, max_width=12, overflow="fold")
    table.add_column("n", justify="right", no_wrap=True)
    for measure in measures:
        table.add_column(TITLES[measure], justify="right", no_wrap=True)
    return table


def by_measure(scores: Sequence[Score], subset: str) -> dict[tuple[str, str], Score]:
    return {(s.predictor, s.measure): s for s in scores if s.subset == subset}


def row_name(row: Sequence[Score | None]) -> str:
    first = next(score for score in row if score is not None)
    name = first.predictor.replace("_", " ")
    return name if first.adapt == "none" else f"{name} + {first.adapt}"


def row_count(row: Sequence[Score | None]) -> str:
    return f"{next(score for score in row if score is not None).n:,}"


def error_cell(score: Score | None, base: Score | None) -> str:
    if score is None or score.value is None:
        return NONE
    shown = _millimetres if score.measure in IN_MILLIMETRES else _metres
    cell = shown(score.value)
    if base is not None and base.value and base is not score:
        cell += f" x{score.value / base.value:.2f}"
    if score.std is not None:
        cell += f"\n± {shown(score.std)}"
    if score.low is not None and score.high is not None:
        cell += f"\n[{shown(score.low)} {shown(score.high)}]"
    return cell


def plain_cell(score: Score | None) -> str:
    if score is not None and score.unit != "share":
        return error_cell(score, None)
    return share_cell(score)


def _metres(value: float) -> str:
    return f"{value:.3f}" if value < 10.0 else f"{value:.2f}"


def _millimetres(value_m: float) -> str:
    return f"{1000.0 * value_m:.1f}"


def share_cell(score: Score | None, interval: bool = True) -> str:
    if score is None or score.value is None:
        return NONE
    cell = f"{100.0 * score.value:.1f} %"
    if interval and score.low is not None and score.high is not None:
        cell += f"\n[{100.0 * score.low:.1f} {100.0 * score.high:.1f}]"
    return cell
