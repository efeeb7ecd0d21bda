"""Where what a command makes goes."""

from __future__ import annotations

import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hatn_sim.errors import HatnSimError, InputError


def free_or_own_folder(out: Path | None, name: str, files: Sequence[str] = ()) -> Path:
    """`out`, or runs/NAME-1, -2 ..., whichever is free; not made yet.

    Raises InputError where a file is in its place, or one of `files` in it.
    """
    out = out or free_folder(name)
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: expected a folder, found a file; choose another --out")
    for one in files:
        if (out / one).exists():
            raise InputError(f"{out / one}: exists already; move it away or choose another --out")
    return out


def free_folder(name: str) -> Path:
    """The first free one of runs/NAME-1, -2 ...; not made yet."""
    number = 1
    while (folder := Path("runs") / f"{name}-{number}").exists():
        number += 1
    return folder


@contextmanager
def finished_runs_stay(out: Path) -> Generator[None, None, None]:
    """Whoever is stopped while many runs are made is told that the finished ones are kept."""
    stays = f"finished runs stay in {out}, and the same command with --out {out} uses them"
    try:
        yield
    except HatnSimError as error:
        raise type(error)(f"{error}; {stays}" if out.exists() else str(error)) from None
    except KeyboardInterrupt:
        if out.exists():
            print(f"hatn-sim: {stays}", file=sys.stderr)
        raise
