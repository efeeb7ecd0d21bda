"""Predictors by name, or anybody's own by `module:Class`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from hatn_sim.datatypes import Predictor
from hatn_sim.errors import InputError, nearest
from hatn_sim.plugins import make_from_module
from hatn_sim.resources import weights_dir


def _hatn(weights: Path | None) -> Predictor:
    from hatn_sim.hatn.predictor import Hatn

    return Hatn(weights or weights_dir() / "hatn.safetensors")


def _constant_velocity(weights: Path | None) -> Predictor:
    from hatn_sim.predictors.constant_velocity import ConstantVelocity

    return ConstantVelocity()


def _idm(weights: Path | None) -> Predictor:
    from hatn_sim.predictors.idm import IntelligentDriverModel

    return IntelligentDriverModel()


PREDICTORS: Final[dict[str, Callable[[Path | None], Predictor]]] = {
    "hatn": _hatn,
    "constant_velocity": _constant_velocity,
    "idm": _idm,
}
READS_WEIGHTS: Final = frozenset({"hatn"})
"""Those that `weights` are for; anybody's own are made without arguments."""
NEEDED: Final = ("name", "init", "observe", "predict")


def load_predictor(name: str, weights: Path | None = None) -> Predictor:
    """The predictor of that name, or an instance of `module:Class`.

    Raises InputError where there is none, or where importing or making it fails.
    """
    if name in PREDICTORS:
        return PREDICTORS[name](weights)
    if ":" not in name:
        raise InputError(
            f"unknown predictor {name!r}{nearest(name, PREDICTORS)} "
            "(your own: --predictor module:Class)"
        )
    made: Predictor = make_from_module("predictor", name, NEEDED)
    return made
