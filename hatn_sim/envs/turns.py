"""Parts of episodes that are taken side by side: simulators drive at once, one batch predicts."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import TypeVar

from hatn_sim.envs.mind import Asked, Foreseen, foresee_all

Result = TypeVar("Result")
Turn = Generator[Asked | None, Foreseen | None, Result]
"""A part of an episode, up to its result.

It gives way (None) where it has checked what it was told and nothing has happened yet, and where
its simulator has been asked to drive on; and it asks for each prediction that it wants.
"""


def taken(turns: Sequence[Turn[Result]]) -> list[Result]:
    """The results of turns with one predictor, taken side by side.

    Where one fails the others go no farther either.
    """
    results: dict[int, Result] = {}
    answers: dict[int, Foreseen | None] = dict.fromkeys(range(len(turns)))
    try:
        while answers:
            asked: dict[int, Asked] = {}
            for k, foreseen in list(answers.items()):
                answers[k] = None
                try:
                    wanted = turns[k].send(foreseen)
                except StopIteration as done:
                    results[k] = done.value
                    del answers[k]
                    continue
                if wanted is not None:
                    asked[k] = wanted
            answers |= zip(asked, foresee_all(list(asked.values())), strict=True)
    finally:
        for turn in turns:
            turn.close()  # without effect on those that are done
    return [results[k] for k in range(len(turns))]
