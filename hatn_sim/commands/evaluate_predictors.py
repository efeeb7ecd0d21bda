"""`hatn-sim evaluate`: several predictors on the same samples of many runs."""

from __future__ import annotations

import argparse
import re
import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.evaluate import DURATION_S, HELD_OUT, PREDICTORS, chosen_scenarios
from hatn_sim.commands.folders import finished_runs_stay, free_or_own_folder
from hatn_sim.evaluation.pool import cores

if TYPE_CHECKING:
    from hatn_sim.config import RecordedSource, Scenario
    from hatn_sim.datatypes import Predictor, Score
    from hatn_sim.evaluation.runs import RunPlan
    from hatn_sim.learn.others_choice import OthersChoice
    from hatn_sim.log import Run

RUNS_FOLDER: Final = "runs"
STEPS_FILE: Final = "steps.csv"
FIGURES: Final = ("steps.png", "steps.pdf")


def main(arguments: argparse.Namespace) -> int:
    """Make the runs, score them, print, draw."""
    from hatn_sim.commands.console import make_console
    from hatn_sim.report.steps_figure import draw_steps, write_steps
    from hatn_sim.report.table import score_table, scores_json, write_scores
    from hatn_sim.score.steps import errors_by_step

    arguments.predictors = arguments.predictors or PREDICTORS
    out = free_or_own_folder(arguments.out, "evaluate")
    logged, scores, learnt = scored_runs(arguments, out)
    steps = [
        # Who is given the routes has another name in scores.
        replace(one, trained=one.scene in learnt[one.predictor.removesuffix("+route")])
        for one in errors_by_step(logged)
    ]
    path = write_scores(out, scores)
    write_steps(out / STEPS_FILE, steps)
    draw_steps(steps, [out / name for name in FIGURES])
    if arguments.json:
        print(scores_json(scores))
        return 0
    make_console().print(score_table(scores, said_clusters(logged)))
    print(f"scores in {path}, error by step in {out / STEPS_FILE} and {out / FIGURES[0]}")
    print(f"runs in {out / RUNS_FOLDER}")
    return 0


def scored_runs(
    arguments: argparse.Namespace, out: Path
) -> tuple[list[Run], list[Score], dict[str, list[str]]]:
    """The logs of all runs that are asked for, made where they are not there, and their scores;
    and by predictor the scenes that its weights were trained on.

    By scene; scores say where a network is judged on what it learnt from.

    Raises HatnSimError, and KeyboardInterrupt, where one of them fails; the others stay.
    """
    from hatn_sim.commands.chosen_predictors import load_predictors
    from hatn_sim.commands.run_header import trained_on
    from hatn_sim.evaluation.runs import is_there
    from hatn_sim.evaluation.seen import Judged, said_of_seen, with_seen
    from hatn_sim.log import read_run
    from hatn_sim.score.prediction import score_runs

    predictors = load_predictors(
        arguments.predictors, arguments.weights, arguments.adapt, arguments.quiet
    )
    plans = list(_plans(arguments, predictors, out))
    judged = [Judged(plan.label, plan.scenario, plan.seed) for plan in plans]
    seen = said_of_seen(predictors, judged)
    if not arguments.quiet:
        for (predictor, scene), words in seen.items():
            print(f"hatn-sim: {scene}: {predictor} {words}", file=sys.stderr)
    there = [is_there(plan) for plan in plans]
    if any(there) and not arguments.quiet:
        said = f"hatn-sim: {sum(there)} of {len(plans)} runs are in {out / RUNS_FOLDER} already"
        print(said, file=sys.stderr)
    wanted = [plan for plan, made in zip(plans, there, strict=True) if not made]
    with finished_runs_stay(out):
        _make(wanted, arguments.workers or cores(), arguments.quiet)
    logged = [read_run(plan.out) for plan in plans]
    learnt = {predictor.name: trained_on(predictor) for predictor in predictors}
    return logged, with_seen(score_runs(logged), seen), learnt


def _make(plans: Sequence[RunPlan], workers: int, quiet: bool) -> None:
    from hatn_sim.commands.progress import RunsProgress
    from hatn_sim.datatypes import DT_S
    from hatn_sim.evaluation.pool import work_on
    from hatn_sim.evaluation.runs import make_run

    told: dict[str, None] = {}
    labels, frames = [plan.label for plan in plans], [plan.frames for plan in plans]
    with RunsProgress(labels, frames, DT_S, quiet) as progress:
        for number, made in work_on(make_run, plans, workers, progress.show):
            progress.finish(number, made.frames)
            told |= {f"{plans[number].scenario.name}: {line}": None for line in made.notices}
    if not quiet:
        for line in told:
            print(f"hatn-sim: {line}", file=sys.stderr)


def _plans(
    arguments: argparse.Namespace, predictors: Sequence[Predictor], out: Path
) -> Iterator[RunPlan]:
    """Every seed of every scene, and every recording."""
    from hatn_sim.errors import InputError

    scenarios = {
        label: replace(scenario, name=label)
        for label, scenario in chosen_scenarios(arguments).items()
    }
    recorded = [scenario.recorded is not None for scenario in scenarios.values()]
    if all(recorded) and arguments.seeds is not None:
        raise InputError("--seeds: recorded traffic has no seed; leave it out")
    for scenario in scenarios.values():
        if scenario.recorded is None:
            for seed in arguments.seeds or HELD_OUT:
                label = f"{scenario.name}, seed {seed}"
                yield _plan(arguments, predictors, scenario, seed, label, out)
        else:
            _refuse_others(arguments, predictors, scenario, out)
            scenes = _recordings(arguments, scenario, scenario.recorded)
            choices = _choices(arguments, predictors, scenario, scenes)
            for name, one in scenes.items():
                label = f"{scenario.name}, {name}"
                yield _plan(arguments, predictors, one, None, label, out, choices.get(name))


def _refuse_others(
    arguments: argparse.Namespace, predictors: Sequence[Predictor], scenario: Scenario, out: Path
) -> None:
    """InputError where runs of other options are in the way, before lines are drawn."""
    from hatn_sim.evaluation.runs import OF_LINES, is_there
    from hatn_sim.recordings.each import each_recording

    for name, one in each_recording(scenario, "lanes").items():
        label = f"{scenario.name}, {name}"
        is_there(_plan(arguments, predictors, one, None, label, out), unknown=OF_LINES)


def _recordings(
    arguments: argparse.Namespace, scenario: Scenario, source: RecordedSource
) -> Mapping[str, Scenario]:
    """Each with its reference lines, which are drawn here, once for many; scenes keep theirs."""
    from hatn_sim.commands.line_choices import drawing_lines
    from hatn_sim.errors import InputError
    from hatn_sim.recordings.each import each_recording

    if arguments.lines == "route" and source.map_path is not None:
        raise InputError("--lines route: recorded tracks know no routes; leave it out")
    lines_from = arguments.lines_from if _is_of_tracks(scenario) else "lanes"
    with drawing_lines(arguments.cache, arguments.quiet) as drawing:
        return each_recording(scenario, lines_from, drawing)


def _choices(
    arguments: argparse.Namespace,
    predictors: Sequence[Predictor],
    scenario: Scenario,
    scenes: Mapping[str, Scenario],
) -> Mapping[str, OthersChoice]:
    """What was fitted for recordings of --tracks to choose lines by."""
    from hatn_sim.commands.line_choices import choices_for

    choice_from = arguments.choice_from if _is_of_tracks(scenario) else "weights"
    workers, cache = arguments.workers or cores(), arguments.cache
    return choices_for(scenes, predictors, choice_from, cache, workers, arguments.quiet)


def _is_of_tracks(scenario: Scenario) -> bool:
    """Whether it is that of --tracks; the recordings of a scene have a file of their own."""
    source = scenario.recorded
    return source is not None and scenario.config_path == source.tracks[0]


def _plan(
    arguments: argparse.Namespace,
    predictors: Sequence[Predictor],
    scenario: Scenario,
    seed: int | None,
    label: str,
    out: Path,
    found: OthersChoice | None = None,
) -> RunPlan:
    from hatn_sim.commands.line_choices import choice_header
    from hatn_sim.commands.options import default_warm_up_s
    from hatn_sim.commands.run_header import make_header
    from hatn_sim.evaluation.runs import RunPlan
    from hatn_sim.labels import SAMPLE_EVERY_FRAMES

    duration_s: float | None = arguments.duration
    if duration_s is None and seed is not None:
        duration_s = DURATION_S
    warm_up_s = default_warm_up_s(scenario) if arguments.warm_up is None else arguments.warm_up
    choice_from = "weights" if found is None else "tracks"
    run = _as_run(arguments, scenario, seed, duration_s, warm_up_s, choice_from)
    header = make_header(run, scenario, predictors, choice_header(found))
    return RunPlan(
        label=label,
        out=out / RUNS_FOLDER / re.sub(r"[^\w.-]+", "-", label),
        scenario=scenario,
        seed=seed,
        warm_up_s=warm_up_s,
        duration_s=duration_s,
        predictors=arguments.predictors,
        weights=arguments.weights,
        adapt=arguments.adapt,
        lines=arguments.lines,
        header={**header, "predicted_every_frames": SAMPLE_EVERY_FRAMES},
        choice=None if found is None else found.choice,
    )


def _as_run(
    arguments: argparse.Namespace,
    scenario: Scenario,
    seed: int | None,
    duration_s: float | None,
    warm_up_s: float,
    choice_from: str,
) -> Namespace:
    """The arguments of the `hatn-sim run` that makes the same scores."""
    from hatn_sim.assist.settings import AssistSettings
    from hatn_sim.commands.options import SIMULATORS_OWN

    source = scenario.recorded
    return Namespace(
        scene=None if source is not None else _word(arguments, scenario),
        tracks=None if source is None else [str(path) for path in source.tracks],
        map=None if source is None else source.map_path,
        recordings=None if source is None or not source.recordings else ",".join(source.recordings),
        seed=seed,
        duration=duration_s,
        warm_up=warm_up_s,
        predictor=arguments.predictors[0],
        compare=arguments.predictors[1:],
        weights=arguments.weights,
        adapt=arguments.adapt,
        lines=arguments.lines,
        egos=None,
        assist_settings=None,
        acts_on_advice=False,
        assist=AssistSettings(),
        counterfactuals=None,
        net=None,
        react_from=None,
        drive=None,
        lines_from=arguments.lines_from if source is not None and source.drawn else "lanes",
        choice_from=choice_from,
        agent=SIMULATORS_OWN,
    )


def _word(arguments: argparse.Namespace, scenario: Scenario) -> str:
    """What the user named the scene by."""
    path = scenario.config_path
    named = {str(path), str(path.parent), scenario.name}
    return next((word for word in arguments.scenes if word in named), scenario.name)


def said_clusters(runs: Sequence[Run]) -> str:
    """What the intervals are over, in the words of the user."""
    from hatn_sim.score.samples import clustered_over

    over = clustered_over(runs)
    seeded = {run.header.get("seed") is not None for run in runs}
    if over != "runs" or len(seeded) > 1:
        return over
    return "seeds" if True in seeded else "recordings"
