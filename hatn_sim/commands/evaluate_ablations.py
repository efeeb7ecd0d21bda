"""`hatn-sim evaluate --table sgn|edn|intention|summary`: the paper's ablations, trained afresh.

Every network of a table is trained on the same samples and judged on the same others; what is
trained lies in OUT/models and is used again. `--rows FILE` prints rows that were reached before.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hatn_sim.commands.evaluate import DURATION_S, HELD_OUT
from hatn_sim.commands.folders import free_or_own_folder
from hatn_sim.evaluation.paper import SUMMARISES

if TYPE_CHECKING:
    from hatn_sim.evaluation.table import AblationRow
    from hatn_sim.learn.ablation_scores import Judged
    from hatn_sim.learn.ablation_training import Study
    from hatn_sim.learn.ablations import Row
    from hatn_sim.learn.dataset import Samples
    from hatn_sim.learn.split import Split
    from hatn_sim.learn.watch import Watch

MODELS_FOLDER: Final = "models"
SCENES: Final = ("intersection5", "roundabout8")
"""What is learnt from, and what is transferred to."""
LEARN_SEEDS: Final = (1, 2, 3, 4)
LEARN_S: Final = 200.0
TUNE_SEEDS: Final = (101,)
TUNE_S: Final = 100.0
"""About 20,000 samples to learn from, as many as the paper has, and 3,000 to tune on."""
CURVES: Final[Mapping[str, Mapping[str, tuple[str, str]]]] = {
    "edn": {
        "Cartesian": ("edn.a", "Cartesian"),
        "Frenet": ("edn.a", "Frenet"),
        "and speed": ("edn.b", "speed in"),
        "and yaw": ("edn.c", "yaw in"),
        "and incremental, aligned": ("edn.d", "incremental, aligned"),
        "hatn": ("edn.e", "hatn"),
    },
    "intention": {
        "no intention": ("intention.b", "No-Intention"),
        "predicted goal": ("intention.b", "Input"),
        "predicted goal, time": ("intention.c", "Input"),
        "true goal": ("intention.a", "Input"),
        "hatn": ("intention.b", "hatn"),
    },
    "summary": {name: ("summary", name) for name in SUMMARISES},
}
"""Table -> curves of the figure of the error by step, by name, and the rows that they are of."""
JUDGED: Final = (
    "every vehicle that is on a line, standing or moving, twice a second where it was seen for a "
    "second before and is for 3 s after; slots where it has more than one to choose from"
)
NOTES: Final = {
    "summary": "Ours: the paper's whole method adapts online; beside it hatn, which does not"
}
"""What is to be said below a table, whosever rows it shows."""


def main(arguments: argparse.Namespace) -> int:
    """Train what is missing, judge, print beside the paper's numbers, draw."""
    if arguments.rows is not None:
        return _print_given(arguments)
    from hatn_sim.commands.train_progress import TrainProgress
    from hatn_sim.learn.ablation_scores import judge
    from hatn_sim.learn.ablation_training import HOW
    from hatn_sim.learn.ablations import rows_of

    table: str = arguments.table
    split = _split(arguments)
    out = free_or_own_folder(arguments.out, table)
    study = _study(arguments, split, out)
    rows = rows_of(table)
    with TrainProgress(arguments.quiet) as watch:
        learn, tune, test = _samples(arguments, study, watch)
        try:
            _train(study, rows, len(learn), arguments.workers, watch)
        except KeyboardInterrupt:
            _say_what_stays(out)
            raise
    judged = judge(study, rows, test, CURVES.get(table, {}))
    _draw(out / f"{table}-steps", judged)
    caption = (
        f"ours: learnt from {len(learn):,} samples of {_traffic(split, 'train')}, seen at most "
        f"{study.how.epochs} times each; tuned on {len(tune):,} samples of "
        f"{_traffic(split, 'tune')}; judged on {_traffic(split, 'test')}: {JUDGED}"
    )
    if study.how.epochs < HOW.epochs:
        caption += (
            f". With {study.how.epochs} epochs where {HOW.epochs} are usual, networks have not "
            "learnt all they could: hold nothing of this against the paper's numbers"
        )
    return _print(arguments, out, judged.rows, judged.clustered_over, caption)


def _print_given(arguments: argparse.Namespace) -> int:
    """The rows of a file."""
    from hatn_sim.errors import InputError
    from hatn_sim.evaluation.paper import TABLES
    from hatn_sim.evaluation.table import read_rows, with_summary

    path: Path = arguments.rows
    if not path.is_file():
        raise InputError(
            f"{path}: there are no rows of ablations; give those of yours with --rows FILE"
        )
    rows = with_summary(read_rows(path))
    keys = {part.key for part in TABLES[arguments.table]}
    if keys.isdisjoint(row.table for row in rows):
        found = ", ".join(dict.fromkeys(row.table for row in rows)) or "none"
        raise InputError(
            f"{path}: expected rows of --table {arguments.table}, found {found}; give another file"
        )
    out = free_or_own_folder(arguments.out, arguments.table)
    return _print(arguments, out, rows, "runs or vehicles", "")


def _print(
    arguments: argparse.Namespace,
    out: Path,
    rows: Sequence[AblationRow],
    clustered_over: str,
    caption: str,
) -> int:
    from hatn_sim.commands.console import make_console
    from hatn_sim.evaluation.paper import TABLES
    from hatn_sim.evaluation.table import compare, entries_json, write_csv, write_rows
    from hatn_sim.report.paper_table import paper_table
    from hatn_sim.whole_file import save_whole

    table: str = arguments.table
    parts = [(part, compare(part, rows)) for part in TABLES[table]]
    entries = [entry for _, of_part in parts for entry in of_part]
    csv_path = out / f"{table}.csv"
    write_csv(csv_path, entries)
    write_rows(out / f"{table}-rows.json", rows)
    save_whole(out / f"{table}.json", entries_json(entries) + "\n")
    if arguments.json:
        print(entries_json(entries))
        return 0
    console = make_console()
    for part, of_part in parts:
        console.print(paper_table(part, of_part, clustered_over))
        print()
    for line in filter(None, (NOTES.get(table), caption)):
        console.print(line, style="dim", markup=False, highlight=False)
    print(f"numbers in {csv_path}")
    return 0


def _split(arguments: argparse.Namespace) -> Split:
    from hatn_sim.commands.line_choices import drawing_lines
    from hatn_sim.errors import InputError
    from hatn_sim.learn.split import make_split, traffic_of_scenes
    from hatn_sim.learn.split_file import read_split

    if arguments.split is not None:
        for name in ("scenes", "seeds", "duration"):
            if getattr(arguments, name):
                raise InputError(f"--{name}: --split names all traffic; leave one of them out")
        read_split(arguments.split, lines="lanes")  # every table, before lines are drawn for one
        with drawing_lines(arguments.cache, arguments.quiet) as drawing:
            split = read_split(arguments.split, drawing)
        if not split.test:
            raise InputError(f"{arguments.split}: expected [[test]], what to judge on; add it")
        return split
    scenes: tuple[str, ...] = arguments.scenes or SCENES
    test = traffic_of_scenes(
        scenes, arguments.seeds or HELD_OUT, duration_s=arguments.duration or DURATION_S
    )
    parts = {
        "train": traffic_of_scenes(scenes[:1], LEARN_SEEDS, duration_s=LEARN_S),
        "tune": traffic_of_scenes(scenes[:1], TUNE_SEEDS, duration_s=TUNE_S),
        "test": test,
    }
    called = {"train": "seeds 1-4, learnt from", "tune": "seed 101, tuned on", "test": "--seeds"}
    return make_split(parts, called)


def _study(arguments: argparse.Namespace, split: Split, out: Path) -> Study:
    from hatn_sim.errors import InputError
    from hatn_sim.kept import SAMPLES, folder_for
    from hatn_sim.learn.ablation_training import Study
    from hatn_sim.learn.cache import SampleCache
    from hatn_sim.learn.train import MAX_SEED

    # With "none", the processes that train still read them from a file.
    folder = folder_for(SAMPLES, arguments.cache) or out / "samples"
    if not 0 <= arguments.torch_seed <= MAX_SEED:
        raise InputError(
            f"--torch-seed {arguments.torch_seed}: expected 0 or more, and less than 2^64"
        )
    study = Study(split, SampleCache(folder), out / MODELS_FOLDER, seed=arguments.torch_seed)
    if arguments.epochs is None:
        return study
    return replace(study, how=replace(study.how, epochs=arguments.epochs))


def _samples(
    arguments: argparse.Namespace, study: Study, watch: Watch
) -> tuple[Samples, Samples, Mapping[str, Samples]]:
    """To learn from, to tune on, and to judge on, these by scene."""
    from hatn_sim.errors import InputError
    from hatn_sim.evaluation.pool import cores
    from hatn_sim.learn.ablation_training import whole
    from hatn_sim.learn.map_doubts import with_doubts
    from hatn_sim.learn.sources import gather
    from hatn_sim.learn.train import TrainingPlan, collect

    workers = arguments.workers or cores()
    plan = TrainingPlan(with_doubts(study.split, watch), {}, workers=workers, cache=study.cache)
    learn, tune = collect(plan, watch)
    test: dict[str, Samples] = {}
    for scene in dict.fromkeys(one.scenario.name for one in study.split.test):
        traffic = [one for one in study.split.test if one.scenario.name == scene]
        test[scene] = gather("test", traffic, study.cache, workers, watch)
        if not whole(test[scene]).any():
            raise InputError(f"{scene}: no vehicle is seen for 4 s in it; judge on longer traffic")
    return learn, tune, test


def _train(study: Study, rows: Sequence[Row], samples: int, workers: int, watch: Watch) -> None:
    """Train the networks that are missing, as many at a time as there are workers."""
    from hatn_sim.evaluation.pool import cores, work_on
    from hatn_sim.learn.ablation_training import Job, is_trained, train_model
    from hatn_sim.learn.ablations import in_order, models_of

    models = models_of(rows)
    called = {row.model: f"{row.table} {row.name}" for row in reversed(rows)}
    steps = study.how.epochs * math.ceil(samples / study.how.batch)
    trained = {model for model in models if is_trained(study, model)}
    watch.say(f"{len(trained)} of {len(models)} networks are trained already")
    for stage in in_order(models):
        wanted = [model for model in stage if model not in trained]
        names = [called.get(model, "sgn Ours") for model in wanted]

        def show(number: int, step: int, names: Sequence[str] = names) -> None:
            words = f"{names[number]} {min(step / steps, 1.0):.0%}"
            watch.step("networks", len(trained), len(models), words)

        jobs = [Job(study, model) for model in wanted]
        for number, card in work_on(train_model, jobs, workers or cores(), show):
            trained.add(wanted[number])
            figures = ", ".join(f"{key} {value:.3f}" for key, value in card["tune_figures"].items())
            watch.say(f"{names[number]}: {figures} on the tuning samples, {card['seconds']:.0f} s")
            watch.step("networks", len(trained), len(models), "")


def _draw(path: Path, judged: Judged) -> None:
    """The figure of the error by step, and its numbers."""
    from hatn_sim.report.steps_figure import draw_steps, write_steps

    if judged.steps:
        write_steps(path.with_suffix(".csv"), judged.steps)
        draw_steps(judged.steps, [path.with_suffix(".png"), path.with_suffix(".pdf")], "all")


def _traffic(split: Split, part: str) -> str:
    """A part of the split in words."""
    return " and ".join(_entry(entry) for entry in split.card()[part])


def _entry(entry: Mapping[str, Any]) -> str:
    if "seeds" in entry:
        return f"{entry['scene']} (seeds {_ranges(entry['seeds'])}, {entry['duration_s']:g} s each)"
    kind = "runs" if "runs" in entry else "recordings"
    count = len(entry[kind])
    return f"{entry['site']} ({count} {kind if count > 1 else kind[:-1]})"


def _ranges(numbers: Sequence[int]) -> str:
    """1, 2, 3, 7 as `1-3, 7`."""
    spans: list[list[int]] = []
    for number in sorted(numbers):
        if spans and number == spans[-1][-1] + 1:
            spans[-1] = [spans[-1][0], number]
        else:
            spans.append([number])
    return ", ".join("-".join(map(str, span)) for span in spans)


def _say_what_stays(out: Path) -> None:
    if out.exists():
        print(
            f"hatn-sim: what is trained stays in {out}, and the same command with --out {out} goes "
            "on from there",
            file=sys.stderr,
        )
