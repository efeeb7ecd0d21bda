"""Files that are there whole or not at all; where a disk is full, the old one stays."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from hatn_sim.errors import InputError

ROOM_OR_OUT: Final = "make room, or choose another --out"
"""Advice to whoever named the place with --out."""


def beside(path: Path) -> Path:
    """Where this process writes a file before it gives it the name `path`."""
    return path.with_name(f".{path.name}.{os.getpid()}")


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a file beside `path` and give it the name when it is done.

    Makes the folder. Where a link has the name, what it leads to is replaced; what is no file, such
    as /dev/null or a pipe, is written to as it is. Raises OSError, with nothing left behind.
    """
    if path.exists() and not path.is_file():
        write(path)
        return
    path = Path(os.path.realpath(path))
    unfinished = beside(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        write(unfinished)
        unfinished.replace(path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise


def save_whole(
    path: Path, content: bytes | memoryview | str, advice: str = "make room there"
) -> None:
    """Write a file whole, text as UTF-8. InputError, which ends in `advice`, where it cannot be."""
    data = content.encode() if isinstance(content, str) else content
    try:
        write_whole(path, lambda file: file.write_bytes(data))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written: {error.strerror or error}; {advice}"
        ) from None


def save_csv(path: Path, rows: Iterable[Iterable[object]]) -> None:
    """Write rows as CSV, None as an empty field. Raises as `save_whole`."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    save_whole(path, text.getvalue())
