"""How true a replay inside SUMO was: for people (two tables) and for programs (scores)."""

from __future__ import annotations

from typing import Final

from rich.console import Group
from rich.table import Table
from rich.text import Text

from hatn_sim.datatypes import Score
from hatn_sim.simulators.sumo_replay.figures import Divergence, Fidelity

NONE: Final = "-"
SHOWN_OVERLAPS: Final = 10
PREDICTOR: Final = "recording"
"""What stands in the predictor's place of the scores: nobody predicts here."""


def replay_table(name: str, fidelity: Fidelity, divergence: Divergence) -> Group:
    """Fidelity of the vehicles placed and divergence of those that drove, for a console."""
    heading = Text(f"{name}: what SUMO made of the recorded vehicles", style="bold")
    parts: list[Table | Text] = [heading, _fidelity_table(fidelity), Text()]
    if divergence.vehicles or divergence.kept or divergence.held_back:
        driven = f"{divergence.vehicles:,} driven vehicles, metres from their own recordings"
        parts += [Text(f"{name}: {driven}", style="bold"), _divergence_table(divergence)]
        parts += [Text(line) for line in _divergence_lines(divergence)]
    else:
        parts.append(Text("no vehicle was taken over"))
    return Group(*parts)


def replay_scores(name: str, fidelity: Fidelity, divergence: Divergence) -> list[Score]:
    """The same figures as scores; `n` counts vehicle-frames, of divergence vehicles."""
    f, d = fidelity, divergence
    rows: list[tuple[str, float | None, str, int]] = [
        ("replay_position_m_median", f.position_m_median, "m", f.n),
        ("replay_position_m_p99", f.position_m_p99, "m", f.n),
        ("replay_position_m_max", f.position_m_max, "m", f.n),
        ("replay_lane_share", f.lane_share, "1", f.lane_n),
        ("replay_speed_mps_median", f.speed_mps_median, "m/s", f.n),
        ("replay_speed_mps_p99", f.speed_mps_p99, "m/s", f.n),
        ("replay_centre_line_m_median", f.centre_line_m_median, "m", f.n),
        ("replay_outside", _share(f.outside, f.n + f.lost), "1", f.n + f.lost),
        ("replay_lost", _share(f.lost, f.n + f.lost), "1", f.n + f.lost),
    ]
    for at in d.at:
        rows.append((f"divergence_m_median_{at.after_s:g}s", at.median_m, "m", at.n))
        rows.append((f"divergence_m_max_{at.after_s:g}s", at.max_m, "m", at.n))
    rows += [
        ("divergence_m_final", d.final_m_median, "m", d.vehicles),
        ("divergence_overlaps", float(len(d.overlaps)), "pairs", d.vehicles),
        ("divergence_kept", float(len(d.kept)), "vehicles", d.vehicles),
        ("divergence_held_back", float(d.held_back), "vehicles", d.vehicles),
    ]
    return [
        Score(measure, PREDICTOR, name, "all", "none", value if n else None, unit, n, None, None)
        for measure, value, unit, n in rows
    ]


def _fidelity_table(f: Fidelity) -> Table:
    table = _table("error of", "n")
    for title in ("median", "99 %", "max"):
        table.add_column(title, justify="right")
    table.add_row(
        "position, m",
        f"{f.n:,}",
        _number(f.position_m_median),
        _number(f.position_m_p99),
        _number(f.position_m_max),
    )
    table.add_row(
        "speed as SUMO derives it, m/s",
        f"{f.n:,}",
        _number(f.speed_mps_median),
        _number(f.speed_mps_p99),
        "",
    )
    right = NONE if f.lane_share is None else f"{100.0 * f.lane_share:.2f} % right"
    table.add_row("lane", f"{f.lane_n:,}", right)
    table.add_row("distance to the centre line, m", f"{f.n:,}", _number(f.centre_line_m_median))
    table.add_row("recorded beside every lane, unseen", f"{f.outside:,}")
    table.add_row("taken off the road by SUMO", f"{f.lost:,}")
    table.add_row("pedestrians, not placed", f"{f.not_placed:,}")
    return table


def _divergence_table(divergence: Divergence) -> Table:
    table = _table("seconds after", "n")
    for title in ("median", "max"):
        table.add_column(title, justify="right")
    for at in divergence.at:
        table.add_row(f"{at.after_s:g}", f"{at.n:,}", _number(at.median_m), _number(at.max_m))
    final = _number(divergence.final_m_median)
    table.add_row("last seen in both", f"{divergence.vehicles:,}", final)
    return table


def _divergence_lines(divergence: Divergence) -> list[str]:
    overlaps = divergence.overlaps
    lines = [f"collisions of driven vehicles (outlines overlap): {len(overlaps):,}"]
    for overlap in overlaps[:SHOWN_OVERLAPS]:
        other = "recorded" if overlap.other_recorded else "driven"
        lines.append(
            f"  {overlap.time_s:.1f} s: {overlap.driven_id} and {overlap.other_id} ({other})"
        )
    if len(overlaps) > SHOWN_OVERLAPS:
        lines.append(f"  and {len(overlaps) - SHOWN_OVERLAPS:,} more")
    if divergence.kept:
        lines.append(f"kept to the recording, for want of a way in the net: {len(divergence.kept)}")
    if divergence.held_back:
        lines.append(
            f"held back until there was room to enter: {divergence.held_back:,} vehicles, "
            f"{divergence.held_back_s:.1f} s in all"
        )
    return lines


def _table(first: str, second: str) -> Table:
    table = Table(
        box=None,
        padding=(0, 2, 0, 0),
        pad_edge=False,
        header_style="italic",
    )
    table.add_column(first)
    table.add_column(second, justify="right")
    return table


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.3f}"


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
