"""The files that a scene is made of: where they change, so does what comes of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from hatn_sim.config import Scenario
from hatn_sim.recordings.each import own_files
from hatn_sim.simulators.sumo_config import named_files, read_sumocfg


def files_of(scenario: Scenario) -> Iterator[Path]:
    """Every file that a scene is read from, as far as it is there."""
    yield from (path for path in _named(scenario) if path.is_file())


def _named(scenario: Scenario) -> Iterator[Path]:
    if scenario.recorded is not None:
        source = scenario.recorded
        for path in own_files(source):
            yield from sorted(path.rglob("*.*")) if path.is_dir() else [path]
        if source.map_path is not None:
            yield source.map_path
    elif scenario.highway is None:
        # What a .sumocfg names may include other files beside it; what it writes is no part of it,
        # nor is what a user keeps there besides, such as weights and logs of their training.
        config = scenario.config_path
        beside = sorted(path for path in config.parent.iterdir() if ".xml" in path.suffixes)
        options = read_sumocfg(config)
        written = {config.parent / value for name, value in options.items() if "output" in name}
        yield from (path for path in (config, *beside) if path not in written)
        yield from named_files(config)
        yield from scenario.driver_paths
