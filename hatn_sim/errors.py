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
"""Of thousands of names not all are listed."""
TOLD_IDS = 5
"""Of vehicles, whose ids are much alike."""
CLOSE = 0.5
"""Similarity from which on a name may be meant (`difflib`)."""


def nearest(word: str, known: Iterable[str]) -> str:
    """`; did you mean 'a' or 'b'?` for the known words nearest to `word`, or the first of all."""
    names = sorted(known)
    close = difflib.get_close_matches(word, names, n=3, cutoff=CLOSE)
    if close:
        return "; did you mean " + " or ".join(repr(name) for name in close) + "?"
    more = f" and {len(names) - TOLD_NAMES:,} more" if len(names) > TOLD_NAMES else ""
    return "; known: " + ", ".join(names[:TOLD_NAMES]) + more


def nearest_vehicle(word: str, ids: Iterable[str]) -> str:
    """The same for ids of vehicles, of which only the few nearest are listed."""
    names = sorted(ids)
    if len(names) <= TOLD_IDS or difflib.get_close_matches(word, names, n=1, cutoff=CLOSE):
        return nearest(word, names)
    few = difflib.get_close_matches(word, names, n=TOLD_IDS, cutoff=0.0)
    return f"; known: {', '.join(few)} and {len(names) - TOLD_IDS:,} more"
