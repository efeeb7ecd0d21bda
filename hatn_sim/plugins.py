"""Somebody's own predictor or agent, by `module:Class`."""

from __future__ import annotations

import importlib.util
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from hatn_sim.datatypes import Agent
from hatn_sim.errors import InputError, nearest
from hatn_sim.resources import find_agents

AGENT_CLASS = "Agent"
"""What the file of an agent that ships defines."""
SHIPPED_AGENTS = "hatn_sim_agent_"
"""How their modules are named when they are loaded."""


def load_agent(name: str) -> Agent:
    """The agent of that name among those that ship, or an instance of `module:Class`.

    Raises InputError where there is none, or where importing or making it fails.
    """
    if ":" in name:
        agent: Agent = make_from_module("agent", name, ("init", "step"))
        return agent
    shipped = find_agents()
    if name not in shipped:
        raise InputError(
            f"unknown agent {name!r}{nearest(name, shipped)} (your own: --agent module:Class)"
        )
    module_name = f"{SHIPPED_AGENTS}{name}"
    spec = importlib.util.spec_from_file_location(module_name, shipped[name])
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses look their module up there
    spec.loader.exec_module(module)
    made: Agent = getattr(module, AGENT_CLASS)()
    return made


def make_from_module(what: str, name: str, needed: tuple[str, ...]) -> Any:
    """An instance of `module:Class`, made without arguments, that has the names `needed`.

    A module is looked for in the working directory first, as `python -m` does. InputError where
    there is none, or where importing or making it fails, with what was raised.
    """
    module_name, _, class_name = name.partition(":")
    try:
        _look_here()
        made = getattr(import_module(module_name), class_name)()
    except Exception as error:  # somebody else's code may raise anything
        said = " ".join(f"{error} ({type(error).__name__})".split())
        raise InputError(
            f"{what} {name!r}: {said}; expected module:Class, importable from here, "
            "that can be made without arguments"
        ) from error
    for member in needed:
        if not hasattr(made, member):
            raise InputError(
                f"{what} {name!r}: has no {member!r}, see datatypes.{what.capitalize()}"
            )
    return made


def _look_here() -> None:
    """Let imports find files in the working directory, which a console script leaves out."""
    here = str(Path.cwd())
    if "" not in sys.path and here not in sys.path:
        sys.path.insert(0, here)
