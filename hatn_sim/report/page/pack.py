"""Whole numbers as few bytes: differences, zigzag varints, raw deflate, base64."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hatn_sim.datatypes import BoolArray, IntArray

BITS: Final = 7
"""Of a number in each byte; the eighth says that another byte follows."""
MOST_BYTES: Final = 5


def first_differences(values: IntArray, starts: BoolArray) -> IntArray:
    """[R] each value less the one before it; where a stretch starts, the value itself."""
    out = values.copy()
    out[1:] -= np.where(starts[1:], 0, values[:-1])
    return out


def second_differences(values: IntArray, starts: BoolArray) -> IntArray:
    """[R] differences of `first_differences`, from the third value of each stretch on."""
    first = first_differences(values, starts)
    second_or_first = starts.copy()
    second_or_first[1:] |= starts[:-1]
    return first_differences(first, second_or_first)


def varints(columns: Sequence[IntArray]) -> bytes:
    """Columns one after the other; numbers must be within ±2**31."""
    if not columns:
        return b""
    numbers = np.concatenate(columns).astype(np.int64)
    zigzag = ((numbers << 1) ^ (numbers >> 63)).astype(np.uint64)
    shifts = np.arange(MOST_BYTES, dtype=np.uint64) * np.uint64(BITS)
    parts = zigzag[:, None] >> shifts
    used = parts > 0
    used[:, 0] = True
    more = np.zeros_like(used)
    more[:, :-1] = used[:, 1:]
    octets: NDArray[np.uint8] = (parts & np.uint64(127)).astype(np.uint8) | (more * np.uint8(128))
    return octets[used].tobytes()


def packed(data: bytes) -> str:
    """Raw deflate in base64."""
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    return base64.b64encode(deflate.compress(data) + deflate.flush()).decode("ascii")


def packed_json(content: Any) -> str:
    """JSON, deflated and in base64: nothing of it can be taken for a part of the page."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False, ensure_ascii=True)
    return packed(text.encode("ascii"))
