"""The runs that `hatn-sim assess` judges: which are wanted, and those that are not there made."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.resources import SUITES, scenes_of_suite

if TYPE_CHECKING:
    from hatn_sim.assist.settings import AssistSettings
    from hatn_sim.config import Scenario
    from hatn_sim.evaluation.assessing import AssessPlan
    from hatn_sim.score.assessed import AssessedRun
    from hatn_sim.score.what_if import Rates

HELD_OUT: Final = tuple(range(401, 441))
FOR_CALIBRATION: Final = tuple(range(300, 316))
CALIBRATION_SCENES: Final = (
    *("intersection5", "roundabout8", "intersection4_allway", "roundabout4_two_lane", "tjunction"),
    *("learn_priority4", "learn_roundabout5"),
)
CALIBRATION_RISKS: Final = ("courteous", "inattentive")
"""What --calibrate looks at by itself, beside all suites."""
DURATION_S: Final = 120.0
SUITE_DURATION_S: Final = 60.0
RUNS_FOLDER: Final = "assessed"


def make_runs(arguments: argparse.Namespace, out: Path) -> list[AssessedRun]:
    """All runs that are asked for, made where they are not there.

    Raises HatnSimError, and KeyboardInterrupt, where one of them fails; the others stay.
    """
    from hatn_sim.commands.folders import finished_runs_stay
    from hatn_sim.commands.progress import RunsProgress
    from hatn_sim.datatypes import DT_S
    from hatn_sim.evaluation.assessing import is_assessed, make_assessed
    from hatn_sim.evaluation.pool import cores, work_on
    from hatn_sim.score.assessed import read_assessed

    plans = list(_plans(arguments, out))
    wanted = [plan for plan in plans if not is_assessed(plan)]
    if len(wanted) < len(plans) and not arguments.quiet:
        there = len(plans) - len(wanted)
        said = f"hatn-sim: {there} of {len(plans)} runs are in {out / RUNS_FOLDER} already"
        print(said, file=sys.stderr)
    labels, frames = [plan.label for plan in wanted], [plan.frames for plan in wanted]
    progress = RunsProgress(labels, frames, DT_S, arguments.quiet)
    with finished_runs_stay(out), progress:
        workers = arguments.workers or cores()
        for number, done in work_on(make_assessed, wanted, workers, progress.show):
            progress.finish(number, done)
    runs = [read_assessed(plan.out) for plan in plans]
    if not arguments.quiet:
        for notice in dict.fromkeys(f"{run.scene}: {line}" for run in runs for line in run.notices):
            print(f"hatn-sim: {notice}", file=sys.stderr)
        for notice in _everyday_brakings(runs):
            print(f"hatn-sim: {notice}", file=sys.stderr)
    return runs


def _everyday_brakings(runs: Sequence[AssessedRun]) -> Iterator[str]:
    """Of each scene and profile where T2 is everyday braking, a line."""
    from hatn_sim.score.everyday import everyday_braking

    for scene, risk in dict.fromkeys((run.scene, run.risk) for run in runs):
        of = [run for run in runs if (run.scene, run.risk) == (scene, risk)]
        events = [
            event
            for run in of
            for event in run.events
            if run.window_s[0] <= event.start_s < run.window_s[1]
        ]
        found = everyday_braking(events, sum(run.vehicle_hours for run in of))
        if found is not None:
            yield f"{scene}{f', {risk} drivers' if risk else ''}: {found}"


def _plans(arguments: argparse.Namespace, out: Path) -> Iterator[AssessPlan]:
    """Every seed of every profile of every scene."""
    from hatn_sim.assist.baselines import RULES
    from hatn_sim.assist.danger_network import sha256_of_danger_network
    from hatn_sim.commands.options import default_warm_up_s
    from hatn_sim.commands.versions import installed
    from hatn_sim.errors import InputError, nearest
    from hatn_sim.evaluation.assessing import AssessPlan
    from hatn_sim.evaluation.comparison import FIXED, OURS
    from hatn_sim.evaluation.made_by import made_by

    rules: tuple[str, ...] = arguments.rules or tuple(RULES)
    for name in rules:
        if name not in RULES:
            raise InputError(f"--rules: unknown rule {name!r}{nearest(name, RULES)}")
    if OURS not in rules and not set(rules) <= FIXED.keys():
        raise InputError(
            f"--rules: expected {OURS} among them, the others are compared at its false alarms; "
            f"found {','.join(rules)}"
        )
    settings = assist_settings(arguments)
    danger = None if arguments.calibrate else sha256_of_danger_network(settings.danger_network)
    for_seeds = arguments.seeds or (FOR_CALIBRATION if arguments.calibrate else HELD_OUT)
    of_suites = {name for suite in SUITES for name in scenes_of_suite(suite)}
    for scenario in _scenarios(arguments):
        warm_up_s = default_warm_up_s(scenario)
        warm_up_s = warm_up_s if arguments.warm_up is None else arguments.warm_up
        made = made_by(scenario)
        duration_s = arguments.duration or (
            SUITE_DURATION_S if scenario.name in of_suites else DURATION_S
        )
        judged: Rates | None = arguments.counterfactuals
        profile = "" if scenario.risk is None else f", {scenario.risk}"
        for seed in for_seeds:
            label = f"{scenario.name}{profile}, seed {seed}"
            yield AssessPlan(
                label=label,
                out=out / RUNS_FOLDER / (re.sub(r"[^\w.-]+", "-", label) + ".npz"),
                scenario=scenario,
                seed=seed,
                warm_up_s=warm_up_s,
                duration_s=duration_s,
                weights=arguments.weights,
                rules=rules,
                settings=settings,
                counterfactuals=judged,
                keeps_signs=arguments.calibrate,
                made_with={
                    "scene": scenario.name,
                    "density": scenario.density,
                    "risk": scenario.risk,
                    "seed": seed,
                    "warm_up_s": warm_up_s,
                    "duration_s": duration_s,
                    "rules": list(rules),
                    "settings": asdict(settings),
                    "counterfactuals": None if judged is None else asdict(judged),
                    "weights": _sha256(arguments.weights),
                    "keeps_signs": arguments.calibrate,
                    "danger_network": None if arguments.calibrate else danger,
                    "versions": installed(),
                    **made,
                },
            )


def assist_settings(arguments: argparse.Namespace) -> AssistSettings:
    from hatn_sim.assist.settings import AssistSettings, read_assist_settings

    path: Path | None = arguments.assist_settings
    return AssistSettings() if path is None else read_assist_settings(path)


def _scenarios(arguments: argparse.Namespace) -> Iterator[Scenario]:
    """The scenes that are named, each with each of its risk profiles that are wanted."""
    from hatn_sim.config import load_scenario
    from hatn_sim.errors import InputError

    words: Sequence[str] = arguments.scenes
    wanted: Sequence[str] = arguments.risk
    if arguments.suite:
        if words:
            raise InputError(f"either --suite {','.join(arguments.suite)} or --scenes; drop one")
        words = [name for suite in arguments.suite for name in scenes_of_suite(suite)]
    elif not words and arguments.calibrate:
        wanted = wanted or CALIBRATION_RISKS
        for word in CALIBRATION_SCENES:
            for risk in wanted:
                yield load_scenario(word, arguments.density, risk)
        words, wanted = [name for suite in SUITES for name in scenes_of_suite(suite)], ()
    if not words:
        raise InputError("name scenes with --scenes A,B, or a --suite")
    for word in words:
        scenario = load_scenario(word, arguments.density, None)
        if scenario.recorded is not None:
            raise InputError(f"{word}: recorded traffic has no seeds to assess; name a scene")
        for risk in wanted or scenario.risks or (None,):
            yield load_scenario(word, arguments.density, risk)


def _sha256(path: Path | None) -> str | None:
    """Of the weights' file; None: those that ship."""
    import hashlib

    from hatn_sim.errors import InputError

    try:
        return None if path is None else hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"--weights {path}: cannot be read ({error.strerror})") from None
