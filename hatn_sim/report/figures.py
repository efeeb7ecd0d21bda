"""What all charts of this package share: how they are dressed, headed and written.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hatn_sim.report.canvas import INK, SOFT_INK
from hatn_sim.whole_file import save_whole


def new_chart(size_in: tuple[float, float]) -> Figure:
    """An empty figure that makes room for its parts."""
    figure = Figure(figsize=size_in, dpi=160, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def head_chart(figure: Figure, title: str, size_pt: float) -> None:
    """The title, at the left above all panels."""
    figure.suptitle(title, x=0.01, ha="left", fontsize=size_pt, color=INK)


def dress(axes: Axes, label_pt: float) -> None:
    """Axes without a box around them, with soft ticks."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.tick_params(colors=SOFT_INK, labelsize=label_pt)


def rule(axes: Axes) -> None:
    """Lines across, behind everything."""
    axes.grid(axis="y", color="#e3e3df", lw=0.6)
    axes.set_axisbelow(True)


def save_figure(figure: Figure, paths: Sequence[Path], **options: Any) -> None:
    """Write a figure in the formats that the suffixes name: the same figure, the same bytes."""
    for path in paths:
        # Without the versions and dates that would change the bytes.
        stamps = {"Software": None} if path.suffix == ".png" else {"CreationDate": None}
        data = io.BytesIO()
        figure.savefig(data, format=path.suffix[1:], metadata=stamps, **options)
        save_whole(path, data.getbuffer())
