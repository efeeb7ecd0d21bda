"""Versions of what a run depends on."""

from __future__ import annotations

import platform
from importlib import metadata

PACKAGES = ("hatn-sim", "libsumo", "numpy", "scipy", "torch", "pyarrow", "safetensors", "matplotlib")


def installed() -> dict[str, str | None]:
    """Package -> version, None where it is not installed; Python itself first."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found
