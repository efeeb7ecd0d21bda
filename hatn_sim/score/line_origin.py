"""What the reference lines of recorded traffic follow, what chose among them, and whether their map
is that of the place, in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Final

LINES: Final = {"lanes": "lanes of the map", "tracks": "other recordings"}
CHOICES: Final = {"weights": "as in the weights", "tracks": "fitted to other recordings"}


def said_lines(headers: Sequence[Mapping[str, Any]]) -> str:
    """Of the runs with these headers (`run.json`); empty where none is of recorded tracks."""
    settings = [header.get("settings", {}) for header in headers]
    doubts = list(dict.fromkeys(doubt for one in settings for doubt in one.get("doubts", ())))
    told = [one for one in settings if "lines_from" in one]
    if not told:
        return "; ".join(_short(doubts))
    lines = [LINES[one["lines_from"]["source"]] for one in told]
    choices = [CHOICES[one.get("choice_from", {}).get("source", "weights")] for one in told]
    origin = f"lines: {_counted(lines)}; choice: {_counted(choices)}"
    return "; ".join((origin, *_short(doubts)))


def _short(doubts: Sequence[str]) -> list[str]:
    """The first of them, and how many more there are."""
    more = [f"{len(doubts) - 1} more doubts about the map"] if len(doubts) > 1 else []
    return [*doubts[:1], *more]


def _counted(words: Sequence[str]) -> str:
    """Each of them, with how many recordings it holds for where there are several."""
    count = Counter(words)
    if len(count) == 1:
        return words[0]
    return ", ".join(f"{word} ({n} of {len(words)} recordings)" for word, n in count.items())
