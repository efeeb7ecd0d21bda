"""A run to be assessed: every rule looks at it as it happens, then it is told what became of it.

What is scored is a window. Rules begin to look `RUN_IN_S` before it, so that they know what they
would know in the middle of a run; traffic goes on for `RUN_OUT_S` after it, with nobody looking, so
that alerts at its end are judged by what came of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from hatn_sim.assist.agree import agreeing
from hatn_sim.assist.alert import LOOK_S, AlertState, Met, alert, with_touched
from hatn_sim.assist.baselines import RULES
from hatn_sim.assist.danger import HATN, SIGNS_OF
from hatn_sim.assist.evade import warn
from hatn_sim.assist.moment import Moment, Recent
from hatn_sim.assist.settings import AssistSettings
from hatn_sim.assist.suggest import SuggestionState, suggest
from hatn_sim.config import Scenario
from hatn_sim.datatypes import DT_S, Advice, Frame, Predictor, Simulator
from hatn_sim.errors import HatnSimError, InputError, SimulatorError
from hatn_sim.evaluation.pool import Teller
from hatn_sim.evaluation.runs import network_of_process
from hatn_sim.loop import warm_up
from hatn_sim.perception import PerceptionState
from hatn_sim.score.advised import AdviceRecorder
from hatn_sim.score.assessed import AssessedRun, read_assessed, write_assessed
from hatn_sim.score.close_passes import close_passes
from hatn_sim.score.counterfactual import CounterfactualSettings
from hatn_sim.score.dangers import DangerRecorder
from hatn_sim.score.driven import DrivenRecorder
from hatn_sim.score.events import severe_events, vehicle_hours
from hatn_sim.score.offences import warnable_s
from hatn_sim.score.sign_traces import SignRecorder
from hatn_sim.score.what_if import Line, Rates, WhatIf
from hatn_sim.traffic import open_traffic

RUN_IN_S: Final = 3.0
RUN_OUT_S: Final = 5.0
LOOK_EVERY_FRAMES: Final = round(LOOK_S / DT_S)
SAMPLE_EVERY_LOOKS: Final = 3
"""Suggestions are sampled every 0.6 s."""


@dataclass(frozen=True, eq=False)
class AssessPlan:
    """A run that is wanted; a process of its own can make it."""

    label: str  # what it is called in progress and errors
    out: Path  # a file
    scenario: Scenario
    seed: int
    warm_up_s: float
    duration_s: float  # that are scored
    weights: Path | None
    rules: tuple[str, ...]  # of `assist.baselines.RULES`
    settings: AssistSettings
    counterfactuals: Rates | None  # at which advice is judged by branches; None: none is
    made_with: Mapping[str, Any]  # what another run in its place is held against
    keeps_signs: bool = False  # of danger, to calibrate by; nobody is advised then

    @property
    def frames(self) -> int:
        """How many there are, from when rules begin to look."""
        return round((RUN_IN_S + self.duration_s + RUN_OUT_S) / DT_S)


def is_assessed(plan: AssessPlan) -> bool:
    """Whether the run is there. Raises InputError where another is in its place, or damage."""
    if not plan.out.exists():
        return False
    found = read_assessed(plan.out).made_with
    for key, wanted in plan.made_with.items():
        if found.get(key) != wanted:
            raise InputError(
                f"{plan.out}: was made otherwise: expected {key} {wanted}, found "
                f"{found.get(key)}; choose another --out"
            )
    return True


def make_assessed(plan: AssessPlan, teller: Teller) -> int:
    """Simulate, look, score, keep; returns the frames that there were.

    Raises HatnSimError, with the run's label, where the simulator or a file is at fault.
    """
    try:
        run, frames = assess(plan, teller)
    except SimulatorError as error:
        raise SimulatorError(f"{plan.label}: {error}") from None
    except HatnSimError as error:
        raise type(error)(f"{plan.label}: {error}") from None
    plan.out.parent.mkdir(parents=True, exist_ok=True)
    write_assessed(plan.out, run)
    return frames


def assess(plan: AssessPlan, teller: Teller) -> tuple[AssessedRun, int]:
    """The run, and how many frames it had."""
    predictor = network_of_process("hatn", plan.weights, "none")
    with closing(open_traffic(plan.scenario)) as simulator:
        first = warm_up(simulator, simulator.reset(plan.seed), round(plan.warm_up_s / DT_S))
        looking = _Looking(plan, predictor, simulator, first.scene.time_s)
        done = 0
        frame = first
        for index in range(plan.frames):
            teller.tell(index)
            looking.look(index, frame)
            done = index + 1
            if frame.done or done == plan.frames:
                break
            frame = simulator.step()
        looking.finish()
        run = looking.assessed(tuple(simulator.notices))
        if plan.counterfactuals and simulator.cannot_branch is None:
            run = replace(run, warnable_s=warnable_s(simulator, plan.seed, run.events))
    return run, done


class _Looking:
    """Everybody who looks at a run."""

    def __init__(
        self, plan: AssessPlan, predictor: Predictor, simulator: Simulator, start_s: float
    ) -> None:
        self._plan, self._road, self._predictor = plan, simulator.road, predictor
        self._memory: PerceptionState = predictor.init(simulator.road)
        self._told = SuggestionState()
        self._recent = Recent()
        self._alerts = AlertState()
        self._dangers = {name: DangerRecorder() for name in plan.rules}
        self._met = dict.fromkeys(plan.rules, Met())
        self._signs = {name: SignRecorder() for name in SIGNS_OF} if plan.keeps_signs else {}
        self._what_if: WhatIf | None = None
        self._notices: tuple[str, ...] = ()
        if plan.counterfactuals and simulator.cannot_branch is not None:
            self._notices = (f"without counterfactuals: {simulator.cannot_branch}",)
        elif plan.counterfactuals:
            costs = CounterfactualSettings()
            self._what_if = WhatIf(simulator, plan.counterfactuals, plan.seed, costs)
        self._lines: list[Line] = []
        low_s = start_s + RUN_IN_S
        self._window_s = (low_s, low_s + plan.duration_s)
        self._advice = AdviceRecorder(*self._window_s)
        self._driven = DrivenRecorder()

    def look(self, index: int, frame: Frame) -> None:
        """The next frame."""
        self._driven.add(frame)
        if frame.scene.time_s >= self._window_s[1]:
            return
        scene = frame.scene
        self._memory = self._predictor.observe(self._memory, scene)
        if index % LOOK_EVERY_FRAMES:
            return
        prediction = self._predictor.predict(self._memory)
        earlier = self._recent.earlier(scene.time_s)
        self._recent = self._recent.with_newest(scene.time_s, prediction)
        seen, settings = self._memory.seen, self._plan.settings
        moment = Moment(self._road, seen, prediction, earlier, settings)
        if self._signs:
            for name, recorder in self._signs.items():
                recorder.add(scene.time_s, scene.ids, SIGNS_OF[name](moment))
            return
        self._told, suggestions = suggest(self._told, self._road, scene, prediction, None)
        sampled = index % (LOOK_EVERY_FRAMES * SAMPLE_EVERY_LOOKS) == 0
        dangers = {name: RULES[name](moment) for name in {*self._dangers, HATN}}
        self._alerts, alerts = alert(
            self._alerts, scene, dangers[HATN], settings, None, partial(warn, moment)
        )
        suggestions = agreeing(suggestions, self._alerts.told(scene.time_s, settings), scene)
        told = Advice(prediction, suggestions, alerts)
        self._advice.add(index, scene.time_s, told, sampled)
        for name, recorder in self._dangers.items():
            self._met[name], found = with_touched(self._met[name], scene, dangers[name])
            recorder.add(scene.time_s, scene.ids, found)
        if self._what_if is not None:
            # Advice is judged in the window only; the whole of a branch lies in the run.
            asks = scene.time_s >= self._window_s[0]
            self._lines += self._what_if.see(index, frame, told, asks)

    def finish(self) -> None:
        """Nothing more will come."""
        if self._what_if is not None:
            self._lines += self._what_if.finish()

    def assessed(self, notices: tuple[str, ...]) -> AssessedRun:
        """What is kept."""
        plan, driven = self._plan, self._driven.driven()
        return AssessedRun(
            scene=plan.scenario.name,
            risk=plan.scenario.risk or "",
            seed=plan.seed,
            window_s=self._window_s,
            vehicle_hours=vehicle_hours(driven, *self._window_s),
            events=(*severe_events(driven), *close_passes(driven)),
            traces={name: recorder.trace() for name, recorder in self._dangers.items()},
            advised=self._advice.advised(driven),
            counterfactuals=tuple(self._lines),
            made_with=plan.made_with,
            notices=(*notices, *self._notices),
            signs={name: recorder.trace() for name, recorder in self._signs.items()},
        )
