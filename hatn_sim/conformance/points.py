"""One thing asked of what is plugged in, and what came of it."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hatn_sim.errors import HatnSimError


@dataclass(frozen=True)
class Point:
    """What was looked at; where it failed, what was expected, found, and what to do."""

    name: str
    ok: bool
    said: str = ""


class BrokenError(Exception):
    """What a check found: expected, found and what to do, in one line."""

    def __init__(self, expected: str, found: str, remedy: str) -> None:
        super().__init__(f"expected {expected}; found {found}; {remedy}")


def point(name: str, check: Callable[[], str | None]) -> Point:
    """Runs a check: what it returns is said of it; what it raises is where it failed."""
    try:
        return Point(name, True, check() or "")
    except (BrokenError, HatnSimError) as broken:
        return Point(name, False, str(broken))
    except Exception as error:  # somebody else's code may raise anything
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(last.filename).name}:{last.lineno}"
        said = " ".join(f"{type(error).__name__}: {error}".split())
        return Point(name, False, f"expected no exception; found {said} ({where}); mend it there")
