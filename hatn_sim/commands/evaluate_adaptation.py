"""`hatn-sim evaluate --table adaptation`: what online adaptation gains, beside the paper's words.

Every network watches every run once; then the errors without and with adaptation are taken for
1 to 10 steps looked back, for every layer, and for simpler methods. Each run is a job on a core of
its own, and what it found is used again by the same command with the same --out.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hatn_sim.commands.evaluate import HELD_OUT
from hatn_sim.commands.folders import free_or_own_folder

if TYPE_CHECKING:
    from hatn_sim.learn.adaptation_rows import AdaptationRow
    from hatn_sim.learn.adaptation_trials import Job, Results, Trial
    from hatn_sim.learn.split import Traffic

NETWORKS: Final = ("hatn-paper", "hatn")
SCENES: Final = ("intersection5", "roundabout8")
"""The shipped scenes that are like the paper's two."""
DURATION_S: Final = 45.0
RESULTS_FOLDER: Final = "results"
CSV_FILE: Final = "adaptation.csv"


def main(arguments: argparse.Namespace) -> int:
    """Do what has not been done, print, write, draw."""
    from hatn_sim.learn.adaptation_rows import rows_json, write_csv

    out = free_or_own_folder(arguments.out, "adaptation")
    traffic = _traffic(arguments)
    jobs = _jobs(arguments, traffic, out)
    results = _results(arguments, jobs)
    by_place = {
        (network, scene): _rows(network, scene, jobs, results)
        for network in _networks(arguments)
        for scene in traffic
    }
    rows = [row for part in by_place.values() for row in (*part[0], *part[1])]
    write_csv(out / CSV_FILE, rows)
    figures = _draw(out, by_place)
    if arguments.json:
        print(rows_json(rows))
        return 0
    _print(by_place, {scene: len(runs) for scene, runs in traffic.items()})
    print(f"numbers in {out / CSV_FILE}, figures in {', '.join(map(str, figures))}")
    return 0


def _networks(arguments: argparse.Namespace) -> Sequence[str]:
    from hatn_sim.errors import InputError
    from hatn_sim.predictors.find import READS_WEIGHTS

    wanted: tuple[str, ...] = arguments.predictors or NETWORKS
    for name in wanted:
        if name not in READS_WEIGHTS:
            raise InputError(
                f"--predictors {name}: cannot be adapted; expected {' or '.join(NETWORKS)}"
            )
    return tuple(dict.fromkeys(wanted))


def _traffic(arguments: argparse.Namespace) -> Mapping[str, Sequence[Traffic]]:
    """The runs by scene."""
    from hatn_sim.errors import InputError
    from hatn_sim.learn.split import traffic_of_scenes, traffic_of_tracks

    found: dict[str, list[Traffic]] = {}
    if arguments.tracks is not None:
        for option in ("seeds", "duration"):
            if getattr(arguments, option) is not None:
                raise InputError(f"--{option}: recorded tracks have none; leave it out")
        recordings = arguments.recordings or ""
        runs = traffic_of_tracks(arguments.tracks, arguments.map, recordings)
        found[runs[0].scenario.name] = runs
    for scene in arguments.scenes or (() if found else SCENES):
        runs = traffic_of_scenes(
            (scene,), arguments.seeds or HELD_OUT, duration_s=arguments.duration or DURATION_S
        )
        if runs[0].scenario.name in found:
            raise InputError(f"--scenes {scene}: a scene of that name is there already")
        found[runs[0].scenario.name] = runs
    return found


def _jobs(
    arguments: argparse.Namespace, traffic: Mapping[str, Sequence[Traffic]], out: Path
) -> list[Job]:
    from hatn_sim.commands.chosen_predictors import check_paper_weights
    from hatn_sim.hatn.weights_io import load_weights
    from hatn_sim.learn.adaptation_trials import TRIALS, Job
    from hatn_sim.predictors.find import weights_of

    networks = _networks(arguments)
    check_paper_weights(networks, arguments.weights, arguments.quiet)
    weights = {name: weights_of(name, arguments.weights) for name in networks}
    for path in weights.values():
        load_weights(path)  # before anything takes long
    return [
        Job(name, path, one, out / RESULTS_FOLDER, TRIALS)
        for name, path in weights.items()
        for runs in traffic.values()
        for one in runs
    ]


def _results(arguments: argparse.Namespace, jobs: Sequence[Job]) -> list[Results]:
    """What every job found, now or before."""
    from hatn_sim.commands.train_progress import TrainProgress
    from hatn_sim.evaluation.pool import cores, work_on
    from hatn_sim.learn.adaptation_trials import do_trials, find_results

    found = [find_results(job) for job in jobs]
    wanted = [number for number, results in enumerate(found) if results is None]
    with TrainProgress(arguments.quiet) as watch:
        if len(wanted) < len(jobs):
            watch.say(f"{len(jobs) - len(wanted)} of {len(jobs)} runs were tried already")

        def show(number: int, frames: int) -> None:
            job, done = jobs[wanted[number]], len(jobs) - len(wanted)
            words = f"{job.network}, {job.traffic.name}: {frames:,} frames"
            watch.step("runs", done + ready, len(jobs), words)

        ready = 0
        try:
            doing = work_on(
                do_trials, [jobs[number] for number in wanted], arguments.workers or cores(), show
            )
            for number, results in doing:
                found[wanted[number]] = results
                ready += 1
                job = jobs[wanted[number]]
                watch.step(
                    "runs",
                    len(jobs) - len(wanted) + ready,
                    len(jobs),
                    f"{job.network}, {job.traffic.name}: done",
                )
        except KeyboardInterrupt:
            if jobs[0].folder.exists():
                out = jobs[0].folder.parent
                print(
                    f"hatn-sim: runs that are done stay in {out}, and the same command with "
                    f"--out {out} uses them",
                    file=sys.stderr,
                )
            raise
    return [results for results in found if results is not None]


Rows = tuple[list["AdaptationRow"], list["AdaptationRow"]]
"""Those over the whole runs, and those by layer."""


def _rows(network: str, scene: str, jobs: Sequence[Job], results: Sequence[Results]) -> Rows:
    """Everything of one network in one scene, over all runs."""
    own = [
        found
        for job, found in zip(jobs, results, strict=True)
        if job.network == network and job.traffic.scenario.name == scene
    ]
    whole: list[AdaptationRow] = []
    by_layer: list[AdaptationRow] = []
    for trial in own[0]:
        kind = whole if trial.frames is None else by_layer
        kind.append(_row(network, scene, trial, own))
    return whole, by_layer


def _row(network: str, scene: str, trial: Trial, own: Sequence[Results]) -> AdaptationRow:
    from hatn_sim.learn.adaptation_rows import AdaptationRow, pooled

    n, changes = pooled([found[trial] for found in own])
    return AdaptationRow(scene, network, trial.method, trial.layer, trial.steps, n, changes)


def _draw(out: Path, by_place: Mapping[tuple[str, str], Rows]) -> list[Path]:
    """Two figures for each network, of the scenes that have any predictions."""
    from hatn_sim.report.adaptation_figure import draw_layers, draw_steps

    drawn: list[Path] = []
    for network in dict.fromkeys(network for network, _ in by_place):
        of_network = {
            scene: (
                [row for row in whole if row.method == "mekf" and row.n],
                [row for row in by_layer if row.n],
            )
            for (name, scene), (whole, by_layer) in by_place.items()
            if name == network
        }
        parts: tuple[tuple[str, Any], ...] = (("steps", draw_steps), ("layers", draw_layers))
        for k, (kind, draw) in enumerate(parts):
            scenes = {scene: rows[k] for scene, rows in of_network.items() if rows[k]}
            if scenes:
                paths = [out / f"{kind}-{network}{suffix}" for suffix in (".png", ".pdf")]
                draw(scenes, paths)
                drawn.append(paths[0])
    return drawn


def _print(by_place: Mapping[tuple[str, str], Rows], runs: Mapping[str, int]) -> None:
    from hatn_sim.commands.console import make_console
    from hatn_sim.learn.adaptation_rows import clustered_over
    from hatn_sim.report.adaptation_table import adaptation_table

    console = make_console()
    for (network, scene), (whole, by_layer) in by_place.items():
        over = clustered_over(runs[scene])
        console.print(adaptation_table(network, scene, whole, by_layer, over))
