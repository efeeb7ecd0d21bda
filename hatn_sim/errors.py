"""Errors a user can act on: one line that says where, what was expected and found, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class HatnSimError(Exception):
    """Base of the errors that end a command with one line on stderr."""

    exit_code = 1


class InputError(HatnSimError):
    """Something handed in (a file, a key, an argument) is wrong. Exit code 2."""

    exit_code = 2


class RunningError(InputError, TypeError):
    """What has a process of its own cannot be copied or pickled."""


class SimulatorError(HatnSimError):
    """The simulator failed in the middle of a run. Exit code 1."""


class WindowClosedError(HatnSimError):
    """The user has closed the simulator's window in the middle of a run."""


TOLD_NAMES = 40
"""Of a recording's thousands of vehicles not all are listed."""


def nearest(word: str, known: Iterable[str]) -> str:
    """`; did you mean 'a' or 'b'?` for the known words nearest to `word`, or the first of all."""
    names = sorted(known)
    close = difflib.get_close_matches(word, names, n=3, cutoff=0.5)
    if close:
        return "; did you mean " + " or ".join(repr(name) for name in close) + "?"
    more = f" and {len(names) - TOLD_NAMES:,} more" if len(names) > TOLD_NAMES else ""
    return "; known: " + ", ".join(names[:TOLD_NAMES]) + more
