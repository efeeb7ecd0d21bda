"""How wide words are on paper.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

from hatn_sim.report.letters import families_of

HINTED: Final = 1.03
"""Letters on whole pixels are wider by so much at most."""


@lru_cache(maxsize=512)
def width_pt(words: str, size_pt: float, bold: bool = False) -> float:
    """Of a line of words."""
    if not words:
        return 0.0  # matplotlib has no outline of nothing
    font = FontProperties(family=families_of(words), weight="bold" if bold else "normal")
    return float(TextPath((0.0, 0.0), words, size=size_pt, prop=font).get_extents().width)


def fitting_pt(words: str, size_pt: float, wide_pt: float, bold: bool = False) -> float:
    """The size at which words are no wider than this, and no larger than `size_pt`."""
    return size_pt * min(1.0, wide_pt / max(HINTED * width_pt(words, size_pt, bold), 1.0))
