"""Samples that were cut before: one file for each piece of traffic.

A file is named by a hash of everything that its samples depend on (the files of the scene or the
recording, the seed, the duration, the source of this package, versions of the simulators), so
nothing in here is ever out of date. Files are whole or not there; one that is damaged is as if it
were not there.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from hatn_sim.content import content_hash
from hatn_sim.kept import library_versions, source_version
from hatn_sim.learn.dataset import Samples
from hatn_sim.learn.scene_files import files_of
from hatn_sim.learn.split import Traffic
from hatn_sim.recordings.each import own_cases
from hatn_sim.whole_file import write_whole

LARGEST_BYTES: Final = 20 * 2**30
"""Of the folder: beyond that, those not used for longest go."""
SUFFIX: Final = ".npz"


@dataclass(frozen=True)
class SampleCache:
    """A folder of samples; None keeps nothing."""

    folder: Path | None

    def load(self, traffic: Traffic) -> Samples | None:
        """The samples of some traffic, None where they are not here or damaged."""
        if self.folder is None:
            return None
        path = self._path(traffic)
        try:
            with np.load(path, allow_pickle=False) as arrays:
                samples = Samples(**{field.name: arrays[field.name] for field in fields(Samples)})
            os.utime(path)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None
        rows = {len(getattr(samples, field.name)) for field in fields(Samples)}
        return samples if len(rows) == 1 else None

    def store(self, traffic: Traffic, samples: Samples) -> str | None:
        """Keep samples; a line for the user where they could not be."""
        if self.folder is None:
            return None
        arrays = {field.name: getattr(samples, field.name) for field in fields(Samples)}

        def write(path: Path) -> None:
            with path.open("wb") as file:
                np.savez(file, **arrays)

        try:
            write_whole(self._path(traffic), write)
            self._make_room()
        except OSError as error:
            return (
                f"cache {self.folder}: {error.strerror}: the samples of {traffic.name} are not "
                "kept; make room, or name another folder with --cache"
            )
        return None

    def size_bytes(self) -> int:
        """Of all samples that are kept."""
        return sum(path.stat().st_size for path in self._files())

    def _path(self, traffic: Traffic) -> Path:
        assert self.folder is not None
        return self.folder / f"{key_of(traffic)}{SUFFIX}"

    def _files(self) -> list[Path]:
        return [] if self.folder is None else list(self.folder.glob(f"*{SUFFIX}"))

    def _make_room(self) -> None:
        by_use = sorted(self._files(), key=lambda path: path.stat().st_mtime)
        too_much = sum(path.stat().st_size for path in by_use) - LARGEST_BYTES
        for path in by_use:
            if too_much <= 0:
                break
            too_much -= path.stat().st_size
            path.unlink(missing_ok=True)


def key_of(traffic: Traffic) -> str:
    """The hash of everything that the samples of some traffic depend on."""
    scenario = traffic.scenario
    recorded = scenario.recorded
    said = {
        "scenario": _without_folders(asdict(replace(scenario, recorded=None, card={}))),
        "cases": () if recorded is None else own_cases(recorded),
        "lines": None if recorded is None or recorded.drawn is None else recorded.drawn.sha256,
        "line_choice": None if traffic.choice is None else traffic.choice.sha256,
        "seed": traffic.seed,
        "warm_up_s": traffic.warm_up_s,
        "duration_s": traffic.duration_s,
        "files": [content_hash(path) for path in files_of(scenario)],
        "source": source_version(),
        "versions": library_versions(),
    }
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:32]


def _without_folders(value: Any) -> Any:
    """Settings as JSON takes them, of paths their names alone."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, Mapping):
        return {str(key): _without_folders(one) for key, one in value.items()}
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [_without_folders(one) for one in value]
    return value
