"""Where what a command makes goes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def free_or_own_folder(out: Path | None, name: str, files: Sequence[str] = ()) -> Path:
    """`out`, or runs/NAME-1, -2 ..., whichever is free; not made yet.

    Raises InputError where a file is in its place, or one of `files` in it.
    """
    from hatn_sim.errors import InputError

    number = 1
    while out is None:
        folder = Path("runs") / f"{name}-{number}"
        out = None if folder.exists() else folder
        number += 1
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: expected a folder, found a file; choose another --out")
    for one in files:
        if (out / one).exists():
            raise InputError(f"{out / one}: exists already; move it away or choose another --out")
    return out
