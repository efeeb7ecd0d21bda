"""`hatn-sim train`: samples of a split, the SGN alone, then the EDN on what the SGN predicts."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from safetensors.torch import save as tensor_bytes

import hatn_sim
from hatn_sim.errors import HatnSimError, InputError
from hatn_sim.evaluation.pool import cores
from hatn_sim.hatn.edn import EncoderDecoderNetwork
from hatn_sim.hatn.inputs import Float32Array
from hatn_sim.hatn.sgn import SemanticGraphNetwork
from hatn_sim.hatn.weights_io import (
    START,
    Weights,
    choice_of,
    choice_tensors,
    make_folder,
    save_weights,
)
from hatn_sim.kept import source_version
from hatn_sim.learn import edn_training
from hatn_sim.learn.cache import SampleCache, key_of
from hatn_sim.learn.dataset import Samples
from hatn_sim.learn.fit import Figures, FitSettings, LossError, Workplace, fit
from hatn_sim.learn.map_doubts import with_doubts
from hatn_sim.learn.settings import TrainingSettings
from hatn_sim.learn.sgn_training import Fit, predicted_profiles, train_sgn
from hatn_sim.learn.site_lines import SiteChoice, fit_to_sites
from hatn_sim.learn.sources import gather
from hatn_sim.learn.split import Split
from hatn_sim.learn.watch import Nobody, Watch
from hatn_sim.whole_file import ROOM_OR_OUT, save_whole

MAX_SEED: Final = 2**64 - 1
"""The largest that torch takes."""
PLAN_FILE: Final = "plan.json"
LINES: Final = "line_choice"
"""In plan and card: of the choice of lines fitted to the sites; None: that which ships."""
LINES_FILE: Final = "line_choice.safetensors"
STOPPED: Final = "stopped"
"""In a card: how the loss was lost; the weights are those of an epoch before."""
STARTED_FORM: Final = "hatn"
"""What may begin with trained weights."""
OF_FORM: Final = {"hatn": "", "paper": "-paper"}
"""What the name of a form's weights ends in."""


@dataclass(frozen=True, eq=False)
class TrainingPlan:
    """What `hatn-sim train` was asked to do."""

    split: Split
    forms: Mapping[str, TrainingSettings]  # of `OF_FORM`
    seed: int = 0
    device: str = "cpu"
    workers: int = 0  # processes that make samples; 0: one for every core
    cache: SampleCache = field(default_factory=lambda: SampleCache(None))
    command: str = ""
    start: Weights | None = None  # that the form `hatn` begins with; the paper's begins with none


def train(plan: TrainingPlan, out: Path, watch: Watch | None = None) -> dict[str, dict[str, Any]]:
    """Train every form, write its weights and their card, and return the cards by form.

    A training that was stopped goes on where it was: what is done lies in `OUT.progress` until all
    is written.

    Raises:
        InputError: before any traffic is played where plan or folder is unfit, before anything is
            trained where the traffic gave too little to learn from, and where a disk is full.
        HatnSimError: traffic fails, or a loss is lost; see `LossError`.
    """
    watch = watch or Nobody()
    place = replace(begin_work(plan, out, watch), progress=progress_folder(out))
    going_on = _goes_on(plan, out)
    plan = replace(plan, split=with_doubts(plan.split, watch))
    site = _kept_choice(out) if going_on else fit_lines(plan, watch)
    learn, tune = collect(choosing(plan, site), watch)
    if not going_on:
        _begin(plan, out, site)
    cards: dict[str, dict[str, Any]] = {}
    for form, settings in plan.forms.items():
        path = weights_path(out, form)
        if going_on and (done := _finished_card(path)) is not None:
            cards[form] = done
            continue
        of_form = replace(place, form=form if len(plan.forms) > 1 else "")
        card = _card(plan, form, settings, len(learn), len(tune), site)
        save = partial(save_weights, path, line_choice=site and site.choice)
        start = plan.start if form == STARTED_FORM else None
        cards[form] = _train_form(learn, tune, settings, start, of_form, path, card, save)
    shutil.rmtree(progress_folder(out), ignore_errors=True)
    return cards


def _train_form(
    learn: Samples,
    tune: Samples,
    settings: TrainingSettings,
    start: Weights | None,
    place: Workplace,
    path: Path,
    card: Mapping[str, Any],
    save: Callable[[SemanticGraphNetwork, EncoderDecoderNetwork, Mapping[str, Any]], None],
) -> dict[str, Any]:
    """Train both networks, `save` them to `path` with their card, and return this.

    Where a loss is lost, what was good before is written nevertheless: both networks to `path`, or
    an SGN alone into the folder of progress.
    """
    try:
        sgn, figures = fit_sgn(learn, tune, settings, place, start and start.sgn)
    except LossError as lost:
        if not lost.epoch or place.progress is None:
            raise
        kept = place.progress / f"{path.stem}-sgn.safetensors"
        save_whole(kept, tensor_bytes(lost.model.state_dict()), ROOM_OR_OUT)
        raise HatnSimError(f"{lost}, in {kept}") from None
    try:
        edn, more = fit_edn(learn, tune, sgn, settings, place, start and start.edn)
    except LossError as lost:
        if not lost.epoch:
            raise
        assert isinstance(lost.model, EncoderDecoderNetwork)
        stopped = {"tune_figures": _known(figures | lost.figures), STOPPED: str(lost)}
        save(sgn, lost.model, {**card, **stopped})
        raise HatnSimError(f"{lost}, in {path}") from None
    whole = {**card, "tune_figures": _known(figures | more)}
    save(sgn, edn, whole)
    return whole


def _known(figures: Figures) -> Figures:
    """Without those that the tuning samples tell nothing of."""
    return {name: value for name, value in figures.items() if math.isfinite(value)}


def collect(plan: TrainingPlan, watch: Watch) -> tuple[Samples, Samples]:
    """The samples to learn from and to tune on. Raises InputError where they are too few."""
    found: list[Samples] = []
    for part in ("train", "tune"):
        traffic = plan.split.part(part)
        recorded = [one for piece in traffic if (one := piece.scenario.recorded) is not None]
        notices = dict.fromkeys(one.lines_notice for one in recorded if one.lines_notice)
        if drawn := sum(one.drawn is not None for one in recorded):
            notices[f"lines of {drawn} recordings drawn from the tracks of others"] = None
        for notice in notices:
            watch.say(f"traffic to {part}: {notice}")
        samples = gather(part, traffic, plan.cache, _workers(plan), watch)
        _check_samples(part, samples, len(traffic))
        found.append(samples)
    return found[0], found[1]


def fit_sgn(
    learn: Samples,
    tune: Samples,
    settings: TrainingSettings,
    place: Workplace,
    start: SemanticGraphNetwork | None = None,
) -> tuple[SemanticGraphNetwork, Figures]:
    """The semantic graph network and its figures. Raises as `fit`."""
    how = _fitting("SGN", settings.sgn_fit, place)
    return train_sgn(learn, tune, settings.sgn, how, start)


def fit_edn(
    learn: Samples,
    tune: Samples,
    sgn: SemanticGraphNetwork,
    settings: TrainingSettings,
    place: Workplace,
    start: EncoderDecoderNetwork | None = None,
) -> tuple[EncoderDecoderNetwork, Figures]:
    """The encoder-decoder network, on what the SGN predicts, and its figures.

    Raises as `fit`; a `LossError` then holds the network's last good weights.
    """
    profiles = [predicted_profiles(sgn, samples) for samples in (learn, tune)]
    how = _fitting("EDN", settings.edn_fit, place)
    model = make_edn(settings, profiles[0])
    if start is not None:
        model.load_state_dict(start.state_dict())
    goals, tune_goals = (edn_training.goals_of(model, one) for one in profiles)
    return model, how(
        model,
        learn,
        lambda samples, rows: edn_training.training_loss(model, samples, goals, rows),
        lambda: edn_training.figures(model, tune, tune_goals),
        "ade_3s_m",
    )


def make_edn(settings: TrainingSettings, profiles: Float32Array) -> EncoderDecoderNetwork:
    """An untrained network that takes no more of a profile [S, P] than there is."""
    steps = min(settings.edn.goal_steps, profiles.shape[1])
    return EncoderDecoderNetwork(replace(settings.edn, goal_steps=steps))


def _fitting(name: str, how: FitSettings, place: Workplace) -> Fit:
    torch.manual_seed(place.seed)  # for the weights that it begins with
    return partial(fit, name=name, settings=how, place=place)


def weights_path(out: Path, form: str) -> Path:
    """Where the weights of a form go."""
    return out.with_name(f"{out.stem}{OF_FORM[form]}{out.suffix}")


def progress_folder(out: Path) -> Path:
    """Where a training keeps what is done until all is written."""
    return out.with_suffix(".progress")


def _goes_on(plan: TrainingPlan, out: Path) -> bool:
    """Whether a training of the same plan goes on. Raises InputError where files are in the way."""
    folder = progress_folder(out)
    path = folder / PLAN_FILE
    ours = described(plan)
    if path.is_file():
        try:
            theirs: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            other = [key for key in ours if theirs.get(key) != ours[key]]
        except (ValueError, AttributeError):  # no JSON, or no object
            other = list(ours)
        if other:
            raise InputError(
                f"{folder}: is of a training with other {', '.join(other)}; remove the folder to "
                "begin anew, or choose another --out"
            )
        return True
    check_free(out, plan.forms)
    return False


def check_free(out: Path, forms: Iterable[str]) -> None:
    """InputError where files are in the way of a training's, unless it is one that goes on."""
    if (progress_folder(out) / PLAN_FILE).is_file():
        return
    for form in forms:
        for taken in (weights_path(out, form), weights_path(out, form).with_suffix(".json")):
            if taken.exists():
                raise InputError(
                    f"--out {out}: {taken.name} exists already; choose another name or remove it"
                )


def _finished_card(path: Path) -> dict[str, Any] | None:
    """The card of weights that are trained to the end; None: not there, or their loss was lost."""
    if not path.exists():
        return None
    card: dict[str, Any] = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    return None if STOPPED in card else card


def _begin(plan: TrainingPlan, out: Path, site: SiteChoice | None) -> None:
    path = progress_folder(out) / PLAN_FILE
    text = json.dumps({**described(plan), LINES: None if site is None else site.card})
    if site is not None:
        tensors = tensor_bytes(choice_tensors(site.choice))
        save_whole(path.with_name(LINES_FILE), tensors, ROOM_OR_OUT)
    save_whole(path, text, ROOM_OR_OUT)


def _kept_choice(out: Path) -> SiteChoice | None:
    """The choice of lines that a training which goes on began with.

    Raises InputError where it is lost or damaged: what was trained hangs on it.
    """
    folder = progress_folder(out)
    path = folder / LINES_FILE
    card = json.loads((folder / PLAN_FILE).read_text(encoding="utf-8")).get(LINES)
    if card is None:
        return None
    try:
        return SiteChoice(choice_of(path, load_file(path)), card)
    except (OSError, SafetensorError, InputError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{path}: not the choice of lines of this training ({reason[:160]}); remove the folder "
            "to begin anew"
        ) from None


def fit_lines(plan: TrainingPlan, watch: Watch) -> SiteChoice | None:
    """The choice of lines for the plan's recordings; None: that which ships is as good."""
    return fit_to_sites(plan.split, _workers(plan), watch)


def choosing(plan: TrainingPlan, site: SiteChoice | None) -> TrainingPlan:
    """The plan with the choice of lines that `fit_lines` found."""
    return plan if site is None else replace(plan, split=plan.split.with_choice(site.choice))


def _workers(plan: TrainingPlan) -> int:
    return plan.workers or cores()


def described(plan: TrainingPlan) -> dict[str, Any]:
    """What a training hangs on: the same gives the same weights."""
    keys = [[key_of(one) for one in plan.split.part(part)] for part in ("train", "tune")]
    settings = {form: asdict(one) for form, one in plan.forms.items()}
    return {
        "traffic": hashlib.sha256(json.dumps(keys).encode()).hexdigest(),
        "settings": settings,
        "torch_seed": plan.seed,
        "device": plan.device,
        "start": None if plan.start is None else plan.start.sha256,
        "versions": [torch.__version__, source_version(everything=True)],
    }


def begin_work(plan: TrainingPlan, out: Path, watch: Watch) -> Workplace:
    """Where a plan is carried out, without checkpoints; the folder of `out` is made.

    Raises InputError where seed, device or folder are unfit.
    """
    if not 0 <= plan.seed <= MAX_SEED:
        raise InputError(f"--torch-seed {plan.seed}: expected 0 or more, and less than 2^64")
    if plan.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: torch finds no such device here; leave it out")
    make_folder(out)
    torch.set_num_threads(1)  # two are slower at this size
    return Workplace(plan.seed, torch.device(plan.device), watch=watch)


def _check_samples(part: str, samples: Samples, pieces: int) -> None:
    """InputError unless there is something of every kind to learn from, and to judge by."""
    kinds = {
        "with a known goal": samples.goal_mask[:, 0],
        "with a whole path": samples.future_mask.all(axis=1),
        "with a choice of slots": (samples.slot >= 0) & (samples.focus_mask.sum(axis=1) > 1),
    }
    counts = {kind: int(rows.sum()) for kind, rows in kinds.items()}
    if not all(counts.values()):
        found = ", ".join(f"{count} {kind}" for kind, count in counts.items())
        raise InputError(
            f"traffic to {part}: too little to learn from: {len(samples)} samples, {found}, in "
            f"{pieces} piece{'s' if pieces > 1 else ''} of traffic; give longer ones or more"
        )


def _start_card(start: Weights) -> dict[str, Any]:
    kept = ("command", "split", START)
    return {"sha256": start.sha256} | {key: start.card[key] for key in kept if key in start.card}


def _card(
    plan: TrainingPlan,
    form: str,
    settings: TrainingSettings,
    learn: int,
    tune: int,
    site: SiteChoice | None,
) -> dict[str, Any]:
    return {
        "made_by": f"hatn-sim {hatn_sim.__version__}",
        "command": plan.command,
        "command_of_files": "their names alone: folders are left out, put yours before them",
        "form": form,
        "split": plan.split.card(),
        START: None if plan.start is None or form != STARTED_FORM else _start_card(plan.start),
        "fit": {"sgn": asdict(settings.sgn_fit), "edn": asdict(settings.edn_fit)},
        "torch_seed": plan.seed,
        "samples": learn,
        "tune_samples": tune,
        LINES: None if site is None else dict(site.card),
    }
