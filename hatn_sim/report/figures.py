"""What all charts of this package share: how they are dressed, headed and written.

Sizes are those on paper: 7.2 inches are as wide as the text of a page, 6.5 points and more can be
read in print. PDF has its fonts inside (TrueType, no Type 3, which printers and journals refuse);
SVG has letters as paths, which look the same where the font is missing.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from hatn_sim.report.canvas import INK, SOFT_INK, plain
from hatn_sim.report.letters import lend_letters
from hatn_sim.whole_file import save_whole

COLOURS: Final = (
    "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8a8f98",
)  # fmt: skip
"""Okabe and Ito's, told apart by the colour-blind, and grey."""
PAGE_IN: Final = 7.2
"""As wide as the text of a page in two columns."""
TITLE_PT: Final = 10.0
LABEL_PT: Final = 7.5
TICK_PT: Final = 7.0
NOTE_PT: Final = 6.5
WRITING: Final[dict[Any, Any]] = {
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "hatn-sim",
}
NO_STAMPS: Final = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}
"""Without the versions and dates that would change the bytes."""


def new_chart(size_in: tuple[float, float]) -> Figure:
    """An empty figure that makes room for its parts."""
    figure = Figure(figsize=size_in, dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def head_chart(figure: Figure, title: str, size_pt: float) -> None:
    """The title, at the left above all panels."""
    figure.suptitle(plain(title), x=0.01, ha="left", fontsize=size_pt, color=INK)


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
    lend_letters(figure.findobj(Text))
    if figure.get_layout_engine() is not None:
        # Once for all formats: making room again moves what has room already by a little.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
    for path in paths:
        data = io.BytesIO()
        with mpl.rc_context(WRITING):
            figure.savefig(data, format=path.suffix[1:], metadata=NO_STAMPS[path.suffix], **options)
        save_whole(path, data.getbuffer())
