"""Which runs are scored together: those of a scene, made in the same way, each of them once."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from hatn_sim.errors import InputError
from hatn_sim.log import Run


def by_scene(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """The runs of each scene, in order of appearance."""
    scenes: dict[str, list[Run]] = {}
    for run in runs:
        scenes.setdefault(str(run.header.get("scene", "")), []).append(run)
    return scenes


def check_pool(runs: Sequence[Run]) -> None:
    """Refuse to pool runs of one scene whose scores are not of the same thing.

    Raises:
        InputError: two runs differ in predictors, lines, density, risk, map, weights, adaptation or
            in who drove, or are one run, given twice.
    """
    first = runs[0]
    known: dict[tuple[Any, str], Run] = {}
    for run in runs:
        if set(run.predictors) != set(first.predictors):
            raise InputError(
                f"{run.path}: expected the predictors of {first.path} "
                f"({', '.join(first.predictors)}), found {', '.join(run.predictors)}; "
                "score these runs one by one"
            )
        there, here = _made_with(first), _made_with(run)
        for what in there | here:
            if there.get(what) != here.get(what):
                raise InputError(
                    f"{run.path}: expected the {what} of {first.path} ({there.get(what)}), "
                    f"found {here.get(what)}; score these runs one by one"
                )
        identity = _identity(run)
        if identity in known:
            raise InputError(
                f"{run.path}: the same run as {known[identity].path}: scene, seed and settings "
                "are equal; give each run once"
            )
        known[identity] = run


def _made_with(run: Run) -> dict[str, Any]:
    """What has to be the same in runs that are pooled."""
    settings = run.header.get("settings", {})
    weights = run.header.get("weights_sha256", {})
    drive = settings.get("drive")
    return {
        "drive": drive,
        "agent": None if drive is None else settings.get("agent"),
        "net": settings.get("net"),
        "react_from_s": settings.get("react_from_s"),
        "lines": "route" if run.by_route else "inferred",
        "density": settings.get("density"),
        "risk": settings.get("risk"),
        "map": settings.get("map"),
        "adapt": run.header.get("adapt", "none"),
        **{f"weights of {name}": str(sha256)[:12] for name, sha256 in weights.items()},
    }


def _identity(run: Run) -> tuple[Any, str]:
    """Equal in runs of a scene that are repetitions; a log that names no seed is only itself."""
    settings = json.dumps(run.header.get("settings"), sort_keys=True)
    return run.header.get("seed", str(run.path)), settings
