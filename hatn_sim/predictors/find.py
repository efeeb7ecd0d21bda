"""Predictors by name, or anybody's own by `module:Class`."""

from __future__ import annotations

import sys
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
READS_WEIGHTS: Final = frozenset({"hatn"})
"""Those that `weights` are for; anybody's own are made without arguments."""


def load_predictor(name: str, weights: Path | None = None) -> Predictor:
    """The predictor of that name, or an instance of `module:Class`.

    A module is looked for in the working directory first, as `python -m` does. InputError where
    there is none, or where importing or making it fails, with what was raised.
    """
    if name in PREDICTORS:
        return PREDICTORS[name](weights)
    if ":" not in name:
        raise InputError(
            f"unknown predictor {name!r}{nearest(name, PREDICTORS)} "
            "(your own: --predictor module:Class)"
        )
    module_name, _, class_name = name.partition(":")
    try:
        _look_here()
        made: Predictor = getattr(import_module(module_name), class_name)()
    except Exception as error:  # somebody else's code may raise anything
        said = " ".join(f"{error} ({type(error).__name__})".split())
        raise InputError(
            f"predictor {name!r}: {said}; expected module:Class, importable from here, "
            "that can be made without arguments"
        ) from error
    for needed in ("name", "init", "observe", "predict"):
        if not hasattr(made, needed):
            raise InputError(f"predictor {name!r}: has no {needed!r}, see datatypes.Predictor")
    return made


def _look_here() -> None:
    """Let imports find files in the working directory, which a console script leaves out."""
    here = str(Path.cwd())
    if "" not in sys.path and here not in sys.path:
        sys.path.insert(0, here)
