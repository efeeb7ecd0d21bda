"""Where the shipped scenes, agents and weights lie: the one finder for wheel and clone.

A wheel carries scenes and agents inside the package (`hatn_sim/_data/`); in a clone, an sdist or
an editable install they lie beside the package, in the repository's top folder.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from hatn_sim.errors import InputError, nearest

PACKAGE_DIR = Path(__file__).resolve().parent
LEARNING_PREFIX = "learn_"
"""How the names of the shipped scenes begin that predictors learn on and are not tested on."""
SUITES = ("do_warn", "suppress_warn", "no_warn")
"""What a scene can be scripted for: a foe violates the ego's right of way; the same approach, but
the foe yields late; ordinary traffic (METHOD section 7)."""
WITHOUT_EVENTS = SUITES[1:]
"""Suites in which nothing is to be warned of."""


def scenarios_dir() -> Path:
    """The folder of the shipped scenes. Raises InputError where they were not installed."""
    return _data_dir("scenarios")


def agents_dir() -> Path:
    """The folder of the example agents. Raises InputError where they were not installed."""
    return _data_dir("agents")


def weights_dir() -> Path:
    """The folder of the shipped network weights. Raises InputError where it is missing."""
    folder = PACKAGE_DIR / "hatn" / "weights"
    if not folder.is_dir():
        raise InputError(f"{folder}: expected the shipped weights here; install hatn_sim again")
    return folder


def find_scenarios() -> dict[str, Path]:
    """The shipped scenes: name -> its scenario.toml, by name."""
    return {path.parent.name: path for path in sorted(scenarios_dir().glob("*/scenario.toml"))}


def scenes_to_test_on() -> tuple[str, ...]:
    """The names of the shipped scenes, but for those to learn on and those of suites."""
    return tuple(
        name
        for name, path in find_scenarios().items()
        if not name.startswith(LEARNING_PREFIX) and _suite_of(path) is None
    )


def scenes_of_suite(suite: str) -> tuple[str, ...]:
    """The names of the shipped scenes of a suite. Raises InputError for an unknown suite."""
    if suite not in SUITES:
        raise InputError(f"unknown suite {suite!r}{nearest(suite, SUITES)}")
    return tuple(name for name, path in find_scenarios().items() if _suite_of(path) == suite)


def suite_of_each_scene() -> dict[str, str]:
    """Of the shipped scenes that are of a suite: name -> suite."""
    suites = {name: _suite_of(path) for name, path in find_scenarios().items()}
    return {name: suite for name, suite in suites.items() if suite is not None}


def _suite_of(path: Path) -> str | None:
    """What a shipped scenario.toml says of its suite."""
    return tomllib.loads(path.read_text("utf-8")).get("suite")


def find_agents() -> dict[str, Path]:
    """The example agents: name -> its file, by name."""
    return {path.stem: path for path in sorted(agents_dir().glob("*.py"))}


def _data_dir(name: str) -> Path:
    installed = PACKAGE_DIR / "_data" / name
    beside = PACKAGE_DIR.parent / name
    if installed.is_dir():
        return installed
    if beside.is_dir() and (PACKAGE_DIR.parent / "pyproject.toml").is_file():
        return beside
    raise InputError(
        f"{installed}: expected the shipped {name} here, or in {beside} of a clone; "
        "install hatn_sim again"
    )
