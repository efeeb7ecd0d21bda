"""A run to be scored: perceived at 10 Hz, predicted on scored frames only, logged as any other."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

from hatn_sim.config import Scenario
from hatn_sim.datatypes import DT_S, Advice, Frame, Predictor
from hatn_sim.errors import HatnSimError, InputError, SimulatorError
from hatn_sim.evaluation.pool import Teller
from hatn_sim.labels import SAMPLE_EVERY_FRAMES
from hatn_sim.line_choice import LineChoice
from hatn_sim.log import RunWriter, read_run
from hatn_sim.log.choice_file import write_run_choice
from hatn_sim.log.head_file import read_head
from hatn_sim.log.road_file import ROAD_FILE, write_road
from hatn_sim.log.schema import RUN_FILE
from hatn_sim.loop import Adviser, LineSource, run, warm_up
from hatn_sim.perception import choose_lines_by
from hatn_sim.predictors.find import READS_WEIGHTS, load_predictor
from hatn_sim.simulators.sumo_config import named_files
from hatn_sim.traffic import found_out, open_traffic

UNCOMPARED: Final = ("command", "settings.ids_by", "settings.doubts", "settings.signals")
"""What of a header may differ in a run that is used again, or is known of opened traffic alone."""
OF_LINES: Final = tuple(
    f"settings.{name}" for name in ("tracks", "recordings", "lines_from", "choice_from")
)
"""What hangs on lines and on the choice among them, once they are known."""
OPTIONS: Final = {
    "weights_sha256": "--weights (their content is another)",
    "trained_on": "--weights (their content is another)",
    "adapt": "--adapt",
    "settings.predictor": "--predictors",
    "settings.compare": "--predictors",
    "settings.duration_s": "--duration",
    "settings.warm_up_s": "--warm-up",
    "settings.lines": "--lines",
    "settings.density": "--density",
    "settings.risk": "--risk",
    "settings.map": "--map",
    "settings.lines_from": "--lines-from, or other recordings in --tracks to draw lines from",
    "settings.choice_from": "--choice-from, or other recordings in --tracks to fit it to",
    "settings.tracks": "--tracks",
    "settings.recordings": "--recordings",
    "versions": "versions of what is installed (see `hatn-sim doctor`)",
}
"""What of a header comes from which option of `evaluate`, the telling ones first."""


@dataclass(frozen=True, eq=False)
class RunPlan:
    """A run that is wanted; a process of its own can make it."""

    label: str  # what it is called in progress and errors
    out: Path
    scenario: Scenario
    seed: int | None  # None: of recorded traffic
    warm_up_s: float
    duration_s: float | None  # None: all of a recording
    predictors: tuple[str, ...]
    weights: Path | None
    adapt: str
    lines: LineSource
    header: Mapping[str, Any]  # of its run.json
    choice: LineChoice | None = None  # of lines, for all predictors; None: each has its own

    @property
    def frames(self) -> int | None:
        """How many are wanted; None: to the end."""
        return None if self.duration_s is None else max(1, round(self.duration_s / DT_S))


@dataclass(frozen=True)
class Made:
    """What is to be told of a run that has been made."""

    frames: int
    notices: tuple[str, ...]


def is_there(plan: RunPlan, unknown: Sequence[str] = ()) -> bool:
    """Whether the run has been made already, and finished.

    `unknown`: keys of the header that are not known yet, and may differ.

    Raises InputError where something else is in its place.
    """
    if not plan.out.exists():
        return False
    if not (plan.out / RUN_FILE).is_file() and any(plan.out.iterdir()):
        raise InputError(f"{plan.out}: expected a run of this evaluation; choose another --out")
    if not (plan.out / RUN_FILE).is_file():
        return False
    if not read_head(plan.out)["finished"]:  # whatever else is lost of it: it is made again
        return False
    there = read_run(plan.out)
    found, wanted = _comparable(there.header), _comparable(plan.header)
    differing = {
        key: (found.get(key), value)
        for key, value in wanted.items()
        if key not in unknown and found.get(key) != value
    }
    if differing:
        raise InputError(
            f"{plan.out}: was made with other {_option(differing)}; choose another --out, or "
            "remove the run"
        )
    made_at = (plan.out / RUN_FILE).stat().st_mtime
    newer = [path for path in _sources(plan) if path.stat().st_mtime > made_at]
    if newer:
        raise InputError(f"{plan.out}: is older than {newer[0]}; choose another --out")
    return True


def _comparable(header: Mapping[str, Any]) -> dict[str, Any]:
    """A header as JSON gives it back, flat, without what may differ."""
    plain: dict[str, Any] = json.loads(json.dumps(dict(header)))
    flat: dict[str, Any] = {}
    for key, value in plain.items():
        inside = value.items() if isinstance(value, dict) else [("", value)]
        flat |= {f"{key}.{name}" if name else key: each for name, each in inside}
    return {key: value for key, value in flat.items() if key not in UNCOMPARED}


def _option(differing: Mapping[str, tuple[Any, Any]]) -> str:
    """What a user calls the most telling of some keys of a header, with what is there and here."""
    for known, option in OPTIONS.items():
        for key, (there, here) in differing.items():
            if key == known:
                plain = all(isinstance(one, str | int | float | None) for one in (there, here))
                return f"{option} ({there} there, {here} here)" if plain else option
            if key.startswith(f"{known}."):
                return option
    return next(iter(differing)).removeprefix("settings.")


def _sources(plan: RunPlan) -> list[Path]:
    """The user's own files that the traffic is made from."""
    recorded, config = plan.scenario.recorded, plan.scenario.config_path
    if recorded is None:
        paths = [config, *named_files(config)] if plan.scenario.is_user_config else []
    else:
        paths = [*recorded.tracks, *([] if recorded.map_path is None else [recorded.map_path])]
    return [path for path in paths if path.is_file()]


def make_run(plan: RunPlan, teller: Teller) -> Made:
    """Simulate or play, predict, log. What is left of a run that was broken off is made anew.

    Raises HatnSimError, with the run's label, where one of these goes wrong; what was logged until
    then stays.
    """
    try:
        return _make(plan, teller)
    except SimulatorError as error:
        command = plan.header["command"]
        raise SimulatorError(f"{plan.label}: {error}; repeat with `{command}`") from None
    except HatnSimError as error:
        raise type(error)(f"{plan.label}: {error}") from None


def _make(plan: RunPlan, teller: Teller) -> Made:
    shutil.rmtree(plan.out, ignore_errors=True)
    advisers = [
        # Nobody is advised: suggestions and alerts are not what is scored.
        Adviser(predictor_of_process(name, plan.weights, plan.adapt), plan.lines, frozenset())
        for name in plan.predictors
    ]
    with closing(open_traffic(plan.scenario)) as simulator:
        first = simulator.reset(plan.seed or 0)
        first = warm_up(simulator, first, round(plan.warm_up_s / simulator.dt_s))
        if plan.choice is not None:
            choose_lines_by(simulator.road, plan.choice)
        settings = {**plan.header["settings"], **found_out(simulator, first)}
        total = plan.frames
        with RunWriter(plan.out, {**plan.header, "settings": settings}) as writer:
            write_road(plan.out / ROAD_FILE, simulator.road.lanes.values())
            write_run_choice(plan.out, advisers[0].predictor, plan.choice)

            def write(index: int, frame: Frame, advice: Mapping[str, Advice]) -> None:
                teller.tell(index)
                writer.write(index, frame, advice)

            frames = run(
                simulator,
                advisers,
                first,
                sys.maxsize if total is None else total,
                write,
                every_frames=SAMPLE_EVERY_FRAMES,
            )
        notices = list(simulator.notices)
    if total is not None and frames < total:
        notices.append(f"the scene was over after {frames} of {total} steps")
    return Made(frames, tuple(notices))


def predictor_of_process(name: str, weights: Path | None, adapt: str) -> Predictor:
    """A predictor for one run. Networks, which keep nothing of a run, are loaded once a process."""
    load = network_of_process if name in READS_WEIGHTS else load_predictor
    return load(name, weights, adapt)


@cache
def network_of_process(name: str, weights: Path | None, adapt: str) -> Predictor:
    """A network, loaded once a process, for it keeps nothing of a run."""
    return load_predictor(name, weights, adapt)
