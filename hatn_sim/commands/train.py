"""Train HATN: play traffic, cut samples, fit the semantic graph network, then the encoder-decoder.

Writes a .safetensors file and beside it a .json card that says how the weights were made. The
traffic of --tune decides which epoch is kept; neither it nor what is learnt from may judge the
result. A training that was stopped goes on with the same command.
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hatn_sim.commands.options import add_lines_from, add_tracks, names, seconds, whole_number

if TYPE_CHECKING:
    from hatn_sim.hatn.weights_io import Weights
    from hatn_sim.learn.cache import SampleCache
    from hatn_sim.learn.settings import TrainingSettings
    from hatn_sim.learn.split import Split
    from hatn_sim.learn.sweep import Trial
    from hatn_sim.learn.train import TrainingPlan
    from hatn_sim.learn.watch import Watch

EXAMPLES = """examples:
  hatn-sim train --out my.safetensors
  hatn-sim train --tracks 'site/vehicle_tracks_*.csv' --map site.osm --recordings 000-014 \\
      --tune 015-016 --out site.safetensors
  hatn-sim train --split split.toml --sweep sweep.toml --out my.safetensors

The command that made the weights that ship is in their card, hatn_sim/hatn/weights/hatn.json.
"""
SCENES: Final = ("intersection5",)
SEEDS: Final = "1-12"
TUNE: Final = "101-102"
OF_SCENES: Final = ("scenes", "seeds", "duration", "risks", "density")
OF_TRACKS: Final = ("tracks", "map", "recordings")
SHOWN_TRIALS: Final = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hatn-sim train`."""
    parser.add_argument(
        "--scenes",
        type=names,
        metavar="A,B",
        help="scenes to learn from, or folders of runs (default: intersection5)",
    )
    parser.add_argument("--seeds", metavar="A-B", help=f"of the scenes (default: {SEEDS})")
    parser.add_argument(
        "--tune",
        metavar="A-B",
        help=f"seeds, or recordings, that choose the epoch (default: seeds {TUNE})",
    )
    parser.add_argument(
        "--duration", type=seconds, metavar="S", help="of traffic for each seed (default: 600)"
    )
    parser.add_argument(
        "--risks",
        type=names,
        metavar="A,B",
        help="risk profiles, the seeds taking them in turn (default: courteous)",
    )
    parser.add_argument("--density", metavar="light|normal|dense")
    add_tracks(parser, "in place of scenes")
    add_lines_from(parser, "auto")
    parser.add_argument(
        "--split", type=Path, metavar="FILE.toml", help="a file that names all of this instead"
    )
    parser.add_argument(
        "--form",
        choices=("hatn", "paper", "both"),
        help="the best networks, the paper's, or both (default: hatn, for --tracks both)",
    )
    parser.add_argument(
        "--start-from",
        metavar="shipped|nothing|FILE",
        help="weights that networks of the form hatn begin with (default: nothing; for --tracks "
        "those that ship: much of driving is the same everywhere)",
    )
    parser.add_argument("--settings", type=Path, metavar="FILE.toml", help="of networks and fits")
    parser.add_argument(
        "--sweep",
        type=Path,
        metavar="FILE.toml",
        help="try settings out, write the best to OUT.settings.toml and train nothing else",
    )
    parser.add_argument("--epochs", type=whole_number, metavar="N", help="of both networks")
    parser.add_argument("--sgn-epochs", type=whole_number, metavar="N")
    parser.add_argument("--edn-epochs", type=whole_number, metavar="N")
    parser.add_argument(
        "--workers", type=whole_number, metavar="N", help="processes (default: one for every core)"
    )
    parser.add_argument(
        "--torch-seed", type=int, default=0, metavar="N", help="0 or more (default: 0)"
    )
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument(
        "--cache", metavar="FOLDER|none", help="where samples are kept (default: the system's)"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.safetensors")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def main(arguments: argparse.Namespace) -> int:
    """Train and say what came out."""
    from hatn_sim.commands.train_progress import TrainProgress
    from hatn_sim.errors import InputError

    out: Path = arguments.out
    if out.suffix != ".safetensors":
        raise InputError(f"--out {out}: expected a name that ends in .safetensors")
    from hatn_sim.learn.train import TrainingPlan, check_free, train, weights_path

    # What is wrong is found before lines are drawn and traffic is played.
    forms = _forms(arguments)
    start = _start(arguments, forms)
    if arguments.sweep is None:
        check_free(out, forms)
    split = _split(arguments)
    cache = _cache(arguments)
    plan = TrainingPlan(
        split=split,
        forms=forms,
        start=start,
        seed=arguments.torch_seed,
        device=arguments.device,
        workers=arguments.workers or 0,
        cache=cache,
        command=_command(arguments),
    )
    with TrainProgress(arguments.quiet) as watch:
        if arguments.sweep is not None:
            return _sweep(arguments, plan, watch)
        if start is not None:
            watch.say(
                f"the networks begin with the weights {arguments.start_from} (to begin with none: "
                "--start-from nothing)"
            )
        cards = train(plan, out, watch)
        if cache.folder is not None:
            watch.say(f"samples kept in {cache.folder}: {cache.size_bytes() / 1e6:,.0f} MB")
    for form, card in cards.items():
        figures = ", ".join(f"{name} {value:.4f}" for name, value in card["tune_figures"].items())
        path = weights_path(out, form)
        print(f"{path}: {card['samples']:,} samples; on the tuning traffic {figures}")
    for doubt in _doubts(cards):
        print(f"in doubt: {doubt}")
    return 0


def _doubts(cards: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The first doubt about each map that was learnt from, in the words of the card."""
    entries = [
        entry for card in cards.values() for part in card["split"].values() for entry in part
    ]
    first = {entry["map"]: entry["doubts"][0] for entry in reversed(entries) if "doubts" in entry}
    return list(first.values())


def _split(arguments: argparse.Namespace) -> Split:
    from hatn_sim.commands.line_choices import drawing_lines
    from hatn_sim.errors import InputError
    from hatn_sim.learn.split import make_split, traffic_of_tracks
    from hatn_sim.learn.split_file import read_split

    given = {
        name for name in (*OF_SCENES, *OF_TRACKS, "tune") if getattr(arguments, name) is not None
    }
    if arguments.tracks is None and arguments.lines_from != "auto":
        raise InputError(f"--lines-from {arguments.lines_from} goes with --tracks; leave it out")
    if arguments.split is not None:
        for name in sorted(given):
            raise InputError(f"--{name}: --split names all traffic; leave one of them out")
        read_split(arguments.split, lines="lanes")  # every table, before lines are drawn for one
        with drawing_lines(arguments.cache, arguments.quiet) as drawing:
            return read_split(arguments.split, drawing)
    if arguments.tracks is None:
        for name in OF_TRACKS:
            if name in given:
                raise InputError(f"--{name} goes with --tracks; leave it out")
        return _split_of_scenes(arguments)
    for name in OF_SCENES:
        if name in given:
            raise InputError(f"--{name} is for scenes; leave it out with --tracks, or use --split")
    if not {"recordings", "tune"} <= given:
        raise InputError(f"--tracks: {_parts_missing(arguments)}")
    tracks, map_path, lines = arguments.tracks, arguments.map, arguments.lines_from
    with drawing_lines(arguments.cache, arguments.quiet) as drawing:
        parts = {
            part: traffic_of_tracks(tracks, map_path, wanted, lines, drawing)
            for part, wanted in (("train", arguments.recordings), ("tune", arguments.tune))
        }
    return make_split(parts, {"train": "--recordings", "tune": "--tune"})


def _parts_missing(arguments: argparse.Namespace) -> str:
    """What to add so that some recordings are learnt from and others tuned on."""
    from hatn_sim.config import load_tracks, recording_names
    from hatn_sim.recordings.interaction.files import group_files

    source = load_tracks(arguments.tracks, arguments.map, ()).recorded
    assert source is not None
    every = [one.name for one in group_files(source.tracks, ())]
    learnt, tuned = (recording_names(text or "") for text in (arguments.recordings, arguments.tune))
    rest = [name for name in every if name not in (*learnt, *tuned)]
    few = max(1, min(2, len(rest) // 4))
    what = "recordings to learn from and others to tune on"
    if learnt and rest:
        return f"expected {what}; add --tune {_span(rest[:few])}"
    if tuned and rest:
        return f"expected {what}; add --recordings {_span(rest)}"
    if len(every) < 2:
        return f"expected {what}, found {len(every)}; name more with --tracks"
    last = max(1, min(2, len(every) // 4))
    instead = "say" if learnt or tuned else "add"
    return (
        f"expected {what}; {instead} --recordings {_span(every[:-last])} "
        f"--tune {_span(every[-last:])}"
    )


def _span(names: Sequence[str]) -> str:
    """Names of recordings as the options take them, `000-014` where they follow each other."""
    from hatn_sim.config import recording_names

    if len(names) > 1 and all(name.isdecimal() for name in names):
        span = f"{names[0]}-{names[-1]}"
        if recording_names(span) == tuple(names):
            return span
    return ",".join(names)


def _split_of_scenes(arguments: argparse.Namespace) -> Split:
    """Scenes by their seeds, and runs by the seeds that they were made with."""
    from hatn_sim.config import seed_numbers
    from hatn_sim.errors import InputError
    from hatn_sim.learn.split import DURATION_S, make_split, traffic_of_runs, traffic_of_scenes

    words = SCENES if arguments.scenes is None else arguments.scenes
    if not words or arguments.risks == ():
        raise InputError("--scenes, --risks, --seeds and --tune: expected at least one of each")
    folders = [word for word in words if (Path(word) / "run.json").is_file()]
    scenes = [word for word in words if word not in folders]
    runs = traffic_of_runs(folders)
    parts = {}
    for part, option, given, default in (
        ("train", "--seeds", arguments.seeds, SEEDS),
        ("tune", "--tune", arguments.tune, TUNE),
    ):
        wanted = seed_numbers(default if given is None else given, f"{option}: ")
        parts[part] = traffic_of_scenes(
            scenes,
            wanted,
            arguments.risks or (),
            arguments.density,
            arguments.duration or DURATION_S,
        ) + [run for run in runs if run.seed in wanted]
    for run in runs:
        if not any(run in part for part in parts.values()):
            raise InputError(
                f"--scenes: {run.name} was made with seed {run.seed}, which is neither in --seeds "
                "nor in --tune; add it to one"
            )
    return make_split(parts, {"train": "--seeds", "tune": "--tune"})


def _cache(arguments: argparse.Namespace) -> SampleCache:
    from hatn_sim.kept import SAMPLES, folder_for
    from hatn_sim.learn.cache import SampleCache

    return SampleCache(folder_for(SAMPLES, arguments.cache))


def _forms(arguments: argparse.Namespace) -> dict[str, TrainingSettings]:
    """The settings of every form that was asked for."""
    from hatn_sim.learn.settings import FORMS, read_settings

    form = arguments.form or ("hatn" if arguments.tracks is None else "both")
    forms = {name: one for name, one in FORMS.items() if form in (name, "both")}
    if arguments.settings is not None:
        forms = {name: read_settings(arguments.settings, one) for name, one in forms.items()}
    sgn, edn = arguments.sgn_epochs or arguments.epochs, arguments.edn_epochs or arguments.epochs
    if sgn is not None:
        forms = {k: replace(f, sgn_fit=replace(f.sgn_fit, epochs=sgn)) for k, f in forms.items()}
    if edn is not None:
        forms = {k: replace(f, edn_fit=replace(f.edn_fit, epochs=edn)) for k, f in forms.items()}
    return forms


def _start(arguments: argparse.Namespace, forms: dict[str, TrainingSettings]) -> Weights | None:
    """The weights to begin with; the settings of `forms` are made to suit them."""
    from hatn_sim.errors import InputError
    from hatn_sim.hatn.weights_io import load_weights
    from hatn_sim.learn.settings import started
    from hatn_sim.learn.train import STARTED_FORM
    from hatn_sim.resources import weights_dir

    wanted: str | None = arguments.start_from
    settings = forms.get(STARTED_FORM)
    if wanted is not None and wanted != "nothing":
        if settings is None:
            raise InputError("--start-from: the paper's form begins with nothing; leave it out")
        if arguments.sweep is not None:
            raise InputError("--start-from: a sweep begins with nothing; leave one of them out")
    by_itself = wanted is None
    if by_itself:
        of_people = arguments.tracks is not None and arguments.sweep is None
        wanted = "shipped" if of_people else "nothing"
    if wanted == "nothing" or settings is None:
        return None
    path = weights_dir() / "hatn.safetensors" if wanted == "shipped" else Path(wanted)
    start = load_weights(path)
    if (start.sgn.settings, start.edn.settings) != (settings.sgn, settings.edn):
        if not by_itself:
            raise InputError(
                f"--start-from {wanted}: its networks have other settings than these; "
                "train with the settings of its card, or with --start-from nothing"
            )
        return None
    arguments.start_from = wanted  # for the card
    if arguments.settings is None:
        forms[STARTED_FORM] = started(settings)
    return start


def _sweep(arguments: argparse.Namespace, plan: TrainingPlan, watch: Watch) -> int:
    from hatn_sim.errors import InputError
    from hatn_sim.learn.settings import changed, settings_toml
    from hatn_sim.learn.sweep import best_trial, read_sweep, run_sweep
    from hatn_sim.whole_file import save_whole

    if len(plan.forms) > 1:
        raise InputError("--sweep tries out one form: add --form hatn or --form paper")
    (basis,) = plan.forms.values()
    sweep = read_sweep(arguments.sweep, basis)
    found = run_sweep(plan, sweep, basis, arguments.out.with_suffix(".sweep.jsonl"), watch)
    best = best_trial(found, sweep.judged_by)
    path = arguments.out.with_suffix(".settings.toml")
    text = settings_toml(changed(basis, str(arguments.sweep), best.values))
    save_whole(path, text)
    _print_trials(found, sweep.judged_by)
    print(f"best settings in {path}; train with --settings {path}")
    return 0


def _print_trials(found: list[Trial], judged_by: str) -> None:
    from rich.table import Table

    from hatn_sim.commands.console import make_console

    ranked = sorted(found, key=lambda one: one.figures.get(judged_by, float("inf")))
    figures = list(dict.fromkeys(name for one in ranked for name in one.figures))
    table = Table(box=None, pad_edge=False)
    for name in (*ranked[0].values, *figures):
        table.add_column(name, justify="right")
    for one in ranked[:SHOWN_TRIALS]:
        values = [
            f"{value:.4f}" if (value := one.figures.get(name)) is not None else "-"
            for name in figures
        ]
        table.add_row(*(str(value) for value in one.values.values()), *values)
    console = make_console()
    console.print(table)
    if len(ranked) > SHOWN_TRIALS:
        console.print(f"and {len(ranked) - SHOWN_TRIALS} more")


def _command(arguments: argparse.Namespace) -> str:
    """The command that does the same again: what was given, without paths of anybody's folders."""
    words = ["hatn-sim", "train"]
    for name, value in vars(arguments).items():
        if name in ("verb", "quiet", "cache", "workers", "sweep") or value is None:
            continue
        option = f"--{name.replace('_', '-')}"
        if isinstance(value, Path):
            words += [option, value.name]
        elif name == "tracks":
            words += [option, *(Path(pattern).name for pattern in value)]
        else:
            words += [option, ",".join(value) if isinstance(value, tuple) else f"{value}"]
    return shlex.join(words)
