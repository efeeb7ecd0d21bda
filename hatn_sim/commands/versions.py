"""Versions of what a run depends on."""

from __future__ import annotations

import platform
from importlib import metadata

import hatn_sim

PACKAGES = (
    "libsumo",
    "highway-env",
    "numpy",
    "scipy",
    "pyproj",
    "torch",
    "pyarrow",
    "safetensors",
    "matplotlib",
)


def installed() -> dict[str, str | None]:
    """Package -> version, None where it is not installed; Python and hatn-sim itself first."""
    found: dict[str, str | None] = {
        "python": platform.python_version(),
        "hatn-sim": hatn_sim.__version__,
    }
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found
