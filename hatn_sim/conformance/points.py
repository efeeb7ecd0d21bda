"""One thing asked of what is plugged in, and what came of it."""

from __future__ import annotations

import inspect
import re
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import hatn_sim
from hatn_sim.errors import HatnSimError

OWN: Final = Path(hatn_sim.__file__).parent
_VARIES: Final = re.compile(r"[\d.]+|'[^']*'")
"""What differs from point to point in the words of one fault."""


@dataclass(frozen=True)
class Point:
    """What was looked at; where it failed, what was expected, found, and what to do."""

    name: str
    ok: bool
    said: str = ""
    reached: bool = True  # False: a fault that was told before hides it


class BrokenError(Exception):
    """What a check found: expected, found and what to do, in one line."""

    def __init__(self, expected: str, found: str, remedy: str) -> None:
        super().__init__(f"expected {expected}; found {found}; {remedy}")


class Told:
    """Points in turn, of which each fault is told at the first only."""

    def __init__(self) -> None:
        self._point_of: dict[str, str] = {}
        self._hides: str | None = None

    def point(self, name: str, check: Callable[[], str | None]) -> Point:
        """A check's point, with what it hides left out."""
        return self.take(Point(name, True) if self._hides else tried(name, check))

    def take(self, point: Point) -> Point:
        """A point that was tried before, in its turn now."""
        if self._hides:
            return _not_reached(point.name, self._hides)
        if point.ok:
            return point
        first = self._point_of.setdefault(_VARIES.sub("", point.said), point.name)
        return point if first == point.name else _not_reached(point.name, first)

    def first(self, name: str, check: Callable[[], str | None]) -> Point:
        """As `point`, of what all others need: if it fails, none of them is reached."""
        found = self.point(name, check)
        self._hides = None if found.ok else name
        return found


def tried(name: str, check: Callable[[], str | None]) -> Point:
    """Runs a check: what it returns is said of it; what it raises is where it failed."""
    try:
        return Point(name, True, check() or "")
    except (BrokenError, HatnSimError) as broken:
        return Point(name, False, str(broken))
    except Exception as error:  # somebody else's code may raise anything
        words = " ".join(f"{type(error).__name__}: {error}".split())
        return Point(name, False, f"expected no exception; found {words}{_place(error)}")


def check_methods(plugged_in: object, methods: dict[str, tuple[str, ...]]) -> None:
    """Raises BrokenError where a method does not take what it is given: arguments by place."""
    for name, arguments in methods.items():
        wanted = f"{name}({', '.join(arguments)})"
        method = getattr(plugged_in, name, None)
        if not callable(method):
            raise BrokenError(f"a method {wanted}", "none", "add it to the class")
        try:
            signature = inspect.signature(method)
        except (TypeError, ValueError):  # it is not Python's own
            continue
        try:
            signature.bind(*arguments)
        except TypeError:
            found = f"{name}{signature}"
            raise BrokenError(wanted, found, "give it these arguments, in this order") from None


def _not_reached(name: str, first: str) -> Point:
    return Point(name, False, f"hidden by what was found of {first!r}", reached=False)


def _place(error: Exception) -> str:
    """The last line of somebody else's code that it went through."""
    lines = traceback.extract_tb(error.__traceback__)
    theirs = [line for line in lines if not Path(line.filename).is_relative_to(OWN)]
    if not theirs:
        return "; mend what is returned or the class's methods"
    return f" ({Path(theirs[-1].filename).name}:{theirs[-1].lineno}); mend it there"
