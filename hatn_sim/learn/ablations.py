"""Which networks the paper's ablations need: every row of its tables, as settings.

A network is what its settings and its goals are: the same network in two rows is trained once. The
tables of the encoder-decoder network are incremental, as in the paper: each keeps the row of the
one before that the paper chose (Frenet; speed in; yaw in; incremental and aligned; no mechanism).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

from hatn_sim.evaluation.paper import SUMMARISES
from hatn_sim.hatn.edn_settings import EdnSettings, Signal
from hatn_sim.hatn.sgn_settings import SgnSettings, best_sgn, paper_sgn, paper_variants

TABLES: Final = ("sgn", "edn", "intention", "summary")
WIDTH: Final = 64
OURS: Final = "hatn"
"""The row beside those of the paper: the network of this package's best form."""
SIGNALS: Final[Mapping[str, Signal]] = {
    "Transform": "transform",
    "Input": "input",
    "Output": "output",
    "Hidden": "hidden",
}


@dataclass(frozen=True)
class SgnModel:
    """A semantic graph network to be trained."""

    settings: SgnSettings


Goals = SgnModel | Literal["none", "true"]


@dataclass(frozen=True)
class EdnModel:
    """An encoder-decoder network to be trained, and where the goals that it is told come from."""

    settings: EdnSettings
    goals: Goals


Model = SgnModel | EdnModel


@dataclass(frozen=True)
class Row:
    """A row of a table."""

    table: str  # key of the paper's table
    name: str
    model: Model


def rows_of(table: str, width: int = WIDTH) -> tuple[Row, ...]:
    """The rows of one of `TABLES`, all its parts."""
    if table == "sgn":
        return _sgn_rows(width)
    if table == "edn":
        return _edn_rows(width)
    if table == "intention":
        return _intention_rows(width)
    return _summary_rows(width)


def models_of(rows: Iterable[Row]) -> tuple[Model, ...]:
    """Every network that the rows need, once."""
    wanted = [row.model for row in rows]
    told_by = [
        model.goals
        for model in wanted
        if isinstance(model, EdnModel) and isinstance(model.goals, SgnModel)
    ]
    return tuple(dict.fromkeys([*told_by, *wanted]))


def in_order(models: Iterable[Model]) -> tuple[tuple[Model, ...], tuple[Model, ...]]:
    """Networks that learn from traffic alone, and those that are told goals by one of these."""
    first: list[Model] = []
    later: list[Model] = []
    for model in models:
        is_told = isinstance(model, EdnModel) and isinstance(model.goals, SgnModel)
        (later if is_told else first).append(model)
    return tuple(first), tuple(later)


def _sgn_rows(width: int) -> tuple[Row, ...]:
    variants = paper_variants(replace(paper_sgn(), width=width))
    paper = [Row("sgn", name, SgnModel(settings)) for name, settings in variants.items()]
    return (*paper, Row("sgn", OURS, _our_sgn(width)))


def _edn_rows(width: int) -> tuple[Row, ...]:
    frenet = EdnSettings(
        width=width,
        decoder="plain",
        goal="none",
        goal_steps=1,
        clock="none",
        speed_in=False,
        yaw_in=False,
        incremental=False,
        aligned=False,
    )
    speed = replace(frenet, speed_in=True)
    yaw = replace(speed, yaw_in=True)
    best = replace(yaw, incremental=True, aligned=True)
    parts: dict[str, dict[str, EdnSettings]] = {
        "edn.a": {"Cartesian": replace(frenet, coordinates="cartesian"), "Frenet": frenet},
        "edn.b": {
            "no speed": frenet,
            "speed in": speed,
            "speed out": replace(frenet, speed_out=True),
            "speed in, out": replace(speed, speed_out=True),
        },
        "edn.c": {
            "no yaw": speed,
            "yaw in": yaw,
            "yaw out": replace(speed, yaw_out=True),
            "yaw in, out": replace(yaw, yaw_out=True),
        },
        "edn.d": {
            "neither": yaw,
            "aligned": replace(yaw, aligned=True),
            "incremental": replace(yaw, incremental=True),
            "incremental, aligned": best,
        },
        "edn.e": {
            "neither": best,
            "teacher forcing": replace(best, teacher_forcing=True),
            "attention": replace(best, attention=True),
            OURS: EdnSettings(width=width, goal="none", goal_steps=1, clock="none"),
        },
    }
    return tuple(
        Row(table, name, EdnModel(settings, "none"))
        for table, of_part in parts.items()
        for name, settings in of_part.items()
    )


def _intention_rows(width: int) -> tuple[Row, ...]:
    (plain,) = (row.model for row in _edn_rows(width) if (row.table, row.name) == _BEST_EDN)
    assert isinstance(plain, EdnModel)
    predicted = SgnModel(replace(paper_sgn(), width=width))
    told_input = replace(plain.settings, goal="input")
    rows: list[Row] = []
    sources: dict[str, Goals] = {"intention.a": "true", "intention.b": predicted}
    for table, goals in sources.items():
        rows.append(Row(table, "No-Intention", plain))
        rows += [
            Row(table, name, EdnModel(replace(plain.settings, goal=signal), goals))
            for name, signal in SIGNALS.items()
        ]
    rows.append(Row("intention.b", OURS, EdnModel(EdnSettings(width=width), _our_sgn(width))))
    rows.append(Row("intention.c", "No-Intention", plain))
    rows += [
        Row("intention.c", name, EdnModel(replace(told_input, clock=signal), predicted))
        for name, signal in SIGNALS.items()
    ]
    return tuple(rows)


def _summary_rows(width: int) -> tuple[Row, ...]:
    of_place = {
        (row.table, row.name): row.model for row in (*_edn_rows(width), *_intention_rows(width))
    }
    return tuple(Row("summary", name, of_place[place]) for name, place in SUMMARISES.items())


def _our_sgn(width: int) -> SgnModel:
    return SgnModel(replace(best_sgn(), width=width))


_BEST_EDN: Final = ("edn.e", "neither")
