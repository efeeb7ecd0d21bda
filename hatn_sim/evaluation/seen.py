"""Traffic that weights were trained or tuned on, by what their card says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from hatn_sim.config import Scenario
from hatn_sim.recordings.each import own_cases, own_files

LEARNT: Final = ("train", "tune")


def was_seen(card: Mapping[str, Any], scenario: Scenario, seed: int | None) -> bool:
    """Whether a card's split names this traffic: the seed of a scene, or a recording of a site.

    So may the split of the weights that these began with. A card knows names only: a recording
    that was given another one is not found.
    """
    if (start := card.get("start")) is not None and was_seen(start, scenario, seed):
        return True
    split: Mapping[str, Any] = card.get("split", {})
    entries = [entry for part in LEARNT for entry in split.get(part, ())]
    if scenario.recorded is None:
        return any(
            entry.get("scene") == scenario.name and seed in entry.get("seeds", ())
            for entry in entries
        )
    files = [path.resolve().name for path in own_files(scenario.recorded)]
    cases = own_cases(scenario.recorded)
    return any(
        _is_of(recording, files, cases)
        for entry in entries
        if entry.get("site") == scenario.name
        for recording in entry.get("recordings", ())
    )


def _is_of(recording: Any, files: list[str], cases: tuple[str, ...]) -> bool:
    """Whether an entry of a card, file names or some cases of files, is of these."""
    if isinstance(recording, str):
        return recording == ", ".join(files)
    same = recording["files"] == files
    return same and (not cases or not set(cases).isdisjoint(recording["cases"]))
