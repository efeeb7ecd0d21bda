"""A run over time: how many are there, how fast they are, whom alerts name, what really happened.

Imports matplotlib, so import this module only where something is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from hatn_sim.datatypes import AlertInterval, FloatArray, Kind, SafetyEvent
from hatn_sim.log import Run
from hatn_sim.report.canvas import INK, SOFT_INK
from hatn_sim.report.figures import (
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

HEIGHT_IN: Final = 3.7
SPEED: Final = "#0072b2"
ALERT: Final = "#d55e00"
SHARES: Final = (0.1, 0.5, 0.9)
EVENTS: Final[Mapping[str, tuple[str, str]]] = {
    "T3": ("close pass (T3)", "o"),
    "T2": ("evasive braking (T2)", "^"),
    "T1": ("collision (T1)", "X"),
}
"""Tier -> its words and marker, the gravest last: it stands on top."""


def speeds_over_time(run: Run) -> tuple[FloatArray, FloatArray]:
    """(vehicles in view [T], 10th, 50th and 90th percentile of their speeds [3, T] in m/s).

    Pedestrians do not count; NaN where nobody is in view.
    """
    tracks = run.tracks
    driven = (tracks.kind != Kind.PEDESTRIAN) & (tracks.frame < run.frame_count)
    frame, speed = tracks.frame[driven], tracks.speed_mps[driven]
    count = np.bincount(frame, minlength=run.frame_count).astype(np.float64)
    speed = speed[np.lexsort((speed, frame))]
    first = np.append(0, np.cumsum(count)[:-1])
    # Of sorted speeds the one at a rank between two is interpolated, as np.quantile does.
    rank = np.array(SHARES)[:, None] * np.maximum(count - 1.0, 0.0)
    low = np.floor(rank)
    at = (first + low).astype(np.int64)
    last = max(len(speed) - 1, 0)
    padded = speed if len(speed) else np.zeros(1)
    upper = np.minimum(at + 1, last)
    quantiles = padded[np.minimum(at, last)] * (1.0 - rank + low) + padded[upper] * (rank - low)
    return count, np.where(count > 0, quantiles, np.nan)


def draw_traffic(
    run: Run,
    alerts: Sequence[AlertInterval],
    events: Sequence[SafetyEvent],
    where: str,
    paths: Sequence[Path],
) -> None:
    """Draw the three panels over one time axis into files."""
    figure = new_chart((PAGE_IN, HEIGHT_IN))
    speeds, counts, advice = figure.subplots(3, 1, sharex=True, height_ratios=(3, 1.2, 1.6))
    count, quantiles = speeds_over_time(run)
    time_s = run.times_s
    speeds.fill_between(time_s, quantiles[0], quantiles[2], color=SPEED, alpha=0.2, linewidth=0)
    speeds.plot(time_s, quantiles[1], color=SPEED, lw=1.3)
    speeds.set_ylim(bottom=0.0)
    _name(speeds, "speed, m/s")
    note = {"fontsize": NOTE_PT, "color": SOFT_INK, "ha": "right", "va": "bottom"}
    speeds.text(1.0, 1.01, "median, and 10 to 90 % of vehicles", transform=speeds.transAxes, **note)
    counts.step(time_s, count, where="post", color=INK, lw=1.0)
    counts.set_ylim(bottom=0.0)
    counts.yaxis.set_major_locator(MaxNLocator(3, integer=True))
    _name(counts, "vehicles")
    _advice(advice, alerts, events)
    advice.set_xlabel("time, s", fontsize=LABEL_PT, color=INK)
    advice.set_xlim(float(time_s[0]), float(time_s[-1]))
    figure.align_ylabels([speeds, counts])
    head_chart(figure, f"Traffic, alerts and what really happened: {where}", TITLE_PT)
    save_figure(figure, paths)


def _advice(axes: Axes, alerts: Sequence[AlertInterval], events: Sequence[SafetyEvent]) -> None:
    """Alerts as bars and events as marks, a row for each kind."""
    rows = ["alert", *EVENTS]
    for alert in alerts:
        # However short, it is seen: a tick marks its onset.
        axes.plot(
            [alert.onset_s, alert.end_s],
            [0, 0],
            color=ALERT,
            lw=5,
            alpha=0.45,
            solid_capstyle="butt",
        )
        axes.plot([alert.onset_s] * 2, [-0.3, 0.3], color=ALERT, lw=1.0)
    for tier, (_, marker) in EVENTS.items():
        at = [event.start_s for event in events if event.tier == tier]
        row = [rows.index(tier)] * len(at)
        axes.scatter(
            at, row, s=18, marker=marker, color=INK, linewidths=0.0, zorder=3, clip_on=False
        )
    axes.set_yticks(range(len(rows)), ["alert", *(words for words, _ in EVENTS.values())])
    axes.set_ylim(-0.6, len(rows) - 0.4)
    dress(axes, TICK_PT)
    rule(axes)


def _name(axes: Axes, what: str) -> None:
    dress(axes, TICK_PT)
    rule(axes)
    axes.set_ylabel(what, fontsize=LABEL_PT, color=INK)
