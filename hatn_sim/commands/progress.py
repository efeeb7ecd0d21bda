"""A progress bar with the rate against real time, on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Any, Self

from hatn_sim.commands.bar import open_bar
from hatn_sim.commands.rate_text import rate_text


class Progress:
    """Shows how far a run is; silent with `quiet`, plain lines where stderr is no terminal.

    `total` is None where nobody knows how long it will be.
    """

    def __init__(self, name: str, total: int | None, dt_s: float, quiet: bool) -> None:
        self._name, self._total, self._dt_s, self._quiet = name, total, dt_s, quiet
        self._of = "" if total is None else f" of {total}"
        self._started = self._shown = time.monotonic()
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Self:
        steps = "{task.completed:.0f}" + self._of + " steps"
        self._bar = open_bar(self._quiet, steps, "{task.fields[rate]}")
        if self._bar is not None:
            self._task = self._bar.add_task(self._name, total=self._total, rate="")
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def show(self, done: int, vehicles: int) -> None:
        """Called at every step; shows itself a few times a second."""
        now = time.monotonic()
        if self._quiet or (now - self._shown < 0.2 and done != self._total):
            return
        times = done * self._dt_s / max(now - self._started, 1e-3)
        rate = f"{vehicles} vehicles now, {rate_text(times)}x real time"
        if self._bar is not None:
            self._shown = now
            self._bar.update(self._task, completed=done, rate=rate)
        elif now - self._shown > 10.0 or done == self._total:
            self._shown = now
            print(f"{self._name}: {done}{self._of} steps, {rate}", file=sys.stderr)


class RunsProgress:
    """Shows how far many runs are that are made side by side.

    `frames` are how many each of them is to have, None where nobody knows.
    """

    def __init__(
        self, labels: Sequence[str], frames: Sequence[int | None], dt_s: float, quiet: bool
    ) -> None:
        self._labels, self._frames, self._dt_s, self._quiet = labels, frames, dt_s, quiet
        self._started: dict[int, float] = {}
        self._tasks: dict[int, Any] = {}
        self._done = 0
        self._bar: Any = None
        self._all: Any = None

    def __enter__(self) -> Self:
        self._bar = open_bar(self._quiet, "{task.fields[said]}")
        if self._bar is not None:
            self._all = self._bar.add_task("runs", total=len(self._labels), said="")
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def show(self, number: int, steps: int) -> None:
        """A run has come to so many steps."""
        now = time.monotonic()
        started = self._started.setdefault(number, now)
        if self._bar is None:
            return
        if number not in self._tasks:
            total = self._frames[number]
            self._tasks[number] = self._bar.add_task(self._labels[number], total=total, said="")
        times = steps * self._dt_s / max(now - started, 1e-3)
        said = f"{steps} steps, {rate_text(times)}x real time"
        self._bar.update(self._tasks[number], completed=steps, said=said)

    def finish(self, number: int, steps: int) -> None:
        """A run is done."""
        self._done += 1
        said = f"{self._done} of {len(self._labels)}"
        if self._bar is not None:
            if number in self._tasks:
                self._bar.remove_task(self._tasks.pop(number))
            self._bar.update(self._all, completed=self._done, said=said)
        elif not self._quiet:
            print(f"{self._labels[number]}: {steps} steps, {said} runs", file=sys.stderr)
