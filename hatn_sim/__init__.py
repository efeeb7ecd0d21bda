"""Closed-loop traffic simulation with HATN: predictions, suggestions and alerts for every vehicle.

Importing the package is cheap; the public names are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "Frame": "hatn_sim.datatypes",
    "Scene": "hatn_sim.datatypes",
    "Prediction": "hatn_sim.datatypes",
    "SemanticGraphs": "hatn_sim.datatypes",
    "SumoSimulator": "hatn_sim.simulators.sumo",
    "load_scenario": "hatn_sim.config",
    "load_predictor": "hatn_sim.predictors.find",
    "tick": "hatn_sim.loop",
    "run": "hatn_sim.loop",
    "read_run": "hatn_sim.log",
    "score_runs": "hatn_sim.score.prediction",
}
__all__ = sorted(_PUBLIC)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'hatn_sim' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
