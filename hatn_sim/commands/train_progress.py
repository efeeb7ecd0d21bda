"""How far a training is: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Any, Final, Self

EVERY_S: Final = 0.2
PLAIN_EVERY_S: Final = 20.0


class TrainProgress:
    """Is a `learn.watch.Watch`; silent with `quiet`."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._bar: Any = None
        self._tasks: dict[str, Any] = {}
        self._shown = 0.0

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import (
                BarColumn,
                MofNCompleteColumn,
                Progress,
                TextColumn,
                TimeRemainingColumn,
            )

            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                TextColumn("{task.fields[words]}"),
                console=Console(stderr=True),
                transient=True,
            )
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def step(self, stage: str, done: int, total: int, words: str) -> None:
        """`done` of `total` steps of a stage; shows itself a few times a second."""
        now = time.monotonic()
        is_new = stage not in self._tasks
        often = EVERY_S if self._bar is not None else PLAIN_EVERY_S
        if self._quiet or (now - self._shown < often and done != total and not is_new):
            return
        self._shown = now
        if self._bar is None:
            self._tasks[stage] = None
            print(f"{stage}: {done:,} of {total:,}, {words}", file=sys.stderr, flush=True)
            return
        if is_new:
            self._tasks[stage] = self._bar.add_task(stage, total=total, words=words)
        self._bar.update(self._tasks[stage], completed=done, words=words)

    def say(self, line: str) -> None:
        """A line that stays."""
        if self._quiet:
            return
        if self._bar is None:
            print(line, file=sys.stderr, flush=True)
        else:
            self._bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
