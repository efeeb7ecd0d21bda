"""The predictors that a command names."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hatn_sim.datatypes import Predictor


def load_predictors(
    names: Sequence[str],
    weights: Path | None,
    adapt: str,
    quiet: bool,
    unadapted: frozenset[str] = frozenset(),
) -> list[Predictor]:
    """All of them, each once; see `load_predictor`.

    Raises InputError where there is no such predictor, where `weights` or `adapt` are for none of
    them, and where two call themselves the same.
    """
    from hatn_sim.errors import InputError
    from hatn_sim.predictors.find import READS_WEIGHTS, load_predictor

    wanted = dict.fromkeys(names)
    twice = [name for name in wanted if names.count(name) > 1]
    if twice and not quiet:
        print(f"hatn-sim: {', '.join(twice)}: named twice, taken once", file=sys.stderr)
    given = None if weights is None else f"--weights {weights}"
    given = f"--adapt {adapt}" if given is None and adapt != "none" else given
    if given is not None and READS_WEIGHTS.isdisjoint(wanted):
        raise InputError(f"{given}: {', '.join(wanted)} cannot use it; leave it out, or add hatn")
    check_paper_weights(tuple(wanted), weights, quiet)
    predictors = [load_predictor(name, weights, adapt, unadapted) for name in wanted]
    called = [predictor.name for predictor in predictors]
    for name in called:
        if called.count(name) > 1:
            raise InputError(f"two predictors call themselves {name!r}; give one another name")
    return predictors


def check_paper_weights(names: Sequence[str], weights: Path | None, quiet: bool) -> None:
    """Say where the paper's form has no weights beside those given, so that it takes what ships.

    Raises InputError where the weights given would then be for nobody.
    """
    from hatn_sim.errors import InputError
    from hatn_sim.predictors.find import PAPER, READS_WEIGHTS, paper_beside, weights_of

    if PAPER not in names or weights is None:
        return
    beside = paper_beside(weights)
    if weights_of(PAPER, weights) == beside:
        return
    if READS_WEIGHTS.isdisjoint({*names} - {PAPER}):
        name = weights.with_stem(weights.stem.removesuffix("-paper")).name
        raise InputError(
            f"--weights {weights}: expected {beside.name} beside it for {PAPER}, found none; "
            + (f"name {name}" if name != weights.name else "leave --weights out for what ships")
        )
    if not quiet:
        print(
            f"hatn-sim: {PAPER}: {beside.name} is not beside {weights}; "
            "predicting with the weights of the paper's form that ship",
            file=sys.stderr,
        )
