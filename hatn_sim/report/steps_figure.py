"""The paper's figure of the error at each predicted step, as PNG, PDF and CSV.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from hatn_sim.datatypes import DT_S, HORIZON_FRAMES
from hatn_sim.errors import InputError
from hatn_sim.report.canvas import INK, SOFT_INK
from hatn_sim.report.figures import COLOURS, dress, head_chart, new_chart, save_figure
from hatn_sim.report.kept_numbers import numbers, read_csv
from hatn_sim.score.steps import StepErrors
from hatn_sim.whole_file import save_csv

SUBSETS: Final = {"all": "all samples", "moving": "moving samples"}
WIDTH_IN: Final = 9.0
ROW_IN: Final = 3.2
EDGES_IN: Final = 0.9
TIMES_S: Final = DT_S * np.arange(1, HORIZON_FRAMES + 1)
BAND: Final = "95 % interval of the mean"
COLUMNS: Final = (
    "scene", "predictor", "subset", "step", "time_s", "mean_m", "std_m", "low_m", "high_m", "n",
)  # fmt: skip
TRAINED: Final = "trained_on_scene"
"""A column more: yes or no; tables made before it was there do not tell."""
TRAINED_WORDS: Final = "* its weights were trained or tuned on runs of this scene"


def write_steps(path: Path, errors: Sequence[StepErrors]) -> None:
    """One row for each scene, predictor, subset and step; no interval is an empty field."""
    rows: list[Sequence[object]] = [(*COLUMNS, TRAINED)]
    for one in errors:
        for step in range(HORIZON_FRAMES):
            values = (one.mean_m, one.std_m, one.low_m, one.high_m)
            told = ("" if np.isnan(v[step]) else f"{v[step]:.6f}" for v in values)
            at = (step + 1, f"{TIMES_S[step]:.1f}")
            who = (one.scene, one.predictor, one.subset)
            rows.append((*who, *at, *told, one.n, "yes" if one.trained else "no"))
    save_csv(path, rows)


def read_steps(path: Path) -> list[StepErrors]:
    """What `write_steps` wrote. InputError where it is damaged."""
    found: dict[tuple[str, str, str], list[dict[str, str]]] = {}
    for row in read_csv(path, COLUMNS):
        found.setdefault((row["scene"], row["predictor"], row["subset"]), []).append(row)
    for rows in found.values():
        if [row["step"] for row in rows] != [str(step + 1) for step in range(HORIZON_FRAMES)]:
            raise InputError(
                f"{path}: expected steps 1 to {HORIZON_FRAMES} of each curve; the file is damaged"
            )
    return [
        StepErrors(
            *key,
            *(numbers(rows, name, path) for name in ("mean_m", "std_m", "low_m", "high_m")),
            n=int(numbers(rows[:1], "n", path)[0]),
            trained=rows[0].get(TRAINED) == "yes",
        )
        for key, rows in found.items()
    ]


def draw_steps(
    errors: Sequence[StepErrors],
    paths: Sequence[Path],
    subset: str = "moving",
    note: str = "",
    unknown: Sequence[str] = (),
) -> None:
    """Draw a row for each scene: linear axes as in the paper, and logarithmic ones.

    Bands are 95 % intervals; a star marks who was trained or tuned on the scene, and the
    legend says of whom that is `unknown`. The format of a file is what its suffix names; a `note`
    stands behind the title.
    """
    shown = [one for one in errors if one.subset == subset]
    scenes = list(dict.fromkeys(one.scene for one in shown)) or [""]
    names = list(dict.fromkeys(one.predictor for one in shown))
    colour = {name: COLOURS[number % len(COLOURS)] for number, name in enumerate(names)}
    figure = new_chart((WIDTH_IN, EDGES_IN + ROW_IN * len(scenes)))
    grid = figure.subplots(len(scenes), 2, squeeze=False)
    for row, scene in zip(grid, scenes, strict=True):
        of_scene = [one for one in shown if one.scene == scene]
        for axes, scale in zip(row, ("linear", "log"), strict=True):
            axes.set_xscale(scale)
            axes.set_yscale(scale)
            for one in of_scene:
                _curve(axes, one, colour[one.predictor])
            _dress(axes, scale)
        n = f", n = {of_scene[0].n:,}" if of_scene else ""
        row[0].set_title(f"{scene}{n}", loc="left", fontsize=10.5, color=INK)
        row[1].set_title("the same, both axes logarithmic", loc="left", fontsize=9.5, color=INK)
        row[0].set_ylabel("mean error, m", color=INK)
        if of_scene:
            handles, _ = row[0].get_legend_handles_labels()
            if any(np.isfinite(one.low_m).all() for one in of_scene):
                handles.append(Patch(color=SOFT_INK, alpha=0.3, lw=0.0, label=BAND))
            if any(one.trained for one in of_scene):
                handles.append(Patch(alpha=0.0, lw=0.0, label=TRAINED_WORDS))
            if unknown:
                words = f"training scenes of {', '.join(unknown)} not known"
                handles.append(Patch(alpha=0.0, lw=0.0, label=words))
            row[0].legend(
                handles=handles, frameon=False, fontsize=8.5, labelcolor=INK, loc="upper left"
            )
    for axes in grid[-1]:
        axes.set_xlabel("time predicted ahead, s", color=INK)
    words = f"Error at each predicted step, {SUBSETS[subset]}"
    head_chart(figure, f"{words}, {note}" if note else words, 13)
    save_figure(figure, paths)


def _curve(axes: Axes, one: StepErrors, colour: str) -> None:
    name = one.predictor.replace("_", " ") + "*" * one.trained
    axes.plot(TIMES_S, one.mean_m, color=colour, linewidth=1.6, label=name)
    if np.isfinite(one.low_m).all():
        axes.fill_between(TIMES_S, one.low_m, one.high_m, color=colour, alpha=0.15, linewidth=0)


def _dress(axes: Axes, scale: str) -> None:
    dress(axes, 8.5)
    if scale == "linear":
        axes.set_xlim(0.0, TIMES_S[-1])
        axes.set_ylim(bottom=0.0)
    else:
        axes.set_xlim(TIMES_S[0], TIMES_S[-1])
        axes.set_xticks([0.1, 0.3, 1.0, 3.0], ["0.1", "0.3", "1", "3"])
        axes.minorticks_off()
        axes.yaxis.set_major_formatter("{x:g}")
        axes.grid(color=SOFT_INK, alpha=0.25, linewidth=0.6)
