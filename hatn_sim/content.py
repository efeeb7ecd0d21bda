"""Files by what is in them."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from hatn_sim.errors import InputError


def content_hash(path: Path) -> str:
    """SHA-256 of a file's content, read once as long as it is not written again.

    Raises InputError where it cannot be read.
    """
    try:
        stat = path.stat()
        return _hash(path.resolve(), stat.st_size, stat.st_mtime_ns)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; mend or remove it") from None


@cache
def _hash(path: Path, size_bytes: int, mtime_ns: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
