"""The networks of the paper's ablations, each trained alone on the same traffic.

A network that is done is a small file in one folder, named by a hash of all that it hangs on:
settings, goals, traffic, how it is fitted. So none is trained twice, and none is out of date.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cache, partial
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save
from torch import nn

import hatn_sim
from hatn_sim.content import content_hash
from hatn_sim.datatypes import BoolArray
from hatn_sim.hatn.edn import EncoderDecoderNetwork
from hatn_sim.hatn.inputs import Float32Array
from hatn_sim.hatn.sgn import SemanticGraphNetwork
from hatn_sim.learn import edn_training
from hatn_sim.learn.ablations import EdnModel, Model, SgnModel
from hatn_sim.learn.cache import SampleCache, key_of
from hatn_sim.learn.dataset import Samples, concatenate
from hatn_sim.learn.fit import Figures, FitSettings, Workplace, fit
from hatn_sim.learn.sgn_training import predicted_profiles, train_sgn
from hatn_sim.learn.sources import samples_of
from hatn_sim.learn.split import Split, Traffic
from hatn_sim.resources import PACKAGE_DIR
from hatn_sim.whole_file import save_whole

HOW: Final = FitSettings(epochs=20, batch=128, learning_rate=5e-3)
"""Many short steps: decoders that say where on the map a vehicle will be take thousands to learn
what increments know from the first on, and are still the worse for it."""
HANGS_ON: Final = (
    "hatn/anchors.py",
    "hatn/edn*.py",
    "hatn/inputs.py",
    "hatn/kinematics.py",
    "hatn/sgn*.py",
    "hatn/slots.py",
    "hatn/travel.py",
    "learn/ablation_training.py",
    "learn/augment.py",
    "learn/batches.py",
    "learn/edn_training.py",
    "learn/fit.py",
    "learn/sgn_loss.py",
    "learn/sgn_training.py",
)
"""The source that makes a trained network what it is, beside that of the samples."""
CARD: Final = "card"
LEARNT: Final = ("train", "tune")
"""Parts of the split that a network hangs on."""

Network = TypeVar("Network", bound=nn.Module)


class Teller(Protocol):
    """Is told how many steps are done; raises what ends the training early."""

    def tell(self, steps: int) -> None: ...


@dataclass(frozen=True, eq=False)
class Study:
    """What all networks of some tables have in common."""

    split: Split
    cache: SampleCache  # has the samples of the split; those that it lost are cut again
    folder: Path
    how: FitSettings = HOW
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Job:
    """One network to train; may be sent to another process."""

    study: Study
    model: Model


def path_of(study: Study, model: Model) -> Path:
    """The file of a trained network."""
    hangs_on = {
        "model": _described(model),
        "traffic": {part: [key_of(one) for one in study.split.part(part)] for part in LEARNT},
        "how": asdict(study.how),
        "seed": study.seed,
        "versions": [torch.__version__, hatn_sim.__version__, _source_version()],
    }
    digest = hashlib.sha256(json.dumps(hangs_on, sort_keys=True).encode()).hexdigest()[:16]
    kind = "sgn" if isinstance(model, SgnModel) else "edn"
    return study.folder / f"{kind}-{digest}.safetensors"


def is_trained(study: Study, model: Model) -> bool:
    """Whether the network's file is there and whole."""
    return bool(card_of(study, model))


def card_of(study: Study, model: Model) -> Mapping[str, Any]:
    """What the file of a network says of it; empty where there is none that can be read."""
    path = path_of(study, model)
    try:
        with safe_open(path, framework="pt") as file:  # pyright: ignore[reportUnknownVariableType]
            card: Mapping[str, Any] = json.loads(file.metadata()[CARD])
    except Exception:  # whatever a damaged file makes of its reader
        return {}
    return card


def train_model(job: Job, teller: Teller) -> Mapping[str, Any]:
    """Train a network, write its file, and return its card.

    A training that was stopped goes on at the last epoch that it finished. The semantic graph
    network that tells the goals must be trained.

    Raises:
        LossError: the loss is not finite.
        InputError: the file cannot be written.
    """
    study, model = job.study, job.model
    torch.set_num_threads(1)
    torch.manual_seed(study.seed)
    path = path_of(study, model)
    progress = path.with_suffix(".progress")
    started = time.monotonic()
    learn, tune = (learning_samples(study, part, model) for part in LEARNT)
    fitting = partial(
        fit,
        name=path.stem,
        settings=study.how,
        place=Workplace(study.seed, progress=progress, watch=_Telling(teller)),
    )
    if isinstance(model, SgnModel):
        network, figures = train_sgn(learn, tune, model.settings, fitting)
    else:
        network, figures = _train_edn(study, model, learn, tune, fitting)
    card = {
        "model": _described(model),
        "split": {part: study.split.card()[part] for part in LEARNT},
        "samples": len(learn),
        "tune_samples": len(tune),
        "how": asdict(study.how),
        "torch_seed": study.seed,
        "tune_figures": figures,
        "seconds": round(time.monotonic() - started, 1),
    }
    data = save(network.state_dict(), {CARD: json.dumps(card)})
    save_whole(
        path, data, "make room and give the same command again, which trains what is missing"
    )
    shutil.rmtree(progress, ignore_errors=True)
    return card


def _train_edn(
    study: Study, model: EdnModel, learn: Samples, tune: Samples, fitting: Callable[..., Figures]
) -> tuple[EncoderDecoderNetwork, Figures]:
    goals, tune_goals = (goals_told(study, model, samples) for samples in (learn, tune))
    network = EncoderDecoderNetwork(model.settings)
    return network, fitting(
        network,
        learn,
        lambda samples, rows: edn_training.training_loss(network, samples, goals, rows),
        lambda: edn_training.figures(network, tune, tune_goals),
        "ade_3s_m",
    )


def load_sgn(study: Study, model: SgnModel) -> SemanticGraphNetwork:
    """A trained network, to predict with."""
    return _filled(SemanticGraphNetwork(model.settings), path_of(study, model))


def load_edn(study: Study, model: EdnModel) -> EncoderDecoderNetwork:
    """A trained network, to predict with."""
    return _filled(EncoderDecoderNetwork(model.settings), path_of(study, model))


def goals_told(study: Study, model: EdnModel, samples: Samples) -> Float32Array:
    """The goals [S, goal_steps] in metres that the network is told: zeros where it is told none."""
    steps = model.settings.goal_steps
    if isinstance(model.goals, SgnModel):
        return predicted_profiles(load_sgn(study, model.goals), samples)[:, -steps:]
    profile = samples.profile_m[:, 0, -steps:]
    return profile if model.goals == "true" else np.zeros_like(profile)


def learning_samples(study: Study, part: str, model: Model) -> Samples:
    """What a network is trained on, or tuned: samples of `part`.

    Encoder-decoder networks have the samples whose future is wholly known, whatever they are told.
    """
    samples = _all_samples(study.split.part(part), study.cache)
    return samples if isinstance(model, SgnModel) else _whole_only(samples)


def whole(samples: Samples) -> BoolArray:
    """Samples [S] whose future is wholly known."""
    return samples.future_mask.all(axis=1) & samples.goal_mask[:, 0]


def rows_where(samples: Samples, chosen: BoolArray) -> Samples:
    """The chosen [S] rows."""
    return Samples(**{one.name: getattr(samples, one.name)[chosen] for one in fields(Samples)})


_READ: Final[dict[tuple[str, ...], Samples]] = {}
"""A working process trains one network after the other on the same samples."""


def _all_samples(traffic: Sequence[Traffic], cut: SampleCache) -> Samples:
    keys = tuple(key_of(one) for one in traffic)
    if keys not in _READ:
        parts: list[Samples] = []
        for one in traffic:
            found = cut.load(one)
            parts.append(samples_of(one) if found is None else found)
        _READ[keys] = concatenate(parts)
    return _READ[keys]


@cache
def _whole_only(samples: Samples) -> Samples:
    return rows_where(samples, whole(samples))


class _Telling:
    """A `Watch` that passes steps on."""

    def __init__(self, teller: Teller) -> None:
        self._teller = teller

    def step(self, stage: str, done: int, total: int, words: str) -> None:
        self._teller.tell(done)

    def say(self, line: str) -> None:
        pass


def _filled(network: Network, path: Path) -> Network:
    network.load_state_dict(load_file(path))
    return network.eval()


def _described(model: Model) -> dict[str, Any]:
    kind = "sgn" if isinstance(model, SgnModel) else "edn"
    return {"kind": kind, **asdict(model)}


@cache
def _source_version() -> str:
    files = sorted({path for pattern in HANGS_ON for path in PACKAGE_DIR.glob(pattern)})
    return hashlib.sha256(" ".join(content_hash(path) for path in files).encode()).hexdigest()
