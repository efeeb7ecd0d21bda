"""A small environment, for processes that import this module and nothing more of the tests."""

from __future__ import annotations

from typing import Any

import gymnasium

import hatn_sim.envs  # noqa: F401 - registers

SHORT = {"predictor": None, "warm_up_s": 2.0, "scene": "intersection5"}


def make_short() -> gymnasium.Env[Any, Any]:
    return gymnasium.make("hatn_sim/Scene-v0", **SHORT)
