"""Where this system keeps what can be made again, and the versions of what makes it."""

from __future__ import annotations

import hashlib
import os
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Final

from hatn_sim.content import content_hash
from hatn_sim.resources import PACKAGE_DIR

SAMPLES: Final = "samples"
LINES: Final = "lines"
"""Drawn from tracks, and the choices among them."""
NO_PART_IN_SAMPLES: Final = (
    "assist",
    "commands",
    "evaluation",
    "predictors",
    "report",
    "score",
    "whole_file",
    "bench",
    "cli",
    "content",
    "kept",
    "hatn/",
    "learn/",
    "_data/",
)
"""Beginnings of the package's files whose change leaves samples as they are ..."""
BUT: Final = ("hatn/inputs", "hatn/weights/line_choice", "learn/dataset", "learn/sources")
"""... and those among them that have a part after all."""
DEPENDS_ON: Final = ("numpy", "scipy", "libsumo", "highway-env", "pyproj")
"""Libraries that have a part in whatever is kept."""


def folder_for(kind: str, cache_option: str | None = None) -> Path | None:
    """The folder for what is kept of a kind: a user's --cache, None for "none", or the system's."""
    if cache_option is not None:
        return None if cache_option == "none" else Path(cache_option)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "hatn_sim" / kind


def source_version(everything: bool = False) -> str:
    """The hash of the source of all that has a part in making samples, or of `everything`."""
    return source_without(()) if everything else source_without(NO_PART_IN_SAMPLES, BUT)


@cache
def source_without(left_out: tuple[str, ...], but: tuple[str, ...] = ()) -> str:
    """The hash of the package's files, weights and all, save those that begin with `left_out`.

    Those that begin with `but` have a part all the same.
    """
    total = hashlib.sha256()
    for path in sorted(PACKAGE_DIR.rglob("*")):
        name = path.relative_to(PACKAGE_DIR).as_posix()
        ours = name.startswith(but) or not name.startswith(left_out)
        if ours and path.is_file() and "__pycache__" not in name:
            total.update(f"{name} {content_hash(path)}\n".encode())
    return total.hexdigest()


@cache
def library_versions() -> dict[str, str | None]:
    """The version of each of `DEPENDS_ON`; None: it is not installed."""
    return {name: _version(name) for name in DEPENDS_ON}


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
