"""What can be set of driver assistance, read from a TOML file at the border.

| key | unit | meaning |
|---|---|---|
| `alert_onset_mps2` | m/s2 | an alert begins where a pair's danger (`danger`) reaches this ... |
| `alert_end_mps2` | m/s2 | ... and goes on while it is at least this |
| `end_after_s` | s | it ends when it was less for longer than this |
| `cool_down_s` | s | danger that comes back sooner than this is the same alert |
| `severe_mps2` | m/s2 | danger of severity 1 |
| `reaction_s` | s | everybody goes on as now for so long before anybody brakes |
| `encroachment_s` | s | two who miss each other by less than this are there nearly at once |
| `soon_s` | s | who comes later than this has time to think |
| `confident` | probability | predicted so surely to let others go, who goes first deviates |
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

from hatn_sim.config import read_toml
from hatn_sim.errors import InputError, nearest


@dataclass(frozen=True)
class AssistSettings:
    """The settings; those that ship were calibrated on seeds of their own."""

    alert_onset_mps2: float = 1.75
    alert_end_mps2: float = 1.4
    end_after_s: float = 0.5
    cool_down_s: float = 2.0
    severe_mps2: float = 9.0
    reaction_s: float = 1.0
    encroachment_s: float = 0.5
    soon_s: float = 4.0
    confident: float = 0.95


RANGES: Final = {
    "alert_onset_mps2": (0.0, 9.0),
    "alert_end_mps2": (0.0, 9.0),
    "end_after_s": (0.0, 10.0),
    "cool_down_s": (0.0, 60.0),
    "severe_mps2": (0.0, 20.0),
    "reaction_s": (0.1, 3.0),
    "encroachment_s": (-3.0, 3.0),
    "soon_s": (0.5, 10.0),
    "confident": (0.5, 1.0),
}
"""Lowest and highest value of each: what is beyond them was meant in another unit."""
ORDERED: Final = (
    ("alert_end_mps2", "alert_onset_mps2"),
    ("alert_onset_mps2", "severe_mps2"),
    ("end_after_s", "cool_down_s"),
)
"""Of each of these the first may not be greater than the second."""


def read_assist_settings(path: Path) -> AssistSettings:
    """The settings in a TOML file; what it does not name stays as it ships.

    Raises InputError for an unknown key, a value out of its range, or thresholds out of order.
    """
    table = read_toml(path)
    known = [field.name for field in fields(AssistSettings)]
    for key, value in table.items():
        if key not in known:
            raise InputError(f"{path}: unknown key {key!r}{nearest(key, known)}")
        low, high = RANGES[key]
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{path}: {key}: expected a number, found {value!r}")
        if not low <= value <= high:
            raise InputError(
                f"{path}: {key}: expected {low:g} to {high:g}, found {value:g}; is it in the unit "
                "that the key's name ends with?"
            )
    settings = AssistSettings(**{key: float(value) for key, value in table.items()})
    for small, large in ORDERED:
        one, other = getattr(settings, small), getattr(settings, large)
        if one > other:
            raise InputError(
                f"{path}: {small} = {one:g} is above {large} = {other:g}; expected it not to be: "
                "change either"
            )
    return settings
