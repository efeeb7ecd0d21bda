"""Where tables are printed."""

from __future__ import annotations

import sys

from rich.console import Console

WIDTH = 100
"""Of tables that go to a file or a pipe; on a terminal they are as wide as it is."""


def make_console() -> Console:
    """A console on standard output that paints nothing of its own accord.

    Names of files and scenes are the user's: what looks like markup in them is none.
    """
    return Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else WIDTH)
