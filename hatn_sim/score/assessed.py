"""One assessed run: what scoring needs of it and no more, in one file, whole or not at all."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np

from hatn_sim.datatypes import FloatArray, SafetyEvent
from hatn_sim.errors import InputError
from hatn_sim.score.advised import Advised
from hatn_sim.score.dangers import DangerTrace
from hatn_sim.score.sign_traces import SignTrace
from hatn_sim.whole_file import ROOM_OR_OUT, save_whole

FORMAT: Final = 4
_TRACE: Final = ("time_s", "first", "second", "danger", "type", "touched")


@dataclass(frozen=True, eq=False)
class AssessedRun:
    """What happened in a run, what every rule said ahead of it, and what egos were advised."""

    scene: str
    risk: str  # "" where the scene knows no risk profiles
    seed: int
    window_s: tuple[float, float]  # what is scored
    vehicle_hours: float  # in the window
    events: tuple[SafetyEvent, ...]  # of the window and 5 s after it
    traces: Mapping[str, DangerTrace]  # by rule
    advised: Advised
    counterfactuals: tuple[Mapping[str, Any], ...] = ()  # lines of counterfactuals.jsonl
    warnable_s: FloatArray | None = None  # of `events`, as `offences` has it; None: nobody asked
    made_with: Mapping[str, Any] = field(default_factory=dict[str, Any])  # settings, to compare
    notices: tuple[str, ...] = ()
    signs: Mapping[str, SignTrace] = field(default_factory=dict[str, SignTrace])  # to calibrate by


def write_assessed(path: Path, run: AssessedRun) -> None:
    """Write the run to a file. The same run, the same bytes are not promised, the content is.

    Raises InputError where there is no room.
    """
    advised = run.advised
    head = {
        "format": FORMAT,
        "scene": run.scene,
        "risk": run.risk,
        "seed": run.seed,
        "window_s": run.window_s,
        "vehicle_hours": run.vehicle_hours,
        "events": [asdict(event) for event in run.events],
        "counterfactuals": [dict(line) for line in run.counterfactuals],
        "made_with": dict(run.made_with),
        "notices": run.notices,
        "advised": {
            name: getattr(advised, name)
            for name in ("encounters", "switches", "crossings", "sampled", "abstained")
        },
        "rules": {name: trace.ids for name, trace in run.traces.items()},
        "signs": {name: trace.pairs.ids for name, trace in run.signs.items()},
    }
    arrays: dict[str, Any] = {
        "probability": advised.probability,
        "agrees": advised.agrees,
        "always_yield_agrees": advised.always_yield_agrees,
    }
    if run.warnable_s is not None:
        arrays["warnable_s"] = run.warnable_s
    for number, trace in enumerate(run.traces.values()):
        arrays |= {f"{number}.{name}": getattr(trace, name) for name in _TRACE}
    for name, trace in run.signs.items():
        arrays |= {f"{name}.{column}": getattr(trace.pairs, column) for column in _TRACE}
        arrays[f"{name}.signs"] = trace.signs
    packed = io.BytesIO()
    np.savez_compressed(packed, head=np.array(json.dumps(head)), **arrays)
    save_whole(path, packed.getbuffer(), ROOM_OR_OUT)


def read_assessed(path: Path) -> AssessedRun:
    """A run that `write_assessed` wrote. Raises InputError where the file is none, or damaged."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        head: dict[str, Any] = json.loads(str(arrays["head"]))
        if head["format"] != FORMAT:
            raise ValueError(f"format {head['format']}, expected {FORMAT}")
        return _run_of(head, arrays)
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"{path}: expected an assessed run, found damage or another version ({said}); delete "
            "it, and the same command makes it anew"
        ) from None


def _run_of(head: dict[str, Any], arrays: dict[str, Any]) -> AssessedRun:
    low_s, high_s = head["window_s"]

    def trace(key: object, ids: Sequence[str]) -> DangerTrace:
        return DangerTrace(tuple(ids), **{name: arrays[f"{key}.{name}"] for name in _TRACE})

    return AssessedRun(
        scene=head["scene"],
        risk=head["risk"],
        seed=head["seed"],
        window_s=(low_s, high_s),
        vehicle_hours=head["vehicle_hours"],
        events=tuple(SafetyEvent(**event) for event in head["events"]),
        traces={
            name: trace(number, ids) for number, (name, ids) in enumerate(head["rules"].items())
        },
        advised=Advised(
            **head["advised"],
            probability=arrays["probability"],
            agrees=arrays["agrees"],
            always_yield_agrees=arrays["always_yield_agrees"],
        ),
        counterfactuals=tuple(head["counterfactuals"]),
        warnable_s=arrays.get("warnable_s"),
        made_with=head["made_with"],
        notices=tuple(head["notices"]),
        signs={
            name: SignTrace(trace(name, ids), arrays[f"{name}.signs"])
            for name, ids in head["signs"].items()
        },
    )
