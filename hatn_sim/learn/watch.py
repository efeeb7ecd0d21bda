"""Who is told how far a training is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Watch(Protocol):
    """Told of steps while they are done, and of lines worth keeping."""

    def step(self, stage: str, done: int, total: int, words: str) -> None:
        """`done` of `total` steps of a stage; called often."""
        ...

    def say(self, line: str) -> None: ...


def counted(tell: Callable[[str], object]) -> Callable[[int, int], None]:
    """Takes the number of a piece of traffic and its steps; tells how many all have."""
    steps: dict[int, int] = {}

    def show(number: int, done: int) -> None:
        steps[number] = done
        tell(f"{sum(steps.values()):,} steps played")

    return show


class Nobody:
    """A `Watch` that is told in vain."""

    def step(self, stage: str, done: int, total: int, words: str) -> None:
        pass

    def say(self, line: str) -> None:
        pass
