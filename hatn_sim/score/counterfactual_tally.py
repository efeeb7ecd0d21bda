"""What the lines of `counterfactuals.jsonl` come to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hatn_sim.score.counterfactual import (
    HARMFUL,
    UNAVAILING,
    UNNEEDED,
    USEFUL,
    CounterfactualSettings,
)

VERDICTS = (USEFUL, UNNEEDED, HARMFUL, UNAVAILING)


@dataclass(frozen=True)
class Regrets:
    """Mean regrets over n suggestions; None where there are none."""

    n: int
    advised: float | None
    always_yield: float | None
    driver: float | None  # the cost of what the driver did, less that of the best slot
    to_best: float | None = None  # the driver's way counts among the candidates; None in older logs


@dataclass(frozen=True)
class Tally:
    """Counts over one or more runs."""

    verdicts: Mapping[str, int]  # of alerts; every verdict is there
    regrets: Regrets
    regrets_where_differs: Regrets
    lost: int  # alerts and suggestions of which a branch was lost
    to_the_end: Mapping[str, int]  # verdicts if all events of the branches count; {}: not known
    regrets_where_slots_differ: Regrets  # elsewhere it makes no difference which slot is taken
    all_collide: int  # suggestions with a collision whichever slot is taken

    @property
    def alerts(self) -> int:
        """Alerts with a verdict."""
        return sum(self.verdicts.values())

    @property
    def alerts_on_events(self) -> int:
        """Alerts with an event in the unmodified branch, or one caused by obeying."""
        return self.alerts - self.verdicts[UNNEEDED]


def tally(lines: Iterable[Mapping[str, Any]]) -> Tally:
    """Adds lines up."""
    lines = list(lines)
    whole = [line for line in lines if not line["lost"]]
    alerts = [line["verdict"] for line in whole if line["about"] == "alert"]
    to_the_end = [line["to_the_end"] for line in whole if "to_the_end" in line]
    suggestions = [line for line in whole if line["about"] == "suggestion"]
    differs = [line for line in suggestions if driver_differs(line)]
    return Tally(
        verdicts={verdict: alerts.count(verdict) for verdict in VERDICTS},
        regrets=_regrets(suggestions),
        regrets_where_differs=_regrets(differs),
        lost=len(lines) - len(whole),
        to_the_end={verdict: to_the_end.count(verdict) for verdict in VERDICTS if to_the_end},
        regrets_where_slots_differ=_regrets([line for line in suggestions if slots_differ(line)]),
        all_collide=sum(all(of["collisions"] for of in line["slots"]) for line in suggestions),
    )


def driver_differs(line: Mapping[str, Any]) -> bool:
    """Whether the driver is known to have yielded where to pass was advised, or the reverse."""
    return line["driver_action"] not in (None, line["action"])


def slots_differ(line: Mapping[str, Any]) -> bool:
    """Whether it makes any difference which slot is taken."""
    return len({slot["total"] for slot in line["slots"]}) > 1


def _regrets(lines: Sequence[Mapping[str, Any]]) -> Regrets:
    def mean(key: str) -> float | None:
        known = [line[key] for line in lines if key in line]
        return float(np.mean(known)) if known else None

    keys = ("regret", "always_yield_regret", "driver_regret", "regret_to_best")
    return Regrets(len(lines), *map(mean, keys))


def tally_words(found: Tally, settings: CounterfactualSettings) -> list[str]:
    """Lines for people, with how costs were weighed."""
    words = [f"counterfactuals: {found.alerts} alerts judged: {_counts(found.verdicts)}"]
    if found.to_the_end:
        words.append(f"counting what came later as well: {_counts(found.to_the_end)}")
    for regrets, which in (
        (found.regrets, "suggestions judged"),
        (found.regrets_where_slots_differ, "of these where it matters which slot is taken"),
        (found.regrets_where_differs, "of these where the driver did otherwise (yield or pass)"),
    ):
        words.append(f"{regrets.n} {which}{_regret_words(regrets)}")
    if found.all_collide:
        words.append(f"{found.all_collide} suggestions with a collision whichever slot is taken")
    if found.lost:
        words.append(f"{found.lost} not judged: a branch was lost")
    weights = ", ".join(f"{key} {value:g}" for key, value in asdict(settings).items())
    return [*words, f"settings of counterfactuals: {weights}"]


def _counts(verdicts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())


def _regret_words(regrets: Regrets) -> str:
    if regrets.advised is None or regrets.always_yield is None or regrets.driver is None:
        return ""
    return (
        f": mean regret {regrets.advised:.2f} "
        f"(always to yield {regrets.always_yield:.2f}, the driver {regrets.driver:.2f}"
        + (
            ""
            if regrets.to_best is None
            else f"; to the best of slots and driver {regrets.to_best:.2f}"
        )
        + ")"
    )
