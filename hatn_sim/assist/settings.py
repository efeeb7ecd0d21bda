"""What can be set of driver assistance, read from a TOML file at the border.

| key | unit | meaning |
|---|---|---|
| `alert_onset` | 0 ... 1 | an alert begins where a pair's danger (`danger`) reaches this ... |
| `alert_end` | 0 ... 1 | ... and goes on while it is at least this |
| `end_after_s` | s | it ends when it was less for longer than this ... |
| `least_s` | s | ... but not sooner than this after its onset |
| `cool_down_s` | s | danger that comes back sooner than this is the same alert |
| `confident` | probability | predicted so surely to let others go, who goes first deviates |
| `danger_network` | file | what tells the danger, beside the TOML file; "": that which ships |
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

from hatn_sim.config import read_toml
from hatn_sim.errors import InputError, nearest


@dataclass(frozen=True)
class AssistSettings:
    """The settings; those that ship were calibrated on seeds of their own."""

    alert_onset: float = 0.279
    alert_end: float = 0.2232
    end_after_s: float = 0.5
    least_s: float = 1.0
    cool_down_s: float = 2.0
    confident: float = 0.95
    danger_network: str = ""


LEAST_DANGER: Final = 1e-3
"""What is less likely is no danger: nothing is told of it."""
RANGES: Final = {
    "alert_onset": (LEAST_DANGER, 1.0),
    "alert_end": (0.0, 1.0),
    "end_after_s": (0.0, 10.0),
    "least_s": (0.0, 10.0),
    "cool_down_s": (0.0, 60.0),
    "confident": (0.5, 1.0),
}
"""Lowest and highest value of each: what is beyond them was meant in another unit."""
ORDERED: Final = (("alert_end", "alert_onset"), ("end_after_s", "cool_down_s"))
"""Of each of these the first may not be greater than the second."""
NETWORK: Final = "danger_network"


def read_assist_settings(path: Path) -> AssistSettings:
    """The settings in a TOML file; what it does not name stays as it ships.

    Raises InputError for an unknown key, a value out of its range, or thresholds out of order.
    """
    table = read_toml(path)
    known = [field.name for field in fields(AssistSettings)]
    given: dict[str, Any] = {}
    for key, value in table.items():
        if key not in known:
            raise InputError(f"{path}: unknown key {key!r}{nearest(key, known)}")
        if key == NETWORK:
            given[key] = _network(path, value)
            continue
        low, high = RANGES[key]
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{path}: {key}: expected a number, found {value!r}")
        if not low <= value <= high:
            unit = " s" if key.endswith("_s") else ", without a unit"
            raise InputError(f"{path}: {key}: expected {low:g} to {high:g}{unit}, found {value:g}")
        given[key] = float(value)
    settings = AssistSettings(**given)
    for small, large in ORDERED:
        if getattr(settings, small) > getattr(settings, large):
            one, other = (
                f"{key} = {getattr(settings, key):g}{'' if key in given else ' (default)'}"
                for key in (small, large)
            )
            raise InputError(f"{path}: {one} is above {other}; expected it not to be: set either")
    return settings


def _network(path: Path, value: object) -> str:
    if not isinstance(value, str):
        raise InputError(f"{path}: {NETWORK}: expected the name of a file, found {value!r}")
    if not value:
        return ""
    file = path.parent / value
    if not file.is_file():
        found = "a folder" if file.is_dir() else "none"
        raise InputError(f"{path}: {NETWORK}: expected a file, found {found} at {file}")
    return str(file)
