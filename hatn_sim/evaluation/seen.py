"""Traffic that weights were trained or tuned on, by what their card says."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from hatn_sim.config import Scenario
from hatn_sim.content import content_hash
from hatn_sim.datatypes import Predictor, Score
from hatn_sim.recordings.each import each_recording, own_cases, own_files

LEARNT: Final = ("train", "tune")


@dataclass(frozen=True, eq=False)
class Judged:
    """A piece of traffic that predictors are judged on."""

    label: str
    scenario: Scenario
    seed: int | None  # None: of recorded traffic


def pieces_of(scenario: Scenario, seed: int | None) -> list[Judged]:
    """A run of a scene, taken apart into its recordings."""
    if scenario.recorded is None:
        return [Judged(scenario.name, scenario, seed)]
    return [Judged(name, one, None) for name, one in each_recording(scenario, "lanes").items()]


def said_of_seen(
    predictors: Iterable[Predictor], traffic: Sequence[Judged]
) -> dict[tuple[str, str], str]:
    """What is to be said of each network that is judged on what it learnt from.

    By the names of predictor and scene.
    """
    said: dict[tuple[str, str], str] = {}
    for predictor in predictors:
        card = getattr(getattr(predictor, "weights", None), "card", {})
        for scene in dict.fromkeys(one.scenario.name for one in traffic):
            runs = [one for one in traffic if one.scenario.name == scene]
            seen = [one.label for one in runs if was_seen(card, one.scenario, one.seed)]
            if seen:
                what = "recordings" if runs[0].scenario.recorded is not None else "runs"
                which = seen[0] if len(seen) == 1 else f"{seen[0]} ..."
                said[predictor.name, scene] = (
                    f"was trained or tuned on {len(seen)} of {len(runs)} {what} "
                    f"({which}): its errors there are too small"
                )
    return said


def with_seen(scores: Iterable[Score], said: Mapping[tuple[str, str], str]) -> list[Score]:
    """The scores, those of `said_of_seen` with what is to be said of them."""
    return [
        # Who is given the routes has another name in scores.
        replace(score, seen=said.get((score.predictor.removesuffix("+route"), score.scene), ""))
        for score in scores
    ]


def was_seen(card: Mapping[str, Any], scenario: Scenario, seed: int | None) -> bool:
    """Whether a card's split names this traffic: the seed of a scene, or a recording of a site.

    So may the split of the weights that these began with. A recording is known by its name at its
    site, and by its content whatever it is called; cards without hashes know names only.
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
    files = own_files(scenario.recorded)
    names = [path.resolve().name for path in files]
    cases = own_cases(scenario.recorded)
    known = {digest for entry in entries for digest in entry.get("sha256", ())}
    if known and files[0].is_file() and content_hash(files[0]) in known:
        return True
    return any(
        _is_of(recording, names, cases)
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
