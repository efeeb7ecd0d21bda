"""How far a training is: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from typing import Any, Final, Self

from hatn_sim.commands.bar import open_bar

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
        self._bar = open_bar(
            self._quiet,
            "{task.completed:,.0f} of {task.total:,.0f}",
            "{task.fields[words]}",
        )
        return self

    def __exit__(self, *_: object) -> None:
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
        # A stage may come again, and be of other lengths then.
        self._bar.update(self._tasks[stage], completed=done, total=total, words=words)

    def say(self, line: str) -> None:
        """A line that stays."""
        if self._quiet:
            return
        if self._bar is None:
            print(line, file=sys.stderr, flush=True)
        else:
            self._bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
