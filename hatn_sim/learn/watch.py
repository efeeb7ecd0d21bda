"""Who is told how far a training is."""

from __future__ import annotations

from typing import Protocol


class Watch(Protocol):
    """Told of steps while they are done, and of lines worth keeping."""

    def step(self, stage: str, done: int, total: int, words: str) -> None:
        """`done` of `total` steps of a stage; called often."""
        ...

    def say(self, line: str) -> None: ...


class Nobody:
    """A `Watch` that is told in vain."""

    def step(self, stage: str, done: int, total: int, words: str) -> None:
        pass

    def say(self, line: str) -> None:
        pass
