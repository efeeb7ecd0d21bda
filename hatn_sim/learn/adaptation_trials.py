"""The trials of the study of online adaptation: every run of traffic a job on a core of its own."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import torch

from hatn_sim.content import content_hash
from hatn_sim.datatypes import Frame, Simulator
from hatn_sim.errors import HatnSimError
from hatn_sim.hatn.adaptation_layer import LAYERS, Layer
from hatn_sim.hatn.adaptation_memory import MAX_STEPS, Method, default_settings
from hatn_sim.hatn.predictor import Hatn
from hatn_sim.kept import source_version
from hatn_sim.learn.adaptation_study import VehicleErrors, Watched, vehicle_errors, watch
from hatn_sim.learn.cache import key_of
from hatn_sim.learn.split import Traffic
from hatn_sim.loop import warm_up
from hatn_sim.traffic import open_traffic
from hatn_sim.whole_file import ROOM_OR_OUT, save_whole

LAST: Final[Layer] = "dense3"
STEPS: Final = tuple(range(1, MAX_STEPS + 1))
LAYER_STEPS: Final = (1, 2, 3, 4, 5)
METHOD_STEPS: Final = 3
LAYER_FRAMES: Final = 100
"""The sweep over layers is of the first frames of a run only: the large ones take long."""


@dataclass(frozen=True)
class Trial:
    """One way to adapt."""

    method: Method
    layer: Layer
    steps: int
    frames: int | None = None  # of the run; None: all


TRIALS: Final = (
    *(Trial("mekf", LAST, steps) for steps in STEPS),
    *(Trial(method, LAST, METHOD_STEPS) for method in ("sgd", "rls")),
    *(Trial("mekf", layer, steps, LAYER_FRAMES) for layer in LAYERS for steps in LAYER_STEPS),
)


class Teller(Protocol):
    """Is told how many frames are done; raises what ends the work early."""

    def tell(self, steps: int) -> None: ...


@dataclass(frozen=True, eq=False)
class Job:
    """All trials of one network on one run."""

    network: str
    weights: Path
    traffic: Traffic
    folder: Path
    trials: tuple[Trial, ...]


Results = Mapping[Trial, VehicleErrors]


def find_results(job: Job) -> Results | None:
    """What a job found before, None where it has not been done or its file is damaged."""
    try:
        with np.load(_path(job), allow_pickle=False) as arrays:
            return {
                trial: VehicleErrors(arrays[f"sum_m_{k}"], arrays[f"n_{k}"])
                for k, trial in enumerate(job.trials)
            }
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def do_trials(job: Job, teller: Teller) -> Results:
    """Watch the traffic, try everything, keep what was found. Raises HatnSimError."""
    try:
        return _do(job, teller)
    except HatnSimError as error:
        raise type(error)(f"{job.traffic.name}: {error}") from None


def _do(job: Job, teller: Teller) -> Results:
    torch.set_num_threads(1)
    hatn = Hatn(job.weights, job.network)
    watched = _watch(hatn, job.traffic, teller)
    done = len(watched.moments)
    results: dict[Trial, VehicleErrors] = {}
    for trial in job.trials:
        some = watched if trial.frames is None else watched.until(trial.frames)
        settings = replace(
            default_settings(hatn.weights.edn),
            method=trial.method,
            layer=trial.layer,
            steps=trial.steps,
        )
        results[trial] = vehicle_errors(hatn.weights.edn, some, settings)
        done += len(some.moments)
        teller.tell(done)
    _keep(job, results)
    return results


def frames_of(job: Job, watched: int) -> int:
    """How many frames a job is told of, where `watched` are watched."""
    each = (watched if trial.frames is None else min(trial.frames, watched) for trial in job.trials)
    return watched + sum(each)


def _watch(hatn: Hatn, traffic: Traffic, teller: Teller) -> Watched:
    with closing(open_traffic(traffic.scenario)) as simulator:
        first = simulator.reset(traffic.seed)
        first = warm_up(simulator, first, round(traffic.warm_up_s / simulator.dt_s))
        return watch(hatn, simulator.road, _frames(simulator, first, traffic.duration_s, teller))


def _frames(
    simulator: Simulator, frame: Frame, duration_s: float | None, teller: Teller
) -> Iterator[Frame]:
    """`frame` and what follows in `duration_s`, or to the end."""
    total = None if duration_s is None else max(1, round(duration_s / simulator.dt_s))
    done = 1
    yield frame
    while not frame.done and done != total:
        frame = simulator.step()
        done += 1
        teller.tell(done)
        yield frame


def _path(job: Job) -> Path:
    """The file is named by all that its numbers hang on."""
    hangs_on = {
        "network": content_hash(job.weights),
        "traffic": key_of(job.traffic),
        "trials": [asdict(trial) for trial in job.trials],
        "versions": [torch.__version__, source_version(everything=True)],
    }
    digest = hashlib.sha256(json.dumps(hangs_on, sort_keys=True).encode()).hexdigest()[:16]
    return job.folder / f"{job.network}-{digest}.npz"


def _keep(job: Job, results: Results) -> None:
    arrays: dict[str, Any] = {f"sum_m_{k}": found.sum_m for k, found in enumerate(results.values())}
    arrays |= {f"n_{k}": found.n for k, found in enumerate(results.values())}
    data = io.BytesIO()
    np.savez(data, **arrays)
    save_whole(_path(job), data.getbuffer(), ROOM_OR_OUT)
