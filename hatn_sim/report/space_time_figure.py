"""An ego and those it meets along its way over time, predicted and real; its slots below.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter

from hatn_sim.datatypes import DT_S, FloatArray, Kind
from hatn_sim.report.canvas import INK, SOFT_INK, plain
from hatn_sim.report.case_cast import BLACK
from hatn_sim.report.figures import (
    COLOURS,
    LABEL_PT,
    NOTE_PT,
    PAGE_IN,
    TICK_PT,
    TITLE_PT,
    dress,
    head_chart,
    new_chart,
    rule,
    save_figure,
)
from hatn_sim.report.space_time import SpaceTime, Strand, free_spans

HEIGHT_IN: Final = 5.6
DASHES: Final = ("-", (0, (6, 1.5)), (0, (4, 1, 1, 1)))
"""Told apart in grey, too."""
ROOM_M: Final = (4.0, 14.0)
"""Shown of the way before the ego's first place and behind the last conflict."""
WAY_POINT_FRAMES: Final = 5
ZONE_PT: Final = 5.0
FAINT: Final = 0.45
NOW: Final[dict[str, Any]] = {"color": SOFT_INK, "lw": 0.7, "ls": (0, (1, 1.5))}
CONFLICT: Final[dict[str, Any]] = {"lw": 0.8, "alpha": 0.6}
SLOTS: Final = "Slots of the ego: black, to yield; each colour, to pass before who has it above"
ELSEWHERE: Final[dict[str, Any]] = {"lw": 0.7, "alpha": 0.7}
"""Whoever is not on the ego's way, as far from the conflict as it is on its own."""


def draw_space_time(story: SpaceTime, where: str, paths: Sequence[Path]) -> None:
    """Draw the ways over time, and how probable the ego's slots were, into files."""
    figure = new_chart((PAGE_IN, HEIGHT_IN))
    ways, slots = figure.subplots(2, 1, sharex=True, height_ratios=(3.6, 1))
    time_s, now_s = story.time_s, float(story.run.times_s[story.frame])
    looks = _looks(story)
    for axes in (ways, slots):
        axes.axvline(now_s, **NOW)
    for strand, look in zip((*story.others, story.ego), (*looks[1:], looks[0]), strict=True):
        _strand(ways, story, strand, look)
    _zones(ways, story, looks)
    for k, look in enumerate(looks):
        slots.plot(time_s, story.chance[:, k], **look)
    _limits(ways, story)
    way = f"along the ego's way, m  (0: ego at {now_s:.1f} s)"
    for axes, name in ((ways, way), (slots, "probability of slot")):
        dress(axes, TICK_PT)
        rule(axes)
        axes.set_ylabel(name, fontsize=LABEL_PT, color=INK)
    slots.set_title(SLOTS, loc="left", fontsize=LABEL_PT, color=INK)
    slots.set_ylim(-0.04, 1.04)
    slots.set_yticks([0.0, 0.5, 1.0])
    slots.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0, symbol=" %"))
    slots.set_xlabel("time, s", fontsize=LABEL_PT, color=INK)
    slots.set_xlim(float(time_s[0]), float(time_s[-1]))
    figure.align_ylabels([ways, slots])
    figure.legend(
        handles=_legend(story, looks, now_s),
        loc="outside lower left",
        ncols=2,
        frameon=False,
        fontsize=NOTE_PT,
        labelcolor=INK,
        handlelength=3.2,
    )
    head_chart(figure, f"Who goes when: {where}", TITLE_PT)
    save_figure(figure, paths)


def _looks(story: SpaceTime) -> list[dict[str, Any]]:
    """How each is drawn, the ego first."""
    looks: list[dict[str, Any]] = [{"color": BLACK, "ls": "-", "lw": 1.8}]
    for k in range(len(story.others)):
        ls = DASHES[k % len(DASHES)]
        looks.append({"color": COLOURS[k % len(COLOURS)], "ls": ls, "lw": 1.3})
    return looks


def _strand(axes: Axes, story: SpaceTime, strand: Strand, look: dict[str, Any]) -> None:
    """What a vehicle drove and what was predicted of it; its length where on the ego's way."""
    time_s, colour, half_m = story.time_s, look["color"], 0.5 * strand.length_m
    body: dict[str, Any] = {"color": colour, "linewidth": 0.0, "alpha": 0.16}
    low_m, high_m = strand.s_m - half_m, strand.s_m + half_m
    axes.fill_between(time_s, low_m, high_m, where=strand.on_way.tolist(), **body)
    axes.plot(time_s, np.where(strand.on_way, strand.s_m, np.nan), **look)
    # Up to where it comes onto the ego's way and from where it leaves it, without a gap.
    elsewhere = ~strand.on_way
    elsewhere[1:] |= ~strand.on_way[:-1]
    elsewhere[:-1] |= ~strand.on_way[1:]
    axes.plot(time_s, np.where(elsewhere, strand.s_m, np.nan), **{**look, **ELSEWHERE})
    for told in strand.forecasts:
        count = told.s_m.shape[1]
        ahead_s = story.run.times_s[told.frame] + DT_S * np.arange(count)
        if told.frame != story.frame:
            best = told.s_m[int(told.chance.argmax())]
            axes.plot(ahead_s, best, color=colour, lw=0.6, ls=":", alpha=FAINT)
            continue
        for way_m, chance in zip(told.s_m, told.chance / told.chance.max(), strict=True):
            axes.plot(
                ahead_s,
                way_m,
                color=colour,
                lw=0.8,
                ls=":",
                alpha=float(chance),
                marker="o",
                ms=3.0,
                mfc="white",
                mew=0.8,
                markevery=(WAY_POINT_FRAMES, WAY_POINT_FRAMES),
                zorder=4,
            )


def _zones(axes: Axes, story: SpaceTime, looks: Sequence[dict[str, Any]]) -> None:
    """When each conflict is taken, and for how long it is free before and after the ego."""
    time_s = story.time_s
    bar: dict[str, Any] = {"lw": ZONE_PT, "solid_capstyle": "butt", "zorder": 5}
    for strand, look in zip(story.others, looks[1:], strict=True):
        at_m = strand.conflict_s_m
        assert at_m is not None
        axes.axhline(at_m, color=look["color"], **CONFLICT)
        for who, colour, comes in (
            (strand, look["color"], strand.crosses),
            (story.ego, BLACK, strand.ego_crosses),
        ):
            if comes and (span_s := who.occupied_s(time_s, at_m)) is not None:
                axes.plot(span_s, (at_m, at_m), color=colour, **bar)
    for span_s, at_m in free_spans(story):
        _gap(axes, span_s, at_m)


def _gap(axes: Axes, span_s: tuple[float, float], at_m: float) -> None:
    arrow: dict[str, Any] = {"arrowstyle": "<->", "lw": 0.6, "color": INK, "shrinkA": 0}
    axes.annotate(
        "", (span_s[1], at_m), (span_s[0], at_m), arrowprops={**arrow, "shrinkB": 0}, zorder=5
    )
    axes.annotate(
        f"{span_s[1] - span_s[0]:.1f} s",
        (0.5 * sum(span_s), at_m),
        (0, 3.5),
        textcoords="offset points",
        ha="center",
        fontsize=NOTE_PT,
        color=INK,
        bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        zorder=6,
    )


def _limits(axes: Axes, story: SpaceTime) -> None:
    meets: FloatArray = np.array([one.conflict_s_m for one in story.others], dtype=np.float64)
    low, high = float(np.nanmin(story.ego.s_m)), float(meets.max())
    axes.set_ylim(min(low, float(meets.min())) - ROOM_M[0], high + ROOM_M[1])


def _legend(
    story: SpaceTime, looks: Sequence[dict[str, Any]], now_s: float
) -> list[Line2D | Patch]:
    run = story.run
    handles: list[Line2D | Patch] = []
    for strand, look in zip((story.ego, *story.others), looks, strict=True):
        kind = Kind(int(run.kinds[run.ids.index(strand.vehicle_id)])).name.lower()
        words = f"{kind} {strand.vehicle_id}"
        words = f"ego: {words}" if strand is story.ego else f"{words}{_how_met(strand)}"
        handles.append(Line2D([], [], label=plain(words), **look))
    for name in story.unplaced:
        words = f"not drawn: {name}, of whom the ego is told; it is in none of its slots"
        handles.append(Line2D([], [], label=plain(words), ls="none"))
    said = f"predicted by {run.predictors[0]} at {now_s:.1f} s"
    dots: dict[str, Any] = {"marker": "o", "ms": 3.0, "mfc": "white", "mew": 0.8}
    thin: dict[str, Any] = {"color": INK, "lw": 0.6, "ls": ":", "alpha": FAINT}
    handles += [
        Line2D([], [], label=f"upright: the moment, {now_s:.1f} s", **NOW),
        Line2D([], [], color=INK, label="level: conflict with who has its colour", **CONFLICT),
        Line2D([], [], color=INK, lw=0.8, ls=":", label=plain(said), **dots),
        Line2D([], [], label="likeliest prediction, once a second", **thin),
        Patch(color=INK, alpha=0.16, lw=0.0, label="on the ego's way, bumper to bumper"),
        Line2D([], [], color=INK, label="elsewhere: so far from the conflict", **ELSEWHERE),
        Line2D([], [], color=INK, lw=ZONE_PT, label="is at the conflict"),
    ]
    if free_spans(story):
        arrow: dict[str, Any] = {"color": INK, "marker": r"$\leftrightarrow$", "ms": 9.0, "ls": ""}
        handles.append(Line2D([], [], label="the conflict is free", **arrow))
    return handles


def _how_met(other: Strand) -> str:
    words = ", of whom the ego is told" if other.is_named else ""
    if not other.crosses:
        return f"{words}; did not come to the conflict"
    return words if other.ego_crosses else f"{words}; came to the conflict, the ego did not"
