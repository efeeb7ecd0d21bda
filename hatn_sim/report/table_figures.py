"""The figures of what `assess`, `compare` and `evaluate` left in a folder, of numbers kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from hatn_sim.errors import InputError
from hatn_sim.report.table import SCORES_FILE

CURVES_FILE: Final = "curves.csv"
STEPS_FILE: Final = "steps.csv"
DENSITY_FILE: Final = "density.csv"
ADAPTATION_FILE: Final = "adaptation.csv"
PAPER_TABLES: Final = ("sgn", "edn", "intention", "summary", "sota")
CLOSED_LOOP_MEASURE: Final = "time_to_cross"
WITHOUT: Final = {
    "lines.pdf": "the curves of `evaluate --table lines` are of samples that are not kept; "
    "lines.pdf is the figure",
    "runtime.csv": "`evaluate --table runtime` is a table of medians, all of them in runtime.csv",
    "assist.toml": "`assess --calibrate` chose thresholds, which assist.toml tells; `assess` "
    "with it as --assist-settings draws curves",
}
"""What a folder holds -> why there is nothing else to draw in it."""


@dataclass(frozen=True)
class TableFigure:
    """A figure, and what draws it into files."""

    name: str
    draw: Callable[[Sequence[Path]], None]


def table_figures(folder: Path) -> list[TableFigure]:
    """Those that the numbers in a folder are enough for.

    Raises:
        InputError: the numbers are damaged, or there are none.
    """
    found: list[TableFigure] = []
    for path in sorted(folder.glob(f"*{STEPS_FILE}")):
        found.append(TableFigure(path.stem, partial(_steps, path)))
    if (folder / CURVES_FILE).is_file():
        found.append(TableFigure("curves", partial(_curves, folder / CURVES_FILE)))
    if (folder / DENSITY_FILE).is_file():
        found.append(TableFigure("density", partial(_density, folder / DENSITY_FILE)))
    for table in PAPER_TABLES:
        if (folder / f"{table}.csv").is_file():
            found.append(TableFigure(table, partial(_paper, folder / f"{table}.csv")))
    if (folder / ADAPTATION_FILE).is_file():
        found += _adaptation(folder / ADAPTATION_FILE)
    if _is_of_drives(folder / SCORES_FILE):
        found.append(TableFigure("closed_loop", partial(_closed_loop, folder / SCORES_FILE)))
    if not found:
        raise InputError(_why_none(folder))
    return found


def _why_none(folder: Path) -> str:
    for name, why in WITHOUT.items():
        if (folder / name).is_file():
            return f"{folder}: nothing to draw again: {why}"
    return (
        f"{folder}: expected the folder of a run, or numbers of `assess`, `compare` or `evaluate` "
        f"({STEPS_FILE}, {CURVES_FILE}, {SCORES_FILE}); found none to draw: name a folder that "
        "their --out made"
    )


def _steps(path: Path, paths: Sequence[Path]) -> None:
    from hatn_sim.report.steps_figure import draw_steps, read_steps

    errors = read_steps(path)
    moving = any(one.subset == "moving" for one in errors)  # ablations are of all samples only
    draw_steps(errors, paths, "moving" if moving else "all")


def _density(path: Path, paths: Sequence[Path]) -> None:
    from hatn_sim.report.density_figure import draw_density
    from hatn_sim.report.kept_numbers import read_density

    draw_density(read_density(path), paths)


def _paper(path: Path, paths: Sequence[Path]) -> None:
    from hatn_sim.evaluation.paper import TABLES
    from hatn_sim.report.kept_numbers import read_beside
    from hatn_sim.report.paper_figure import draw_beside

    title = TABLES[path.stem][0].title.split(" (a)")[0]  # without that of the first part
    draw_beside(read_beside(path), f"{title}: the paper and ours", paths)


def _adaptation(path: Path) -> list[TableFigure]:
    from hatn_sim.report.adaptation_figure import draw_layers, draw_steps
    from hatn_sim.report.adaptation_file import read_adaptation

    return [
        TableFigure(f"{kind}-{network}", partial(draw, scenes))
        for network, parts in read_adaptation(path).items()
        for kind, draw, scenes in zip(
            ("steps", "layers"), (draw_steps, draw_layers), parts, strict=True
        )
        if scenes
    ]


def _curves(path: Path, paths: Sequence[Path]) -> None:
    from hatn_sim.report.assistance_figure import draw_curves
    from hatn_sim.report.kept_numbers import read_curves, read_scores

    beside = path.with_name(SCORES_FILE)
    draw_curves(read_curves(path), paths, read_scores(beside) if beside.is_file() else ())


def _is_of_drives(path: Path) -> bool:
    from hatn_sim.report.kept_numbers import read_scores

    return path.is_file() and any(s.measure == CLOSED_LOOP_MEASURE for s in read_scores(path))


def _closed_loop(path: Path, paths: Sequence[Path]) -> None:
    from hatn_sim.report.closed_loop_figure import draw_closed_loop
    from hatn_sim.report.kept_numbers import read_scores

    scores = read_scores(path)
    agent = next(score.subset for score in scores if score.measure == CLOSED_LOOP_MEASURE)
    draw_closed_loop(scores, agent, paths)
