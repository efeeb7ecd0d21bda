"""The choice of lines where a recording will be scored, fitted to other recordings of the place.

Labels of the choice are hindsight of tracks alone (METHOD section 1.1), so the recordings that drew
the lines of another can also teach which of these lines drivers take. The recording itself has no
part in it: neither in the lines nor in the choice.

Whether it is taken is judged more kindly than on a recording that is scored: the half held out from
the fit has helped to draw the lines that it is judged on, so one of them fits its drivers better
than it fits strangers. What it is compared with, the choice of the weights, is judged on the same
lines by the same drivers; so the errors of both are too small, and the comparison is fair but for a
fit that gains from lines drawn too near. Lines drawn anew without each half would cost as much
again, and could be too few to drive on.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch

from hatn_sim.config import Scenario
from hatn_sim.errors import InputError
from hatn_sim.evaluation.pool import Teller, work_on
from hatn_sim.kept import source_version
from hatn_sim.learn.cache import key_of
from hatn_sim.learn.line_choice import choice_figures, fit_line_choice, right_candidates
from hatn_sim.learn.line_samples import ChoiceSamples, choice_samples, joined
from hatn_sim.learn.sources import named, played
from hatn_sim.learn.split import Traffic
from hatn_sim.learn.watch import Watch, counted
from hatn_sim.line_choice import DIGITS, LineChoice
from hatn_sim.whole_file import save_whole

LEAST: Final = 2
"""Recordings without which none can be held out from the fit."""
MOST: Final = 4
"""Recordings that are fitted to; further ones would not make the choice better."""
MOST_S: Final = 300.0
"""What of each is looked at."""
EVERY_FRAMES: Final = 10
"""Choices a second apart: nearer ones teach little more."""
FEWEST_CASES: Final = 40
"""That tell, in each half; with fewer nobody knows whether the fitted choice is better."""


class HeldOut(NamedTuple):
    """How well a choice does on cases that it was not fitted to."""

    n: int
    wrong: float  # share, see `ChoiceFigures`
    log_loss: float  # nats

    def __str__(self) -> str:
        return f"wrong {100.0 * self.wrong:.1f} %, log loss {self.log_loss:.3f}"


@dataclass(frozen=True, eq=False)
class OthersChoice:
    """What came of fitting to other recordings."""

    choice: LineChoice | None  # None: on held-out recordings it is not better than what was there
    recordings: tuple[str, ...]  # fitted to
    cases: int
    fitted: HeldOut | None = None  # None: too few cases to tell
    before: HeldOut | None = None  # of what it began with

    def about(self) -> dict[str, Any]:
        """What is said of it in `run.json`."""
        held_out = [None if one is None else one._asdict() for one in (self.fitted, self.before)]
        return {
            "source": "weights" if self.choice is None else "tracks",
            "recordings": list(self.recordings),
            "cases": self.cases,
            "held_out": dict(zip(("fitted", "weights"), held_out, strict=True)),
            "sha256": None if self.choice is None else self.choice.sha256,
        }


def choices_of_others(
    scenes: Mapping[str, Scenario],
    starts: Sequence[LineChoice],
    least: int,
    keep: Path | None,
    workers: int,
    watch: Watch,
) -> dict[str, OthersChoice]:
    """A choice of lines for each scene whose lines at least `least` other recordings drew.

    Scenes with the same lines from the same recordings share one. It begins with the first of
    `starts`, is drawn back to it, and must be better than all of them: fitted to half of the
    recordings, on the other half, both ways. The lines are those that these recordings drew, as
    they are where the choice is used.

    Args:
        scenes: recorded tracks, one recording each, by name.
        starts: the choices that are used otherwise.
        least: at least `LEAST`.
        keep: folder where what was found is kept and found again; None: nowhere.
        workers: processes; the result is the same for any number.
        watch: is told of the samples, and of what came of each fit.

    Raises:
        HatnSimError: in one line that names the recording at fault.
    """
    # Lines may be the same though others drew them: who is fitted to must be the same as well.
    groups: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for name, scene in scenes.items():
        drawn = None if scene.recorded is None else scene.recorded.drawn
        if drawn is not None and len(drawn.recordings) >= max(least, LEAST):
            groups.setdefault((drawn.sha256, drawn.recordings), []).append(name)
    jobs = {name: _pieces(scenes[name], starts[0]) for name, *_ in groups.values()}
    files = {name: _file(keep, pieces, starts) for name, pieces in jobs.items()}
    found = {name: known for name in jobs if (known := _read(files[name])) is not None}
    missing = [name for name in jobs if name not in found]
    samples = _gather([one for name in missing for one in jobs[name]], workers, watch)
    fits = [_Fit(tuple(next(samples) for _ in jobs[name]), tuple(starts)) for name in missing]
    for number, made in work_on(_fit, fits, workers, lambda *_: None):
        name = missing[number]
        found[name] = replace(made, recordings=tuple(_recording(one) for one in jobs[name]))
        if (trouble := _write(files[name], found[name])) is not None:
            watch.say(trouble)
    shared = {name: found[group[0]] for group in groups.values() for name in group}
    for first, *more in groups.values():
        watch.say(_said([first, *more], found[first]))
    return {name: shared[name] for name in scenes if name in shared}


def _pieces(scene: Scenario, start: LineChoice) -> list[Traffic]:
    """Some of the recordings that drew the lines of a scene, on these lines."""
    source = scene.recorded
    assert source is not None and source.drawn is not None
    names = source.drawn.recordings
    spread = np.linspace(0, len(names) - 1, min(MOST, len(names))).round().astype(int)
    return [
        Traffic(
            name=f"{scene.name}, {name}",
            scenario=replace(scene, recorded=replace(source, recordings=(name,))),
            seed=0,
            warm_up_s=0.0,
            duration_s=MOST_S,
            sources=(),
            choice=start,
        )
        for name in (names[k] for k in spread)
    ]


def _recording(traffic: Traffic) -> str:
    assert traffic.scenario.recorded is not None
    return traffic.scenario.recorded.recordings[0]


def _gather(traffic: Sequence[Traffic], workers: int, watch: Watch) -> Any:
    """The samples of each piece, in order."""
    found: dict[int, ChoiceSamples] = {}
    tell = partial(watch.step, "choices of lines", total=len(traffic))
    show = counted(lambda words: tell(done=len(found), words=words))
    for number, samples in work_on(_cut, traffic, workers, show):
        found[number] = samples
        tell(done=len(found), words=f"{sum(map(len, found.values())):,} choices")
    return iter([found[number] for number in range(len(traffic))])


def _cut(traffic: Traffic, teller: Teller) -> ChoiceSamples:
    assert traffic.choice is not None
    with named(traffic), played(traffic, teller.tell) as (simulator, frames):
        return choice_samples(simulator.road, frames, traffic.choice, EVERY_FRAMES)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A choice that is wanted; a process of its own can fit it."""

    parts: tuple[ChoiceSamples, ...]  # one for each recording
    starts: tuple[LineChoice, ...]


def _fit(wanted: _Fit, _: Teller) -> OthersChoice:
    """The names of the recordings are for the caller to fill in."""
    torch.set_num_threads(1)  # sums are the same in any process
    parts, (start, *_others) = wanted.parts, wanted.starts
    cases = sum(map(len, parts))
    halves = joined(parts[::2]), joined(parts[1::2])
    if any(right_candidates(half)[1].sum() < FEWEST_CASES for half in halves):
        return OthersChoice(None, (), cases)
    crossed = [fit_line_choice(half, start) for half in reversed(halves)]
    fitted = _on_halves(halves, crossed)
    before = [_on_halves(halves, (one, one)) for one in wanted.starts]
    taken = all(fitted.log_loss < b.log_loss and fitted.wrong <= b.wrong for b in before)
    choice = _rounded(fit_line_choice(joined(parts), start)) if taken else None
    return OthersChoice(choice, (), cases, fitted, before[0])


def _on_halves(halves: Sequence[ChoiceSamples], choices: Sequence[LineChoice]) -> HeldOut:
    figures = [choice_figures(*pair) for pair in zip(halves, choices, strict=True)]
    count = sum(one.n for one in figures)
    wrong = sum(one.n * one.wrong for one in figures) / count
    log_loss = sum(one.n * one.log_loss for one in figures) / count
    return HeldOut(count, round(wrong, 4), round(log_loss, 4))


def _rounded(choice: LineChoice) -> LineChoice:
    """As it is read from a file."""
    arrays = choice.to_arrays().items()
    return LineChoice.from_arrays({name: np.round(one, DIGITS) for name, one in arrays})


def _said(names: Sequence[str], found: OthersChoice) -> str:
    where = f"choice of lines for {', '.join(names)}"
    if found.fitted is None or found.before is None:
        return f"{where}: as in the weights, found {found.cases:,} choices, too few to fit one"
    taken = "as in the weights" if found.choice is None else "fitted to other recordings"
    return (
        f"{where}: {taken}; {', '.join(found.recordings)}, held out in halves, with the fitted "
        f"one: {found.fitted}; with that of the weights: {found.before} (n {found.fitted.n:,})"
    )


def _file(
    keep: Path | None, pieces: Sequence[Traffic], starts: Sequence[LineChoice]
) -> Path | None:
    """Named by a hash of all that the choice depends on, so nothing in there is out of date."""
    if keep is None:
        return None
    said = [source_version(everything=True), *map(key_of, pieces), *(one.sha256 for one in starts)]
    return keep / f"{hashlib.sha256(' '.join(said).encode()).hexdigest()[:32]}.json"


def _read(path: Path | None) -> OthersChoice | None:
    """What was kept; None where nothing is, or nothing whole."""
    if path is None or not path.is_file():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        about, weights = content["about"], content["weights"]
        fitted, before = (
            None if (one := about["held_out"][name]) is None else HeldOut(**one)
            for name in ("fitted", "weights")
        )
        choice = None if weights is None else LineChoice.from_arrays(weights)
        return OthersChoice(choice, tuple(about["recordings"]), about["cases"], fitted, before)
    except (OSError, ValueError, KeyError, TypeError, InputError):
        return None


def _write(path: Path | None, found: OthersChoice) -> str | None:
    """Keep what was found; a line for the user where it could not be."""
    if path is None:
        return None
    choice = found.choice
    weights = None
    if choice is not None:
        weights = {name: one.tolist() for name, one in choice.to_arrays().items()}
    text = json.dumps({"about": found.about(), "weights": weights}, indent=1) + "\n"
    try:
        save_whole(path, text)
    except InputError as error:
        return f"{error}; until then choices of lines are not kept"
    return None
