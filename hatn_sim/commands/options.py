"""Arguments that several verbs share, and the types that check them."""

from __future__ import annotations

import argparse
import math
from typing import Final

WARM_UP_S: Final = 60.0
"""For traffic to build up in a shipped scene, unless told otherwise."""


def seconds(text: str) -> float:
    """A duration in seconds, more than 0."""
    value = _number(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"expected seconds above 0, found {text!r}")
    return value


def seconds_or_none(text: str) -> float:
    """A duration in seconds, 0 or more."""
    value = _number(text)
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"expected seconds, 0 or more, found {text!r}")
    return value


def names(text: str) -> tuple[str, ...]:
    """Names parted by commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def seeds(text: str) -> tuple[int, ...]:
    """Seeds as `7`, `1-12` or `1-4,9`."""
    found: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        try:
            start = int(first)
            stop = int(last) if dash else start
        except ValueError:
            raise argparse.ArgumentTypeError(
                f"expected seeds like 7, 1-12 or 1-4,9, found {text!r}"
            ) from None
        if stop < start:
            raise argparse.ArgumentTypeError(f"expected seeds in rising order, found {part!r}")
        found += range(start, stop + 1)
    return tuple(dict.fromkeys(found))


def whole_number(text: str) -> int:
    """A whole number above 0."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number above 0, found {text!r}")
    return value


def whole_numbers(text: str) -> tuple[int, ...]:
    """Whole numbers above 0, parted by commas."""
    return tuple(whole_number(part.strip()) for part in text.split(","))


def add_traffic(parser: argparse.ArgumentParser) -> None:
    """`--density` and `--risk` of a shipped scene."""
    parser.add_argument(
        "--density", metavar="light|normal|dense", help="how much traffic (default: normal)"
    )
    parser.add_argument(
        "--risk",
        metavar="PROFILE",
        help="who drives: courteous, assertive or inattentive (default: courteous)",
    )


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a number of seconds, found {text!r}") from None
