"""A bar on a terminal's stderr, the same for every command that takes long."""

from __future__ import annotations

import sys
from typing import Any


def open_bar(quiet: bool, *texts: str) -> Any:
    """A started bar of rich's, to be stopped; None with `quiet` and where stderr is no terminal.

    `texts` stand behind the bar, as formats of its tasks ("{task.completed}").
    """
    if quiet or not sys.stderr.isatty():
        return None
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    bar = Progress(
        TextColumn("{task.description}", markup=False),  # names of the user's files
        BarColumn(),
        *(TextColumn(text, markup=False) for text in texts),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    bar.start()
    return bar
