"""Rows sorted into buckets: in memory while they are few, beyond that in temporary files."""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hatn_sim.datatypes import IntArray
from hatn_sim.errors import HatnSimError

MEMORY_BYTES: Final = 96 << 20
"""Rows kept in memory before they go to files."""

Rows = NDArray[Any]


class Spool:
    """Takes rows in any order and hands them out bucket by bucket, in each as they came.

    To be used as a context, which takes its files away at the end.
    """

    def __init__(self, dtype: np.dtype[Any], memory_bytes: int | None = None) -> None:
        self._dtype = dtype
        self._limit_bytes = MEMORY_BYTES if memory_bytes is None else memory_bytes
        self._bytes = 0
        self._chunks: dict[int, list[Rows]] = {}
        self._buckets: set[int] = set()
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    @property
    def buckets(self) -> list[int]:
        """The buckets that have rows, in rising order."""
        return sorted(self._buckets)

    def add(self, buckets: IntArray, rows: Rows) -> None:
        """Rows [R] and the bucket of each. Raises HatnSimError where the disk is full."""
        order = np.argsort(buckets, kind="stable")
        buckets, rows = buckets[order], rows[order]
        starts = np.concatenate([[0], np.flatnonzero(np.diff(buckets)) + 1])
        for start, chunk in zip(starts, np.split(rows, starts[1:]), strict=True):
            self._chunks.setdefault(int(buckets[start]), []).append(chunk)
        self._buckets.update(self._chunks)
        self._bytes += rows.nbytes
        if self._bytes > self._limit_bytes:
            self._to_files()

    def read(self, bucket: int) -> Rows:
        """The rows of a bucket."""
        parts = self._chunks.get(bucket, [])
        if self._folder is not None and self._path(bucket).is_file():
            parts = [np.fromfile(self._path(bucket), dtype=self._dtype), *parts]
        return np.concatenate([np.zeros(0, dtype=self._dtype), *parts])

    def _path(self, bucket: int) -> Path:
        assert self._folder is not None
        return Path(self._folder.name) / f"{bucket}.rows"

    def _to_files(self) -> None:
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="hatn-sim-")
        try:
            for bucket, chunks in self._chunks.items():
                with self._path(bucket).open("ab") as file:
                    for chunk in chunks:
                        file.write(chunk.tobytes())
        except OSError as error:
            raise HatnSimError(
                f"{self._folder.name}: tracks cannot be sorted there ({error.strerror}); make "
                "room, or name another place in the environment variable TMPDIR"
            ) from error
        self._chunks.clear()
        self._bytes = 0

    def __enter__(self) -> Spool:
        return self

    def __exit__(
        self,
        _type: type[BaseException] | None,
        _value: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        self._chunks.clear()
        if self._folder is not None:
            self._folder.cleanup()
