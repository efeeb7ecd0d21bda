"""Predictors by name, or anybody's own by `module:Class`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

from hatn_sim.datatypes import Predictor
from hatn_sim.errors import InputError, nearest
from hatn_sim.plugins import make_from_module
from hatn_sim.resources import weights_dir


def _constant_velocity() -> Predictor:
    from hatn_sim.predictors.constant_velocity import ConstantVelocity

    return ConstantVelocity()


def _constant_acceleration() -> Predictor:
    from hatn_sim.predictors.constant_acceleration import constant_acceleration

    return constant_acceleration()


def _constant_turn_rate() -> Predictor:
    from hatn_sim.predictors.constant_turn_rate import ConstantTurnRate

    return ConstantTurnRate()


def _idm() -> Predictor:
    from hatn_sim.predictors.idm import intelligent_driver_model

    return intelligent_driver_model()


def _fsm_d() -> Predictor:
    from hatn_sim.predictors.fsm import CloserBy, finite_state_machine

    return finite_state_machine(CloserBy.DISTANCE)


def _fsm_t() -> Predictor:
    from hatn_sim.predictors.fsm import CloserBy, finite_state_machine

    return finite_state_machine(CloserBy.TIME)


PREDICTORS: Final[dict[str, Callable[[], Predictor]]] = {
    "constant_velocity": _constant_velocity,
    "constant_acceleration": _constant_acceleration,
    "constant_turn_rate": _constant_turn_rate,
    "idm": _idm,
    "fsm_d": _fsm_d,
    "fsm_t": _fsm_t,
}
PAPER: Final = "hatn-paper"
"""HATN in the form of the paper."""
READS_WEIGHTS: Final = frozenset({"hatn", PAPER})
"""Those that `weights` and `adapt` are for; anybody's own are made without arguments."""
NEEDED: Final = ("name", "init", "observe", "predict")


def load_predictor(
    name: str,
    weights: Path | None = None,
    adapt: str = "none",
    unadapted: frozenset[str] = frozenset(),
) -> Predictor:
    """The predictor of that name, or an instance of `module:Class`.

    Networks learn on from every vehicle as `adapt` says, none or one of `METHODS`, but for those of
    `unadapted`. Raises InputError where there is no such predictor, or where importing or making
    it fails.
    """
    if name in READS_WEIGHTS:
        return _network(name, weights_of(name, weights), adapt, unadapted)
    if name in PREDICTORS:
        return PREDICTORS[name]()
    if ":" not in name:
        raise InputError(
            f"unknown predictor {name!r}{nearest(name, (*READS_WEIGHTS, *PREDICTORS))} "
            "(your own: --predictor module:Class)"
        )
    made: Predictor = make_from_module("predictor", name, NEEDED)
    return made


def _network(name: str, weights: Path, adapt: str, unadapted: frozenset[str]) -> Predictor:
    from hatn_sim.hatn.predictor import Hatn

    hatn = Hatn(weights, name)
    if adapt == "none":
        return hatn
    from hatn_sim.hatn.adaptation_memory import METHODS, default_settings
    from hatn_sim.hatn.adaptive import AdaptiveHatn

    if adapt not in METHODS:
        raise InputError(f"unknown adaptation {adapt!r}{nearest(adapt, METHODS)}")
    settings = replace(default_settings(hatn.weights.edn), method=adapt)
    return AdaptiveHatn(hatn, settings, unadapted)


def paper_beside(weights: Path) -> Path:
    """Where the paper's form has its weights, if `weights` are those of `hatn`."""
    return weights.parent / f"{weights.stem}-paper{weights.suffix}"


def weights_of(name: str, weights: Path | None) -> Path:
    """The weight file of a network.

    `weights` is that of `hatn`; the paper's form has its own beside it, FILE-paper.safetensors.
    Without them, those that ship.
    """
    if weights is not None and name != PAPER:
        return weights
    if weights is not None and (beside := paper_beside(weights)).is_file():
        return beside
    return weights_dir() / f"{name}.safetensors"
