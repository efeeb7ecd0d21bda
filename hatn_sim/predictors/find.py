"""Predictors by name, or anybody's own by `module:Class`."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Final

from hatn_sim.datatypes import Predictor
from hatn_sim.errors import InputError, nearest
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


def load_predictor(name: str, weights: Path | None = None) -> Predictor:
    """The predictor of that name, or an instance of `module:Class`. InputError if there is none."""
    if name in PREDICTORS:
        return PREDICTORS[name](weights)
    if ":" not in name:
        raise InputError(
            f"unknown predictor {name!r}{nearest(name, PREDICTORS)} "
            "(your own: --predictor module:Class)"
        )
    module_name, _, class_name = name.partition(":")
    try:
        made: Predictor = getattr(import_module(module_name), class_name)()
    except (ImportError, AttributeError) as error:
        raise InputError(
            f"predictor {name!r}: {error}; expected module:Class, importable from here"
        ) from None
    for needed in ("name", "init", "observe", "predict"):
        if not hasattr(made, needed):
            raise InputError(f"predictor {name!r}: has no {needed!r}, see datatypes.Predictor")
    return made
