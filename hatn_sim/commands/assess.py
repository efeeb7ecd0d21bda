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
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hatn_sim.commands.assess_calibration import NO_EVENTS
from hatn_sim.commands.assess_runs import RUNS_FOLDER, assist_settings, make_runs
from hatn_sim.commands.options import (
    names,
    rates,
    seconds,
    seconds_or_none,
    seeds,
    whole_number,
)
from hatn_sim.resources import SUITES

if TYPE_CHECKING:
    from hatn_sim.datatypes import Score
    from hatn_sim.score.assessed import AssessedRun
    from hatn_sim.score.sweep import Operating

EXAMPLES = """examples:
  hatn-sim assess --scenes intersection5,roundabout8 --risk courteous,inattentive --seeds 401-440
  hatn-sim assess --suite do_warn,suppress_warn,no_warn --seeds 401-440 --json
  hatn-sim assess --calibrate
"""
FALSE_ALARMS_PER_HOUR: Final = 1.0
WITHOUT: Final = (
    "recall has no value, and rules beside hatn are left out: there is nothing to choose their "
    "thresholds by; name scenes or suites with events as well (--suite do_warn,suppress_warn)"
)
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
        "--rules",
        type=names,
        metavar="A,B",
        help="alert rules to compare, hatn among them (default: all)",
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
    from hatn_sim.commands.assess_calibration import calibrate
    from hatn_sim.commands.folders import free_or_own_folder

    out = free_or_own_folder(arguments.out, "assess")
    runs = make_runs(arguments, out)
    return calibrate(arguments, out, runs) if arguments.calibrate else _tell(arguments, out, runs)


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

    settings = assist_settings(arguments)
    curves: dict[str, dict[str, list[Operating]]] = curves_of(runs, settings)
    thresholds = thresholds_by_scene(runs, curves, settings)
    scores: list[Score] = compare_rules(runs, thresholds, settings)
    path = write_scores(out, scores)
    write_curves(out / CURVES_FILE, curves)
    draw_curves(curves, [out / name for name in FIGURES], scores)
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
