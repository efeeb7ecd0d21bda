"""The settings of a training, and the file that they are read from and written to.

[sgn]                    # of the semantic graph network: see `SgnSettings`
width = 64
[edn]                    # of the encoder-decoder network: see `EdnSettings`
[sgn_fit]                # how each is fitted: see `FitSettings`
learning_rate = 0.002
[edn_fit]
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final, get_type_hints

from hatn_sim.errors import InputError, nearest
from hatn_sim.hatn.edn_settings import PAPER, EdnSettings
from hatn_sim.hatn.sgn_settings import SgnSettings, best_sgn, paper_sgn
from hatn_sim.hatn.weights_io import RANGES, unfit
from hatn_sim.learn.fit import FitSettings
from hatn_sim.learn.split_file import read_toml


@dataclass(frozen=True)
class TrainingSettings:
    """Both networks, and how each is fitted."""

    sgn: SgnSettings = field(default_factory=best_sgn)
    edn: EdnSettings = field(default_factory=EdnSettings)
    sgn_fit: FitSettings = field(default_factory=FitSettings)
    edn_fit: FitSettings = field(default_factory=FitSettings)


FORMS: Final[Mapping[str, TrainingSettings]] = {
    "hatn": TrainingSettings(
        sgn_fit=FitSettings(batch=128, learning_rate=4e-3),
        edn_fit=FitSettings(learning_rate=4e-3),
    ),
    "paper": TrainingSettings(paper_sgn(), PAPER),
}
"""`hatn` is the best that we know, `paper` has the paper's networks."""
STARTED_RATE: Final = 1e-3
"""Learning rate of networks that begin with trained ones, so that these are not unlearnt."""
SECTIONS: Final = tuple(one.name for one in fields(TrainingSettings))
FIT_RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "epochs": (1, 100_000),
    "batch": (1, 1_000_000),
    "learning_rate": (1e-9, 10.0),
    "weight_decay": (0.0, 10.0),
    "average": (0.0, 1.0 - 1e-9),
    "patience": (1, 100_000),
}
"""What each number may be, both ends included; those of the networks are with their weights."""


def started(settings: TrainingSettings) -> TrainingSettings:
    """For networks that begin with trained ones."""
    return replace(
        settings,
        sgn_fit=replace(settings.sgn_fit, learning_rate=STARTED_RATE),
        edn_fit=replace(settings.edn_fit, learning_rate=STARTED_RATE),
    )


def read_settings(path: Path, basis: TrainingSettings) -> TrainingSettings:
    """`basis`, changed as a file says. Raises InputError for keys and values that there are not."""
    return changed(basis, str(path), _flat(str(path), read_toml(path)))


def changed(basis: TrainingSettings, where: str, values: Mapping[str, Any]) -> TrainingSettings:
    """`basis` with the values of keys like `sgn.width`. Raises InputError as `read_settings`."""
    ranges = {**RANGES, **FIT_RANGES}
    for key, value in values.items():
        check_key(where, key)
        section, _, name = key.partition(".")
        old = getattr(basis, section)
        expected = unfit(value, get_type_hints(type(old))[name], ranges.get(name))
        if expected:
            raise InputError(f"{where}: {key}: expected {expected}, found {value!r}")
        basis = replace(basis, **{section: replace(old, **{name: value})})
    return basis


def check_key(where: str, key: str) -> None:
    """Raises InputError, with the nearest name, unless there is a setting like `sgn.width`."""
    known = {
        f"{name}.{one.name}" for name in SECTIONS for one in fields(getattr(FORMS["hatn"], name))
    }
    if key not in known:
        raise InputError(f"{where}: unknown setting {key!r}{nearest(key, known)}")


def settings_toml(settings: TrainingSettings) -> str:
    """The text of a settings file."""
    lines: list[str] = []
    for section, values in asdict(settings).items():
        lines.append(f"[{section}]")
        lines += [f"{name} = {json.dumps(value)}" for name, value in values.items()]
    return "\n".join(lines) + "\n"


def _flat(where: str, content: Mapping[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for section, values in content.items():
        if section not in SECTIONS:
            raise InputError(f"{where}: unknown table {section!r}{nearest(section, SECTIONS)}")
        if not isinstance(values, dict):
            raise InputError(f"{where}: {section}: expected a table [{section}], found {values!r}")
        flat |= {f"{section}.{name}": value for name, value in values.items()}
    return flat
