"""A row of a seed: what drives came to with one predictor, in one file, whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from hatn_sim.errors import InputError
from hatn_sim.score.closed_loop import UNITS
from hatn_sim.whole_file import ROOM_OR_OUT, save_whole

FORMAT: Final = 1
REFERENCE: Final = "sumo_driver"
"""The row of the simulator's own driver, who knows more than any predictor."""
ORACLE: Final = "oracle"
"""The row of the predictor that is told the future."""


@dataclass(frozen=True)
class DrivenEgo:
    """A vehicle that was driven, and the measures of it (`score.closed_loop`)."""

    ego_id: str
    end: str
    measures: Mapping[str, float]


@dataclass(frozen=True)
class OpenLoop:
    """A mean of the predictor's over samples of the reference, in which nobody is driven."""

    measure: str
    subset: str
    unit: str
    value: float
    n: int


@dataclass(frozen=True)
class DrivenRow:
    """All drives of one seed of a scene with one predictor, or those of the simulator's driver."""

    scene: str
    seed: int
    row: str
    egos: tuple[DrivenEgo, ...]
    open_loop: tuple[OpenLoop, ...]
    made_with: Mapping[str, Any]  # settings, to compare


def write_row(path: Path, row: DrivenRow) -> None:
    """Write a row. InputError where there is no room."""
    text = json.dumps({"format": FORMAT, **asdict(row)}, indent=1, allow_nan=False)
    save_whole(path, text + "\n", ROOM_OR_OUT)


def read_row(path: Path) -> DrivenRow:
    """A row that `write_row` wrote. Raises InputError where the file is none, or damaged."""
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if found["format"] != FORMAT:
            raise ValueError(f"format {found['format']}, expected {FORMAT}")
        egos = tuple(
            DrivenEgo(
                str(one["ego_id"]),
                str(one["end"]),
                {name: float(one["measures"][name]) for name in UNITS},
            )
            for one in found["egos"]
        )
        open_loop = tuple(OpenLoop(**one) for one in found["open_loop"])
        return DrivenRow(
            str(found["scene"]),
            int(found["seed"]),
            str(found["row"]),
            egos,
            open_loop,
            dict(found["made_with"]),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"{path}: expected driven vehicles, found damage or another version ({said}); delete "
            "it, and the same command makes it anew"
        ) from None
