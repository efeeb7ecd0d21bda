"""Judge alerts and suggestions over many runs, by what really happened in them.

One run for each scene, risk profile and seed, on all cores. HATN looks at all vehicles; its alerts
are held against collisions (T1) and evasive braking (T2), beside those of simpler rules, each at
the threshold at which it raises no more false alarms than HATN's does. False alarms are counted
where drivers are courteous, if that is among the profiles. Where nothing is to be warned of
(suppress_warn, no_warn), rules are at thresholds chosen by the other scenes named, so name
do_warn,suppress_warn,no_warn together. Finished runs stay in OUT/assessed; the
same command with the same --out goes on where it was stopped.

With --calibrate, what tells the danger of a pair is fitted anew instead, on seeds of its own, and
the threshold sought that recalls most at no more than --false-alarms per vehicle-hour. Both are
written: OUT/danger.json, and OUT/assist.toml, to be given as --assist-settings.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.options import (
    names,
    rates,
    seconds,
    seconds_or_none,
    seeds,
    whole_number,
)
from hatn_sim.resources import SUITES, scenes_of_suite

if TYPE_CHECKING:
    from hatn_sim.assist.settings import AssistSettings
    from hatn_sim.config import Scenario
    from hatn_sim.datatypes import Score
    from hatn_sim.evaluation.assessing import AssessPlan
    from hatn_sim.score.assessed import AssessedRun
    from hatn_sim.score.sweep import Operating
    from hatn_sim.score.what_if import Rates

EXAMPLES = """examples:
  hatn-sim assess --scenes intersection5,roundabout8 --risk courteous,inattentive --seeds 401-440
  hatn-sim assess --suite do_warn,suppress_warn,no_warn --seeds 401-440 --json
  hatn-sim assess --calibrate
"""
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
NO_EVENTS: Final = "no collision and no evasive braking in these runs"
WITHOUT: Final = (
    "recall has no value, and rules beside hatn are left out: there is nothing to choose their "
    "thresholds by; name scenes or suites with events as well (--suite do_warn,suppress_warn)"
)
FALSE_ALARMS_PER_HOUR: Final = 1.0
RUNS_FOLDER: Final = "assessed"
SETTINGS_FILE: Final = "assist.toml"
NETWORK_FILE: Final = "danger.json"
SEVERE: Final = ("T1", "T2")
CURVES_FILE: Final = "curves.csv"
FIGURES: Final = ("curves.png", "curves.pdf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim assess`."""
    parser.add_argument(
        "--scenes", type=names, default=(), metavar="A,B", help="names of scenes, or .sumocfg files"
    )
    parser.add_argument(
        "--suite",
        type=names,
        default=(),
        metavar="A,B",
        help=f"instead: all scenes of scripted suites ({', '.join(SUITES)})",
    )
    parser.add_argument(
        "--risk",
        type=names,
        default=(),
        metavar="PROFILE,PROFILE",
        help="who drives: courteous, assertive, inattentive (default: all that a scene knows)",
    )
    parser.add_argument("--density", metavar="light|normal|dense", help="how much traffic")
    parser.add_argument(
        "--seeds",
        type=seeds,
        metavar="A-B",
        help="of the traffic (default: 401-440; with --calibrate 300-315)",
    )
    parser.add_argument(
        "--duration",
        type=seconds,
        metavar="S",
        help="of each run (default: 120; 60 in a scene of a suite)",
    )
    parser.add_argument(
        "--warm-up",
        type=seconds_or_none,
        metavar="S",
        help="seconds to let traffic build up before (default: 60 in a shipped scene, 0 in yours)",
    )
    parser.add_argument(
        "--rules", type=names, metavar="A,B", help="alert rules to compare (default: all)"
    )
    parser.add_argument("--weights", type=Path, metavar="FILE", help="weights of hatn")
    parser.add_argument(
        "--assist-settings",
        type=Path,
        metavar="FILE.toml",
        help="thresholds of assistance, as --calibrate writes them (default: those that ship)",
    )
    parser.add_argument(
        "--counterfactuals",
        type=rates,
        metavar="RATE",
        help="share of alerts and suggestions that are judged by branches of the simulation, up to "
        "1; two of them as ALERTS,SUGGESTIONS (default: none)",
    )
    parser.add_argument(
        "--calibrate", action="store_true", help="fit the danger of alerts and seek their threshold"
    )
    parser.add_argument(
        "--false-alarms",
        type=seconds,
        default=FALSE_ALARMS_PER_HOUR,
        metavar="N",
        help="with --calibrate: at most so many in an hour of a vehicle (default: 1)",
    )
    parser.add_argument(
        "--workers",
        type=whole_number,
        metavar="N",
        help="runs made at once (default: as many as there are cores)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="where runs, figures and numbers go (default: the first free runs/assess-N)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    parser.add_argument("--quiet", action="store_true", help="no progress, no notices")


def main(arguments: argparse.Namespace) -> int:
    """Make the runs; score, print, draw, or calibrate."""
    from hatn_sim.commands.folders import free_or_own_folder

    out = free_or_own_folder(arguments.out, "assess")
    runs = make_runs(arguments, out)
    return _calibrate(arguments, out, runs) if arguments.calibrate else _tell(arguments, out, runs)


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
    from hatn_sim.evaluation.made_by import made_by

    rules: tuple[str, ...] = arguments.rules or tuple(RULES)
    for name in rules:
        if name not in RULES:
            raise InputError(f"--rules: unknown rule {name!r}{nearest(name, RULES)}")
    settings = _settings(arguments)
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


def _settings(arguments: argparse.Namespace) -> AssistSettings:
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


def _tell(arguments: argparse.Namespace, out: Path, runs: Sequence[AssessedRun]) -> int:
    from hatn_sim.commands.console import make_console
    from hatn_sim.evaluation.comparison import (
        compare_rules,
        curves_of,
        thresholds_by_scene,
        write_curves,
    )
    from hatn_sim.report.assistance_figure import draw_curves
    from hatn_sim.report.assistance_table import assistance_table
    from hatn_sim.report.table import scores_json, write_scores

    settings = _settings(arguments)
    curves: dict[str, dict[str, list[Operating]]] = curves_of(runs, settings)
    thresholds = thresholds_by_scene(runs, curves, settings)
    scores: list[Score] = compare_rules(runs, thresholds, settings)
    path = write_scores(out, scores)
    write_curves(out / CURVES_FILE, curves)
    draw_curves(curves, [out / name for name in FIGURES])
    if not arguments.quiet and not any(s.n for s in scores if s.measure == "event_recall"):
        print(f"hatn-sim: {NO_EVENTS}: {WITHOUT}", file=sys.stderr)
    if arguments.json:
        print(scores_json(scores))
        return 0
    chosen_on = {scene: of.chosen_on for scene, of in thresholds.items()}
    make_console().print(assistance_table(scores, chosen_on))
    print(f"scores in {path}, curves in {out / CURVES_FILE} and {out / FIGURES[0]}")
    print(f"runs in {out / RUNS_FOLDER}")
    return 0


def _calibrate(arguments: argparse.Namespace, out: Path, runs: Sequence[AssessedRun]) -> int:
    from hatn_sim.assist.danger import HATN
    from hatn_sim.assist.danger_network import write_danger_networks
    from hatn_sim.assist.settings import NETWORK
    from hatn_sim.commands.versions import installed
    from hatn_sim.errors import HatnSimError, InputError
    from hatn_sim.learn.danger_study import fit_all, held_out_runs
    from hatn_sim.score.sweep import best_within, operating, sharpest, sweep, thresholds_of
    from hatn_sim.whole_file import ROOM_OR_OUT, save_whole

    if len({run.seed for run in runs}) < 2:
        raise InputError(
            "--calibrate: expected two --seeds or more, since a threshold is sought on seeds that "
            "the danger was not fitted to; found one"
        )
    networks = fit_all(runs)
    if networks is None:
        raise HatnSimError(
            f"{NO_EVENTS}: there is nothing to calibrate by; add seeds, or --risk inattentive"
        )
    settings = _settings(arguments)
    judged = held_out_runs(runs, HATN)
    curve = sweep(judged, HATN, thresholds_of(judged, HATN), settings)
    within = partial(best_within, false_alarms_per_hour=arguments.false_alarms)
    best = sharpest(judged, HATN, curve, within, settings)
    if best is None:
        raise HatnSimError(
            f"no threshold keeps within {arguments.false_alarms:g} false alarms per vehicle-hour; "
            "allow more with --false-alarms, or add runs"
        )
    # Rounded up, so that what is written is as strict; the figures told are those of it.
    onset = math.ceil(1000.0 * best.threshold) / 1000.0
    best = operating(judged, HATN, onset, settings)
    release = settings.alert_end / settings.alert_onset
    found = replace(settings, alert_onset=onset, alert_end=round(release * onset, 4))
    card = {
        "scenes": sorted({run.scene for run in runs}),
        "profiles": sorted({run.risk for run in runs}),
        "seeds": sorted({run.seed for run in runs}),
        "vehicle_hours": round(sum(run.vehicle_hours for run in runs), 2),
        "events": sum(one.tier in SEVERE for run in runs for one in run.events),
        "versions": installed(),
    }
    write_danger_networks(out / NETWORK_FILE, networks, card)
    path = out / SETTINGS_FILE
    values = {field.name: getattr(found, field.name) for field in fields(found)}
    lines = [f"{key} = {value}" for key, value in values.items() if key != NETWORK]
    lines.append(f'{NETWORK} = "{NETWORK_FILE}"')
    save_whole(path, "\n".join(lines) + "\n", ROOM_OR_OUT)
    print(
        f"alerts from a danger of {onset:g} on: {best.false_alarms_per_hour:.2f} false "
        f"alarms per vehicle-hour, {_percent(best.event_recall)} of events preceded by an alert, "
        f"{_percent(best.recall_1s5)} by 1.5 s or more (on runs that the network was not fitted "
        f"to); settings in {path}, the network in {out / NETWORK_FILE}"
    )
    return 0


def _percent(share: float) -> str:
    return "none" if math.isnan(share) else f"{100.0 * share:.1f} %"
