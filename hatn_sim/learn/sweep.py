"""`hatn-sim train --sweep`: settings tried out on the tuning traffic, a short training each.

    draws = 20                  # at random; without it: every combination
    seed = 0                    # of the draws
    judged_by = "ade_3s_m"      # or another figure that is better the less it is
    [sgn]
    width = [48, 64, 96]        # one of these ...
    [edn_fit]
    learning_rate = { from = 5e-4, to = 5e-3 }      # ... or from a span, evenly in its logarithm
    [sgn_fit]
    epochs = [5]

What is done is a line of JSON in a file; a sweep that was stopped goes on behind the last of them.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from hatn_sim.errors import HatnSimError, InputError, nearest
from hatn_sim.hatn.sgn import SemanticGraphNetwork
from hatn_sim.learn.fit import Figures, LossError
from hatn_sim.learn.map_doubts import with_doubts
from hatn_sim.learn.settings import SECTIONS, TrainingSettings, changed, check_key
from hatn_sim.learn.split_file import read_toml
from hatn_sim.learn.train import (
    TrainingPlan,
    begin_work,
    choosing,
    collect,
    described,
    fit_edn,
    fit_lines,
    fit_sgn,
)
from hatn_sim.learn.watch import Watch

KEYS: Final = ("draws", "seed", "judged_by")
FIGURES: Final = ("ade_3s_m", "ade_0s3_m", "goal_error_m")
MOST_TRIALS: Final = 10_000
Values = Mapping[str, Any]


@dataclass(frozen=True)
class Span:
    """Numbers from which one is drawn, evenly in its logarithm."""

    low: float
    high: float


@dataclass(frozen=True)
class Sweep:
    """Settings by keys like `sgn.width`, with what each may be."""

    choices: Mapping[str, tuple[Any, ...] | Span]
    draws: int | None = None  # None: every combination
    seed: int = 0
    judged_by: str = "ade_3s_m"


@dataclass(frozen=True)
class Trial:
    """Settings that were tried, and their figures on the tuning traffic; empty: it was lost."""

    values: Values
    figures: Mapping[str, float]
    note: str = ""


def read_sweep(path: Path, basis: TrainingSettings) -> Sweep:
    """The sweep that a file describes.

    Raises InputError for keys that there are not, with the nearest name, and for values that the
    settings cannot have.
    """
    content = read_toml(path)
    for key in content:
        if key not in (*KEYS, *SECTIONS):
            raise InputError(f"{path}: unknown key {key!r}{nearest(key, (*KEYS, *SECTIONS))}")
    draws, seed = content.get("draws"), content.get("seed", 0)
    for key, value, least in (("draws", draws, 1), ("seed", seed, 0)):
        if value is not None and (type(value) is not int or value < least):
            raise InputError(
                f"{path}: {key}: expected a whole number from {least}, found {value!r}"
            )
    judged_by = content.get("judged_by", FIGURES[0])
    if judged_by not in FIGURES:
        raise InputError(
            f"{path}: judged_by: unknown {judged_by!r}{nearest(str(judged_by), FIGURES)}"
        )
    choices: dict[str, tuple[Any, ...] | Span] = {}
    for section in SECTIONS:
        table = content.get(section, {})
        if not isinstance(table, dict):
            raise InputError(f"{path}: {section}: expected a table [{section}], found {table!r}")
        for name, said in table.items():
            key = f"{section}.{name}"
            check_key(str(path), key)
            choices[key] = choice = _choice(f"{path}: {key}", said, draws is not None)
            ends = (choice.low, choice.high) if isinstance(choice, Span) else choice
            for value in ends:
                changed(basis, str(path), {key: value})
    if not choices:
        raise InputError(f"{path}: expected settings to try in {', '.join(SECTIONS)}, found none")
    return Sweep(choices, draws, seed, judged_by)


def trials(sweep: Sweep) -> Iterator[Values]:
    """The settings to try, always in the same order."""
    if sweep.draws is None:
        lists = [value for value in sweep.choices.values() if not isinstance(value, Span)]
        for values in itertools.product(*lists):
            yield dict(zip(sweep.choices, values, strict=True))
        return
    random = np.random.default_rng(sweep.seed)
    for _ in range(sweep.draws):
        yield {key: _draw(random, choice) for key, choice in sweep.choices.items()}


def run_sweep(
    plan: TrainingPlan, sweep: Sweep, basis: TrainingSettings, done_path: Path, watch: Watch
) -> list[Trial]:
    """Try all that is not in `done_path` yet, one line of which is written for each.

    Samples are cut as `train` cuts them: with a choice of lines fitted to the recordings.

    Raises:
        InputError: as `train` does, and where the file is of another sweep or cannot be written.
    """
    wanted = list(trials(sweep))
    if len(wanted) > MOST_TRIALS:
        raise InputError(f"{len(wanted):,} combinations to try; name fewer, or give draws = N")
    place = begin_work(plan, done_path, _Counted(watch))
    mark = _mark(plan, basis)
    done = _read_done(done_path, mark)
    if all(_line_of(values) in done for values in wanted):
        return [done[_line_of(values)] for values in wanted]
    plan = replace(plan, split=with_doubts(plan.split, watch))
    learn, tune = collect(choosing(plan, fit_lines(plan, watch)), watch)
    known: dict[object, tuple[SemanticGraphNetwork, Figures]] = {}

    def figures_of(settings: TrainingSettings) -> Figures:
        key = (settings.sgn, settings.sgn_fit)
        if key not in known:
            known[key] = fit_sgn(learn, tune, settings, place)
        sgn, figures = known[key]
        if sweep.judged_by in figures:
            return figures
        return figures | fit_edn(learn, tune, sgn, settings, place)[1]

    for k, values in enumerate(wanted, start=1):
        if _line_of(values) in done:
            continue
        watch.step("sweep", k - 1, len(wanted), ", ".join(f"{n} {v}" for n, v in values.items()))
        try:
            trial = Trial(values, figures_of(changed(basis, "sweep", values)))
        except LossError as error:
            trial = Trial(values, {}, str(error))
        _add(done_path, mark, trial)
        done[_line_of(values)] = trial
    watch.step("sweep", len(wanted), len(wanted), "")
    return [done[_line_of(values)] for values in wanted]


def best_trial(found: Sequence[Trial], judged_by: str) -> Trial:
    """The one with the least figure. Raises HatnSimError where all were lost."""
    judged = [one for one in found if judged_by in one.figures]
    if not judged:
        raise HatnSimError("sweep: every loss was lost; try smaller learning rates")
    return min(judged, key=lambda one: one.figures[judged_by])


class _Counted:
    """Passes on the steps of trainings, and keeps their epochs for itself."""

    def __init__(self, watch: Watch) -> None:
        self._watch = watch

    def step(self, stage: str, done: int, total: int, words: str) -> None:
        self._watch.step(stage, done, total, words)

    def say(self, line: str) -> None:
        pass


def _choice(where: str, said: Any, is_drawn: bool) -> tuple[Any, ...] | Span:
    if isinstance(said, list) and said and not any(isinstance(one, list | dict) for one in said):
        return tuple(said)
    if isinstance(said, dict) and set(said) == {"from", "to"}:
        low, high = said["from"], said["to"]
        if not all(type(end) in (int, float) for end in (low, high)) or not 0 < low < high:
            raise InputError(f"{where}: expected a span of numbers above 0, found {said!r}")
        if not is_drawn:
            raise InputError(f"{where}: a span is drawn from: add draws = N, or name values")
        return Span(float(low), float(high))
    raise InputError(f"{where}: expected a list of values or {{from = A, to = B}}, found {said!r}")


def _draw(random: np.random.Generator, choice: tuple[Any, ...] | Span) -> Any:
    if isinstance(choice, Span):
        low, high = math.log(choice.low), math.log(choice.high)
        return float(f"{math.exp(random.uniform(low, high)):.3g}")
    return choice[int(random.integers(len(choice)))]


def _mark(plan: TrainingPlan, basis: TrainingSettings) -> str:
    """What all trials have in common."""
    common = described(plan) | {"settings": asdict(basis)}
    return hashlib.sha256(json.dumps(common, sort_keys=True).encode()).hexdigest()[:16]


def _line_of(values: Values) -> str:
    return json.dumps(values, sort_keys=True)


def _read_done(path: Path, mark: str) -> dict[str, Trial]:
    if not path.exists():
        return {}
    done: dict[str, Trial] = {}
    for text in path.read_text(encoding="utf-8").splitlines():
        try:
            line = json.loads(text)
            trial = Trial(line["values"], line["figures"], line["note"])
            theirs = line["sweep"]
        except (ValueError, KeyError, TypeError):
            continue  # half a line: it was being written when the sweep was stopped
        if theirs != mark:
            raise InputError(
                f"{path}: is of a sweep over other traffic or by another version; remove it to "
                "begin anew, or choose another --out"
            )
        done[_line_of(trial.values)] = trial
    return done


def _add(path: Path, mark: str, trial: Trial) -> None:
    line = json.dumps({"sweep": mark, **vars(trial)})
    try:
        with path.open("a", encoding="utf-8") as file:
            # Begun anew, since the line before may have been cut off.
            file.write(f"\n{line}\n" if file.tell() else f"{line}\n")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written: {error.strerror}; make room and give the same command "
            "again, which goes on from here"
        ) from None
